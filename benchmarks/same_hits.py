"""Tell whether two states of the project give the same hits, to the last bit.

``python benchmarks/same_hits.py BEFORE AFTER``: each is a folder with a checkout, or a file that
``python benchmarks/same_hits.py --write FILE`` wrote with the package that is installed. Traces
seeded rays, closest and any hit, through the sets of `same_hits_sets`, which have all kinds of
leaves, and renders a few small images; prints for each set what differs: hits, images, and the
number of operations of the kernels, as Dr.Jit counts them.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

HERE = Path(__file__).resolve().parent
#: Rays a set; those of `Case.many` get enough for the wavefront of incoherent rays.
RAYS, MANY = 20_000, 80_000


def rays_at(box: np.ndarray, targets: np.ndarray, seed: int) -> Any:
    """Return rays at points of a surface and at some beside them, from near by and from far away.

    Some have an end, and a few are none at all.
    """
    import mitsuba as mi

    rng = np.random.default_rng(seed)
    count = len(targets)
    middle, size = box.mean(axis=0), float(np.ptp(box, axis=0).max())
    targets = targets.copy()
    targets[::4] += rng.normal(scale=0.2 * size, size=targets[::4].shape)
    o = middle + 2 * size * rng.normal(size=(count, 3))
    o[::7] = targets[::7] + 1e-3 * size * rng.normal(size=o[::7].shape)
    o[::11] = middle + 50 * size * rng.normal(size=o[::11].shape)
    d = targets - o
    d[::3] /= np.maximum(np.linalg.norm(d[::3], axis=1, keepdims=True), 1e-30)
    d[::101, 0] = 0.0
    d[::1009] = 0.0
    o[1::1009] = np.nan
    ends = np.full(count, np.inf)
    ends[::5] = rng.random(len(ends[::5])) * 3 * size
    ray = mi.Ray3f(mi.Point3f(*o.T.copy()), mi.Vector3f(*d.T.copy()))
    ray.maxt = mi.Float(ends)
    return ray


def points_on(patches: Any, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a box about the finite middle of patches, and points on them, near edges too."""
    rng = np.random.default_rng(seed)
    uv = rng.dirichlet([0.5, 0.5, 0.5], count)[:, :2]
    homogeneous = patches.evaluate(rng.integers(0, len(patches), count), uv)
    with np.errstate(all="ignore"):
        points = homogeneous[:, :3] / homogeneous[:, 3:]
    finite = np.isfinite(points).all(axis=1)
    low, high = np.quantile(points[finite], [0.02, 0.98], axis=0)
    reach = 3 * np.ptp([low, high], axis=0).max()
    points = np.where(finite[:, None], points, low)
    return np.stack([low, high]), np.clip(points, low - reach, high + reach)


def trace(case: Any, folder: Path) -> dict[str, np.ndarray]:
    """Return what rays find in a set, and how many operations the kernels have."""
    import drjit as dr
    import mitsuba as mi

    import mitsuba_bezier as mb

    mi.set_variant("llvm_ad_rgb")
    scene, patches = case.load(folder)
    count = MANY if case.many else RAYS
    ray = rays_at(*points_on(patches, count, 1), seed=2)
    dr.eval(ray)
    found: dict[str, np.ndarray] = {}
    dr.kernel_history_clear()
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        if case.double:
            found.update(trace_double(patches, ray))
        for name, coherent in (("coherent", True), ("any order", False)):
            if case.double or (not coherent and not case.many):
                continue
            si = mb.ray_intersect(scene, ray, coherent=coherent)
            shape = dr.reinterpret_array(mi.UInt32, si.shape)
            fields = (si.t, *si.uv, si.prim_index, shape, *si.p, *si.n, *si.dp_du, *si.dp_dv)
            dr.eval(*fields)
            # all have 32 bits, and these are what is compared
            found[f"{name}, closest"] = np.stack([np.array(x).view(np.uint32) for x in fields])
        if not case.double:
            found["any hit"] = np.array(mb.ray_test(scene, ray))
        # uploads and the like aside
        history = [k for k in dr.kernel_history() if k.get("operation_count", 0) > 100]
    found["operations"] = np.array([k["operation_count"] for k in history])
    return found


