"""The march where it was wrong once: inward edges, roots at hand, ruled lines, base points."""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import numpy as np
import pytest
from backend_cases import Float

import mitsuba_bezier as mb
from mitsuba_bezier.geometry import bernstein, shapes
from mitsuba_bezier.geometry.covers import ruled_cover
from mitsuba_bezier.kernels.arrays import types_of
from mitsuba_bezier.kernels.graph.chart import LeafBounds, _cull, cull, first_root
from mitsuba_bezier.kernels.query import Query, Rays
from mitsuba_bezier.kernels.structure import Structure, build_structure
from mitsuba_bezier.kernels.traverse import intersect
from mitsuba_bezier.leaves.builder import build_leaves
from mitsuba_bezier.leaves.records import LeafKind, LeafSettings
from mitsuba_bezier.oracles import analytic

GENERAL = LeafSettings(closed_form=False)
ONE_SHEET = np.diag([1.0, 1.0, -1.0, -1.0])


@pytest.fixture(scope="module")
def one_sheet() -> Structure:
    """The hyperboloid ``x^2 + y^2 = z^2 + 1`` as graph leaves."""
    return build_structure(build_leaves(ruled_cover(ONE_SHEET), GENERAL), Float)


def trace(structure: Structure, o: np.ndarray, d: np.ndarray) -> np.ndarray:
    columns = [[Float(np.ascontiguousarray(a[:, i])) for i in range(3)] for a in (o, d)]
    return np.array(intersect(structure, *columns, Float(np.inf)).t)


def test_a_leaf_whose_edge_bends_inwards(one_sheet):
    # it enters the leaf's prism where the leaf is not, once taken for the other side of it
    o = np.array([[1.7358781, -1.7425355, -2.1977838]], dtype=np.float32)
    d = np.array([[-0.6654433, 0.2565923, 0.7009605]], dtype=np.float32)
    first = analytic.quadric(ONE_SHEET, o, d).first()
    # 1e-4: the cosine is 0.0026
    np.testing.assert_allclose(trace(one_sheet, o, d), first, atol=1e-4)


@pytest.mark.parametrize("off", [1e-2, 1e-3])
def test_rays_along_ruled_lines(one_sheet, off):
    rng = np.random.default_rng(3)
    count = 65536
    turn, side = rng.uniform(0, 2 * np.pi, count), rng.choice([-1, 1], count)
    o = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    d = np.stack([-side * np.sin(turn), side * np.cos(turn), np.ones(count)], axis=1)
    d += off * rng.normal(size=d.shape)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    o = o + off * rng.normal(size=o.shape) - 2 * d
    o, d = o.astype(np.float32), d.astype(np.float32)
    hits = analytic.quadric(ONE_SHEET, o, d)
    t = hits.first()
    x = o + np.where(np.isfinite(t), t, 0.0)[:, None] * d
    normal = x * (1, 1, -1)
    cosine = np.abs(np.einsum("ni,ni->n", normal, d)) / np.linalg.norm(normal, axis=1)
    judged = np.isfinite(t) & (cosine > 3e-5) & (np.abs(t) < 100)
    assert judged.sum() > 10000
    # what a rounding across the surface, 1e-7 each of the ray, the chart and the net, is along it
    error = np.abs(trace(one_sheet, o, d)[judged] - t[judged])
    assert (error <= 1e-5 * t[judged] + 3e-7 / cosine[judged]).all()


@pytest.mark.parametrize(
    ("value", "slope", "half_second", "expected"),
    [
        (1.0, -1.0, 0.0, 1.0),
        (1.0, 0.0, -4.0, 0.5),
        (1.0, 3.0, -4.0, 1.0),
        (1.0, -2.0, 1.0, 1.0),  # double
        (1.0, -1.0, 1.0, None),
        (1.0, 1.0, 0.0, None),
        (1.0, 0.0, 0.0, None),
        (0.0, -1.0, -1.0, 0.0),
        (0.0, 2.0, -1.0, 2.0),  # the root at hand is left behind, the next one counts
        (0.0, 2.0, 1.0, None),
        (-0.25, -1.5, 1.0, -0.15),  # just passed
    ],
)
def test_first_root(value, slope, half_second, expected):
    step, exists = first_root(Float([value]), Float([slope]), Float([half_second]))
    dr.eval(step, exists)
    if expected is None:
        # or so far away that it does not count
        assert not exists[0] or step[0] > 1e20
    else:
        # two digits for the last case, whose root is -0.1514
        assert exists[0] and step[0] == pytest.approx(expected, rel=1e-2, abs=1e-12)


