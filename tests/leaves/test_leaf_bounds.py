"""Bounds of graph leaves against dense samples, by formulas of their own."""

from __future__ import annotations

import numpy as np
import pytest

import mitsuba_bezier as mb
from mitsuba_bezier.geometry import bernstein, shapes
from mitsuba_bezier.geometry.covers import quadric_cover, ruled_cover
from mitsuba_bezier.kernels.leaf_nets import pack_bending
from mitsuba_bezier.leaves.builder import build_leaves
from mitsuba_bezier.leaves.graph import bounds as leaf_bounds
from mitsuba_bezier.leaves.graph import cover as leaf_cover
from mitsuba_bezier.leaves.graph.bounds import LeafBounds
from mitsuba_bezier.leaves.graph.subdivision import _CULLING
from mitsuba_bezier.leaves.records import (
    BENDING_LIMIT,
    LEAST_REACH,
    SIZES,
    LeafKind,
    LeafSettings,
    round_reach,
)

GENERAL = LeafSettings(closed_form=False)


def wavy(n: int, count: int = 3, weights: tuple[float, float] = (0.5, 2.0)) -> mb.BezierTriangles:
    rng = np.random.default_rng(n)
    points = np.pad(bernstein.multi_indices(n)[:, :2] / n, ((0, 0), (0, 1)))
    points = points + rng.normal(scale=0.3 / n, size=(count, *points.shape))
    w = rng.uniform(*weights, size=(*points.shape[:2], 1))
    return mb.BezierTriangles(np.concatenate([points * w, w], axis=-1))


SURFACES = {
    "octants": mb.sphere(cover="octants"),
    "torus": mb.torus(),
    # projective charts, and edges that bend inwards
    "paraboloid": quadric_cover(
        np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, -0.5], [0, 0, -0.5, 0]])
    ),
    "one sheet": ruled_cover(np.diag([1.0, 1, -1, -1])),
    "flat": wavy(1),
    **{f"degree {n}": wavy(n) for n in (2, 3, 4, 5, 6, 8)},
    "degree 10": wavy(10, 1),  # beyond `_HIGH`
    "polynomial": wavy(4, weights=(1.0, 1.0)),
}


