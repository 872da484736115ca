"""Common roots of two polynomials: planted roots, products of lines, folds, curves of roots."""

from __future__ import annotations

import numpy as np
import pytest

from mitsuba_bezier.errors import GeometryError
from mitsuba_bezier.geometry import bernstein
from mitsuba_bezier.oracles.bivariate import (
    DOUBLE,
    NEAR_MISS,
    SIMPLE,
    UNDECIDED,
    UNRESOLVED,
    Roots,
    common_roots,
)
from mitsuba_bezier.oracles.bivariate_local import evaluate, hull_distance


def scale_of(f: np.ndarray) -> np.ndarray:
    return np.abs(f).max(axis=(1, 2))


def interior(rng: np.random.Generator, count: int) -> np.ndarray:
    return rng.dirichlet([1, 1, 1], count)[:, :2]


def residuals(f: np.ndarray, roots: Roots) -> np.ndarray:
    value = evaluate(f[roots.problem], roots.uv, 1)[..., 0]
    return np.abs(value).max(axis=1) / scale_of(f)[roots.problem]


@pytest.mark.parametrize("n", [1, 2, 3, 5, 8])
def test_planted_roots_are_found(n: int) -> None:
    rng = np.random.default_rng(n)
    x = interior(rng, 200)
    f = rng.normal(size=(200, 2, bernstein.size(n)))
    f -= evaluate(f, x, 1)[..., :1]  # the basis sums to one: now f(x) = 0
    roots = common_roots(f, scale_of(f))
    real = roots.kind >= 0
    assert (roots.kind[real] == SIMPLE).all()
    # eps times the number of terms, with room
    assert residuals(f, roots)[real].max() < 1e-13
    for q in range(200):
        gap = np.linalg.norm(roots.uv[real & (roots.problem == q)] - x[q], axis=1)
        # the worst condition among 200 random Jacobians is some 1e4
        assert gap.min(initial=np.inf) < 1e-10


def product_of_lines(lines: np.ndarray) -> np.ndarray:
    """Return the Bernstein coefficients of products of linear forms ``(n, 3)`` in u, v, 1."""
    n = len(lines)
    nodes = bernstein.multi_indices(n)[:, :2] / n
    values = (lines @ np.column_stack([nodes, np.ones(len(nodes))]).T).prod(axis=0)
    return np.linalg.solve(bernstein.basis(n, nodes), values)


@pytest.mark.parametrize("n", [2, 3, 4, 6])
def test_products_of_lines_have_n_squared_roots(n: int) -> None:
    """Two products of n lines meet in n^2 known points: none lost, none too many."""
    rng = np.random.default_rng(100 + n)
    problems, expected = [], []
    for _ in range(40):
        angle = rng.uniform(0, np.pi, (2, n))
        through = interior(rng, 2 * n).reshape(2, n, 2)
        normal = np.stack([np.cos(angle), np.sin(angle)], axis=2)
        lines = np.concatenate([normal, -(normal * through).sum(axis=2)[..., None]], axis=2)
        meet = np.cross(lines[0][:, None], lines[1][None]).reshape(-1, 3)
        meet = meet[:, :2] / meet[:, 2:]
        bary = np.column_stack([meet, 1 - meet.sum(axis=1)]).min(axis=1)
        if np.abs(bary).min() < 1e-6:  # on the boundary either answer is right
            continue
        gap = np.linalg.norm(meet[:, None] - meet[None], axis=2) + np.eye(n * n)
        if gap.min() < 1e-5:  # nearly a double root: its own test
            continue
        problems.append([product_of_lines(line) for line in lines])
        expected.append(meet[bary > 0])
    f = np.array(problems)
    roots = common_roots(f, scale_of(f))
    inside = np.minimum(roots.uv.min(axis=1), 1 - roots.uv.sum(axis=1)) >= 0
    inside &= roots.kind >= 0
    assert len(f) > 20
    for q, points in enumerate(expected):
        found = roots.uv[(roots.problem == q) & inside]
        assert len(found) == len(points)
        if len(points) == 0:
            continue
        gap = np.linalg.norm(found[:, None] - points[None], axis=2)
        # solving for the coefficients costs some digits at degree 6, close roots some more
        assert gap.min(axis=0).max() < 1e-6 and gap.min(axis=1).max() < 1e-6


def folded(rng: np.random.Generator, n: int, count: int) -> tuple[np.ndarray, ...]:
    """Return polynomials with a fold at ``x``: value zero and a singular Jacobian."""
    x = interior(rng, count)
    f = rng.normal(size=(count, 2, bernstein.size(n)))
    angle = rng.uniform(0, 2 * np.pi, count)
    left = np.column_stack([np.cos(angle), np.sin(angle)])
    e = evaluate(f, x, 1)
    slope = np.einsum("qp,qpr->qr", left, e)
    nodes = bernstein.multi_indices(n)[:, :2] / n  # linear precision
    linear = np.einsum("qd,qkd->qk", slope[:, 1:], nodes[None] - x[:, None])
    f = f - e[..., :1] - left[..., None] * linear[:, None]
    e = evaluate(f, x, 2)
    _u, sigma, vt = np.linalg.svd(e[..., 1:3])
    null = vt[:, 1]
    hessian = np.einsum("qp,qpr->qr", left, e[..., 3:])
    bend = hessian[:, 0] * null[:, 0] ** 2 + hessian[:, 2] * null[:, 1] ** 2
    bend += 2 * hessian[:, 1] * null[:, 0] * null[:, 1]
    edge = np.minimum(x.min(axis=1), 1 - x.sum(axis=1))
    # away from cusps, from singular points and from the boundary, where other answers are right
    good = (np.abs(bend) > scale_of(f)) & (sigma[:, 0] > 0.3 * scale_of(f)) & (edge > 0.02)
    return f[good], x[good], left[good], bend[good]


