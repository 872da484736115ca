"""Trimmed patches: the oracle, the cells, and the kernel against the oracle."""

from __future__ import annotations

from math import comb

import mitsuba as mi
import numpy as np
import pytest
from backend_cases import VARIANT

from mitsuba_bezier.errors import GeometryError
from mitsuba_bezier.geometry import bernstein
from mitsuba_bezier.geometry.sign_changes import bernstein_product, evaluate, sign_changes, split
from mitsuba_bezier.geometry.trim_cells import SLACK, monotone_pieces, trim_cells
from mitsuba_bezier.geometry.trims import Trims, closed_region, square_map
from mitsuba_bezier.kernels.trim import keep
from mitsuba_bezier.kernels.trim_table import build_table


def circle(center, radius, pieces=4) -> list[np.ndarray]:
    """A circle as rational parabolas."""
    out = []
    h = np.pi / pieces
    for a in 2 * h * np.arange(pieces):
        rows = [(np.cos(a), np.sin(a), 1), (np.cos(a + h), np.sin(a + h), np.cos(h))]
        arc = np.array([*rows, (np.cos(a + 2 * h), np.sin(a + 2 * h), 1)])
        arc[:, :2] = arc[:, :2] * radius + np.array(center) * arc[:, 2:]
        out.append(arc)
    return closed_region(out, 1e-12)


def blob(rng, center, radius, pieces, n) -> list[np.ndarray]:
    """A closed curve that crosses itself and turns often, of rational pieces of degree n."""
    a = 2 * np.pi * np.arange(pieces) / pieces
    corners = np.stack([np.cos(a), np.sin(a)], axis=1) * rng.uniform(0.6, 1.4, (pieces, 1))
    corners = corners * radius + center
    out = []
    for p, q in zip(corners, np.roll(corners, -1, axis=0)):
        t = np.linspace(0, 1, n + 1)[1:-1, None]
        inner = p + (q - p) * t + rng.normal(size=(n - 1, 2)) * 0.4 * radius
        w = np.concatenate([[1], rng.uniform(0.4, 2.5, n - 1), [1]])
        out.append(np.column_stack([np.array([p, *inner, q]) * w[:, None], w]))
    return closed_region(out, 1e-12)


def polygon(*points) -> list[np.ndarray]:
    ends = zip(points, [*points[1:], points[0]])
    return [np.array([[*a, 1], [*b, 1]], float) for a, b in ends]


@pytest.fixture(autouse=True)
def variant():
    mi.set_variant(VARIANT)


SQUARE = polygon((0, 0), (1, 0), (1, 1), (0, 1))


def whole(regions, **options) -> Trims:
    """Trims of one patch for each region, whose parameters are the region's."""
    count = len(regions)
    options = {"square": [square_map()] * count, "place": [[[0, 0], [1, 1]]] * count} | options
    return Trims(regions, range(count), **options)


# ---------------------------------------------------------------------------- sign changes


@pytest.mark.parametrize("n", range(1, 9))
def test_sign_changes_are_all_real_roots(n):
    rng = np.random.default_rng(n)
    coefficients = rng.normal(size=(100, n + 1))
    index, t = sign_changes(coefficients)
    for k, b in enumerate(coefficients):
        power = np.zeros(n + 1)
        for i in range(n + 1):
            for j in range(n - i + 1):
                power[n - i - j] += b[i] * comb(n, i) * comb(n - i, j) * (-1) ** j
        roots = np.roots(power)
        real = np.sort(
            roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0) & (roots.real < 1)]
        )
        # 1e-8: what numpy's eigenvalues give for the closest pair of roots among these
        np.testing.assert_allclose(np.sort(t[index == k]), real, atol=1e-8)


def test_double_roots_change_no_sign():
    line = np.array([-0.3, 0.7])
    square = bernstein_product(line, line)
    assert len(sign_changes(square[None])[0]) in (0, 2)  # as rounding has it, never one
    np.testing.assert_allclose(sign_changes(line[None])[1], [0.3], atol=1e-15)
    assert len(sign_changes(np.array([[0.0, 1.0], [0.0, 0.0]]))[0]) == 0  # zero is positive
    assert sign_changes(np.array([[0.0, -1.0]]))[1][0] < 1e-15


def test_split_and_evaluate():
    rng = np.random.default_rng(0)
    curve = rng.normal(size=(5, 3))
    left, right = split(curve, 0.3)
    t = np.linspace(0, 1, 7)
    # 1e-14: a few roundings of numbers near one
    np.testing.assert_allclose(evaluate(left, t), evaluate(curve, 0.3 * t), atol=1e-14)
    np.testing.assert_allclose(evaluate(right, t), evaluate(curve, 0.3 + 0.7 * t), atol=1e-14)


