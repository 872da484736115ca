"""Measure what patches of high degree cost: those beside them, compiling, and closed forms.

    python benchmarks/speed_degrees.py [--rows elsewhere,compile,bolt] [--million 4] [--runs 9]
        [--variant llvm_ad_rgb] [--json FILE]

`elsewhere` traces rays at the teapot, which has degree 6, by itself and in a scene with one patch
of degree 16 that none of them meets, in turns; `compile` starts a process with an empty kernel
cache for each degree, and for all together, which renders and differentiates; `bolt` sends rays at
a body of several quadrics, by closed forms and by the general path. Each row is a ratio or a time,
beside what is required.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

import mitsuba_bezier as mb  # before Dr.Jit, for which it finds LLVM

sys.path.insert(0, str(Path(__file__).parent))  # for a caller that is not in this folder

import drjit as dr
import mitsuba as mi
import numpy as np
from common import camera_rays, child, machine, random_rays, set_variant, time_in_turns, to_rays
from speed_render import kernels_of
from speed_surfaces import bezier_shape, patches_of

from mitsuba_bezier._files import write_file
from mitsuba_bezier.geometry import bernstein
from mitsuba_bezier.plugins.scene_data import data_for_scene

#: What is required: ratios at least, seconds at most.
ELSEWHERE, COMPILE, CLOSED = 0.95, 5.0, 1.3
#: Degrees of scenes that are compiled; "all" has a patch of each up to 20.
DEGREES = ("3", "6", "8", "9", "12", "16", "20", "all")


def wavy(n: int, place: tuple[float, float, float]) -> mb.BezierTriangles:
    """Return a rational height field of degree `n`, of one patch."""
    x, y, _w = bernstein.multi_indices(n).T / n
    z = 0.2 * np.sin(3 * x) * np.cos(2 * y)
    w = 1 + 0.1 * np.cos(2 * x)
    points = np.stack([x, y, z, np.ones_like(x)]) + np.append(place, 0)[:, None]
    return mb.BezierTriangles((points * w).T[None])


def query_of(name: str, scene: Any, ray: Any, coherent: bool) -> Callable[[], Any]:
    """Return a query of all rays."""
    if name == "any":
        return lambda: mb.ray_test(scene, ray)
    if name == "interaction":
        return lambda: mb.ray_intersect(scene, ray, coherent=coherent)
    data = data_for_scene(scene)
    assert data is not None
    return lambda: data.preliminary(ray, coherent=coherent).pi.t


def times_of(scene: Any, ray: Any, coherent: bool) -> np.ndarray:
    """Return the ray parameters of hits."""
    return np.array(mb.ray_intersect(scene, ray, coherent=coherent).t)


def elsewhere(million: float, runs: int) -> list[dict[str, Any]]:
    """Trace rays that do not meet the patch of degree 16, with and without it in the scene."""
    teapot = {"type": "scene", "teapot": bezier_shape(patches_of("teapot"))}
    far = wavy(16, (0.0, 30.0, 0.0))
    scenes = {
        "alone": mi.load_dict(teapot),
        "beside": mi.load_dict({**teapot, "far": bezier_shape(far)}),
    }
    side = int(np.sqrt(million * 1e6))
    rows = []
    for kind, pair in (("coherent", camera_rays(side)), ("random", random_rays(side * side))):
        coherent = kind == "coherent"
        found = {n: times_of(s, to_rays(*pair), coherent) for n, s in scenes.items()}
        same = found["alone"] == found["beside"]
        # a few random rays do meet the patch
        assert same.mean() > 0.99
        pair = tuple(np.ascontiguousarray(x[same]) for x in pair)
        ray, count = to_rays(*pair), int(same.sum())
        share = float(np.isfinite(found["alone"][same]).mean())
        for name in ("closest", "interaction", "any"):
            tasks = {k: query_of(name, s, ray, coherent) for k, s in scenes.items()}
            times = time_in_turns(tasks, runs)
            rows.append(
                {
                    "rays": kind,
                    "query": name,
                    "hits": share,
                    "alone": count / times["alone"].best / 1e6,
                    "beside": count / times["beside"].best / 1e6,
                    "ratio": times["alone"].cpu / times["beside"].cpu,
                }
            )
    return rows


def compile_one(which: str) -> dict[str, Any]:
    """Render a scene of a degree and differentiate the picture, where nothing is compiled yet."""
    degrees = range(2, 21) if which == "all" else [int(which)]
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "bezierpath", "max_depth": 4},
        "sky": {"type": "constant"},
        "lamp": {"type": "point", "position": [0, 0, 3], "intensity": 1.0},
        "sensor": {
            "type": "perspective",
            "to_world": mi.ScalarTransform4f().look_at([0.4, 0.4, 4], [0.4, 0.4, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 16, "height": 16},
        },
    }
    for n in degrees:
        scene[f"d{n}"] = bezier_shape(wavy(n, (0.0, 0.0, -0.5 * (n - degrees[0]) / 20)))
    loaded = mi.load_dict(scene)
    dr.eval(dr.arange(mi.Float, 16) + 1.0)  # starts the compiler
    past = mi.Ray3f(mi.Point3f(9), mi.Vector3f(1, 0, 0))
    dr.eval(mb.ray_test(loaded, past))  # builds
    out: dict[str, Any] = {"what": which}

    def measured(name: str, task: Any) -> None:
        cpu = time.process_time()
        found = kernels_of(task)
        out[name] = {"cpu": time.process_time() - cpu, "compile": found["compile_seconds"]}

    measured("render", lambda: mi.render(loaded, spp=1, seed=0))
    params = mi.traverse(loaded)
    key = f"d{degrees[-1]}.control_points"
    dr.enable_grad(params[key])
    params.update()
    dr.eval(mb.ray_test(loaded, past))  # builds again, which is not compiling

    def gradient() -> Any:
        dr.backward(dr.mean(mi.render(loaded, params, spp=1, seed=0), axis=None))
        return dr.grad(params[key])

    measured("gradient", gradient)
    return out


def compiled(variant: str) -> list[dict[str, Any]]:
    """Compile scenes of all degrees, each in a process of its own."""
    rows = []
    for which in DEGREES:
        with tempfile.TemporaryDirectory() as folder:
            variables = {"DRJIT_CACHE_DIR": folder, "CUDA_CACHE_PATH": folder}
            arguments = ["--compile-one", which, "--variant", variant]
            rows.append(child("speed_degrees.py", arguments, variables))
    return rows


def bolt(million: float, runs: int) -> list[dict[str, Any]]:
    """Return the rates of closed forms and of the general path on a body of several quadrics."""
    import closed_forms

    row = closed_forms.measure("bolt", million, runs)
    return [
        {
            "rays": rays,
            "query": asked,
            "closed": row[f"closed {rays} {asked}"],
            "general": row[f"general {rays} {asked}"],
        }
        for rays in ("coherent", "random")
        for asked in ("closest", "any")
    ]


def table(title: str, header: list[str], rows: list[list[str]]) -> Table:
    out = Table(title=title)
    for name in header:
        out.add_column(name)
    for row in rows:
        out.add_row(*row)
    return out


def tables(data: dict[str, Any]) -> list[Table]:
    """Lay out what was measured."""
    out = []
    if "elsewhere" in data:
        rows = [
            [r["rays"], r["query"], f"{r['hits']:.2f}", f"{r['alone']:.1f}", f"{r['beside']:.1f}",
             f"{r['ratio']:.3f}"]
            for r in data["elsewhere"]
        ]  # fmt: skip
        title = (
            "Teapot beside a patch of degree 16 against the teapot alone, Mray/s; the ratio is one "
            f"of processor time (required {ELSEWHERE})"
        )
        out.append(table(title, ["rays", "query", "hits", "alone", "beside", "ratio"], rows))
    if "compile" in data:
        rows = []
        for r in data["compile"]:
            times = (r["render"], r["gradient"])
            rows.append([r["what"], *(f"{t['cpu']:.2f} ({t['compile']:.2f})" for t in times)])
        title = (
            "Processor seconds of a first render and of a first gradient, of which compiling in "
            f"wall time (required {COMPILE:g})"
        )
        out.append(table(title, ["degree", "render", "gradient"], rows))
    if "bolt" in data:
        rows = [
            [r["rays"], r["query"], f"{r['closed']:.1f}", f"{r['general']:.1f}",
             f"{r['closed'] / r['general']:.2f}"]
            for r in data["bolt"]
        ]  # fmt: skip
        title = f"Bolt, closed forms against the general path, Mray/s (random: required {CLOSED})"
        out.append(table(title, ["rays", "query", "closed", "general", "ratio"], rows))
    return out


def main(arguments: list[str] | None = None) -> None:
    """Measure, and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--rows", default="elsewhere,compile,bolt", help="which (all)")
    parser.add_argument("--variant", default="llvm_ad_rgb", help="Mitsuba variant (llvm_ad_rgb)")
    parser.add_argument("--million", type=float, default=4.0, help="rays, in millions (4)")
    parser.add_argument("--runs", type=int, default=9, help="repetitions (9)")
    parser.add_argument("--json", type=Path, help="write the numbers to a file, too")
    parser.add_argument("--compile-one", help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    mb.register()
    set_variant(options.variant)
    if options.compile_one:
        print(json.dumps(compile_one(options.compile_one)))
        return
    wanted = options.rows.split(",")
    data: dict[str, Any] = {"machine": machine()}
    if "elsewhere" in wanted:
        data["elsewhere"] = elsewhere(options.million, options.runs)
    if "compile" in wanted:
        data["compile"] = compiled(options.variant)
    if "bolt" in wanted:
        data["bolt"] = bolt(options.million, options.runs)
    for found in tables(data):
        Console(width=140).print(found)
    if options.json:
        write_file(options.json, json.dumps(data, indent=1).encode())


if __name__ == "__main__":
    main()