@pytest.mark.parametrize("n", [2, 4, 7])
@pytest.mark.parametrize("offset", [1e-5, 1e-8, 1e-12])
def test_folds_give_two_roots_or_none(n: int, offset: float) -> None:
    f, x, left, bend = folded(np.random.default_rng(7), n, 60)
    scale = scale_of(f)
    shift = (np.sign(bend) * offset * scale)[:, None] * left
    reach = np.sqrt(2 * offset * scale / np.abs(bend))
    for sign, count in ((-1, 2), (1, 0)):
        moved = f + sign * shift[..., None]
        roots = common_roots(moved, scale, band=1e-3 * scale)
        # 2: half as far again as the roots, whose distance is right to first order in reach
        near = np.linalg.norm(roots.uv - x[roots.problem], axis=1) < 2 * reach[roots.problem]
        simple = np.bincount(roots.problem[near & (roots.kind == SIMPLE)], minlength=len(x))
        assert (simple == count).all()
        assert not (near & ((roots.kind == DOUBLE) | (roots.kind == UNRESOLVED))).any()
        if count == 0:  # the near miss is noted instead, at its distance
            near &= roots.kind == NEAR_MISS
            assert (np.bincount(roots.problem[near], minlength=len(x)) > 0).all()
            value = evaluate(moved[roots.problem[near]], roots.uv[near], 1)[..., 0]
            distance = np.linalg.norm(value, axis=1) / scale[roots.problem[near]]
            least = np.full(len(x), np.inf)
            np.minimum.at(least, roots.problem[near], distance)
            # the offset itself to first order; reach is up to 0.03
            np.testing.assert_allclose(least, offset, rtol=0.1, atol=1e-14)


def test_a_tangent_is_a_double_root() -> None:
    f, x, _left, _bend = folded(np.random.default_rng(8), 4, 60)
    roots = common_roots(f, scale_of(f))
    at = np.linalg.norm(roots.uv - x[roots.problem], axis=1) < 1e-6  # sqrt of the rounding
    assert (np.bincount(roots.problem[at], minlength=len(x)) == 1).all()
    # rounding may leave two roots 1e-7 apart that are merged, or see them apart
    assert (roots.kind[at] == DOUBLE).mean() > 0.9


def test_a_curve_of_roots_is_never_called_simple() -> None:
    rng = np.random.default_rng(9)
    g = rng.normal(size=(20, bernstein.size(3)))
    g -= g.mean(axis=1)[:, None]  # zero on a curve
    f = np.stack([g, 0.3 * g], axis=1)
    roots = common_roots(f, scale_of(f))
    assert set(np.unique(roots.kind)) <= {UNRESOLVED, UNDECIDED}
    found = roots.kind == UNRESOLVED
    assert (np.bincount(roots.problem[found], minlength=20) > 3).all()
    assert residuals(f, roots)[found].max() < 1e-12  # ten times NOISE, where one is accepted


def test_margin_finds_the_roots_just_outside() -> None:
    rng = np.random.default_rng(10)
    x = np.column_stack([np.full(100, -0.004), rng.uniform(0.1, 0.9, 100)])
    f = rng.normal(size=(100, 2, bernstein.size(3)))
    f -= evaluate(f, x, 1)[..., :1]

    def hits(margin: float) -> np.ndarray:
        roots = common_roots(f, scale_of(f), margin=margin)
        near = np.linalg.norm(roots.uv - x[roots.problem], axis=1) < 1e-9
        return np.bincount(roots.problem[near], minlength=100) > 0

    assert hits(0.01).all()
    assert not hits(0.0).all()


def test_hull_distance_is_a_lower_bound() -> None:
    rng = np.random.default_rng(11)
    f = rng.normal(size=(2000, 2, 6)) + rng.normal(size=(2000, 2, 1)) * 2
    bound = hull_distance(f)
    angle = np.linspace(0, 2 * np.pi, 2000, endpoint=False)
    direction = np.stack([np.cos(angle), np.sin(angle)])
    # distance of the origin from a hull: the best of all half planes
    exact = np.stack([(direction.T @ points).min(axis=1).max() for points in f])
    # 2000 directions miss the best one by at most 1.6e-3 of the greatest distance, here 8
    assert (bound <= np.maximum(exact, 0) + 0.013).all()
    clear = exact > 0.05
    assert clear.sum() > 500 and (bound[clear] > 0).all()
    assert (bound[exact < -0.02] <= 0).all()


def test_errors_name_the_parameter() -> None:
    with pytest.raises(GeometryError, match=r"f: expected .*\(Q, 2, K\)"):
        common_roots(np.zeros((3, 6)), np.ones(3))
    with pytest.raises(GeometryError, match="f: expected finite"):
        common_roots(np.full((1, 2, 6), np.nan), np.ones(1))
    with pytest.raises(GeometryError, match="scale: expected positive"):
        common_roots(np.zeros((1, 2, 6)), np.zeros(1))
    with pytest.raises(GeometryError, match="margin: expected"):
        common_roots(np.zeros((1, 2, 6)), np.ones(1), margin=-1)
