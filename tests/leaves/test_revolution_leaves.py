"""Bounds of the leaves of even aspheres, against dense samples of the sag."""

from __future__ import annotations

import numpy as np
import pytest
from asphere_cases import ASPHERES

from mitsuba_bezier.geometry.aspheres import STEEPEST, EvenAsphere
from mitsuba_bezier.leaves.records import ClosedFormLeaves, GraphLeaves, LeafKind, Leaves
from mitsuba_bezier.leaves.revolution import MARGIN, OVERLAP, make_profile, revolution_leaf

CASES = {
    **ASPHERES,
    "as steep as can be": EvenAsphere(np.sqrt(STEEPEST), 1),
    "beyond float32": EvenAsphere(1e-12, 1e12, -1, (0, 1e-38)),
}


def cells_of(profile, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the cells of squared distances, and those from their middles, as the kernel does."""
    one = np.float32(1)
    grade = (one - np.float32(profile.grading) * s.astype(np.float32)).astype(np.float32)
    shift = np.uint32(23 - profile.bits)
    code = grade.view(np.uint32) >> shift
    ends = [((code + np.uint32(k)) << shift).view(np.float32).astype(float) for k in (0, 1)]
    middle = (1 - (ends[0] + ends[1]) / 2) / profile.grading
    return code.astype(int) - profile.first, s - middle


@pytest.mark.parametrize("name", CASES)
def test_bounds_hold_and_are_close(name):
    profile = make_profile(CASES[name])
    rng = np.random.default_rng(0)
    s = np.concatenate([rng.random(20_000), [0, 1, 1 + 0.75 * MARGIN, 1e-12]])
    cell, off = cells_of(profile, s)
    assert cell.min() >= 0
    assert cell.max() < len(profile.cells)
    c = profile.cells[cell].astype(float)
    # also a little outside of the cell
    for moved in (0.0, -OVERLAP / 2, OVERLAP / 2):
        if moved and (s + moved > 1 + MARGIN).any():
            s, off, c = (x[s + moved <= 1 + MARGIN] for x in (s, off, c))
        f, _slope, second = profile.surface.derivatives(s + moved)
        q = off + moved
        polynomial = c[:, 0] + q * (c[:, 1] + q * (c[:, 2] + q * (c[:, 3] + q * c[:, 4])))
        # coefficients are rounded to float32
        rounding = 6e-8 * (np.abs(c[:, 0]) + np.abs(c[:, 1] * q) + np.abs(c[:, 2] * q * q))
        assert (np.abs(polynomial - f) <= c[:, 7] + 2 * rounding + 1e-15).all()
        assert (second >= c[:, 5]).all()
        assert (second <= c[:, 6]).all()
    largest = np.abs(profile.cells[:, 5:7]).max()
    change = c[:, 6] - c[:, 5]
    assert (change <= 0.25 * np.abs(c[:, 5:7]).max(axis=1) + 0.1 * (1 + 1.01 * largest)).all()
    within = profile.surface.sag(np.linspace(profile.surface.inner**2, 1, 999))
    assert profile.low <= within.min()
    assert profile.high >= within.max()
    assert profile.high - profile.low < 1.1 * np.ptp(within) + 0.05 + 0.1 * within.max()


def test_the_hole_is_not_in_the_bounds():
    ring = make_profile(EvenAsphere(0, 1, coefficients=(1.0,), inner=0.8))
    # cells are an eighth of the interval
    assert 0.5 < ring.low <= 0.64


def test_boxes_hold_the_surface():
    rng = np.random.default_rng(4)
    for surface in ASPHERES.values():
        matrix = np.eye(4)
        matrix[:3] = rng.normal(size=(3, 4))
        box = revolution_leaf(surface, matrix).box[0]
        r = surface.inner + (surface.aperture - surface.inner) * rng.random(5000)
        angle = rng.random(5000) * 2 * np.pi
        r[::2] = surface.aperture
        p = np.stack([r * np.cos(angle), r * np.sin(angle), surface.sag(r**2)], axis=1)
        p = p @ matrix[:3, :3].T + matrix[:3, 3]
        assert (p >= box[0]).all()
        assert (p <= box[1]).all()
        # it is that of the cylinder around the surface: up to a half larger where that is turned
        assert (np.ptp(p, axis=0) > 0.6 * (box[1] - box[0])).all()


def test_they_are_counted_last():
    leaf = revolution_leaf(ASPHERES["lens"], np.eye(4))
    leaves = Leaves(GraphLeaves.zeros(2), ClosedFormLeaves.zeros(3), leaf)
    leaves.closed_form.kind[:] = LeafKind.LINEAR
    assert len(leaves) == 6
    assert leaves.kind.tolist()[2:] == [LeafKind.LINEAR] * 3 + [LeafKind.REVOLUTION]
    assert not leaves.is_closed_form[-1]
    assert leaves.certified[2:].all()
    assert leaves.select(np.array([1, 4, 5])).kind.tolist()[1:] == [
        LeafKind.LINEAR,
        LeafKind.REVOLUTION,
    ]
    both = Leaves.join([leaves, leaves.of_patches(np.arange(7, 13))])
    assert len(both) == 12
    assert both.patch[-2:].tolist() == [0, 7]
