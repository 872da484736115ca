"""Measure nets of tensor-product patches in powers of the patch against those of total degree.

    python benchmarks/tensor_nets.py [--surfaces teapot,5x5] [--million 1] [--runs 5]

Leaves of both kinds are built of the same patches, in float64, and meet the same rays in turns.
Operations are those of a value and two partials, numbers those that a march reads of a net. A
surface `PxQ` is a height field of nine patches of that degree.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

import mitsuba_bezier as mb  # before Dr.Jit, for which it finds LLVM

sys.path.insert(0, str(Path(__file__).parent))  # for a caller that is not in this folder

import mitsuba as mi
import numpy as np
from common import camera_rays, machine, random_rays, set_variant, time_in_turns, to_rays
from speed_surfaces import patches_of

from mitsuba_bezier.geometry import bernstein
from mitsuba_bezier.kernels.buckets import Bucket
from mitsuba_bezier.kernels.structure import Structure, build_structure
from mitsuba_bezier.kernels.traverse import intersect
from mitsuba_bezier.leaves.builder import build_leaves
from mitsuba_bezier.leaves.graph import subdivision
from mitsuba_bezier.leaves.nets import Powers
from mitsuba_bezier.leaves.records import LeafSettings


def surface(name: str) -> mb.BezierTriangles:
    """Return the patches of a surface."""
    if "x" not in name:
        return patches_of(name)
    p, q = (int(d) for d in name.split("x"))
    nets = []
    for i in range(3):
        for j in range(3):
            at = (2 * (i + np.arange(p + 1) / p) / 3 - 1, 2 * (j + np.arange(q + 1) / q) / 3 - 1)
            x, y = np.meshgrid(*at, indexing="ij")
            z = 0.25 * np.sin(4 * x) * np.cos(3 * y) + 0.1 * np.sin(9 * x + 3 * y)
            nets.append(np.stack([x, y, z, np.ones_like(x)], axis=-1))
    return mb.tensor_to_triangles(np.array(nets))


def whole_powers(nets: np.ndarray) -> np.ndarray:
    """Return all powers of the degree of nets, as `patch_powers` would."""
    return np.full((len(nets), 3), bernstein.degree_of(nets.shape[1]))


def operations(powers: Powers, components: int, framed: bool) -> int:
    """Return the fused operations of Horner's method for a value and its partials."""
    rows = [powers.top(a) for a in range(powers.p, -1, -1)]
    one = sum(top + max(top - 1, 0) for top in rows) + len(rows) - 1 + 2 * (len(rows) - 2)
    one += rows[0] > 0  # then the first row has a partial by t, too
    return components * (one + 4 * framed) + 4 * framed


def described(bucket: Bucket) -> str:
    """Return what a bucket's nets are: powers, numbers to read, operations."""
    if bucket.powers is None:
        return "row by row"
    p, q, n = bucket.powers
    kind = f"degree {n}" if min(p, q) == n else f"({p}, {q})"
    numbers = bucket.powers.size * bucket.components + 4 * bucket.framed
    steps = operations(bucket.powers, bucket.components, bucket.framed)
    return f"{kind}: {numbers} numbers, {steps} operations"


def queries(structure: Structure, ray: Any) -> dict[str, Any]:
    """Return the queries that are timed."""
    o, d = list(ray.o), list(ray.d)

    def closest() -> Any:
        hit = intersect(structure, o, d, ray.maxt)
        return hit.valid, hit.t, hit.u, hit.v, hit.patch

    def any_hit() -> Any:
        return intersect(structure, o, d, ray.maxt, any_hit=True).valid

    return {"closest": closest, "any": any_hit}


def measure(name: str, million: float, runs: int) -> tuple[Table, Table]:
    """Return tables of sizes and of times of a surface."""
    patches = surface(name)
    find = subdivision.patch_powers
    structures = {}
    sizes = Table("nets", "leaves", "buckets", "of nets, kB", "of all, kB", title=name)
    for kind in ("tensor", "whole"):
        if kind == "whole":
            subdivision.patch_powers = whole_powers
        try:
            leaves = build_leaves(patches, LeafSettings(closed_form=False))
        finally:
            subdivision.patch_powers = find
        structures[kind] = s = build_structure(leaves, mi.Float)
        sizes.add_row(
            kind,
            f"{len(leaves)}",
            "; ".join(described(b) for b in s.nets),
            f"{sum(b.bytes for b in s.nets) / 1e3:.0f}",
            f"{s.bytes / 1e3:.0f}",
        )
    times = Table("rays", "query", "tensor, ns", "whole, ns", "ratio", title="processor time a ray")
    side = int(np.sqrt(million * 1e6))
    for rays, pair in (("coherent", camera_rays(side)), ("random", random_rays(side * side))):
        ray = to_rays(*pair)
        tasks = {
            f"{kind} {query}": task
            for kind, s in structures.items()
            for query, task in queries(s, ray).items()
        }
        found = time_in_turns(tasks, runs)
        for query in ("closest", "any"):
            tensor, whole = (found[f"{k} {query}"].cpu / side**2 * 1e9 for k in structures)
            times.add_row(rays, query, f"{tensor:.0f}", f"{whole:.0f}", f"{whole / tensor:.2f}")
    return sizes, times


def main(arguments: list[str] | None = None) -> None:
    """Measure, and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--surfaces", default="teapot,4x4,5x5", help="which (teapot,4x4,5x5)")
    parser.add_argument("--variant", default="llvm_ad_rgb", help="Mitsuba variant (llvm_ad_rgb)")
    parser.add_argument("--million", type=float, default=1.0, help="rays, in millions (1)")
    parser.add_argument("--runs", type=int, default=5, help="repetitions (5)")
    options = parser.parse_args(arguments)
    mb.register()
    set_variant(options.variant)
    print(machine())
    for name in options.surfaces.split(","):
        for table in measure(name, options.million, options.runs):
            Console(width=140).print(table)


if __name__ == "__main__":
    main()
