"""A glass ball in a Cornell box, end to end: `bezierpath` against Mitsuba's `path`."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from common import Options, mesh, time_in_turns
from speed_report import Section, judged, short
from speed_surfaces import bezier_shape, patches_of, switch_off

__all__ = ["box", "cases", "kernels_of", "measure", "sections"]

NATIVE = "Mitsuba's sphere, path"
MESH = "mesh 1M, path"
#: Longest paths of all renders here.
DEPTH = 12
GLASS = {"type": "dielectric", "int_ior": "bk7"}
PLACE = np.array([[0.36, 0, 0, 0.43], [0, 0.36, 0, -0.3], [0, 0, 0.36, 0.36], [0, 0, 0, 1.0]])


def box(ball: dict[str, Any] | Any, integrator: str, options: Options) -> dict[str, Any]:
    """Return a Cornell box with a glass ball, as a dictionary for `mi.load_dict`.

    Parameters
    ----------
    ball : dict or mi.Shape
        The unit sphere; if it is a dictionary, it is placed and gets its glass here.
    """
    t = mi.ScalarTransform4f
    white = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.72, 0.72, 0.7]}}
    red = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.57, 0.04, 0.04]}}
    green = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.1, 0.38, 0.09]}}

    def wall(transform: Any, bsdf: dict[str, Any]) -> dict[str, Any]:
        return {"type": "rectangle", "to_world": transform, "bsdf": bsdf}

    if isinstance(ball, dict):
        ball = {**ball, "to_world": t(PLACE), "bsdf": GLASS}
    return {
        "type": "scene",
        "integrator": {"type": integrator, "max_depth": DEPTH},
        "sensor": {
            "type": "perspective",
            "fov": 37.8,
            "to_world": t().look_at(origin=[0, -3.9, 1], target=[0, 0, 1], up=[0, 0, 1]),
            "film": {
                "type": "hdrfilm",
                "width": options.side,
                "height": options.side,
                "rfilter": {"type": "box"},
            },
            "sampler": {"type": "independent", "sample_count": options.spp},
        },
        "floor": wall(t(), white),
        "ceiling": wall(t().translate([0, 0, 2]).rotate([1, 0, 0], 180), white),
        "back": wall(t().translate([0, 1, 1]).rotate([1, 0, 0], 90), white),
        "left": wall(t().translate([-1, 0, 1]).rotate([0, 1, 0], 90), red),
        "right": wall(t().translate([1, 0, 1]).rotate([0, 1, 0], -90), green),
        "light": {
            "type": "rectangle",
            "to_world": t().translate([0, 0, 1.995]).rotate([1, 0, 0], 180).scale([0.38, 0.32, 1]),
            "bsdf": {"type": "diffuse"},
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [19, 15.5, 11.5]}},
        },
        "ball": ball,
    }


def cases(options: Options) -> dict[str, Any]:
    """Return the scenes to render."""
    scenes = {
        NATIVE: mi.load_dict(box({"type": "sphere"}, "path", options)),
        "Mitsuba's sphere, bezierpath": mi.load_dict(
            box({"type": "sphere"}, "bezierpath", options)
        ),
    }
    for name in ("sphere, tetrahedral", "sphere, octants", "sphere, general"):
        shape = bezier_shape(patches_of(name))
        scenes[f"{name}, bezierpath"] = mi.load_dict(box(shape, "bezierpath", options))
        if name == "sphere, general":
            switch_off(scenes[f"{name}, bezierpath"])
    placed = patches_of("sphere, octants").transform(PLACE)
    for name, triangles in options.mesh_sizes.items():
        ball = mesh(placed, triangles, mi.load_dict(GLASS))
        scenes[f"{name}, path"] = mi.load_dict(box(ball, "path", options))
    return scenes


def kernels_of(task: Any) -> dict[str, float]:
    """Run a task and return what it launched and compiled, and the mean of its result.

    ``kernels`` are compiled programs launched, ``others`` are Dr.Jit's own operations
    (reductions, compressions), ``compiled`` counts kernels not found in memory.
    """
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        result = task()
        dr.eval(result)
        dr.sync_thread()
        history = dr.kernel_history()
    jit = [e for e in history if "hash" in e]
    fresh = [e for e in jit if not e["cache_hit"]]
    return {
        "kernels": len(jit),
        "others": len(history) - len(jit),
        "compiled": len(fresh),
        "compile_seconds": sum(e["codegen_time"] + e["backend_time"] for e in fresh) / 1e3,
        "mean": float(np.array(result).mean()) if isinstance(result, mi.TensorXf) else math.nan,
    }


def bytes_per_sample(scene: Any, options: Options) -> float:
    """Return how the peak of Dr.Jit's memory grows with the samples of one pass."""
    peak = []
    few = max(1, options.spp // 4)
    for spp in (few, options.spp):
        dr.flush_malloc_cache()
        dr.detail.malloc_clear_statistics()
        dr.eval(mi.render(scene, spp=spp, seed=0))
        dr.sync_thread()
        peak.append(dr.detail.malloc_watermark(dr.backend_v(mi.Float)))
    return (peak[1] - peak[0]) / (options.side**2 * (options.spp - few))


def measure(options: Options) -> list[dict[str, Any]]:
    """Render all scenes in turns."""
    scenes = cases(options)
    seeds = iter(range(1_000_000))
    tasks = {
        name: lambda s=scene: mi.render(s, spp=options.spp, seed=next(seeds))
        for name, scene in scenes.items()
    }
    times = time_in_turns(tasks, options.renders)
    rows = []
    for name, scene in scenes.items():
        again = kernels_of(tasks[name])
        changed = 0
        if "ball.control_points" in (params := mi.traverse(scene)):
            params["ball.control_points"] = params["ball.control_points"] * 1.0
            params.update()
            changed = kernels_of(tasks[name])["compiled"]
        rows.append(
            {
                "scene": name,
                "ratio": times[name].best / times[NATIVE].best,
                "ratio_median": times[name].median / times[NATIVE].median,
                "ratio_cpu": times[name].cpu / times[NATIVE].cpu,
                "ratio_mesh": times[name].best / times[MESH].best,
                "ratio_mesh_cpu": times[name].cpu / times[MESH].cpu,
                "kernels": again["kernels"],
                "others": again["others"],
                "compiled_again": again["compiled"],
                "compiled_after_update": changed,
                "bytes_per_sample": bytes_per_sample(scene, options),
                "mean": again["mean"],
                **times[name].as_row(),
            }
        )
    return rows


def sections(data: list[dict[str, Any]]) -> list[Section]:
    """Return the tables for people."""

    def required(name: str) -> tuple[float | None, float | None]:
        return (1.5, 0.8) if name.startswith("sphere") else (None, None)

    rows = []
    for r in data:
        native, meshed = required(r["scene"])
        rows.append(
            [
                r["scene"],
                f"{short(r['best'])} s ({short(r['cpu'])} s)",
                judged(r["ratio"], native, at_most=True),
                short(r["ratio_cpu"]),
                judged(r["ratio_mesh"], meshed, at_most=True),
                short(r["ratio_mesh_cpu"]),
                f"{r['kernels']:.0f} + {r['others']:.0f}",
                f"{r['compiled_again']:.0f}, {r['compiled_after_update']:.0f}",
                short(r["bytes_per_sample"]),
                f"{r['mean']:.4f}",
            ]
        )
    return [
        Section(
            "Time of a render over that of Mitsuba's sphere, and over that of the mesh (required)",
            [
                "scene",
                "best (processor)",
                "over the sphere",
                "by processor",
                "over mesh 1M",
                "by processor",
                "kernels + others",
                "compiled again, after update()",
                "bytes a sample",
                "mean of the image",
            ],
            rows,
        )
    ]