def trace_double(patches: Any, ray: Any) -> dict[str, np.ndarray]:
    """Return what rays in float64 find; no variant of Mitsuba's wheels has them."""
    import drjit as dr
    from drjit.llvm import Float64

    from mitsuba_bezier.kernels.structure import build_structure
    from mitsuba_bezier.kernels.traverse import intersect
    from mitsuba_bezier.leaves.builder import build_leaves

    structure = build_structure(build_leaves(patches), Float64)
    o, d = ([Float64(dr.detach(x)) for x in v] for v in (ray.o, ray.d))
    hit = intersect(structure, o, d, Float64(dr.detach(ray.maxt)))
    dr.eval(hit)
    any_hit = intersect(structure, o, d, Float64(dr.detach(ray.maxt)), any_hit=True)
    return {
        "closest": np.stack([np.array(x, dtype=float) for x in hit]),
        "any hit": np.array(any_hit.valid),
    }


def render(case: Any, folder: Path) -> dict[str, np.ndarray]:
    """Return an image, and for those that are differentiable a gradient."""
    import drjit as dr
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    scene, integrator, key = case.load(folder)
    found = {"image": np.array(mi.render(scene, integrator=integrator, spp=4, seed=1))}
    if key:
        params = mi.traverse(scene)
        dr.enable_grad(params[key])
        params.update()
        image = mi.render(scene, params, integrator=integrator, spp=4, seed=1)
        dr.backward(dr.mean(dr.square(image), axis=None))
        found["gradient"] = np.array(dr.grad(params[key]))
    return found


def write(path: str, only: str) -> None:
    """Trace and render all sets with the package that is found, and write what is found."""
    import drjit as dr
    from same_hits_sets import IMAGES, SETS

    import mitsuba_bezier as mb

    # one thread: sums of gradients and splats are in order
    dr.set_thread_count(1)
    print(f"{path}: {Path(mb.__file__).parent}", file=sys.stderr)
    out = {}
    with tempfile.TemporaryDirectory() as folder:
        for number, (name, case) in enumerate([*SETS.items(), *IMAGES.items()]):
            if not re.search(only, name):
                continue
            place = Path(folder) / str(number)
            place.mkdir()
            for key, values in (trace if name in SETS else render)(case, place).items():
                out[f"{name}: {key}"] = values
    with open(path, "wb") as file:
        np.savez_compressed(file, **out)


def results(state: str, only: str) -> dict[str, np.ndarray]:
    """Return what was written for a state, or what its package finds now."""
    if Path(state).is_dir():
        with tempfile.TemporaryDirectory() as folder:
            path = str(Path(folder) / "found.npz")
            environment = {**os.environ, "PYTHONPATH": str(Path(state).resolve())}
            command = [sys.executable, __file__, "--write", path, "--only", only]
            subprocess.run(command, check=True, env=environment, cwd=HERE)
            return results(path, only)
    with np.load(state) as found:
        return {key: found[key] for key in found.files if re.search(only, key.split(":")[0])}


def difference(name: str, a: np.ndarray | None, b: np.ndarray | None) -> str:
    """Say what differs; nothing if all is equal to the last bit."""
    if a is None or b is None:
        return "only in one of both"
    if a.shape == b.shape and a.dtype == b.dtype and a.tobytes() == b.tobytes():
        return ""
    if name.endswith("operations"):
        return f"{a.sum()} -> {b.sum()}"
    if a.shape != b.shape:
        return f"shape {a.shape} -> {b.shape}"
    return f"{(~((a == b) | ((a != a) & (b != b)))).sum()} of {a.size} numbers"


def main() -> int:
    """Compare two states, or write one; return 1 where hits or images differ."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("states", nargs="*", help="two folders of checkouts, or files")
    parser.add_argument("--write", metavar="FILE", help="write what the installed package finds")
    parser.add_argument("--only", default="", help="only sets whose names match this pattern")
    options = parser.parse_args()
    if options.write:
        write(options.write, options.only)
        return 0
    if len(options.states) != 2:
        parser.error("expected two states: folders of checkouts, or files of --write")
    before, after = (results(state, options.only) for state in options.states)
    table = Table(title="Sets in which something differs")
    for column in ("set", "what", "before -> after"):
        table.add_column(column)
    bad = 0
    keys = [*before, *(key for key in after if key not in before)]
    for key in keys:
        text = difference(key, before.get(key), after.get(key))
        if text:
            table.add_row(*key.split(": ", 1), text)
            bad += not key.endswith(": operations")
    console = Console()
    if table.row_count:
        console.print(table)
    sets = len({key.split(":")[0] for key in keys})
    console.print(f"{sets} sets, {len(keys)} results: {bad} differ in hits or images")
    total = [sum(int(s[k].sum()) for k in s if k.endswith("operations")) for s in (before, after)]
    console.print(f"operations of all kernels: {total[0]} -> {total[1]}")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
