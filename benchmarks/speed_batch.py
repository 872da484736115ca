"""Rays of an array that go more and more apart: a lane each, and traced at once."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from common import Options, camera_rays, random_rays, time_in_turns
from speed_report import Section, short
from speed_surfaces import bezier

from mitsuba_bezier.kernels import traverse, wavefront
from mitsuba_bezier.kernels.arrays import types_of, upload

__all__ = ["measure", "sections"]

#: Surfaces without closed forms.
SURFACES = ("sphere, general", "torus", "teapot")
#: Standard deviations, in radians, by which rays of a camera are turned.
TURNS = (0.0, 0.01, 0.03, 0.1, 0.3)


def rays_by_name(side: int) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return origins and directions of the kinds of rays, the most coherent first."""
    o, d = camera_rays(side)
    d = d / np.linalg.norm(d, axis=1, keepdims=True)
    noise = np.random.default_rng(0).normal(size=d.shape)
    out = {f"camera, turned by {turn:g}": (o, d + turn * noise) for turn in TURNS}
    return {**out, "random": random_rays(side * side)}


def measure(options: Options) -> list[dict[str, Any]]:
    """Measure both ways in turns."""
    ty = types_of(mi.Float)
    rows = []
    for kind, (o, d) in rays_by_name(options.side_of_rays).items():
        columns = [[upload(ty.Float, a[:, k].astype(np.float32)) for k in range(3)] for a in (o, d)]
        for name in SURFACES:
            structure = bezier(name).structure
            row: dict[str, Any] = {
                "rays": kind,
                "surface": name,
                "apart": wavefront._distance(structure, ty, *columns),
                "chosen": wavefront.is_worthwhile(structure, *columns),
            }
            for query, any_hit in (("closest", False), ("any", True)):
                tasks = {
                    # a tuple: Dr.Jit does not look into those with names
                    way: lambda run=run, s=structure, r=columns, any_hit=any_hit: tuple(
                        run(s, *r, ty.Float(dr.inf), any_hit=any_hit)
                    )
                    for way, run in (
                        ("each", traverse.intersect),
                        ("batch", wavefront.intersect_wavefront),
                    )
                }
                times = time_in_turns(tasks, options.runs)
                for way, timing in times.items():
                    row[f"{query}, {way}"] = len(o) / timing.best
                row[query] = times["each"].best / times["batch"].best
            rows.append(row)
    return rows


def sections(data: list[dict[str, Any]]) -> list[Section]:
    """Return the table for people."""
    rows = [
        [
            r["rays"],
            r["surface"],
            f"{r['apart']:.3f}{'' if r['chosen'] else ' (together)'}",
            *(
                text
                for query in ("closest", "any")
                for text in (
                    short(r[f"{query}, each"] / 1e6),
                    short(r[f"{query}, batch"] / 1e6),
                    short(r[query]),
                )
            ),
        ]
        for r in data
    ]
    ways = ["a lane each", "at once", "ratio"]
    return [
        Section(
            "Million rays a second, with a lane each and traced at once",
            ["rays", "surface", "apart", *ways, *(f"{way}, any hit" for way in ways)],
            rows,
            text_columns=2,
        )
    ]