def test_no_stand_ins_through_infinity_at_base_points():
    # all four coordinates vanish at u = v = 1/3
    i, j = bernstein.multi_indices(2)[:, :2].T
    rows = {(a, b): r for r, (a, b) in enumerate(zip(i.tolist(), j.tolist()))}
    monomial = np.zeros((6, 4))
    for c, terms in enumerate(
        (
            {(1, 0): 1.0, (0, 0): -1 / 3},
            {(0, 1): 1.0, (0, 0): -1 / 3},
            {(1, 1): 1.0, (0, 1): -1 / 3, (1, 0): 1.0, (0, 0): -1 / 3},
            {(1, 1): 1.0, (1, 0): -1 / 3, (0, 1): 0.5, (0, 0): -1 / 6},
        )
    ):
        for power, factor in terms.items():
            monomial[rows[power], c] = factor
    net = np.linalg.solve(bernstein.monomial_matrix(2), monomial)
    leaves = build_leaves(mb.BezierTriangles([net]), LeafSettings(closed_form=False, max_depth=5))
    crumbs = leaves.select(~leaves.certified)
    assert len(crumbs) > 10
    corners = (crumbs.domain / crumbs.domain.sum(axis=1, keepdims=True)).transpose(0, 2, 1)
    points = bernstein.basis(2, corners[..., :2]) @ net
    one_sign = (points[..., 3] > 0).all(axis=1) | (points[..., 3] < 0).all(axis=1)
    unit = points / np.linalg.norm(points, axis=-1, keepdims=True)
    cosine = np.einsum("tic,tjc->tij", unit, unit).min(axis=(1, 2))
    assert (one_sign | (cosine > 0.85)).all()


#: A patch with weights of both signs whose parametrisation nearly has a base point: its leaves
#: there are a thousand times as long as wide.
HAIRS = mb.BezierTriangles(
    [
        [
            [1.8029861, 0.4668871, 0.5983862, 1.9928936],
            [-0.3092980, 0.2774411, -0.1530738, -0.4013414],
            [-0.6349918, 0.2040248, 0.0084814, -0.7350066],
            [-0.2527271, -0.0671341, 0.1994566, -0.7526388],
            [0.1949565, 0.0761238, 0.0800975, 0.3470788],
            [0.0433692, 0.0447713, 0.1163165, -0.7253027],
            [-0.4431647, -3.2630113, -0.0808779, -2.7646599],
            [0.0643078, -0.0252776, 0.1773662, 0.3109825],
            [0.0192044, 0.2437809, -0.1355372, -0.4834815],
            [0.5410191, -1.1561485, -0.8507317, 2.0076545],
            [0.1089186, -0.1475999, 0.0767005, -0.3626979],
            [-0.6169033, 0.4149617, 0.6812336, 1.8805689],
            [-0.5848227, 0.3660197, -0.1585970, 1.3177252],
            [-0.6151071, -0.6880926, -0.1228548, 0.9229053],
            [0.1432603, 0.2249495, -0.0160205, -0.3897462],
        ]
    ]
)


@pytest.mark.parametrize(
    ("o", "d", "t"),
    [
        (
            (-62.199734, -379.679321, -387.182770),
            (-0.480529428, -0.205889031, 0.852467716),
            557.7075,
        ),
        ((15.1298447, 61.3431206, 14.9805012), (0.721083879, 0.0934171230, -0.686521113), 39.55896),
    ],
)
def test_leaves_as_thin_as_hairs(o, d, t):
    # in float32 the quadratic of such a leaf was nonsense at the point of the ray nearest in space
    structure = build_structure(build_leaves(HAIRS), Float)
    hit = intersect(structure, [Float([x]) for x in o], [Float([x]) for x in d], Float(np.inf))
    # 1e-5: the net above is rounded to 1e-7, and the surface is far away
    assert float(hit.t[0]) == pytest.approx(t, rel=1e-5)


