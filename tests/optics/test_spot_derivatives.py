"""Derivatives of spots by the prescription, against differences of whole traces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mitsuba_bezier.errors import PrescriptionError
from mitsuba_bezier.optics import Abbe, Constant, Lens, Surface, spot, spot_derivatives, trace
from mitsuba_bezier.optics.frames import turn


def triplet() -> Lens:
    """Return a Cooke triplet, f = 50, f/5 (ZEMAX's sample), whose stop has a fixed size."""
    crown, flint = Abbe(1.6204, 60.32), Abbe(1.6200, 36.37)
    rows = [
        (22.01359, 3.25896, crown),
        (-435.76044, 6.00755, None),
        (-22.21328, 0.99997, flint),
        (20.29192, 4.75041, None),
        (79.68360, 2.95208, crown),
        (-18.39533, 42.20778, None),
    ]
    surfaces = [
        Surface(1 / r, t, medium or Constant(1.0), stop=i == 3, semi_diameter=12.0)
        for i, (r, t, medium) in enumerate(rows)
    ]
    return Lens(surfaces, aperture=("stop", 3.9), wavelengths=[0.48, 0.55, 0.65], weights=[1, 2, 1])


def rms(lens: Lens, field: tuple[float, float]) -> float:
    found = [spot(lens, field, w).points for w in lens.wavelengths]
    share = np.concatenate([np.full(len(p), s) for p, s in zip(found, lens.weights)])
    points = np.concatenate(found)
    share = share / share.sum()
    return float(np.sqrt(share @ ((points - share @ points) ** 2).sum(axis=1)))


def changed(lens: Lens, i: int, kind: str, step: float, power: int = 0) -> Lens:
    s = lens.surfaces[i]
    if kind in ("nd", "vd"):
        value: dict = {"medium": replace(s.medium, **{kind: getattr(s.medium, kind) + step})}
    elif kind == "coefficients":
        a = list(s.coefficients)
        a[power] += step
        value = {kind: tuple(a)}
    else:
        value = {kind: getattr(s, kind) + step}
    return replace(
        lens, surfaces=[*lens.surfaces[:i], replace(s, **value), *lens.surfaces[i + 1 :]]
    )


def difference(lens: Lens, field, i: int, kind: str, step: float, power: int = 0) -> float:
    up, down = changed(lens, i, kind, step, power), changed(lens, i, kind, -step, power)
    return (rms(up, field) - rms(down, field)) / (2 * step)


#: Steps small enough that third derivatives do not count, and large against roundings.
STEPS = {"curvature": 1e-7, "thickness": 1e-5, "conic": 1e-4, "nd": 1e-6, "vd": 1e-3}


@pytest.mark.parametrize("field", [(0.0, 0.0), (0.0, 14.0), (7.0, 12.0)])
@pytest.mark.parametrize("kind", STEPS)
def test_a_triplet_s_spot_by_every_parameter(kind, field):
    lens = triplet()
    found = getattr(spot_derivatives(lens, field), kind)
    assert spot_derivatives(lens, field).rms == pytest.approx(rms(lens, field), rel=1e-12)
    where = [
        i for i in range(6) if kind not in ("nd", "vd") or isinstance(lens.surfaces[i].medium, Abbe)
    ]
    expected = [difference(lens, field, i, kind, STEPS[kind]) for i in where]
    # required are 1 %; differences are good to step^2 and to roundings over the step, 1e-6 here
    assert found[where] == pytest.approx(expected, rel=1e-5, abs=1e-6 * np.abs(expected).max())


def test_aspheres_a_near_object_and_glass_without_dispersion():
    lens = Lens(
        [
            Surface(1 / 30, 5, Constant(1.6), 9, -0.4, (1e-4, 2e-6, -3e-9)),
            Surface(0, 3, stop=True, semi_diameter=9),
            Surface(-1 / 40, 70, Constant(1.33), 9, 0.7),
        ],
        object_distance=90.0,
        aperture=("stop", 4.0),
        field_kind="object_height",
        weights=[1.0],
    )
    field = (1.0, 5.0)
    found = spot_derivatives(lens, field)
    steps = {"curvature": 1e-7, "thickness": 1e-5, "conic": 1e-4}
    for kind, step in steps.items():
        expected = [difference(lens, field, i, kind, step) for i in range(3)]
        got = getattr(found, kind)
        assert got == pytest.approx(expected, rel=1e-5, abs=1e-6 * np.abs(expected).max())
    for power, size in enumerate([1e-4, 2e-6, 3e-9]):
        expected = difference(lens, field, 0, "coefficients", 1e-3 * size, power)
        assert found.coefficients[0][power] == pytest.approx(expected, rel=1e-5)
    assert not found.vd.any()


def test_mirrors_and_tilts():
    lens = Lens(
        [
            Surface(-1 / 400, -150, mirror=True, stop=True, semi_diameter=30, conic=-0.9),
            Surface(0, 0, mirror=True, before=turn(40), after=turn(40)),
            Surface(1 / 300, 35, Constant(1.5), semi_diameter=60),
        ],
        aperture=("stop", 25.0),
        weights=[1.0],
    )
    assert trace(lens, [[0, 1, -9]], [[0, 0, 1]]).valid.all()
    field = (0.0, 0.4)
    found = spot_derivatives(lens, field)
    for kind in ("curvature", "thickness", "conic"):
        expected = [difference(lens, field, i, kind, STEPS[kind]) for i in range(3)]
        got = getattr(found, kind)
        assert got == pytest.approx(expected, rel=1e-5, abs=1e-6 * np.abs(expected).max())


def test_a_point_has_no_derivative():
    mirror = Lens(
        [Surface(0, 100, stop=True, semi_diameter=4)], object_distance=5, aperture=("stop", 1e-300)
    )
    with pytest.raises(PrescriptionError, match="spot: expected one with a size"):
        spot_derivatives(mirror, pupil=np.zeros((3, 2)))
