"""From one patch to a hundred thousand: build, bytes, rays a second, `update()`."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from common import Options, camera_rays, random_rays, time_in_turns, to_rays
from speed_rays import query_of
from speed_report import Section, judged, short
from speed_surfaces import balls, bezier_shape, height_field, patches_of

import mitsuba_bezier as mb
from mitsuba_bezier.kernels import nodes as nodes_module
from mitsuba_bezier.kernels.structure import Structure, build_structure
from mitsuba_bezier.leaves.builder import build_leaves
from mitsuba_bezier.leaves.records import INVERTED_KINDS, LeafKind

__all__ = ["measure", "net_bytes", "sections"]


class Clock:
    """Seconds, by the clock and of the processor, since it was made."""

    def __init__(self) -> None:
        self._start = time.perf_counter(), time.process_time()

    def read(self) -> dict[str, float]:
        """Return the times up to now."""
        wall, cpu = self._start
        return {"wall": time.perf_counter() - wall, "cpu": time.process_time() - cpu}


@contextmanager
def _timed_tree() -> Iterator[dict[str, float]]:
    """Add up what the trees take while structures are built."""
    spent = {"wall": 0.0, "cpu": 0.0}
    build = nodes_module.build_bvh

    def timed(*args: Any, **kwargs: Any) -> Any:
        clock = Clock()
        result = build(*args, **kwargs)
        for key, value in clock.read().items():
            spent[key] += value
        return result

    nodes_module.build_bvh = timed
    try:
        yield spent
    finally:
        nodes_module.build_bvh = build


def net_bytes(structure: Structure) -> int:
    """Return the bytes of the nets alone: what any representation of the leaves must keep."""
    return (
        structure.has(LeafKind.GRAPH_AFFINE) * sum(b.bytes for b in structure.nets)
        + structure.has(LeafKind.GRAPH_PROJECTIVE) * sum(b.bytes for b in structure.far_nets)
        + structure.has(LeafKind.PLANE_SECTIONS, *INVERTED_KINDS) * len(structure.polynomials) * 4
    )


def build(patches: mb.BezierTriangles) -> tuple[Structure, dict[str, dict[str, float]]]:
    """Build a structure; return the times of its parts too."""
    clock = Clock()
    leaves = build_leaves(patches)
    first = clock.read()
    with _timed_tree() as tree:
        clock = Clock()
        structure = build_structure(leaves, mi.Float)
        dr.sync_thread()
        rest = clock.read()
    rest = {key: rest[key] - tree[key] for key in rest}
    return structure, {"leaves": first, "tree": dict(tree), "upload": rest}


def measure(options: Options) -> list[dict[str, Any]]:
    """Measure a sphere, then height fields of growing numbers of patches."""
    side = min(1024, options.side_of_rays)
    cases = {
        "sphere, tetrahedral": patches_of("sphere, tetrahedral"),
        "sphere, octants": patches_of("sphere, octants"),
        **{f"height field, {n}": height_field(n) for n in options.patches},
        **{f"balls, {n}": balls(n) for n in options.patches[-2:]},
    }
    rays = {
        "coherent": to_rays(*camera_rays(side)),
        "random": to_rays(*random_rays(side * side)),
    }
    build(cases["sphere, octants"])  # what is slow the first time only: imports, kernels to upload
    rows = []
    for name, patches in cases.items():
        structure, parts = build(patches)
        shape = mi.load_dict(bezier_shape(patches))
        query = {kind: query_of(shape, ray, "closest") for kind, ray in rays.items()}
        dr.eval(query["random"]())
        times = time_in_turns(query, options.runs)
        rows.append(
            {
                "surface": name,
                "patches": len(patches),
                "leaves": structure.leaf_count,
                "parts": parts,
                "build": sum(p["wall"] for p in parts.values()),
                "build_cpu": sum(p["cpu"] for p in parts.values()),
                "bytes_per_leaf": (structure.bytes - net_bytes(structure)) / structure.leaf_count,
                "net_bytes_per_leaf": net_bytes(structure) / structure.leaf_count,
                "rays_per_second": {k: side * side / t.best for k, t in times.items()},
                "update": _update(shape),
            }
        )
    return rows


def _update(shape: Any) -> dict[str, dict[str, float]]:
    """Move the whole surface, then a thousandth of its patches; return the times of both.

    Each is the time until a first ray is answered. All patches move under an affine map, so that
    those with a closed form keep it.
    """
    ray = to_rays(*random_rays(16))
    dr.eval(shape.ray_intersect_preliminary(ray).t)
    params = mi.traverse(shape)
    out = {}
    for name in ("all", "few"):
        net = np.array(params["control_points"])
        which = slice(None) if name == "all" else slice(-(-len(net) // 1000))
        net[which, :, :3] *= np.float32([1.02, 0.99, 1.01])
        moved = mi.TensorXf(net.ravel(), shape=net.shape)
        dr.eval(moved)
        clock = Clock()
        params["control_points"] = moved
        params.update()
        dr.eval(shape.ray_intersect_preliminary(ray).t)
        dr.sync_thread()
        out[name] = clock.read()
    return out


def sections(data: list[dict[str, Any]]) -> list[Section]:
    """Return the table for people."""
    limits = {"sphere, tetrahedral": 0.05, "sphere, octants": 0.05}
    limits |= {"height field, 100000": 20.0, "balls, 100000": 20.0}
    rows = []
    for r in data:
        parts, limit = r["parts"], limits.get(r["surface"])
        bytes_limit = 200 if r["surface"] == "height field, 100000" else None
        rows.append(
            [
                r["surface"],
                str(r["leaves"]),
                *(f"{parts[k]['wall']:.3g}" for k in ("leaves", "tree", "upload")),
                judged(r["build"], limit, at_most=True),
                short(r["build_cpu"]),
                judged(r["bytes_per_leaf"], bytes_limit, at_most=True),
                short(r["net_bytes_per_leaf"]),
                *(short(r["rays_per_second"][k] / 1e6) for k in ("coherent", "random")),
                *(f"{r['update'][k]['wall']:.3g}" for k in ("all", "few")),
            ]
        )
    header = ["surface, patches", "leaves", "leaves, s", "tree, s", "upload, s", "build, s"]
    header += ["processor, s", "bytes a leaf", "+ net", "coherent, M/s", "random, M/s"]
    header += ["update of all, s", "of a thousandth, s"]
    return [Section("Build, memory and speed (required)", header, rows)]
