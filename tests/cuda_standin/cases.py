"""Run kernels of CUDA on the CPU and compare them with LLVM's: a process of its own for some cases.

    python -m cuda_standin.cases FOLDER CASE ...

with the environment of `standin.environment`. What Dr.Jit generates for a case is left in
FOLDER/CASE. Prints a line of JSON for each case: its name and what `differences` returns.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import mitsuba_bezier as mb  # isort: skip (first: it chooses Dr.Jit's LLVM)
import drjit as dr
import numpy as np
from drjit import cuda, llvm

from mitsuba_bezier.geometry.aspheres import EvenAsphere
from mitsuba_bezier.geometry.trim_cells import trim_cells
from mitsuba_bezier.geometry.trims import Trims, square_map
from mitsuba_bezier.kernels import wavefront
from mitsuba_bezier.kernels.curvature import affine_second_partials, evaluate_second
from mitsuba_bezier.kernels.float64_use import set_float64
from mitsuba_bezier.kernels.instances import build_instances, intersect_instances
from mitsuba_bezier.kernels.patch import affine_partials, pack
from mitsuba_bezier.kernels.structure import build_structure
from mitsuba_bezier.kernels.traverse import intersect
from mitsuba_bezier.kernels.trim_table import build_table
from mitsuba_bezier.leaves.builder import build_leaves
from mitsuba_bezier.leaves.records import (
    GRAPHS,
    INVERTED_KINDS,
    ClosedFormLeaves,
    GraphLeaves,
    LeafSettings,
    Leaves,
)
from mitsuba_bezier.leaves.revolution import revolution_leaf

__all__ = ["CASES"]

COUNT = 400
GENERAL = LeafSettings(closed_form=False)
#: A structure for the array types of an argument.
Structures = Callable[[Any], Any]


def rays(count: int = COUNT) -> list[np.ndarray]:
    """Return the columns of origins and directions, from all sides to what is in the unit ball.

    Half of them start inside of it, and a quarter graze the unit sphere.
    """
    rng = np.random.default_rng(7)
    a, b, c = rng.normal(size=(3, count, 3))
    a /= np.linalg.norm(a, axis=1, keepdims=True)
    kind = np.arange(count)[:, None] % 4
    along = np.cross(a, c) / np.linalg.norm(np.cross(a, c), axis=1, keepdims=True)
    depth = 1 - 10.0 ** -rng.uniform(2, 4, (count, 1))
    b *= 1.1 * np.cbrt(rng.random((count, 1))) / np.linalg.norm(b, axis=1, keepdims=True)
    o = np.select([kind == 0, kind == 1], [a * depth - 2.5 * along, a * 2.5], a * 0.4)
    d = np.where(kind == 0, along, b - o)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    return [np.ascontiguousarray(x, dtype=np.float32) for x in (*o.T, *d.T)]


def plain(leaves: Leaves) -> Structures:
    return lambda like: build_structure(leaves, like)


def at_infinity() -> mb.BezierTriangles:
    """The image of a sphere under a collineation that takes a plane that cuts it to infinity.

    Its general leaves are projective, some of them.
    """
    m = np.eye(4)
    m[3] = (0.2, 0.1, 0.9, 0.6)
    return mb.sphere(cover="octants").transform(m)


def inverted() -> Leaves:
    """Triangles of a sphere whose edges are no circles: parameters by Newton's method."""
    patches = mb.sphere(cover="octants").elevate(1)
    corners = [(0.8, 0.1, 0.1), (0.2, 0.7, 0.1), (0.1, 0.2, 0.7)]
    leaves = build_leaves(patches.subtriangle(np.array(corners)))
    assert leaves.kinds <= INVERTED_KINDS
    return leaves


def trimmed() -> Structures:
    """A torus of which a window is left in each patch, with two straight sides and an arc."""
    patches = mb.torus(tube=0.3)
    corners = [(0.9, 0.05, 1.0), (0.05, 0.05, 1.0), (0.05, 0.9, 1.0)]
    arc = [corners[2], (0.3, 0.3, 0.6), corners[0]]
    window = [*map(list, pairwise(corners)), arc]
    size = len(patches)
    trims = Trims([window], [0] * size, [square_map()] * size, [[[0, 0], [1, 1]]] * size)
    leaves = build_leaves(patches)
    cells, cell, keep = trim_cells(trims, leaves.patch, leaves.corners())
    kept = leaves.select(keep)
    return lambda like: build_structure(kept, like, (build_table(cells, like), cell[keep]))