# ---------------------------------------------------------------------------- the oracle


def test_circle_is_a_circle():
    rng = np.random.default_rng(3)
    trims = whole([circle((0.5, 0.5), 0.3), SQUARE + circle((0.4, 0.4), 0.2)])
    uv = rng.random((4000, 2))
    assert (trims.inside(0, uv) == (np.hypot(*(uv - 0.5).T) < 0.3)).all()
    assert (trims.inside(1, uv) == (np.hypot(*(uv - 0.4).T) > 0.2)).all()


def test_square_maps_are_those_of_tensor_patches():
    from mitsuba_bezier.geometry.tensor import evaluate_tensor, tensor_to_triangles

    rng = np.random.default_rng(4)
    net = rng.normal(size=(3, 4, 4))
    both = tensor_to_triangles(net)
    uv = rng.dirichlet([1, 1, 1], 5)[:, :2]
    for turned, triangles in ((False, both), (True, both.reverse())):
        maps = [square_map(k == 1, turned) for k in range(2)]
        trims = Trims([], [-1, -1], maps, [[[0, 0], [1, 1]]] * 2)
        for k in range(2):
            wanted = evaluate_tensor(net, trims.parameters(k, uv))
            # 1e-13: rounding of a net of degree five with entries near one
            np.testing.assert_allclose(triangles.evaluate(k, uv), wanted, atol=1e-13)


def test_arcs_are_angles():
    """On a rational arc, the parameter is the angle."""
    opening = 1.9
    half = opening / 2
    arc = np.array(
        [
            [1, 0, 1],
            [np.cos(half), np.sin(half), np.cos(half)],
            [np.cos(opening), np.sin(opening), 1],
        ]
    )
    arc[1, :2] = [1.0 * np.cos(half), 1.0 * np.sin(half)]
    u = np.linspace(0, 1, 9)
    x = evaluate(arc, u)
    trims = Trims([], [-1], [square_map()], [[[0, 0], [opening, 1]]], [[opening, 0]])
    got = trims.parameters(0, np.column_stack([u, 0 * u]))[:, 0]
    np.testing.assert_allclose(got, np.arctan2(x[:, 1], x[:, 0]), atol=1e-15 * 8)


def test_join_and_select():
    trims = Trims.join([whole([SQUARE]), Trims.none(2), whole([circle((0.5, 0.5), 0.3)])])
    uv = np.array([[0.1, 0.1], [0.45, 0.45]])
    assert trims.region.tolist() == [0, -1, -1, 1]
    assert [trims.inside(p, uv).tolist() for p in (0, 1, 3)] == [[True, True]] * 2 + [[False, True]]
    assert trims[[3, 0]].inside(0, uv).tolist() == [False, True]
    assert trims[[3, 0]] == trims[[3, 0]] and trims[[3, 0]] != trims[[0, 3]]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"regions": [SQUARE[:3]]}, "region 0: expected closed loops, got 2 loose ends"),
        ({"regions": [[c * [1, 1, -1] for c in SQUARE]]}, "positive weight"),
        ({"regions": [[c[:1] for c in SQUARE]]}, r"shape \(n\+1, 3\)"),
        ({"region": [1]}, "region: expected numbers from -1 to 0"),
        ({"place": [[[0, 0], [1, 0]]]}, "place: expected positive sizes"),
        ({"arc": [[4, 0]]}, "arc: expected openings"),
        ({"square": [np.full((2, 3), np.nan)]}, "square: expected finite numbers"),
    ],
)
def test_bad_trims(change, message):
    good = {
        "regions": [SQUARE],
        "region": [0],
        "square": [square_map()],
        "place": [[[0, 0], [1, 1]]],
    }
    Trims(**good)
    with pytest.raises(GeometryError, match=message):
        Trims(**(good | change))


# ---------------------------------------------------------------------------- pieces and kernel


