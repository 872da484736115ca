"""The sag of even aspheres, and what is no asphere."""

from __future__ import annotations

import numpy as np
import pytest
from asphere_cases import ASPHERES

from mitsuba_bezier.errors import GeometryError
from mitsuba_bezier.geometry.aspheres import EvenAsphere
from mitsuba_bezier.optics import Surface


@pytest.mark.parametrize("name", ASPHERES)
def test_the_sag_is_that_of_a_prescription(name):
    s = ASPHERES[name]
    other = Surface(s.curvature, conic=s.conic, coefficients=tuple(s.coefficients))
    r = np.linspace(0, s.aperture, 999)
    f, slope, _second = s.derivatives(r**2)
    scale = 1 + np.abs(f).max()
    assert np.abs(f - other.sag(r)).max() < 1e-13 * scale
    assert np.abs(f - s.sag(r**2)).max() < 1e-13 * scale
    assert np.abs(2 * slope - other.slope(r)).max() < 1e-11 * (1 + np.abs(slope).max())


@pytest.mark.parametrize("name", ASPHERES)
def test_derivatives_are_those_of_the_sag(name):
    s = ASPHERES[name]
    at = np.linspace(0.01, 0.95, 50) * s.aperture**2
    step = 1e-5 * s.aperture**2
    f, slope, second = s.derivatives(at)
    (_, before, _), (_, after, _) = s.derivatives(at - step), s.derivatives(at + step)
    # central differences: the third derivative times the step squared, and roundings over the step
    tolerance = 1e-5 * np.abs(second).max() + 1e-9 * np.abs(slope).max() / step + 1e-300
    assert np.abs((s.sag(at + step) - s.sag(at - step)) / (2 * step) - slope).max() < (
        1e-5 * np.abs(slope).max() + 1e-9 * np.abs(f).max() / step + 1e-300
    )
    assert np.abs((after - before) / (2 * step) - second).max() < tolerance


def test_units_of_the_aperture():
    s = ASPHERES["gull"]
    unit = s.normalised()
    r = np.linspace(0, 1, 50)
    assert unit.aperture == 1
    assert np.abs(unit.sag(r**2) * s.aperture - s.sag((r * s.aperture) ** 2)).max() < 1e-14


def test_areas():
    # a zone of a sphere: 2 pi R h, also turned, and 4 times as large by twice the size
    ball = EvenAsphere(1 / 5, 4, inner=3)
    area = 2 * np.pi * 5 * (4 - 3)
    assert ball.area() == pytest.approx(area, rel=1e-12)
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    assert ball.area(2 * turn) == pytest.approx(4 * area, rel=1e-12)
    # an ellipse
    assert EvenAsphere(0, 2).area(np.diag([3, 5, 7])) == pytest.approx(60 * np.pi, rel=1e-12)


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        ({"aperture": -1}, "aperture: expected a positive radius, got -1"),
        ({"aperture": np.nan}, "aperture: expected a positive radius"),
        ({"aperture": np.inf}, "aperture: expected a positive radius"),
        ({"curvature": np.nan}, "curvature: expected a finite number"),
        ({"conic": np.inf}, "conic: expected a finite number"),
        ({"coefficients": (0, np.nan)}, "coefficients: expected finite numbers"),
        ({"coefficients": (1e300,)}, "coefficients: expected a sag below"),
        (
            {"coefficients": (1.0,) * 200, "aperture": 1e3, "curvature": 0},
            "coefficients: expected a sag below",
        ),
        ({"inner": 1}, "inner_radius: expected a radius from 0 to below 1"),
        ({"inner": -0.1}, "inner_radius: expected a radius from 0"),
        ({"curvature": 2}, "where it is 4"),
        ({"curvature": 1}, "at most 0.9999"),
        ({"curvature": 0.1, "conic": 1e3}, "is a graph"),
    ],
)
def test_what_is_no_asphere(numbers, message):
    with pytest.raises(GeometryError, match=message):
        EvenAsphere(**{"curvature": 0.1, "aperture": 1, **numbers})


def test_nothing_is_too_high_that_is_zero():
    # the power of the radius alone would be infinite
    assert EvenAsphere(0.0, 1e3, coefficients=(1e-6, *[0.0] * 200)).sag(1.0) == 1e-6