def several_kinds() -> Leaves:
    """Closed forms beside graphs, affine and projective: all branches in one kernel."""
    parts = [mb.sphere(cover="tetrahedral"), mb.torus(tube=0.3), at_infinity()]
    leaves = [build_leaves(parts[0]), build_leaves(parts[1]), build_leaves(parts[2], GENERAL)]
    first = np.cumsum([0, *(len(p) for p in parts)])
    return Leaves.join(
        [x.of_patches(k + np.arange(len(p))) for x, p, k in zip(leaves, parts, first.tolist())]
    )


def aspheres() -> Leaves:
    """Two even aspheres, one turned and with a hole, beside a closed form and graphs."""
    parts = [build_leaves(mb.sphere(radius=0.3)), build_leaves(mb.torus(tube=0.2))]
    turned = np.diag([0.9, 0.9, 0.9, 1.0])
    turned[:3, :3] = turned[:3, :3] @ [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    bowl = EvenAsphere(0.8, 1.0, -0.4, (0, 0.05, -0.1, 0.07, 0, -0.02, 0, 0.01))
    ring = EvenAsphere(-0.6, 0.9, -3.0, (0.1, -0.3, 0.12), inner=0.4)
    parts += [
        Leaves(GraphLeaves.zeros(), ClosedFormLeaves.zeros(), revolution_leaf(surface, matrix))
        for surface, matrix in ((bowl, np.eye(4)), (ring, turned))
    ]
    counts = [int(part.patch.max()) + 1 for part in parts]
    first = np.cumsum([0, *counts])
    return Leaves.join([p.of_patches(k + np.arange(n)) for p, k, n in zip(parts, first, counts)])


def only_an_asphere() -> Leaves:
    return aspheres().select(np.array([-2]))


STRUCTURES: dict[str, Callable[[], Structures]] = {
    "tetrahedral": lambda: plain(build_leaves(mb.sphere(cover="tetrahedral"))),
    "octants": lambda: plain(build_leaves(mb.sphere(cover="octants"))),
    "capped cone": lambda: plain(build_leaves(mb.cone(capped=True))),
    "inverted": lambda: plain(inverted()),
    "general": lambda: plain(build_leaves(mb.sphere(cover="octants"), GENERAL)),
    "torus": lambda: plain(build_leaves(mb.torus(tube=0.3))),
    "infinity": lambda: plain(build_leaves(at_infinity(), GENERAL)),
    "several kinds": lambda: plain(several_kinds()),
    "trims": trimmed,
    "aspheres": lambda: plain(aspheres()),
    "an asphere": lambda: plain(only_an_asphere()),
}


def found(structures: Structures, like: Any, any_hit: bool) -> dict[str, np.ndarray]:
    columns = [like(x) for x in rays()]
    hit = intersect(structures(like), columns[:3], columns[3:], like(np.inf), True, any_hit)
    dr.eval(hit)
    return {name: np.array(x) for name, x in zip(hit._fields, hit)}


def in_batch(structures: Structures, like: Any, any_hit: bool) -> dict[str, np.ndarray]:
    wavefront._MIN_RAYS, wavefront._RAYS_A_LANE = (
        16,
        5,
    )  # all rounds, and lanes that take several rays
    columns = [like(x) for x in rays()]
    s = structures(like)
    assert s.kinds >= GRAPHS
    hit = wavefront.intersect_wavefront(s, columns[:3], columns[3:], like(np.inf), True, any_hit)
    dr.eval(hit)
    return {name: np.array(x) for name, x in zip(hit._fields, hit)}


def among_instances(patches: mb.BezierTriangles, like: Any, any_hit: bool) -> dict[str, np.ndarray]:
    leaves = build_leaves(patches)
    s = build_structure(leaves, like, None, np.zeros(len(leaves), dtype=int))
    rng = np.random.default_rng(3)
    count = 12
    matrices = np.tile(np.eye(4), (count, 1, 1))
    matrices[:, :3, :3] *= 0.35 * rng.uniform(0.5, 1, (count, 1, 1))
    matrices[:, :3, 3] = rng.uniform(-0.8, 0.8, (count, 3))
    low, high = patches.bounds()[:, 0].min(axis=0), patches.bounds()[:, 1].max(axis=0)
    boxes = np.stack([low, high])[None] * matrices[:, 0, 0, None, None] + matrices[:, None, :3, 3]
    instances = build_instances(s, boxes, np.zeros(count, dtype=int), matrices, like)
    columns = [like(x) for x in rays()]
    hit, instance = intersect_instances(
        instances, columns[:3], columns[3:], like(np.inf), True, any_hit
    )
    dr.eval(hit, instance)
    return {name: np.array(x) for name, x in zip((*hit._fields, "instance"), (*hit, instance))}


Run = Callable[[Any], "dict[str, np.ndarray]"]


def _case(run: Callable[..., Any], make: Callable[[], Any], any_hit: bool) -> Run:
    return lambda like: run(make(), like, any_hit)


CASES: dict[str, Run] = {}
for _any, _kind in ((False, "closest"), (True, "any")):
    for _name, _make in STRUCTURES.items():
        CASES[f"{_name}, {_kind}"] = _case(found, _make, _any)
    CASES[f"batch, {_kind}"] = _case(in_batch, STRUCTURES["several kinds"], _any)
    CASES[f"instances, {_kind}"] = _case(among_instances, lambda: mb.torus(tube=0.3), _any)


def _points(like: Any) -> dict[str, np.ndarray]:
    """Points with first and second partials, from nets."""
    patches = mb.torus(tube=0.3)
    nets = like(pack(patches.control_points).ravel())
    rng = np.random.default_rng(1)
    uv = rng.dirichlet((1, 1, 1), COUNT)
    patch = dr.uint32_array_t(like)(rng.integers(0, len(patches), COUNT).astype(np.uint32))
    u, v = (like(np.ascontiguousarray(uv[:, k], dtype=np.float32)) for k in range(2))
    f64 = dr.float64_array_t(like)  # as hits are
    first = affine_partials(*evaluate_second(nets, patches.degree, patch, f64(u), f64(v))[:3])
    second = affine_second_partials(evaluate_second(nets, patches.degree, patch, u, v))
    values = [x for y in (*first, *second) for x in y]
    dr.eval(values)
    return {str(i): np.array(x) for i, x in enumerate(values)}


CASES["points"] = _points


def _reciprocals(like: Any) -> dict[str, np.ndarray]:
    """What is not to be done: `dr.rcp` in float64, which has 20 bits on CUDA."""
    x = dr.rcp(dr.float64_array_t(like)(np.linspace(1.0, 2.0, COUNT)))
    dr.eval(x)
    return {"x": np.array(x)}


CASES["dr.rcp"] = _reciprocals


def differences(name: str, one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> dict:
    """Compare what was found on CUDA (`one`) with what LLVM found.

    Returns the share of `hits`, how many rays differ in what they hit, and the largest
    differences of t (relative), u and v where they hit the same.
    """
    if "valid" not in one:
        scale = {k: 1 + np.abs(x).max() for k, x in other.items()}
        off = max(float(np.abs(one[k] - x).max() / scale[k]) for k, x in other.items())
        return {"values": off}
    valid = other["valid"]
    result = {"hits": float(valid.mean()), "rays": len(valid)}
    different = one["valid"] != valid
    if "closest" not in name:
        return {**result, "different": int(different.sum())}
    both = one["valid"] & valid
    for key in {"patch", "instance"} & set(one):
        different |= both & (one[key] != other[key])
    same = ~different & valid
    result["different"] = int(different.sum())
    for key, scale in (("t", np.abs(other["t"])), ("u", 1.0), ("v", 1.0)):
        off = np.abs(one[key] - other[key]) / scale
        result[key] = float(off[same].max(initial=0.0))
    return result


def main(folder: Path, names: list[str]) -> None:
    # as plugins.scene_data records kernels
    for flag in (dr.JitFlag.SymbolicLoops, dr.JitFlag.SymbolicConditionals):
        dr.set_flag(flag, True)
    for name in names:
        wide = name.startswith("float64: ")
        out = folder / name
        out.mkdir(parents=True)
        os.environ["CUDA_STANDIN_OUT"] = str(out)
        dr.flush_kernel_cache()  # so that kernels of another case are loaded again
        pairs = name.startswith("pairs: ")
        run = CASES[name.removeprefix("float64: ").removeprefix("pairs: ")]
        result = {"case": name}
        set_float64("never" if pairs else "always")
        on_cuda = run(cuda.Float64 if wide else cuda.Float)
        set_float64("always")
        if os.environ.get("CUDA_STANDIN_TRANSLATE"):  # else nothing was run
            on_llvm = run(llvm.Float64 if wide else llvm.Float)
            result.update(differences(name, on_cuda, on_llvm))
        print(json.dumps(result), flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
