"""Peak memory of a Bézier sphere and of a mesh, each in a process of its own.

Run as a program it prints one line of JSON:
``python benchmarks/speed_memory.py VARIANT CASE [FILE]``.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Any

import mitsuba_bezier as mb  # before Dr.Jit: chooses its LLVM

# isort: split
import json
import resource

import drjit as dr
import mitsuba as mi
from common import Options, child, mesh, random_rays, set_variant, to_rays
from speed_report import Section, short
from speed_surfaces import bezier_shape, patches_of

from mitsuba_bezier.plugins.scene import ray_intersect

__all__ = ["measure", "sections"]

NOTHING = "no scene"


def measure(options: Options) -> list[dict[str, Any]]:
    """Trace the same random rays in all scenes; the mesh comes from a binary PLY file."""
    label, triangles = list(options.mesh_sizes.items())[-1]
    runs = min(3, options.runs)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "sphere.ply"
        mesh(patches_of("sphere, octants"), triangles).write_ply(str(file))
        cases = {
            NOTHING: ["nothing"],
            "sphere, tetrahedral": ["tetrahedral"],
            "sphere, octants": ["octants"],
            "Mitsuba's sphere": ["sphere"],
            label: ["mesh", str(file)],
        }
        # the least of three processes: now and then one takes some twenty MiB more
        peak = {
            name: min(child("speed_memory.py", [options.variant, *case]) for _ in range(runs))
            for name, case in cases.items()
        }
    rows = []
    for name, size in peak.items():
        own = size - peak[NOTHING]
        rows.append(
            {
                "scene": name,
                "peak": size,
                "own": own,
                "of_mesh": size / peak[label],
                "own_of_mesh": own / (peak[label] - peak[NOTHING]),
            }
        )
    return rows


def one(case: str, file: str | None) -> int:
    """Make a scene, trace rays, return the peak of this process's memory in bytes."""
    shapes: dict[str, Any] = {
        "nothing": None,
        "tetrahedral": lambda: bezier_shape(patches_of("sphere, tetrahedral")),
        "octants": lambda: bezier_shape(patches_of("sphere, octants")),
        "sphere": lambda: {"type": "sphere"},
        "mesh": lambda: {"type": "ply", "filename": file, "face_normals": True},
    }
    ray = to_rays(*random_rays(2**16))
    if case != "nothing":
        scene = mi.load_dict({"type": "scene", "s": shapes[case]()})
        dr.eval(ray_intersect(scene, ray).p)
        dr.sync_thread()
    return peak_memory()


def peak_memory() -> int:
    """Return the most memory this process has held at a time, in bytes."""
    try:
        # not `getrusage`: its maximum starts with that of the process that started this one
        with open("/proc/self/status") as lines:
            (high,) = (line for line in lines if line.startswith("VmHWM:"))
        return int(high.split()[1]) * 1024
    except OSError:
        unit = 1 if sys.platform == "darwin" else 1024
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


def sections(data: list[dict[str, Any]]) -> list[Section]:
    """Return the table for people."""
    large = data[-1]["scene"] == "mesh 16M"
    rows = []
    for r in data:
        target = 0.05 if large and r["scene"].startswith("sphere") else None
        mark = (
            "" if target is None else f" (≤ {target} {'✓' if r['own_of_mesh'] <= target else '✗'})"
        )
        rows.append(
            [
                r["scene"],
                short(r["peak"] / 2**20),
                short(r["own"] / 2**20),
                f"{r['of_mesh']:.3f}",
                f"{r['own_of_mesh']:.4f}{mark}",
            ]
        )
    return [
        Section(
            "Peak memory of a process, MiB, and how much of it is the scene's own (required)",
            ["scene", "process", "own", "process, over the mesh's", "own, over the mesh's"],
            rows,
        )
    ]


if __name__ == "__main__":
    mb.register()
    set_variant(sys.argv[1])
    print(json.dumps(one(sys.argv[2], sys.argv[3] if len(sys.argv) > 3 else None)))
