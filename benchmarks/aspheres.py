"""How fast rays meet an asphere: beside closed forms, and a mesh of a million triangles of it.

    python benchmarks/aspheres.py [--million 1] [--runs 5] [--triangles 1000000] [--json FILE]

The shape `asphere` (a lens to r^16 that fills the view), the same without its polynomial, also as
quadratic patches (the closed form of `optics.surface_patches`), the unit sphere as patches and as
Mitsuba's own, and Embree's mesh of the asphere. The same rays for all, in turns; ratios are of
processor time, which other work on the machine moves least.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from typing import Any

import mitsuba_bezier as mb  # before Dr.Jit: chooses its LLVM

# isort: split
import mitsuba as mi
import numpy as np
from accuracy_aspheres import asphere_parameters
from common import camera_rays, machine, random_rays, set_variant, time_in_turns, to_rays
from rich.console import Console
from rich.table import Table

from mitsuba_bezier._files import write_file
from mitsuba_bezier.geometry.aspheres import EvenAsphere
from mitsuba_bezier.optics import Surface, surface_patches

LENS = EvenAsphere(0.6, 1.2, -0.4, (0, 0.05, -0.1, 0.07, 0, -0.02, 0, 0.005))


def mesh_of(surface: EvenAsphere, triangles: int) -> Any:
    """Return a mesh of rings, of about so many triangles."""
    rings = max(2, int(np.sqrt(triangles / 8)))
    steps = 4 * rings
    r = np.linspace(0, surface.aperture, rings + 1)
    angle = np.arange(steps) / steps * 2 * np.pi
    x, y = r[:, None] * np.cos(angle), r[:, None] * np.sin(angle)
    z = np.broadcast_to(surface.sag(r**2)[:, None], x.shape)
    at = np.arange((rings + 1) * steps, dtype=np.uint32).reshape(rings + 1, steps)
    inner, outer = at[:-1], at[1:]
    beside = [np.roll(a, -1, axis=1) for a in (inner, outer)]
    faces = np.concatenate(
        [np.stack([inner, outer, beside[1]], -1), np.stack([inner, beside[1], beside[0]], -1)]
    )
    mesh = mi.Mesh("asphere", x.size, faces.size // 3)
    params = mi.traverse(mesh)
    params["vertex_positions"] = mi.Float(np.stack([x, y, z], -1).astype(np.float32).ravel())
    params["faces"] = mi.UInt32(faces.astype(np.uint32).ravel())
    params.update()
    return mesh


def surfaces(triangles: int) -> dict[str, Any]:
    """Return what is traced, as scenes."""
    conic = Surface(LENS.curvature, semi_diameter=LENS.aperture, conic=LENS.conic)
    patches = {
        "conic in closed form": surface_patches(conic),
        "sphere in closed form": mb.sphere(cover="tetrahedral"),
    }
    shapes = {
        "asphere": asphere_parameters(LENS),
        "asphere without polynomial": asphere_parameters(replace(LENS, coefficients=())),
        **{k: {"type": "beziertriangle", "control_points": p} for k, p in patches.items()},
        "Mitsuba's sphere": {"type": "sphere"},
        f"mesh of {triangles:,} triangles": mesh_of(LENS, triangles),
    }
    return {name: mi.load_dict({"type": "scene", "shape": s}) for name, s in shapes.items()}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--million", type=float, default=1.0, help="rays of each kind (1)")
    parser.add_argument("--runs", type=int, default=5, help="repetitions (5)")
    parser.add_argument("--triangles", type=int, default=1_000_000, help="of the mesh")
    parser.add_argument("--variant", default="llvm_ad_rgb")
    parser.add_argument("--json", metavar="FILE", help="write the numbers to a file")
    options = parser.parse_args()
    set_variant(options.variant)
    scenes = surfaces(options.triangles)
    side = max(8, int(np.sqrt(options.million * 1e6)))
    table = Table(title="Processor time, that of the asphere = 1; more is slower")
    table.add_column("surface")
    rows: dict[str, dict[str, float]] = {name: {} for name in scenes}
    for kind, pair in (
        ("coherent", camera_rays(side)),
        ("random", random_rays(side * side)),
    ):
        ray = to_rays(*pair)
        for query in ("closest", "any"):

            def task(scene: Any, query: str = query, ray: Any = ray) -> Any:
                if query == "any":
                    return lambda: scene.ray_test(ray)

                def closest() -> Any:
                    pi = scene.ray_intersect_preliminary(ray, coherent=False)
                    return pi.t, pi.prim_uv, pi.prim_index

                return closest

            times = time_in_turns({n: task(s) for n, s in scenes.items()}, options.runs)
            table.add_column(f"{kind}, {query}", justify="right")
            for name, timing in times.items():
                rows[name][f"{kind}, {query}"] = timing.cpu
    for name, row in rows.items():
        table.add_row(name, *(f"{t / rows['asphere'][k]:.2f}" for k, t in row.items()))
    console = Console()
    console.print(table)
    speed = {k: side * side / t / 1e6 for k, t in rows["asphere"].items()}
    console.print(
        "asphere, million rays a second of one core:", {k: round(v, 2) for k, v in speed.items()}
    )
    if options.json:
        report = {"machine": machine(), "rays": side * side, "seconds": rows}
        write_file(options.json, json.dumps(report, indent=1).encode())


if __name__ == "__main__":
    main()