def unpacked(packed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return bending and size of what `pack_bending` gave."""
    size = np.floor(packed / BENDING_LIMIT)
    return packed - BENDING_LIMIT * size, size.astype(int)


class Charts:
    """Leaves of a surface in their charts, with what is stored about them."""

    def __init__(self, patches: mb.BezierTriangles, settings: LeafSettings = GENERAL) -> None:
        leaves = build_leaves(patches, settings).graph
        leaves = leaves.select(leaves.certified)
        self.n = bernstein.degree_of(leaves.net.shape[1])
        some = 60 if self.n < 8 else 12  # the time of a leaf grows with the fourth power
        leaves = leaves.select(slice(None, None, 1 + len(leaves) // some))
        i, j = bernstein.multi_indices(self.n)[:, :2].T
        self.net = np.linalg.solve(bernstein.monomial_matrix(self.n), leaves.net)
        self.net[..., 0] += i / self.n
        self.net[..., 1] += j / self.n
        self.net[..., 3] += 1.0
        self.q = leaves.quadratic
        self.remainder, self.variation = leaves.remainder, leaves.variation
        self.outward, self.inward = leaves.outward.copy(), leaves.inward
        self.margin = self.outward.max(axis=1)
        projective = leaves.kind == LeafKind.GRAPH_PROJECTIVE
        self.outward[projective] = self.margin[projective, None]  # what the kernel has of those
        # as the kernel has them
        self.bending, self.size = unpacked(pack_bending(leaves.bending, leaves.size))

    def triangle(self, leaf: int, count: int) -> np.ndarray:
        """Return a lattice of parameters on the triangle of a leaf's bounds."""
        inner = bernstein.multi_indices(count)[:, :2] / count
        return 1 / 3 + (inner - 1 / 3) * (1 + 3 * SIZES[self.size[leaf]])

    def jets(self, leaf: int, uv: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return the affine chart point ``(S, 3)`` and its derivatives ``(S, 3, 2[, 2])``."""
        n, net = self.n, self.net[leaf]
        value = bernstein.basis(n, uv) @ net
        first = np.stack(
            [bernstein.basis(n - 1, uv) @ m @ net for m in bernstein.partials_matrices(n)], axis=-1
        )
        second = np.zeros((len(uv), 4, 2, 2))
        if n > 1:
            b = bernstein.basis(n - 2, uv)
            for r, m in enumerate(bernstein.partials_matrices(n)):
                for c, m2 in enumerate(bernstein.partials_matrices(n - 1)):
                    second[:, :, r, c] = b @ m2 @ m @ net
        w, dw, ddw = value[:, 3:], first[:, 3:], second[:, 3:]
        p = value[:, :3] / w
        dp = (first[:, :3] - p[..., None] * dw) / w[..., None]
        mixed = dp[..., :, None] * dw[:, :, None, :]
        ddp = second[:, :3] - p[..., None, None] * ddw - mixed - mixed.swapaxes(-1, -2)
        return p, dp, ddp / w[..., None, None]

    def graph(self, leaf: int, uv: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return point, gradient and Hessian of ``h`` at parameters."""
        p, dp, ddp = self.jets(leaf, uv)
        back = np.linalg.inv(dp[:, :2])
        gradient = np.einsum("si,sia->sa", dp[:, 2], back)
        bent = ddp[:, 2] - np.einsum("sc,scij->sij", gradient, ddp[:, :2])
        return p, gradient, np.einsum("sia,sij,sjb->sab", back, bent, back)

    def quadratic(self, leaf: int) -> np.ndarray:
        a, b, c = self.q[leaf]
        return np.array([[-2 * b, a - b - c], [a - b - c, -2 * c]])


@pytest.fixture(scope="module", params=SURFACES)
def charts(request) -> Charts:
    return Charts(SURFACES[request.param])


def quadratic_value(q: np.ndarray, p: np.ndarray) -> np.ndarray:
    x, y = p[:, 0], p[:, 1]
    return q[0] * x * y + (q[1] * x + q[2] * y) * (1 - x - y)


def test_bounds_hold_and_are_not_loose(charts):
    loose = []
    for leaf in range(len(charts.net)):
        p, _gradient, hessian = charts.graph(leaf, charts.triangle(leaf, 40))
        remainder = np.abs(p[:, 2] - quadratic_value(charts.q[leaf], p)).max()
        norm = np.linalg.norm(hessian - charts.quadratic(leaf), 2, axis=(1, 2)).max()
        assert remainder <= charts.remainder[leaf]
        assert norm <= charts.variation[leaf]
        assert norm / 2 <= charts.bending[leaf]
        # what is added for float32 does not count
        loose.append(
            (
                charts.remainder[leaf] / (remainder + 1e-5),
                charts.variation[leaf] / (norm + 1e-4),
            )
        )
    # medians are 1.0 to 1.4; 2.6 at degree 10, where fourth derivatives are bounded by parts
    assert np.median(loose, axis=0).max() < 1.7
    # 3.8 at degree 8: leaves cut in two are larger, and more of their bounds is fourth derivatives
    assert np.quantile(loose, 0.9, axis=0).max() < 4.0


def test_tangent_planes_from_anywhere(charts):
    # the march starts from points of the triangle, not only from near ones
    rng = np.random.default_rng(0)
    for leaf in range(len(charts.net)):
        inner = rng.dirichlet(np.ones(3) / 2, 400)[:, :2]
        uv = 1 / 3 + (inner - 1 / 3) * (1 + 3 * SIZES[charts.size[leaf]])
        p, gradient, _hessian = charts.graph(leaf, uv)
        step = p[200:, :2] - p[:200, :2]
        # with the quadratic's second derivative
        second = charts.quadratic(leaf)
        off = p[200:, 2] - p[:200, 2] - (gradient[:200] * step).sum(axis=1)
        off -= np.einsum("si,ij,sj->s", step, second, step) / 2
        length = np.linalg.norm(step, axis=1)
        bending = charts.bending[leaf]
        # 1e-12: a hundred roundings of chart coordinates
        assert (np.abs(off) <= bending * length**2 + 1e-12).all()
        turn = np.linalg.norm(gradient[200:] - gradient[:200] - step @ second, axis=1)
        assert (turn <= 2 * bending * length + 1e-12).all()


def test_the_map_is_one_to_one_and_covers(charts):
    around = np.linspace(0, 1, 33)
    for leaf in range(len(charts.net)):
        _p, dp, _ddp = charts.jets(leaf, charts.triangle(leaf, 20))
        symmetric = (dp[:, :2] + dp[:, :2].swapaxes(-1, -2)) / 2
        assert np.linalg.eigvalsh(symmetric).min() > 0
        # any point of the chart triangle has a parameter in T: Newton's iteration, damped
        # and any point of the inner triangle one in the leaf itself
        for least, shift in (
            (-SIZES[charts.size[leaf]], charts.outward[leaf]),
            (0.0, -charts.inward[leaf]),
        ):
            corners = np.eye(3) * (1 + shift.sum()) - shift
            if shift.sum() <= -1:
                continue  # nothing is said to be covered
            corners = corners[:, :2]
            xy = np.concatenate(
                [corners[i] + around[:, None] * (corners[i - 1] - corners[i]) for i in range(3)]
            )
            uv = np.clip(xy, 0, 1)
            for _ in range(25):
                p, dp, _ddp = charts.jets(leaf, uv)
                uv = uv + 0.7 * np.linalg.solve(dp[:, :2], (xy - p[:, :2])[..., None])[..., 0]
            assert np.abs(charts.jets(leaf, uv)[0][:, :2] - xy).max() < 1e-9
            assert np.minimum(np.minimum(uv[:, 0], uv[:, 1]), 1 - uv.sum(axis=1)).min() >= least
        # and the leaf lies in the chart triangle
        p = charts.jets(leaf, bernstein.multi_indices(20)[:, :2] / 20)[0]
        x, y = p[:, 0], p[:, 1]
        assert (np.stack([x, y, 1 - x - y]).min(axis=1) >= -charts.outward[leaf]).all()
        assert charts.outward[leaf].max() == charts.margin[leaf]


def test_too_small_a_triangle_does_not_cover():
    charts = Charts(SURFACES["torus"])
    needed = leaf_cover.needed_margin(charts.outward)
    assert (needed > charts.outward).all()
    small = leaf_cover._covers(charts.net, needed, charts.n, 0)
    large = leaf_cover._covers(charts.net, needed, charts.n, 11)
    # edges of the torus' leaves bend by some 5 % of the leaf, and 0.004 is the first size
    assert not small.any() and large.mean() > 0.5


def test_few_samples_give_bounds_too(monkeypatch):
    """What lies between the samples is bounded, whatever they show."""
    surface = SURFACES["degree 3"]
    dense = Charts(surface)
    monkeypatch.setattr(leaf_bounds, "_LATTICES", (3,))
    coarse = leaf_bounds.leaf_bounds(dense.net, dense.outward, 0 * dense.inward, 1.0)
    assert coarse.proved.mean() > 0.1
    for leaf in np.flatnonzero(coarse.proved):
        dense.size[leaf] = coarse.size[leaf]
        p, _gradient, hessian = dense.graph(leaf, dense.triangle(leaf, 30))
        q = coarse.quadratics[leaf, :3]
        dense.q[leaf] = q
        assert np.abs(p[:, 2] - quadratic_value(q, p)).max() <= coarse.remainder[leaf]
        off = hessian - dense.quadratic(leaf)
        assert np.linalg.norm(off, 2, axis=(1, 2)).max() <= coarse.variation[leaf]


def random_charts(n: int, count: int, noise: float) -> np.ndarray:
    """Return nets in charts, with noise that need not leave them graphs."""
    rng = np.random.default_rng(n)
    ijk = bernstein.multi_indices(n)
    net = np.zeros((count, len(ijk), 4))
    net[..., :2], net[..., 3] = ijk[:, :2] / n, 1.0
    moved = rng.normal(size=net.shape) * noise * rng.uniform(0.02, 1, (count, 1, 1))
    moved[:, bernstein.corner_rows(n)] = 0.0
    return net + moved


@pytest.mark.parametrize("n", [2, 3, 5])
def test_what_is_no_graph_is_not_proved(n):
    net = random_charts(n, 400, 0.7 / n)
    out, inward = leaf_cover.edge_reach(net)
    bounds = leaf_bounds.leaf_bounds(net, out, inward, 1.0)
    assert isinstance(bounds, LeafBounds) and 0.02 < bounds.proved.mean() < 0.98
    uv = bernstein.multi_indices(30)[:, :2] / 30
    for leaf in np.flatnonzero(bounds.proved):
        t = 1 / 3 + (uv - 1 / 3) * (1 + 3 * SIZES[bounds.size[leaf]])
        value = bernstein.basis(n, t) @ net[leaf]
        du, dv = (bernstein.basis(n - 1, t) @ m @ net[leaf] for m in bernstein.partials_matrices(n))
        w = value[:, 3]
        x, y = value[:, 0] / w, value[:, 1] / w
        xu, xv = (du[:, 0] - x * du[:, 3]) / w, (dv[:, 0] - x * dv[:, 3]) / w
        yu, yv = (du[:, 1] - y * du[:, 3]) / w, (dv[:, 1] - y * dv[:, 3]) / w
        assert w.min() > 0 and (xu * yv - xv * yu).min() > 0


def test_edges_reach_no_further_than_they_say():
    net = random_charts(4, 100, 0.3)
    net[..., 3] = np.maximum(net[..., 3], 0.2)
    out, inward = leaf_cover.edge_reach(net)
    s = np.linspace(0, 1, 101)
    reach, back = np.zeros((100, 3)), np.zeros((100, 3))
    for e in range(3):
        bary = np.zeros((101, 3))
        bary[:, (e + 1) % 3], bary[:, (e + 2) % 3] = s, 1 - s
        p = bernstein.basis(4, bary[:, :2]) @ net
        x, y = p[..., 0] / p[..., 3], p[..., 1] / p[..., 3]
        chart = np.stack([x, y, 1 - x - y])
        reach = np.maximum(reach, -chart.min(axis=2).T)
        back[:, e] = np.maximum(back[:, e], chart[e].max(axis=1))
    assert (reach <= out).all() and (back <= inward).all()
    # eight pieces: what a polygon is off a curve is a 64th of what it was, some 2 % of the net
    assert (out - reach).max() < 0.02 and (inward - back).max() < 0.02


def test_bending_and_size_share_a_number():
    bending = np.array([0.0, 1e-9, 0.3, 1.0, 15.7])
    for size in range(len(SIZES)):
        packed = pack_bending(bending, np.full(5, size))
        assert np.array_equal(packed, packed.astype(np.float32))
        again, found = unpacked(packed)
        assert (found == size).all()
        # rounded up, by at most the last of fourteen bits
        assert (again >= bending).all() and (again - bending).max() <= 2.0**-14
    assert unpacked(pack_bending(np.array([99.0]), np.array([3])))[1] == 3
    assert BENDING_LIMIT * len(SIZES) <= 256


def test_reach_is_rounded_up_to_seven_bits():
    reach = np.concatenate([[0.0, 1e-9, LEAST_REACH], np.geomspace(1e-4, 3.7, 1000)])
    rounded = round_reach(reach)
    assert (rounded >= reach).all() and (round_reach(rounded) == rounded).all()
    # sixteen steps from one power of two to the next but one
    assert (rounded <= np.maximum(reach * 1.125, LEAST_REACH)).all()
    assert len(np.unique(round_reach(np.geomspace(1e-9, 3.75, 100_000)))) <= 2**7
    assert round_reach(np.array([3.76, np.inf])).tolist() == [np.inf, np.inf]


@pytest.mark.parametrize("surface", ["torus", "cone", "flat"])
def test_what_culling_in_float32_may_be_off(surface):
    # the kernel's way to a chart coordinate, rounded at each step, against float64
    flat = mb.BezierTriangles([[[3.1, 0.2, 0.7, 1], [-0.4, 2.3, -1.1, 1], [0.6, -1.7, 1.9, 1]]])
    patches = {"torus": mb.torus(), "cone": shapes.cone(), "flat": flat}[surface]
    leaves = build_leaves(patches, GENERAL).graph
    rng = np.random.default_rng(12)
    leaf = rng.integers(0, len(leaves), 50000)
    nets = leaves.box[leaf] - leaves.shift[leaf, None]
    extent = np.abs(nets).max(axis=1)
    frame = leaves.chart[leaf, :3, :3]
    near, way = extent * rng.uniform(-1, 1, (2, *extent.shape))
    single = np.float32
    x = np.zeros_like(near, dtype=np.float32)
    for k in range(3):
        x += frame[:, :, k].astype(single) * near[:, k, None].astype(single)
    direction = (way / np.linalg.norm(way, axis=1, keepdims=True)).astype(single)
    length = np.linalg.norm(way, axis=1)[:, None]
    e = np.zeros_like(x)
    for k in range(3):
        e += frame[:, :, k].astype(single) * direction[:, k, None]
    exact = np.einsum("sij,sj->si", frame, near + length * direction)
    off = np.abs(x + length * e.astype(float) - exact).max(axis=1)
    bound = _CULLING * np.abs(frame).max(axis=(1, 2)) * extent.sum(axis=1)
    # worst cases are rare: the bound is five to fifteen times what is seen
    assert 0.03 < (off / bound).max() <= 1
    # and it is in what is stored
    assert (leaves.outward[leaf].max(axis=1) >= bound).all()
    assert (leaves.remainder[leaf] >= bound).all()
