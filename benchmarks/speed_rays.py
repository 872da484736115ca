"""Rays a second against Mitsuba's sphere and meshes, and the order of primary rays."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from common import Options, Timing, camera_rays, mesh, random_rays, time_in_turns, to_rays
from speed_report import Section, judged, short
from speed_surfaces import BEZIER, bezier, patches_of

__all__ = ["TARGETS", "measure", "measure_order", "order_sections", "sections"]

NATIVE = "Mitsuba's sphere"
QUERIES = ("closest", "any")

#: Required ratios of rays a second, coherent and random.
TARGETS = {
    ("closed form", NATIVE): (0.4, 0.12),
    ("general", NATIVE): (0.22, 0.05),
    ("sphere", "mesh 65k"): (0.5, 1.5),
    ("sphere", "mesh 1M"): (1.0, 3.0),
    ("sphere", "mesh 16M"): (2.5, 5.0),
    ("torus", "torus mesh 1M"): (0.7, 1.8),
    ("teapot", "teapot mesh 1M"): (0.6, 1.8),
}


def required(surface: str, against: str, rays: str, query: str, closed: bool) -> float | None:
    """Return the required ratio, if there is one; any hit has one against meshes only."""
    if against == NATIVE and query == "any":
        return None
    kind = surface.split(",")[0]
    if against == NATIVE:
        kind = "closed form" if closed else "general"
    pair = TARGETS.get((kind, against))
    return None if pair is None else pair[("coherent", "random").index(rays)]


def query_of(surface: Any, ray: Any, query: str) -> Callable[[], Any]:
    """Return the task: hits as (t, u, v, patch), or whether there is one."""
    if query == "any":
        return lambda: surface.ray_test(ray)

    def closest() -> Any:
        hit = surface.ray_intersect_preliminary(ray)
        return hit.t, hit.prim_uv, hit.prim_index

    return closest


def measure(options: Options) -> dict[str, Any]:
    """Measure all surfaces with the same rays, those of one kind in turns."""
    side = options.side_of_rays
    speeds: list[dict[str, Any]] = []
    ratios: list[dict[str, Any]] = []
    for names, others in _groups(options):
        ours = {name: bezier(name) for name in names}
        closed = {name: surface.structure.has_groups for name, surface in ours.items()}
        surfaces = ours | others()
        for kind, pair in (
            ("coherent", camera_rays(side)),
            ("random", random_rays(side * side)),
        ):
            ray = to_rays(*pair)
            for query in QUERIES:
                tasks = {n: query_of(s, ray, query) for n, s in surfaces.items()}
                times = time_in_turns(tasks, options.runs)
                for name, timing in times.items():
                    share = dr.mean(mi.Float(surfaces[name].ray_test(ray)))
                    speeds.append(
                        {
                            "surface": name,
                            "rays": kind,
                            "query": query,
                            "rays_per_second": side * side / timing.best,
                            "hits": float(np.array(share).item()),
                            **timing.as_row(),
                        }
                    )
                for name in names:
                    for against in others.names:  # type: ignore[attr-defined]
                        target = required(name, against, kind, query, closed[name])
                        ratios.append(
                            {
                                "surface": name,
                                "against": against,
                                "rays": kind,
                                "query": query,
                                **_ratio(times[name], times[against]),
                                "required": target,
                            }
                        )
    return {"speeds": speeds, "ratios": ratios}


class _Others:
    """The surfaces to compare with, made when their turn comes: they are large."""

    def __init__(self, names: list[str], make: Callable[[], dict[str, Any]]) -> None:
        self.names = names
        self._make = make

    def __call__(self) -> dict[str, Any]:
        return self._make()


def _groups(options: Options) -> list[tuple[list[str], _Others]]:
    """Return the surfaces that meet the same rays in turns."""
    sizes = options.mesh_sizes
    spheres = [name for name in BEZIER if name.startswith("sphere")]

    def sphere_scenes() -> dict[str, Any]:
        scenes = {NATIVE: mi.load_dict({"type": "scene", "s": {"type": "sphere"}})}
        for name, triangles in sizes.items():
            shape = mesh(patches_of("sphere, octants"), triangles)
            scenes[name] = mi.load_dict({"type": "scene", "s": shape})
        return scenes

    groups = [(spheres, _Others([NATIVE, *sizes], sphere_scenes))]
    for surface in ("torus", "teapot"):
        name = f"{surface} mesh 1M"

        def scenes(surface: str = surface, name: str = name) -> dict[str, Any]:
            shape = mesh(patches_of(surface), sizes["mesh 1M"])
            return {name: mi.load_dict({"type": "scene", "s": shape})}

        groups.append(([surface], _Others([name], scenes)))
    return groups


def _ratio(ours: Timing, theirs: Timing) -> dict[str, float]:
    return {
        "ratio": theirs.best / ours.best,
        "ratio_median": theirs.median / ours.median,
        "ratio_cpu": theirs.cpu / ours.cpu,
    }


def sections(data: dict[str, Any]) -> list[Section]:
    """Return the tables for people."""
    columns = [(rays, query) for query in QUERIES for rays in ("coherent", "random")]
    titles = [f"{rays}{', any hit' if query == 'any' else ''}" for rays, query in columns]
    by_ratio = {(r["surface"], r["against"], r["rays"], r["query"]): r for r in data["ratios"]}
    pairs = list(dict.fromkeys((r["surface"], r["against"]) for r in data["ratios"]))

    def row(pair: tuple[str, str], key: str) -> list[str]:
        cells = [by_ratio[(*pair, *column)] for column in columns]
        return [*pair, *(judged(c[key], c["required"] if key == "ratio" else None) for c in cells)]

    by_speed = {(r["surface"], r["rays"], r["query"]): r for r in data["speeds"]}
    surfaces = list(dict.fromkeys(r["surface"] for r in data["speeds"]))
    return [
        Section(
            "Ratio of rays a second, best runs (required)",
            ["Bézier", "against", *titles],
            [row(pair, "ratio") for pair in pairs],
            text_columns=2,
        ),
        Section(
            "The same by processor time",
            ["Bézier", "against", *titles],
            [row(pair, "ratio_cpu") for pair in pairs],
            text_columns=2,
        ),
        Section(
            "Million rays a second, best run (median)",
            ["surface", *titles],
            [
                [s, *(_speed(by_speed[(s, *column)]) for column in columns)]  # type: ignore[index]
                for s in surfaces
            ],
        ),
    ]


def _speed(row: dict[str, float]) -> str:
    best = row["rays_per_second"] / 1e6
    return f"{short(best)} ({short(best * row['best'] / row['median'])})"


# ---------------------------------------------------------------------- order


def tiles(side: int, width: int, height: int) -> np.ndarray:
    """Return pixel numbers of a square image, tile after tile."""
    y, x = np.mgrid[0:side, 0:side]
    return np.lexsort(
        [a.ravel() for a in (x % width, y % height, x // width, y // height)]
    )  # the last key counts most


def morton(side: int) -> np.ndarray:
    """Return pixel numbers of a square image along the Z curve."""
    y, x = np.mgrid[0:side, 0:side]
    code = np.zeros_like(x)
    for bit in range(16):
        code |= ((x >> bit) & 1) << (2 * bit) | ((y >> bit) & 1) << (2 * bit + 1)
    return np.argsort(code.ravel(), kind="stable")


def measure_order(options: Options) -> list[dict[str, Any]]:
    """Measure the coherent rays in several orders, one sample a pixel."""
    side = options.side_of_rays
    o, d = camera_rays(side)
    orders = {
        "scanlines": np.arange(side * side),
        "tiles of 4 x 4": tiles(side, 4, 4),
        "tiles of 8 x 4": tiles(side, 8, 4),
        "Morton": morton(side),
        "shuffled": np.random.default_rng(0).permutation(side * side),
    }
    rays = {name: to_rays(o[order], d[order]) for name, order in orders.items()}
    rows = []
    for surface in BEZIER:
        tasks = {name: query_of(bezier(surface), ray, "closest") for name, ray in rays.items()}
        times = time_in_turns(tasks, options.runs)
        for name, timing in times.items():
            ratio = _ratio(timing, times["scanlines"])
            rows.append({"surface": surface, "order": name, **ratio, **timing.as_row()})
    return rows


def order_sections(data: list[dict[str, Any]]) -> list[Section]:
    """Return the table for people."""
    orders = list(dict.fromkeys(row["order"] for row in data))
    surfaces = list(dict.fromkeys(row["surface"] for row in data))
    cells = {(row["surface"], row["order"]): row for row in data}
    return [
        Section(
            "Primary rays in another order: rays a second over those in scanlines",
            ["surface", *orders],
            [[s, *(short(cells[s, order]["ratio"]) for order in orders)] for s in surfaces],
        )
    ]
