"""Lenses as shapes, traced by the kernels, against the float64 trace, Optiland and ray-optics.

    python benchmarks/lenses.py [--only TEXT ...]

The sample lenses of ``tests/optics/optiland.json`` and ``scenes/lenses``, at three fields and three
wavelengths. Rays go from surface to surface by `shape.ray_intersect` in float32; refraction and the
way to the image plane are in float64, with the kernel's points and normals. Spheres are met as the
cap inside the clear aperture, which `lens_shapes` makes, and as whole ones by either cover.

Relative differences are of focal lengths, of the spots' radii (root mean square) from other
programs, and of points on the image and spots' radii from the kernels, over the focal length
(required: 2e-5). The focal length by the kernels is the height of rays over the sine of their angle
behind the lens, at a tenth of the aperture.
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
from mitsuba_bezier.optics import Lens, beam, first_order, load, pupil_grid, trace

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))  # the lenses of the tests

from optics_cases import (  # noqa: E402
    by_kernels,
    lens_at,
    lens_of,
    rays_by_kernels,
    recorded,
    recorded_beam,
    rms,
)

#: Largest difference that is allowed.
REQUIRED = 2e-5
#: How a sphere is met.
KINDS = ("cap", "octants", "tetrahedral")


def by_others(record: dict, row: dict, lens: Lens) -> tuple[float, float]:
    """Return how far spots are from those of Optiland and ray-optics at one wavelength."""
    off = np.zeros(2)
    for k, field in enumerate(lens.fields):
        points = trace(lens, *recorded_beam(record, field), vignetting=False).local[-1][:, :2]
        for i, name in enumerate(("spots", "rayoptics")):
            off[i] = max(off[i], abs(rms(points) / row[name][k] - 1))
    return float(off[0]), float(off[1])


def by_kind(lens: Lens, w: float, o: np.ndarray, d: np.ndarray, kind: str) -> tuple[int, float]:
    """Return how many rays are missed, and the largest difference over the focal length.

    Rays are those of the fields in turn, as many of each.
    """
    focal = abs(first_order(lens, w).focal_length)
    truth = trace(lens, o, d, w, False)
    got = by_kernels(lens, o, d, w, kind)
    ok = truth.valid & np.isfinite(got).all(axis=1)
    off = np.linalg.norm((got - truth.local[-1])[ok][:, :2], axis=1).max()
    for part in np.split(np.arange(len(o)), len(lens.fields)):
        part = part[ok[part]]
        off = max(off, abs(rms(got[part, :2]) - rms(truth.local[-1][part, :2])))
    return int((truth.valid & ~ok).sum()), float(off) / focal


def focal_by_kernels(lens: Lens, w: float) -> float:
    """Return the relative difference of the focal length of a narrow zone."""
    height = 0.1 * first_order(lens).entrance_diameter / 2
    o, d = np.array([[0.0, height, 0.0]]), np.array([[0.0, 0.0, 1.0]])
    exact = trace(lens, o, d, w, False).directions[-2][0]
    _o, found = rays_by_kernels(lens, o - d, d, w)
    return abs(exact[1] / found[0, 1] - 1)


def main() -> int:
    """Print the table; return 1 if a lens is off by more than is required."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--only", nargs="*", default=[], help="names that contain these")
    options = parser.parse_args()
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    table = Table(title="Largest relative differences from the float64 trace")
    columns = ("lens", "surfaces", "f", "f: Optiland", "ray-optics", "kernels", "spots: Optiland")
    columns += ("ray-optics", "rays", "missed", *KINDS)
    for column in columns:
        table.add_column(column, justify="left" if column == "lens" else "right")
    records = recorded()
    names = [*records, *(path.stem for path in sorted((ROOT / "scenes/lenses").glob("*.csv")))]
    bad = 0
    for name in names:
        if options.only and not any(text in name for text in options.only):
            continue
        if name in records:
            record = records[name]
            data = first_order(lens_of(record))
            rows = [(row, lens_at(record, row)) for row in record["spectrum"]]
            focal = [abs(data.focal_length / record["focal_length"] - 1)]
            # one that has mirrors is negative for ray-optics
            focal.append(
                max(
                    abs(abs(row["focal_length"] / first_order(lens).focal_length) - 1)
                    for row, lens in rows
                )
            )
            others = np.max([by_others(record, row, lens) for row, lens in rows], axis=0)
            cells = [f"{v:.1e}" for v in (*focal, *others)]
            bad += max(*focal, *others) > REQUIRED
        else:
            lens = load(ROOT / "scenes/lenses" / f"{name}.csv")
            data = first_order(lens)
            # as wide as its beams
            lens = replace(
                lens,
                surfaces=[replace(s, semi_diameter=np.inf) for s in lens.surfaces],
                aperture=("diameter", data.entrance_diameter),
            )
            rows = [({"wavelength": w}, lens) for w in lens.wavelengths]
            cells = [""] * 4
        found: dict[str, list[tuple[int, float]]] = {kind: [] for kind in KINDS}
        rays = 0
        own = 0.0
        for row, lens in rows:
            w = row["wavelength"]
            beams = [
                recorded_beam(records[name], field)
                if name in records
                else beam(lens, field, pupil_grid(4), w)
                for field in lens.fields
            ]
            o, d = (np.concatenate(parts) for parts in zip(*beams))
            rays += len(o)
            own = max(own, focal_by_kernels(lens, w))
            for kind in KINDS:
                found[kind].append(by_kind(lens, w, o, d, kind))
        missed = sum(n for kind in KINDS for n, _ in found[kind])
        off = [max(v for _, v in found[kind]) for kind in KINDS]
        bad += max(own, *off) > REQUIRED or missed > 0
        table.add_row(
            name,
            str(len(rows[0][1].surfaces)),
            f"{abs(data.focal_length):.4g}",
            *cells[:2],
            f"{own:.1e}",
            *cells[2:],
            f"{rays:,}",
            str(missed),
            *(f"{v:.1e}" for v in off),
        )
    Console(width=150).print(table)
    print(f"mitsuba_bezier {mb.__version__}")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
