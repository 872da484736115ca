"""Curves in space, pulled back to the parameters of the surface they lie on."""

from __future__ import annotations

import numpy as np
import pytest

from mitsuba_bezier.io.cad.opencascade_surfaces import arc
from mitsuba_bezier.io.cad.pull_back import grid_axes, pulled_back
from mitsuba_bezier.io.nurbs_surface import PatchGrid, bezier_points

TURN = 2 * np.pi


def turned(profile, v) -> PatchGrid:
    """Turn a profile ``(S, q+1, 3)`` of rows (w distance, w height, w) about z."""
    circle, breaks = arc(0.0, TURN)
    f, g, w = np.moveaxis(np.asarray(profile, dtype=float), -1, 0)
    c, s, one = np.moveaxis(circle, -1, 0)
    rows = [np.einsum("ui,vj->uvij", a, b) for a, b in ((c, f), (s, f), (one, g), (one, w))]
    return PatchGrid(np.stack(rows, axis=-1), breaks, np.asarray(v, dtype=float))


def cylinder() -> PatchGrid:
    return turned([[[2, 0, 1], [2, 3, 1]]], [0, 3])


def ball() -> PatchGrid:
    pieces, breaks = arc(-np.pi / 2, np.pi / 2)
    return turned(pieces, breaks)


def bow(start, stop, radius, height) -> np.ndarray:
    """Return an arc about z in space, by its angles."""
    middle, w = (start + stop) / 2, np.cos((stop - start) / 2)
    at = [(start, 1.0, 1.0), (middle, 1.0, w), (stop, 1.0, 1.0)]
    return np.array([[radius * np.cos(a), radius * np.sin(a), height * k, k] for a, _one, k in at])


def test_axes_are_found():
    axes = grid_axes(cylinder())
    np.testing.assert_allclose(axes.period, [TURN, 0])
    assert axes.poles == ([], [])
    axes = grid_axes(ball())
    np.testing.assert_allclose(axes.period, [TURN, 0])
    assert axes.poles == ([], [-np.pi / 2, np.pi / 2])


@pytest.mark.parametrize("start, stop", [(-1.0, 1.0), (0.0, 1.2), (-0.9, 0.0), (2.0, 3.5), (5, 7)])
@pytest.mark.parametrize("shape, height", [(cylinder, 1.2), (ball, 0.7)])
def test_curve_across_the_seam_goes_on(shape, height, start, stop):
    grid = shape()
    radius = 2.0 if shape is cylinder else np.sqrt(1 - height**2)
    curve = bow(start, stop, radius, height)
    axes = grid_axes(grid)
    (place,), off = pulled_back(grid, axes, curve[None])
    t = np.linspace(0, 1, 50)
    uv = place(t)
    # 1e-13: rounding of lengths near 2
    assert off < 1e-13
    inside = uv.copy()
    inside[:, 0] -= TURN * np.floor(uv[:, 0] / TURN)
    np.testing.assert_allclose(grid.jet(inside)[0], bezier_points(curve, t), atol=1e-12)
    # a jump would be of a whole period, the speed of a rational arc is below 2.5 of its mean
    assert np.abs(np.diff(uv[:, 0])).max() < 2.5 * (stop - start) / 49
    assert np.ptp(uv[:, 0]) == pytest.approx(stop - start, rel=0.2)


@pytest.mark.parametrize("angle", [0.0, 1.0, 4.0])
def test_curve_from_a_pole_keeps_its_meridian(angle):
    pieces, _breaks = arc(0.3, np.pi / 2)
    (piece,) = pieces
    c, s, w = piece.T
    curve = np.column_stack([c * np.cos(angle), c * np.sin(angle), s, w])
    grid = ball()
    (place,), off = pulled_back(grid, grid_axes(grid), curve[None])
    uv = place(np.linspace(0, 1, 20))
    assert off < 1e-13 and np.ptp(uv[:, 0]) < 1e-6
    assert uv[-1, 1] == pytest.approx(np.pi / 2, abs=1e-6)


def test_distance_from_the_surface_is_told():
    grid = cylinder()
    _places, off = pulled_back(grid, grid_axes(grid), bow(0.2, 1.4, 2.01, 1.0)[None])
    assert off == pytest.approx(0.01, rel=1e-9)


def test_curve_at_the_side_of_an_open_surface():
    """Steps that leave the surface must not hide the nearest point of its side."""
    waves = np.zeros((1, 1, 4, 4, 4))
    waves[0, 0, :, :, 0], waves[0, 0, :, :, 1] = np.meshgrid(
        np.arange(4) / 3, np.arange(4) / 3, indexing="ij"
    )
    waves[..., 2] = np.array([0, 2.0, -2.0, 0])[:, None] * [1, 0.2, 0.5, 1]
    waves[..., 3] = 1
    grid = PatchGrid(waves, np.array([0.0, 1]), np.array([0.0, 1]))
    curve = waves[0, 0, :, 0]
    (place,), off = pulled_back(grid, grid_axes(grid), curve[None])
    t = np.linspace(0, 1, 30)
    assert off < 1e-14
    np.testing.assert_allclose(place(t), np.column_stack([t, 0 * t]), atol=1e-9)
