"""Hits on the Bézier sphere against the analytic sphere, computed in float64 from the same rays.

    python benchmarks/accuracy_sphere.py [--variant llvm_ad_rgb] [--json FILE]

Four million coherent and two million random rays on each cover, the control points once in
float32, as Mitsuba's tensors usually are, and once in float64. The silhouette is where the
distance of a ray from the centre equals the radius; float32 control points alone move it by 1e-7.
"""

from __future__ import annotations

import argparse
import json
from typing import Any

import mitsuba_bezier as mb  # before Dr.Jit: chooses its LLVM

# isort: split
import mitsuba as mi
import numpy as np
from common import camera_rays, machine, random_rays, to_rays
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from mitsuba_bezier._files import write_file

#: Rays this near the silhouette, relative to the radius, may go either way.
BAND = 2e-6


def analytic(o: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the nearest ray parameter, infinite for a miss, and the distance from the centre."""
    o, d = o.astype(np.float64), d.astype(np.float64)
    dd = np.einsum("ni,ni->n", d, d)
    along = -np.einsum("ni,ni->n", o, d) / dd
    foot = o + along[:, None] * d
    square = np.einsum("ni,ni->n", foot, foot)
    t = along - np.sqrt(np.maximum(1 - square, 0) / dd)
    return np.where(square <= 1, t, np.inf), np.sqrt(square)


def bezier(cover: str, double: bool) -> Any:
    net = mb.sphere(cover=cover).control_points
    if double:
        tensor = mi.TensorXf64(net.ravel(), shape=net.shape)
    else:
        tensor = mi.TensorXf(net.astype(np.float32).ravel(), shape=net.shape)
    return mi.load_dict({"type": "beziertriangle", "control_points": tensor})


def compare(shape: Any, o: np.ndarray, d: np.ndarray) -> dict[str, float]:
    ray = to_rays(o, d)
    pi = shape.ray_intersect_preliminary(ray)
    t, blocked = np.array(pi.t), np.array(shape.ray_test(ray))
    truth, distance = analytic(o, d)
    hit, expected = np.isfinite(t), np.isfinite(truth)
    off = np.abs(distance - 1)
    wrong = hit != expected
    both = hit & expected
    error = np.abs(t[both] - truth[both])
    cosine = np.sqrt(1 - distance[both] ** 2)
    return {
        "rays": len(t),
        "wrong": int((wrong & (off > BAND)).sum()),
        "wrong_in_band": int((wrong & (off <= BAND)).sum()),
        "any_hit_differs": int((blocked != hit).sum()),
        "worst_t": float(error[off[both] > BAND].max()),
        "worst_t_in_band": float(error.max()),
        "worst_across": float((error * cosine).max()),
        "median_t": float(np.median(error)),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--variant", default="llvm_ad_rgb")
    parser.add_argument("--json", metavar="FILE", help="write the numbers to a file")
    arguments = parser.parse_args()
    mi.set_variant(arguments.variant)

    rows = []
    kinds = {"coherent": camera_rays(2000), "random": random_rays(2_000_000)}
    for cover in ("octants", "tetrahedral"):
        for double in (False, True):
            shape = bezier(cover, double)
            for kind, (o, d) in kinds.items():
                numbers = "float64" if double else "float32"
                row = {"cover": cover, "control_points": numbers, "kind": kind}
                rows.append({**row, **compare(shape, o, d)})
    table = Table(
        title=f"wrong hits and misses, error of t; band: {BAND:g} around the silhouette",
        box=SIMPLE_HEAD,
        padding=0,
    )
    table.add_column("cover, points, rays", no_wrap=True)
    for heading in ("wrong", "in band", "any hit", "error", "in band", "across"):
        table.add_column(f" {heading}", justify="right", no_wrap=True)
    for row in rows:
        table.add_row(
            f"{row['cover']} {row['control_points']} {row['kind']}",
            *(str(row[k]) for k in ("wrong", "wrong_in_band", "any_hit_differs")),
            *(
                f"{row[k]:.1e}".replace("e-0", "e-")
                for k in ("worst_t", "worst_t_in_band", "worst_across")
            ),
        )
    console = Console()
    console.print(table)
    about = machine()
    console.print(", ".join(f"{k} {v}" for k, v in about.items() if v is not None))
    if arguments.json:
        text = json.dumps({"machine": about, "rows": rows}, indent=1)
        write_file(arguments.json, text.encode())


if __name__ == "__main__":
    main()
