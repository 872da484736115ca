"""Cold compile times, in a process of its own with an empty kernel cache.

Run as a program it prints one line of JSON: ``python benchmarks/speed_compile.py VARIANT``.
"""

from __future__ import annotations

import sys
import tempfile
import time
from typing import Any

import mitsuba_bezier as mb  # before Dr.Jit: chooses its LLVM

# isort: split
import json

import drjit as dr
import mitsuba as mi
from common import Options, child, random_rays, set_variant, to_rays
from speed_rays import query_of
from speed_render import cases, kernels_of
from speed_report import Section, judged, short
from speed_surfaces import bezier

__all__ = ["measure", "sections"]

#: Required seconds of compiling.
TARGETS = {"rays": 0.5, "render": 3.0}


def measure(options: Options) -> list[dict[str, Any]]:
    """Compile everything once, in another process."""
    with tempfile.TemporaryDirectory() as folder:
        variables = {"DRJIT_CACHE_DIR": folder, "CUDA_CACHE_PATH": folder}
        return child("speed_compile.py", [options.variant], variables)


def once(name: str, kind: str, task: Any) -> dict[str, Any]:
    """Return what the first run of a task costs, and the second."""
    wall, cpu = time.perf_counter(), time.process_time()
    first = kernels_of(task)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    again = time.perf_counter()
    second = kernels_of(task)
    again = time.perf_counter() - again
    return {
        "what": name,
        "kind": kind,
        "kernels": first["kernels"],
        "compile": first["compile_seconds"],
        "first": wall,
        "first_cpu": cpu,
        "second": again,
        "compiled_again": second["compiled"],
    }


def all_cases() -> list[dict[str, Any]]:
    """Run everything small, where compiling is all that takes time."""
    options = Options(variant=mi.variant(), side=16, spp=1, mesh_unit=1e4)
    dr.eval(dr.arange(mi.Float, 16) + 1.0)  # starts the compiler
    ray = to_rays(*random_rays(1024))
    rows = []
    for name in ("sphere, tetrahedral", "sphere, general", "teapot"):
        for query in ("closest", "any"):
            rows.append(once(f"{name}, {query} hit", "rays", query_of(bezier(name), ray, query)))
    scenes = cases(options)
    for name in (
        "Mitsuba's sphere, path",
        "Mitsuba's sphere, bezierpath",
        "sphere, tetrahedral, bezierpath",
        "sphere, octants, bezierpath",
        "sphere, general, bezierpath",
    ):
        rows.append(once(name, "render", lambda s=scenes[name]: mi.render(s, spp=1, seed=0)))
    return rows


def sections(data: list[dict[str, Any]]) -> list[Section]:
    """Return the table for people."""
    rows = []
    for r in data:
        ours = r["kind"] == "rays" or (r["what"].startswith("sphere,"))
        target = TARGETS[r["kind"]] if ours else None
        rows.append(
            [
                r["what"],
                str(r["kernels"]),
                judged(r["compile"], target, at_most=True),
                short(r["first"]),
                short(r["first_cpu"]),
                short(r["second"]),
                str(r["compiled_again"]),
            ]
        )
    header = ["what", "kernels", "compile", "first run", "processor", "second run"]
    return [
        Section("Seconds with an empty kernel cache (required)", [*header, "compiled again"], rows)
    ]


if __name__ == "__main__":
    mb.register()
    set_variant(sys.argv[1])
    print(json.dumps(all_cases()))
