"""Lenses as shapes, traced by the kernels, against the float64 trace of the prescription.

    python benchmarks/lenses.py [--rings 8] [--only TEXT ...]

The sample lenses of ``tests/optics/optiland.json`` and ``scenes/lenses``. Rays of three fields go
from surface to surface by `shape.ray_intersect` in float32; refraction and the way to the image
plane are in float64, with the kernel's points and normals. The table has the largest distance
between the two on the image, over the focal length (required: 2e-5), and the spot's radius (root
mean square) from both.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

import mitsuba_bezier as mb  # before anything imports Dr.Jit
from mitsuba_bezier.errors import BezierError
from mitsuba_bezier.optics import (
    beam,
    first_order,
    load,
    pupil_grid,
    trace,
)

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))  # the lenses of the tests

from optics_cases import by_kernels, lens_of, recorded  # noqa: E402

#: Largest distance on the image, over the focal length.
REQUIRED = 2e-5


def main() -> int:
    """Print the table; return 1 if a lens is off by more than is required."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--rings", type=int, default=8, help="rings of rays in the pupil (8)")
    parser.add_argument("--only", nargs="*", default=[], help="names that contain these")
    options = parser.parse_args()
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    lenses = {}
    for name, record in recorded().items():
        lens, largest = lens_of(record), record["field"]
        lenses[name] = replace(lens, fields=[(0.0, h * largest) for h in (0, 0.7, 1)], title=name)
    for path in sorted((ROOT / "scenes/lenses").glob("*.csv")):
        lenses[path.stem] = load(path)
    table = Table(title="Lenses as shapes against the float64 trace")
    for column in ("lens", "surfaces", "f", "rays", "missed", "largest / f", "spot", "by kernels"):
        table.add_column(column, justify="left" if column == "lens" else "right")
    bad = 0
    for name, lens in lenses.items():
        if options.only and not any(text in name for text in options.only):
            continue
        focal = abs(first_order(lens).focal_length)
        worst, rays, missed, spots = 0.0, 0, 0, (0.0, 0.0)
        open_ = replace(lens, surfaces=[replace(s, semi_diameter=np.inf) for s in lens.surfaces])
        try:
            for field in open_.fields:
                for w in open_.wavelengths:
                    o, d = beam(open_, field, pupil_grid(options.rings), w)
                    truth = trace(open_, o, d, w)
                    got = by_kernels(open_, o, d, w)
                    ok = truth.valid & np.isfinite(got).all(axis=1)
                    rays += int(truth.valid.sum())
                    missed += int((truth.valid & ~ok).sum())
                    off = np.linalg.norm(got[ok][:, :2] - truth.local[-1][ok][:, :2], axis=1)
                    worst = max(worst, float(off.max()) / focal)
                    spots = tuple(
                        max(old, float(np.sqrt(((p - p.mean(0)) ** 2).sum(1).mean())))
                        for old, p in zip(spots, (truth.local[-1][ok][:, :2], got[ok][:, :2]))
                    )
        except BezierError as error:
            table.add_row(name, str(len(lens.surfaces)), "", "", "", str(error), "", "")
            continue
        bad += worst > REQUIRED or missed > 0
        table.add_row(
            name,
            str(len(lens.surfaces)),
            f"{focal:.4g}",
            f"{rays:,}",
            str(missed),
            f"{worst:.1e}",
            f"{spots[0]:.5g}",
            f"{spots[1]:.5g}",
        )
    Console(width=110).print(table)
    print(f"mitsuba_bezier {mb.__version__}")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