def test_pieces_are_monotone_and_join():
    rng = np.random.default_rng(5)
    t = np.linspace(0, 1, 200)
    for curve in blob(rng, (0, 0), 1, 9, 5):
        pieces = monotone_pieces([curve])
        assert len(pieces) > 1
        ends = np.concatenate([e for _c, e in pieces]).tolist()
        assert sum(ends.count(e) == 1 for e in ends) == 2  # only the curve's own ends are single
        for coefficients, (a, b) in pieces:
            h = evaluate(coefficients, t)
            x = h[:, :2] / h[:, 2:]
            # 1e-15 a step: rounding, near turns where a coordinate stands still
            assert (np.diff(x[:, 1]) >= -4e-15).all()
            assert (np.diff(x[:, 0]) * np.sign(b[0] - a[0]) >= -4e-15).all()
            np.testing.assert_allclose(x[[0, -1]], [a, b], atol=1e-14)


def near(trims, patch, uv, size) -> np.ndarray:
    """Tell which points are within `size` of a place where the answer changes."""
    here = trims.inside(patch, uv)
    angles = 2 * np.pi * np.arange(16) / 16
    steps = size * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return np.any([trims.inside(patch, uv + step) != here for step in steps], axis=0)


@pytest.fixture(scope="module")
def many() -> Trims:
    """Every kind of boundary under every kind of map."""
    rng = np.random.default_rng(6)
    regions = [
        circle((0.5, 0.5), 0.3),
        blob(rng, (0.5, 0.5), 0.4, 7, 3),
        blob(rng, (0.5, 0.5), 0.5, 9, 5) + circle((0.4, 0.5), 0.1),
        polygon((0.2, 0.1), (0.8, 0.1), (0.8, 0.7), (0.3, 0.9)),
        SQUARE + circle((1.0, 0.0), 0.3),
        blob(rng, (2, 0.5), 3, 7, 4),  # far larger than a patch
    ]
    rows = [
        (r, square_map(second, turned), [[rng.uniform(-1, 4) if r == 5 else 0, 0], [1, 1]], arc)
        for r in range(len(regions))
        for second in (False, True)
        for turned in (False, True)
        for arc in ((0, 0), (2.0, 0), (0.3, 1.4))
    ]
    return Trims(regions, *(list(column) for column in zip(*rows)))


def leaves(count: int, levels: int) -> tuple[np.ndarray, np.ndarray]:
    """Patches and corners of midpoint splits."""
    corners = np.eye(3)[None]
    for _ in range(levels):
        corners = np.einsum("ekj,pji->peki", bernstein.SPLIT_CORNERS, corners).reshape(-1, 3, 3)
    patch = np.repeat(np.arange(count), len(corners))
    return patch, np.tile(corners[:, :, :2], (count, 1, 1))


@pytest.mark.parametrize("levels", [None, 3])
def test_kernel_is_the_oracle(many, levels):
    """On whole patches and on their leaves: only points on a curve may differ."""
    rng = np.random.default_rng(7)
    count = 30000
    if levels is None:
        cells, _cell, _keep = trim_cells(many)
        patch = rng.integers(0, len(many), count)
        uv = rng.dirichlet([1, 1, 1], count)[:, :2]
        cell, kept = patch, np.ones(count, bool)
    else:
        owner, corners = leaves(len(many), levels)
        cells, cells_of, keeps = trim_cells(many, owner, corners)
        assert 0 < (cells_of >= 0).mean() < 0.6  # most leaves are decided at once
        leaf = rng.integers(0, len(owner), count)
        # corners and edges often
        uv = np.einsum("nk,nkc->nc", rng.dirichlet([0.4] * 3, count), corners[leaf])
        patch, cell, kept = owner[leaf], cells_of[leaf], keeps[leaf]
    uv = uv.astype(np.float32).astype(float)
    tested = keep(
        build_table(cells, mi.Float),
        mi.UInt32(np.maximum(cell, 0)),
        mi.Float(uv[:, 0]),
        mi.Float(uv[:, 1]),
        mi.Bool(cell >= 0),
    )
    got = np.where(cell >= 0, np.array(tested), kept)
    differ = np.flatnonzero(got != many.inside(patch, uv))
    # the slack of 1e-6, in (u, v) a little more where an arc runs faster than its angle: at most
    # tan(arc/4) / (arc/4) < 1.1 times; and roundings of float32
    assert near(many, patch[differ], uv[differ], 1.5 * SLACK).all()
    assert len(differ) <= 5


