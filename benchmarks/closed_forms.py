"""Measure what closed forms save on surfaces as CAD systems write them.

    python benchmarks/closed_forms.py [--variant llvm_ad_rgb] [--million 4] [--runs 5] [--json FILE]

Surfaces of revolution from tensor-product patches, cut along diagonals, with edges that collapse at
the axis; turned, and in float32 as Mitsuba's tensors are. Each with closed forms and without, the
same rays in turns: leaves, seconds of the build, rays a second, and the ratio of these.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import track
from rich.table import Table

import mitsuba_bezier  # noqa: F401 (before Dr.Jit, for which it finds LLVM)

sys.path.insert(0, str(Path(__file__).parent))  # for a caller that is not in this folder

import mitsuba as mi
import numpy as np
from common import camera_rays, into_view, machine, random_rays, set_variant, time_in_turns

from mitsuba_bezier._files import write_file
from mitsuba_bezier.geometry.tensor import revolved, tensor_to_triangles
from mitsuba_bezier.geometry.triangles import BezierTriangles
from mitsuba_bezier.kernels.arrays import types_of, upload
from mitsuba_bezier.kernels.structure import build_structure
from mitsuba_bezier.kernels.wavefront import query
from mitsuba_bezier.leaves.builder import build_leaves
from mitsuba_bezier.leaves.records import LeafSettings

H = np.sqrt(0.5)
FOOT = [(0, -1, 1), (1, -1, 1)]
SURFACES = {
    "cylinder": [[(1, -1, 1), (1, 1, 1)]],
    "cylinder, capped": [FOOT, [(1, -1, 1), (1, 1, 1)], [(1, 1, 1), (0, 1, 1)]],
    "cone, capped": [FOOT, [(1, -1, 1), (0, 1, 1)]],
    "sphere": [[(0, -1, 1), (H, -H, H), (1, 0, 1)], [(1, 0, 1), (H, H, H), (0, 1, 1)]],
    "paraboloid": [[(0, 0, 1), (0.5, 0, 1), (1, 1, 1)]],
    "bolt": [
        [(0, -1, 1), (0.3, -1, 1)],
        [(0.3, -1, 1), (0.3, 0.3, 1)],
        [(0.3, 0.3, 1), (0.7, 0.3, 1)],
        [(0.7, 0.3, 1), (0.7, 0.6, 1)],
        [(0.7, 0.6, 1), (0.5, 0.8, 1)],
        [(0.5, 0.8, 1), (0, 0.8, 1)],
    ],
}


def surface(name: str) -> BezierTriangles:
    """Return a surface, turned and as float32 numbers, in front of the benchmarks' camera."""
    patches = BezierTriangles.join([tensor_to_triangles(revolved(p)) for p in SURFACES[name]])
    matrix = np.eye(4)
    matrix[:3, :3] = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    patches = into_view(patches.transform(matrix))
    return BezierTriangles(patches.control_points.astype(np.float32))


def measure(name: str, million: float, runs: int) -> dict[str, Any]:
    """Measure one surface both ways."""
    ty = types_of(mi.Float)
    patches = surface(name)
    structures, row = {}, {"surface": name, "patches": len(patches)}
    for kind in ("closed", "general"):
        start = time.perf_counter()
        leaves = build_leaves(patches, LeafSettings(closed_form=kind == "closed"))
        row[f"{kind} build s"] = time.perf_counter() - start
        row[f"{kind} leaves"] = len(leaves)
        structures[kind] = build_structure(leaves, ty.Float)
    side = int(np.sqrt(million * 1e6))
    for rays, (o, d) in (("coherent", camera_rays(side)), ("random", random_rays(side * side))):
        o, d = ([upload(ty.Float, a[:, k].astype(np.float32)) for k in range(3)] for a in (o, d))
        for asked, any_hit in (("closest", False), ("any", True)):

            def task(kind, o=o, d=d, any_hit=any_hit, coherent=rays == "coherent"):
                hit = query(
                    structures[kind], o, d, ty.Float(np.inf), ty.Bool(True), any_hit, coherent
                )
                return hit.valid if any_hit else tuple(hit)

            timings = time_in_turns({k: lambda k=k: task(k) for k in structures}, runs)
            for kind, timing in timings.items():
                row[f"{kind} {rays} {asked}"] = side * side / timing.best / 1e6
    return row


def main(arguments: list[str] | None = None) -> None:
    """Measure all surfaces and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--variant", default="llvm_ad_rgb", help="Mitsuba variant (llvm_ad_rgb)")
    parser.add_argument("--million", type=float, default=4.0, help="rays, in millions (4)")
    parser.add_argument("--runs", type=int, default=5, help="repetitions (5)")
    parser.add_argument("--json", type=Path, help="write the numbers to a file, too")
    options = parser.parse_args(arguments)
    set_variant(options.variant)
    console = Console(stderr=True)
    rows = [
        measure(name, options.million, options.runs)
        for name in track(SURFACES, description="surfaces", console=console, transient=True)
    ]
    table = Table(title="Closed forms against the general path, million rays a second")
    asked = [f"{rays} {what}" for rays in ("coherent", "random") for what in ("closest", "any")]
    for title in ("surface", "leaves", "build s", *asked):
        table.add_column(title, justify="left" if title == "surface" else "right")
    for row in rows:
        cells = [f"{row['closed leaves']} / {row['general leaves']}"]
        cells.append(f"{row['closed build s']:.2f} / {row['general build s']:.2f}")
        for what in asked:
            ours, general = row[f"closed {what}"], row[f"general {what}"]
            cells.append(f"{ours:.0f} / {general:.0f} = {ours / general:.2g}")
        table.add_row(row["surface"], *cells)
    Console(width=140).print(table)
    if options.json:
        found = {"machine": machine(), "rows": rows}
        write_file(options.json, json.dumps(found, indent=1).encode())


if __name__ == "__main__":
    main()