def test_a_cone_near_its_apex():
    # the leaves there are so small and thin that culling in float32, about a point that float32
    # places, lets all rays through: the march began far outside of the leaf, and got nowhere
    rng = np.random.default_rng(6)
    count = 20000
    depth, turn = 10 ** rng.uniform(-6, -1, count), rng.random(count) * 2 * np.pi
    target = np.stack([depth * np.cos(turn), depth * np.sin(turn), 1 - depth], axis=1)
    target += 0.3 * depth[:, None] * rng.normal(size=target.shape)
    o = rng.normal(size=target.shape)
    o = (2.5 * o / np.linalg.norm(o, axis=1, keepdims=True) + [0, 0, 0.5]).astype(np.float32)
    d = (target - o).astype(np.float32)
    hits = analytic.cone((0, 0, 1), (0, 0, 1), 1.0, o, d)
    z = o[:, 2:] + np.where(np.isfinite(hits.t), hits.t, 0.0) * d[:, 2:]
    t = np.where(np.isfinite(hits.t) & (z >= 0) & (z <= 1) & (hits.t > 0), hits.t, np.inf)
    foot = o - np.array([0, 0, 1.0])
    unit = d / np.linalg.norm(d.astype(float), axis=1, keepdims=True)
    foot = foot - np.einsum("ni,ni->n", foot, unit)[:, None] * unit
    # the apex is placed to 3e-6, and so are silhouettes near it; the other nappe is not ours
    judged = (np.linalg.norm(foot, axis=1) > 1e-5) & (np.abs(hits.clearance) > 4e-6)
    judged &= (np.isinf(t) | (np.abs(z - 1) > 3e-6) & (np.abs(z) > 1e-4)).all(axis=1)
    cosine = np.abs(np.einsum("nki,ni->nk", hits.normals, unit)).min(axis=1)
    judged &= cosine > 0.03
    t = t.min(axis=1)[judged]
    assert len(t) > 5000
    for settings in (LeafSettings(), GENERAL):
        structure = build_structure(build_leaves(shapes.cone(), settings), Float)
        # 2e-5: what float32 may be off across the surface, 1e-6, over the cosine
        np.testing.assert_allclose(trace(structure, o[judged], d[judged]), t, atol=3e-5)


@pytest.mark.parametrize("surface", ["torus", "cone", "hairs"])
def test_no_leaf_is_culled_that_is_met(surface):
    # also by rays from afar, and where leaves are thin: culling is done in float32
    patches = {"torus": mb.torus(), "cone": shapes.cone(), "hairs": HAIRS}[surface]
    every = build_leaves(patches, GENERAL)
    every = every.select(every.kind == LeafKind.GRAPH_AFFINE)
    leaves = every.graph
    rng = np.random.default_rng(11)
    count = 100_000
    leaf = rng.integers(0, len(leaves), count)
    inner = 0.05 + 0.85 * rng.dirichlet(np.ones(3), count)  # barycentrics, not near the edge
    net = leaves.net[leaf]
    n = bernstein.degree_of(net.shape[1])
    i, j = bernstein.multi_indices(n)[:, :2].T
    x = np.einsum("sk,skc->sc", inner[:, :1] ** i * inner[:, 1:2] ** j, net)
    x[:, [0, 1, 3]] += np.stack([inner[:, 0], inner[:, 1], np.ones(count)], axis=1)
    frame = leaves.chart[leaf, :3, :3]
    p = np.linalg.solve(frame, (x[:, :3] / x[:, 3:])[..., None])[..., 0]
    d = rng.normal(size=p.shape)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    d = d.astype(np.float32)
    far = 10 ** rng.uniform(-1, 3, count)
    o = (p + leaves.shift[leaf] - far[:, None] * d).astype(np.float32)
    # a point within a thousandth of the leaf of the surface, though the origin is rounded
    off = np.einsum("sij,sj->si", frame, o + far[:, None] * d.astype(float) - leaves.shift[leaf])
    e = np.einsum("sij,sj->si", frame, d.astype(float))
    judged = np.linalg.norm(off - x[:, :3] / x[:, 3:], axis=1) < 1e-3
    judged &= np.abs(e[:, 2]) > 0.2 * np.linalg.norm(e, axis=1)
    assert judged.sum() > 5000

    ty = types_of(Float)
    columns = [[Float(np.ascontiguousarray(a[judged, k])) for k in range(3)] for a in (o, d)]
    structure = build_structure(every, Float)
    query, rays = Query(structure, ty, False), Rays(*columns, Float(np.inf))
    candidate, line = cull(query, ty.UInt(leaf[judged]), rays, ty.Bool(True))
    assert np.array(candidate).all()
    # and the march begins before the surface is met; 0.01 for what the point may be off
    begin = np.array(line.base) + np.array(line.tau, dtype=np.float64)
    slack = 0.01 / np.linalg.norm(e[judged], axis=1)
    assert (begin <= far[judged] + slack).all()