def test_a_patch_that_sees_little_of_a_region():
    """A thousandth of a long curve: pieces are cut to what float32 resolves near the patch."""
    rng = np.random.default_rng(9)
    big = circle((0, 0), 1)
    angles = rng.uniform(0, 2 * np.pi, 40)
    size = 1e-3
    low = np.stack([np.cos(angles), np.sin(angles)], axis=1) - size * rng.random((40, 2))
    place = np.stack([low, np.full((40, 2), size)], axis=1)
    trims = Trims([big], np.zeros(40, int), [square_map()] * 40, place)
    table = build_table(trim_cells(trims)[0], mi.Float)
    patch = rng.integers(0, 40, 20000)
    # within 2e-5 of the curve, where a coarser test would err
    at = angles[patch] + rng.uniform(-0.5, 0.5, 20000) * size
    radius = 1 + size * rng.uniform(-2e-5, 2e-5, 20000)
    uv = (radius[:, None] * np.stack([np.cos(at), np.sin(at)], axis=1) - low[patch]) / size
    inside = ((uv > 0) & (uv < 1)).all(axis=1)
    patch, uv = patch[inside], uv[inside].astype(np.float32).astype(float)
    x = trims.parameters(patch, uv)
    off = (np.hypot(*x.T) - 1) / size
    got = np.array(keep(table, mi.UInt32(patch), mi.Float(uv[:, 0]), mi.Float(uv[:, 1])))
    # 1.5e-6 of the patch, as for the others: not of the region
    sure = np.abs(off) > 1.5 * SLACK
    assert (got == (off < 0))[sure].all() and sure.sum() > 5000


def test_points_on_a_curve_belong_to_both_sides():
    """Two patches that share a trimming curve leave no gap: points on it are on both."""
    rng = np.random.default_rng(8)
    loop = circle((0.45, 0.5), 0.3)
    trims = whole([loop, SQUARE + loop])
    cells, _cell, _keep = trim_cells(trims)
    table = build_table(cells, mi.Float)
    h = np.concatenate([evaluate(c, rng.random(2000)) for c in loop])
    uv = h[:, :2] / h[:, 2:]
    for patch in (0, 1):
        cell = mi.UInt32(np.full(len(uv), patch))
        assert np.array(keep(table, cell, mi.Float(uv[:, 0]), mi.Float(uv[:, 1]))).all()
    # and not further than the slack: 3e-6 off, the two answers exclude each other
    for off, wanted in ((-3e-6, [True, False]), (3e-6, [False, True])):
        out = uv + off * (uv - [0.45, 0.5]) / 0.3
        for patch in (0, 1):
            cell = mi.UInt32(np.full(len(uv), patch))
            got = np.array(keep(table, cell, mi.Float(out[:, 0]), mi.Float(out[:, 1])))
            assert (got == wanted[patch]).all()


def test_leaves_of_whole_patches_need_no_test():
    trims = Trims.none(3)
    owner, corners = leaves(3, 2)
    cells, cell, keeps = trim_cells(trims, owner, corners)
    assert (cell == -1).all() and keeps.all() and len(cells.pieces) == 0


def test_a_face_with_many_holes_has_short_lists():
    """A plate of 144 holes that is one leaf: a point looks at the pieces of its own square."""
    rng = np.random.default_rng(11)
    centers = (np.stack(np.meshgrid(*[np.arange(12)] * 2), axis=-1).reshape(-1, 2) + 0.5) / 12
    radius = 0.03
    plate = SQUARE + [c[::-1] for center in centers for c in circle(center, radius)]
    corners = np.array([[[1, 0], [0, 1], [0, 0]]], float)
    cells, cell, kept = trim_cells(whole([plate]), np.array([0]), corners)
    assert cell.tolist() == [0] and kept.all()  # no second table of the same
    first, side = cells.cells[0, 10:12].astype(int)
    lists = cells.lists[first : first + side**2, 1]
    # 1156 pieces of four quarters a circle, cut where they turn: a square of the 24 x 24 has one
    # quarter, or two beside each other, and heights at which the number on its right changes
    assert len(lists) == 576 and 1 <= lists.max() <= 8

    table = build_table(cells, mi.Float)
    uv = rng.random((200_000, 2))
    uv[:50_000, 0] = np.rint(24 * uv[:50_000, 0]) / 24  # on lines of the grid, nearly
    uv[50_000:100_000, 1] = np.rint(24 * uv[50_000:100_000, 1]) / 24
    uv = uv.astype(np.float32).astype(float)
    got = keep(table, mi.UInt32(np.zeros(len(uv), int)), mi.Float(uv[:, 0]), mi.Float(uv[:, 1]))
    off = np.linalg.norm(uv[:, None] - centers, axis=2).min(axis=1) - radius
    sure = np.abs(off) > 1.5 * SLACK  # as above
    assert (np.array(got) == (off > 0))[sure].all() and sure.mean() > 0.99
