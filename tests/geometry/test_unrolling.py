"""Unrolling a developable keeps lengths and areas."""

from __future__ import annotations

import numpy as np
import pytest

from mitsuba_bezier.errors import GeometryError
from mitsuba_bezier.geometry.developable import DevelopableSurface
from mitsuba_bezier.geometry.unrolling import strip, strip_faces, unrolled

PLANES = [[1, 0, 0.2, -1], [0.8, 0.8, -0.3, -1], [0, 1, 0.1, -1.1], [-0.9, 0.6, 0, -1]]
BOTTOM, TOP = [0, 0, 1, 0], [0, 0, 1, -1]
SURFACE = DevelopableSurface(PLANES)


def area(x: np.ndarray) -> np.ndarray:
    a, b, c = np.moveaxis(x[strip_faces(len(x))], 1, 0)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


def lengths(x: np.ndarray) -> np.ndarray:
    return np.concatenate(
        [np.linalg.norm(x[k:] - x[:-k], axis=1) for k in (1, 2)]  # rulings, diagonals, sides
    )


@pytest.mark.parametrize("bend", [0.0, 0.3, 0.8, 1.0, 1.4])
def test_bending_keeps_every_length_and_area(bend):
    x = strip(SURFACE, BOTTOM, TOP, 150)
    y = unrolled(x, bend)
    # 300 steps, each a few roundings
    np.testing.assert_allclose(lengths(y), lengths(x), rtol=1e-10)
    np.testing.assert_allclose(area(y), area(x), rtol=1e-8)
    if bend == 1:
        np.testing.assert_allclose(y, x, atol=1e-10)
    if bend == 0:  # flat
        centred = y - y.mean(axis=0)
        assert np.linalg.svd(centred, compute_uv=False)[2] < 1e-10


def test_the_flat_strip_converges_to_the_surface():
    """Area and boundary lengths against those of the exact patch, to second order."""
    patch = SURFACE.patch(BOTTOM, TOP)
    exact = patch.area().sum()
    t = np.linspace(0, 1, 20001)
    curve = SURFACE.trace(BOTTOM).points(t)
    arc = np.linalg.norm(np.diff(curve, axis=0), axis=1).sum()  # to 1e-9, by its own steps
    errors = []
    for n in (50, 100, 200):
        y = unrolled(strip(SURFACE, BOTTOM, TOP, n))
        side = np.linalg.norm(np.diff(y[::2], axis=0), axis=1).sum()
        errors.append((abs(area(y).sum() / exact - 1), abs(side / arc - 1)))
    errors = np.array(errors)
    assert errors[-1].max() < 2e-4
    # a quarter with half the step; 3.5 leaves room for higher order
    assert (errors[:-1] / errors[1:] > 3.5).all()


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: unrolled(np.zeros((2, 3))), "n >= 3"),
        (lambda: unrolled([[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 1, 0]]), "on a line"),
        (lambda: unrolled(np.eye(3), np.nan), "bend"),
        (lambda: strip(SURFACE, BOTTOM, TOP, 1), "integer >= 2"),
        (lambda: strip(SURFACE, BOTTOM, BOTTOM, 5), "rulings with a length"),
    ],
)
def test_bad_strips(call, says):
    with pytest.raises(GeometryError) as caught:
        call()
    assert says in str(caught.value)
