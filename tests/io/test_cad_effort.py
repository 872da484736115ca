"""What readers of CAD files do grows with what is in them: counted, not timed."""

from __future__ import annotations

import numpy as np

from mitsuba_bezier.geometry import bernstein, trim_cells
from mitsuba_bezier.geometry.triangles import BezierTriangles
from mitsuba_bezier.geometry.trims import Trims, square_map
from mitsuba_bezier.io.cad.plane_regions import chain
from mitsuba_bezier.io.cad.trimmed_patches import fit_parabolas
from mitsuba_bezier.leaves.builder import build_leaves, rebuild_leaves
from mitsuba_bezier.leaves.graph import subdivision
from mitsuba_bezier.leaves.records import LeafSettings


def test_parabolas_are_fitted_in_rounds():
    """A curve on a surface is dear to evaluate at one place, and cheap at many more."""
    calls = []

    def wave(t: np.ndarray) -> np.ndarray:
        calls.append(len(t))
        return np.stack([t, 0.1 * np.sin(20 * t)], axis=1)

    curves = fit_parabolas(wave, np.ones(2), 1e-7)
    assert curves is not None and len(curves) > 100
    assert len(calls) <= 13  # once for every number of halvings; one by one it was 1400
    ends = np.array([c[[0, -1], :2] for c in curves])
    assert (ends[1:, 0] == ends[:-1, 1]).all()  # in order, and joined
    middle = np.array([c.T @ [0.25, 0.5, 0.25] for c in curves])
    # the tolerance is held at three places of each, and about so between them
    assert np.abs(middle[:, 1] - 0.1 * np.sin(20 * middle[:, 0])).max() < 2e-7


def test_parabolas_end_where_too_many_are_needed():
    calls = []

    def noise(t: np.ndarray) -> np.ndarray:
        calls.append(len(t))
        return np.stack([t, np.sin(1e6 * t)], axis=1)

    assert fit_parabolas(noise, np.ones(2), 1e-7) is None
    assert sum(calls) < 20_000


def test_turns_of_all_curves_are_sought_together(monkeypatch):
    calls = []
    real = trim_cells.sign_changes
    monkeypatch.setattr(trim_cells, "sign_changes", lambda h: calls.append(len(h)) or real(h))
    angle = np.linspace(0, 2 * np.pi, 201)[:-1]
    ring = 0.5 + 0.3 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    middle = (ring + np.roll(ring, -1, axis=0)) / 2 + 1e-3
    points = np.stack([ring, middle, np.roll(ring, -1, axis=0)], axis=1)
    region = np.concatenate([points, np.ones((200, 3, 1))], axis=2)
    # one patch that sees all of it, and one so small that nearly all pieces leave its square
    places = [[[0, 0], [1, 1]], [[0.79, 0.45], [0.02, 0.02]]]
    trims = Trims([region], [0, 0], [square_map()] * 2, places)
    corners = np.tile([[[1.0, 0], [0, 1], [0, 0]]], (2, 1, 1))
    _cells, cell, keep = trim_cells.trim_cells(trims, np.arange(2), corners)
    assert keep.all() and (cell >= 0).all()
    assert len(calls) <= 5  # one for all curves, and four sides of the small patch


def test_shuffled_curves_are_chained():
    rng = np.random.default_rng(3)
    curves = []
    for centre, count in (((0, 0), 700), ((5, 0), 300)):
        angle = np.arange(count) / count * 2 * np.pi
        ring = np.array(centre) + np.stack([np.cos(angle), np.sin(angle)], axis=1)
        sides = np.stack([ring, np.roll(ring, -1, axis=0)], axis=1)
        curves += list(np.concatenate([sides, np.ones((count, 2, 1))], axis=2))
    order = rng.permutation(len(curves))
    mixed = [curves[k] if k % 3 else curves[k][::-1] for k in order]
    loops = chain(mixed, 1e-9)
    assert loops is not None and sorted(map(len, loops)) == [300, 700]
    for loop in loops:
        for a, b in zip(loop, [*loop[1:], loop[0]]):
            assert np.abs(a[-1] - b[0]).max() <= 1e-9
    assert chain(mixed[:-1], 1e-9) is None
    assert chain([], 1e-9) == []


def test_parts_that_are_trimmed_away_have_no_leaves(monkeypatch):
    """CAD surfaces go on beyond their faces, and may be singular there: that costs nothing."""
    rng = np.random.default_rng(8)
    # a height field, which turns round and folds where v is small
    ijk = bernstein.multi_indices(5) / 5
    net = np.ones((1, len(ijk), 4))
    net[0, :, :2], net[0, :, 2] = ijk[:, :2], rng.uniform(0, 0.4, len(ijk))
    low = ijk[:, 1] < 0.3
    net[0, low, :2] += rng.uniform(-0.6, 0.6, (low.sum(), 2))
    patches = BezierTriangles(net)
    corners = np.array([[0.2, 0.5], [0.4, 0.5], [0.2, 0.7]])
    sides = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
    region = np.concatenate([sides, np.ones((3, 2, 1))], axis=2)
    trims = Trims([region], [0], [square_map()], [[[0, 0], [1, 1]]])

    examined = []
    real = subdivision._graph_leaves
    monkeypatch.setattr(
        subdivision, "_graph_leaves", lambda nets, *rest: examined.append(nets) or real(nets, *rest)
    )
    settings = LeafSettings(sections=False)
    leaves = [build_leaves(patches, settings), build_leaves(patches, settings, trims)]
    counts = [len(x) for x in examined]
    first = counts.index(1, 1)  # the second build begins with the patch again
    assert sum(counts[first:]) < 0.2 * sum(counts[:first])
    kept = []
    for found in leaves:
        keep = trim_cells.trim_cells(trims, found.patch, found.corners())[2]
        domains = found.corners()[keep].reshape(-1, 6)
        kept.append(domains[np.lexsort(domains.T)])
    # what is left is the same, to the last bit
    np.testing.assert_array_equal(*kept)
    # and an update of a patch leaves parts away, too
    again = rebuild_leaves(patches, settings, BezierTriangles(net + 1e-3), leaves[1], trims)
    assert len(again) == len(leaves[1])
