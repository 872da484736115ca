"""What a step of a fit costs: memory over many steps, and time beside `prb` on a mesh.

    python benchmarks/derivative_costs.py [--steps 100] [--side 48] [--spp 16] [--json FILE]

A wavy surface of patches and a mesh of as many numbers (coordinates of its vertices) fill the same
view under the same lamp. A step changes all of them, renders, and takes the derivative of a loss
in reverse mode: by `bezierpath` on the patches, by Mitsuba's `prb` on the mesh, by turns. Also a
lens of patches, whose derivatives follow light through glass. Memory is what the process holds
after 10 steps and after all.
"""

from __future__ import annotations

import argparse
import gc
import json
import resource
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mitsuba_bezier as mb  # before Dr.Jit: chooses its LLVM

# isort: split
import drjit as dr
import mitsuba as mi
import numpy as np
from common import machine, set_variant
from rich.console import Console
from rich.table import Table

from mitsuba_bezier._files import write_file
from mitsuba_bezier.geometry import bernstein

#: Patches along a side; two triangles fill a cell.
CELLS = 4


def wavy(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the heights of the surface."""
    return 0.1 * np.sin(2.1 * x + y) + 0.07 * np.cos(1.7 * y - x)


def patches() -> np.ndarray:
    """Return cubic patches over a square."""
    ij = np.array(bernstein.multi_indices(3))[:, :2] / 3
    corners = np.linspace(-2, 2, CELLS + 1)
    step, nets = corners[1] - corners[0], []
    for a in corners[:-1]:
        for b in corners[:-1]:
            for turned in (False, True):
                x = a + step * (1 - ij[:, 0] if turned else ij[:, 0])
                y = b + step * (1 - ij[:, 1] if turned else ij[:, 1])
                nets.append(np.c_[x, y, wavy(x, y), np.ones(len(x))])
    return np.array(nets)


def mesh(numbers: int) -> Any:
    """Return a mesh of about so many coordinates."""
    side = round(np.sqrt(numbers / 3))
    grid = np.linspace(-2, 2, side)
    x, y = (a.ravel() for a in np.meshgrid(grid, grid, indexing="ij"))
    at = np.arange(side * side).reshape(side, side)
    a, b, c, d = (m.ravel() for m in (at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]))
    faces = np.concatenate([np.c_[a, b, c], np.c_[a, c, d]])
    made = mi.Mesh("mesh", side * side, len(faces))
    params = mi.traverse(made)
    params["vertex_positions"] = mi.Float(np.c_[x, y, wavy(x, y)].astype(np.float32).ravel())
    params["faces"] = mi.UInt32(faces.astype(np.uint32).ravel())
    params.update()
    return made


def scene_of(shape: Any, side: int, lens: bool = False) -> Any:
    """Return a scene with one shape that has all of the view."""
    place = mi.ScalarTransform4f()
    camera = {
        "type": "perspective",
        "fov": 25,
        "to_world": place.look_at([0, 0, 5], [0, 0, 0], [0, 1, 0]),
        "film": {"type": "hdrfilm", "width": side, "height": side, "pixel_format": "rgb"},
    }
    lamp = {
        "type": "rectangle",
        "to_world": place.look_at([0, 0, -4 if lens else 6], [0, 0, 0], [0, 1, 0]).scale(5),
        "emitter": {"type": "area", "radiance": 2.0},
    }
    return mi.load_dict({"type": "scene", "camera": camera, "shape": shape, "lamp": lamp})


def stepper(scene: Any, key: str, integrator: dict[str, Any], spp: int) -> Callable[[int], None]:
    """Return a step of a fit."""
    params = mi.traverse(scene)
    first = type(params[key])(params[key])
    made = mi.load_dict({**integrator, "max_depth": 4})
    rng = np.random.default_rng(0)

    def step(k: int) -> None:
        change = rng.normal(size=first.shape) * 1e-4
        if change.ndim == 3:
            change[..., 3] = 0
        moved = first + type(first)(change.astype(np.float32))
        dr.enable_grad(moved)
        params[key] = moved
        params.update()
        image = mi.render(scene, params, integrator=made, spp=spp, seed=k)
        dr.backward(dr.mean(dr.square(image - 0.5), axis=None))
        gradient = dr.grad(moved)
        dr.eval(gradient)
        dr.sync_thread()
        if not np.isfinite(np.array(gradient)).all():
            raise SystemExit(f"step {k}: the gradient is not finite")

    return step


def held() -> float:
    """Return the memory that the process holds now, in MB."""
    gc.collect()
    dr.sync_thread()
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 1e6


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--steps", type=int, default=100, help="of each (100)")
    parser.add_argument("--side", type=int, default=48, help="of the image (48)")
    parser.add_argument("--spp", type=int, default=16, help="samples a pixel (16)")
    parser.add_argument("--variant", default="llvm_ad_rgb")
    parser.add_argument("--json", metavar="FILE")
    options = parser.parse_args()
    set_variant(options.variant)
    net = patches()
    numbers = net.size
    tensor = mi.TensorXf(net.astype(np.float32).ravel(), shape=net.shape)
    points = {"type": "beziertriangle", "control_points": tensor}
    glass = {**points, "bsdf": {"type": "dielectric"}}
    path, prb = {"type": "bezierpath"}, {"type": "prb"}
    made = {
        f"patches, {numbers} numbers, bezierpath": (points, "shape.control_points", path, False),
        "mesh of as many, prb": (mesh(numbers), "shape.vertex_positions", prb, False),
        "the patches as glass, bezierpath": (glass, "shape.control_points", path, True),
    }
    steps = {
        name: stepper(scene_of(shape, options.side, lens), key, integrator, options.spp)
        for name, (shape, key, integrator, lens) in made.items()
    }
    spent: dict[str, list[float]] = {name: [] for name in steps}
    early = 0.0
    for k in range(options.steps):
        for name, step in steps.items():
            start = time.process_time()
            # Mitsuba's own throughout: nothing asks for patches in the mesh's scene
            with mb.native("prb" not in name):
                step(k)
            spent[name].append(time.process_time() - start)
        if k == min(9, options.steps - 1):
            early = held()
    late = held()
    table = Table(title=f"mitsuba_bezier {mb.__version__}: steps of a fit, {options.side} pixels")
    for column in ("what", "first step", "median of later ones", "over the mesh's"):
        table.add_column(column)
    base = statistics.median(spent[list(steps)[1]][2:] or [1.0])
    rows = []
    for name, seconds in spent.items():
        median = statistics.median(seconds[2:] or seconds)
        table.add_row(name, f"{seconds[0]:.2f} s", f"{1e3 * median:.0f} ms", f"{median / base:.2f}")
        rows.append({"what": name, "first": seconds[0], "median": median, "ratio": median / base})
    Console(width=max(Console().width, 110)).print(table)
    print(
        f"memory held: {early:.0f} MB after 10 steps of each, {late:.0f} MB after {options.steps}"
    )
    about = machine()
    print(f"processor time; {about['processor']}, Mitsuba {about['mitsuba']}")
    if options.json:
        data = {"machine": about, "rows": rows, "early": early, "late": late}
        write_file(options.json, json.dumps(data, indent=1).encode())


if __name__ == "__main__":
    main()
