"""Rays per second: the Bézier sphere, Mitsuba's own sphere, and a mesh of a million triangles.

    python benchmarks/rays.py [--variant llvm_ad_rgb] [--million 1] [--runs 7] [--json FILE]

All are met by the same rays in one process, in turns; the best run of each counts. The Bézier
sphere is measured through both ways of the intersector: the tetrahedral cover has a closed form,
the octants take the way of any other net.
"""

from __future__ import annotations

import argparse
import json
import math
from typing import Any

import mitsuba_bezier as mb  # before Dr.Jit: chooses its LLVM

# isort: split
import mitsuba as mi
import numpy as np
from common import best_times, camera_rays, machine, random_rays, sphere_mesh, to_rays
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

MESH = "mesh, 10^6 triangles"


def bezier(cover: str) -> Any:
    net = mb.sphere(cover=cover).control_points.astype(np.float32)
    tensor = mi.TensorXf(net.ravel(), shape=net.shape)
    return mi.load_dict({"type": "beziertriangle", "control_points": tensor})


def queries(ray: Any) -> dict[str, dict[str, Any]]:
    """Return the tasks: query, then surface."""
    shapes = {"Bézier, closed form": bezier("tetrahedral"), "Bézier, any net": bezier("octants")}
    scenes = {
        "Mitsuba's sphere": mi.load_dict({"type": "scene", "s": {"type": "sphere"}}),
        MESH: mi.load_dict({"type": "scene", "s": sphere_mesh(1_000_000)}),
    }
    closest = {k: lambda s=s: s.ray_intersect_preliminary(ray) for k, s in shapes.items()}
    closest |= {k: lambda s=s: s.ray_intersect_preliminary(ray) for k, s in scenes.items()}
    every = {**shapes, **scenes}
    return {
        "closest hit": closest,
        "any hit": {k: lambda s=s: s.ray_test(ray) for k, s in every.items()},
    }


def measure(million: float, runs: int) -> list[dict[str, Any]]:
    side = math.isqrt(int(million * 1e6))
    rows = []
    for kind, (o, d) in (
        ("coherent", camera_rays(side)),
        ("random", random_rays(side * side)),
    ):
        ray = to_rays(o, d)
        for query, tasks in queries(ray).items():
            times = best_times(tasks, runs)
            hits = {name: float(np.array(task_hits(tasks[name]())).mean()) for name in tasks}
            for name, seconds in times.items():
                rows.append(
                    {
                        "rays": kind,
                        "query": query,
                        "surface": name,
                        "rays_per_second": len(o) / seconds,
                        "of_mesh": times[MESH] / seconds,
                        "share_of_hits": hits[name],
                    }
                )
    return rows


def short(value: float) -> str:
    return f"{value:.0f}" if value >= 20 else f"{value:.1f}"


def task_hits(result: Any) -> Any:
    return result.is_valid() if hasattr(result, "is_valid") else result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--variant", default="llvm_ad_rgb")
    parser.add_argument("--million", type=float, default=1.0, help="rays of each kind")
    parser.add_argument("--runs", type=int, default=7)
    parser.add_argument("--json", metavar="FILE", help="write the numbers to a file")
    arguments = parser.parse_args()
    mi.set_variant(arguments.variant)

    rows = measure(arguments.million, arguments.runs)
    about = {**machine(), "rays": arguments.million * 1e6, "runs": arguments.runs}
    table = Table(title="million rays a second (times the mesh)", box=SIMPLE_HEAD, padding=0)
    table.add_column("surface", no_wrap=True)
    columns = list(dict.fromkeys((row["rays"], row["query"]) for row in rows))
    for rays, query in columns:
        table.add_column(f"  {rays}\n  {query}", justify="right", no_wrap=True)
    for surface in dict.fromkeys(row["surface"] for row in rows):
        mine = {(r["rays"], r["query"]): r for r in rows if r["surface"] == surface}
        table.add_row(
            surface,
            *(
                f"{short(mine[c]['rays_per_second'] / 1e6)} ({short(mine[c]['of_mesh'])})"
                for c in columns
            ),
        )
    console = Console()
    console.print(table)
    console.print(", ".join(f"{k} {v}" for k, v in about.items() if v is not None))
    if arguments.json:
        with open(arguments.json, "w", encoding="utf-8") as file:
            json.dump({"machine": about, "rows": rows}, file, indent=1, ensure_ascii=False)


if __name__ == "__main__":
    main()
