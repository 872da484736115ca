"""The row of the accuracy suite for even aspheres."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from accuracy_rows import scaled
from accuracy_tools import Line, Tracer, describe

from mitsuba_bezier.geometry.aspheres import EvenAsphere
from mitsuba_bezier.leaves.records import ClosedFormLeaves, GraphLeaves, Leaves
from mitsuba_bezier.leaves.revolution import revolution_leaf
from mitsuba_bezier.oracles.aspheres import first_hits

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))  # the aspheres of the tests

from asphere_cases import ASPHERES, asphere_parameters, rays_at

__all__ = ["asphere_parameters", "aspheres"]

Rng = np.random.Generator

#: Rays that pass the surface at less than this, in apertures, may go either way: some thousand
#: roundings of float64. For other surfaces it is 2e-6 to 1e-5.
GRAZING = 1e-12
#: The same at the rims, whose tolerance is 1e-6.
RIM = 2e-6
#: Rays a part: bounds the memory.
_PART = 100_000


def asphere_tracer(surface: EvenAsphere) -> Tracer:
    """Return the kernel over one asphere."""
    leaf = revolution_leaf(surface, np.eye(4))
    return Tracer.of(Leaves(GraphLeaves.zeros(), ClosedFormLeaves.zeros(), leaf))


def aspheres(rng: Rng, scale: float) -> Iterator[Line]:
    """Rays from all sides, nine kinds of them, against the sag in float64; any hit, too."""
    for name, surface in ASPHERES.items():
        tracer = asphere_tracer(surface)
        count, judged, wrong, differs, worst = scaled(400_000, scale), 0, 0, 0, 0.0
        failures: list[str] = []
        for first in range(0, count, _PART):
            size = min(_PART, count - first)
            o, d, kind = rays_at(surface, size, int(rng.integers(1 << 31)))
            truth = first_hits(surface, o, d)
            got, any_hit = tracer(o, d), tracer(o, d, any_hit=True)
            asked = (truth.grazing > GRAZING) & (truth.rim > RIM)
            hit = np.isfinite(truth.t)
            both = np.flatnonzero(asked & hit & got.valid)
            length = np.linalg.norm(d[both].astype(float), axis=1)
            error = np.abs(got.t[both] - truth.t[both]) * length
            error /= surface.aperture + truth.t[both] * length
            bad = asked & (got.valid != hit)
            bad[both[error > 1e-6]] = True  # another root
            judged += int(asked.sum())
            wrong += int(bad.sum())
            differs += int((any_hit.valid != got.valid).sum())
            worst = max(worst, float(error[error <= 1e-6].max(initial=0.0)))
            failures += describe(o, d, bad, kind, got.t, truth.t)[: 3 - len(failures)]
        yield Line(
            name,
            judged,
            "0 wrong, closest and any",
            f"{wrong} wrong, {differs} any, {judged / count:.1%} judged, max |dt| {worst:.1e}",
            not (wrong or differs),
            {"wrong": wrong, "any": differs, "judged": judged / count, "max |dt|": worst},
            failures,
        )