@pytest.mark.parametrize("cover", ["octants", "tetrahedral"])
def test_grazing_hits(cover):
    rng = np.random.default_rng(5)
    count = 200_000
    o = rng.normal(size=(count, 3))
    o = (3.0 * o / np.linalg.norm(o, axis=1, keepdims=True)).astype(np.float32)
    # so far from the middle, as seen from `o`
    side = np.cross(o, rng.normal(size=(count, 3)))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    # further in than float32 directions and control points move the silhouette
    sine = (1.0 - 10.0 ** rng.uniform(-5.3, -3.5, (count, 1))) / 3.0
    d = (-o / 3.0 * np.sqrt(1 - sine**2) + sine * side).astype(np.float32)
    first = analytic.sphere((0, 0, 0), 1.0, o, d).first()
    patches = mb.sphere(cover=cover)
    structure = build_structure(build_leaves(patches, GENERAL), Float)
    columns = [[Float(np.ascontiguousarray(a[:, i])) for i in range(3)] for a in (o, d)]
    hit = intersect(structure, *columns, Float(np.inf))
    t, u, v = (np.array(x, dtype=np.float64) for x in (hit.t, hit.u, hit.v))
    assert np.isfinite(first).all() and np.isfinite(t).all()
    # the cosine is 0.003 and more: what rounding the net may move the surface by, 2e-8 of the
    # radius, is 300 times as much along the ray; without the step in float64 it is 2.8e-5
    assert np.abs(t - first).max() < 7e-6
    points = patches.points(np.array(hit.patch), np.stack([u, v], axis=1))
    # (u, v) are float32, and t as above
    assert np.linalg.norm(o + t[:, None] * d - points, axis=1).max() < 8e-6


@pytest.mark.parametrize(("n", "noise", "most"), [(5, 0.4, 1.5), (8, 0.6, 2.0)])
def test_no_root_is_passed_wherever_the_march_begins(n, noise, most):
    # its first parameters only say how many steps there will be: what may be off the ray while they
    # are bad is in the bounds. So make them as bad as can be
    rng = np.random.default_rng(0)
    uv = bernstein.multi_indices(n)[:, :2] / n
    points = np.concatenate([uv, np.zeros((len(uv), 1))], axis=1)
    points = points + noise / n * rng.normal(size=points.shape)
    w = rng.uniform(1 / most, most, (len(uv), 1))
    patch = mb.BezierTriangles([np.concatenate([points * w, w], axis=1)])
    leaves = build_leaves(patch, GENERAL)
    assert leaves.certified.all()
    count = 20_000
    target = patch.points(np.zeros(count, dtype=int), rng.dirichlet((2, 2, 2), count)[:, :2])
    d = rng.normal(size=(count, 3))
    d = 0.5 * d / np.linalg.norm(d, axis=1, keepdims=True)
    o, d = (target - d).astype(np.float32), d.astype(np.float32)
    expected = trace(build_structure(leaves, Float), o, d)
    assert np.isfinite(expected).all()
    start = rng.uniform(-4, 4, (len(leaves), 2, 3))
    bad = replace(leaves, graph=replace(leaves.graph, start=start))
    # 1e-4: the last step is the same to its square and, at grazing angles, the rounding of float32
    np.testing.assert_allclose(trace(build_structure(bad, Float), o, d), expected, atol=1e-4)


def test_what_is_within_the_remainder_is_not_culled():
    # a level surface to the eye of the quadratic, and a ray that rises beside it
    x0, e = ([Float(x) for x in row] for row in ((0.2, 0.2, 0.03), (0.1, 0.0, 0.001)))
    found = []
    for remainder in (0.05, 0.02):
        bounds = LeafBounds([Float(0)] * 3, Float(remainder), [Float(1e-4)] * 3, None)
        candidate, _line = _cull((x0, e), bounds, Float(0), Float(np.inf), Float(0))
        found.append(bool(candidate[0]))
    assert found == [True, False]
