"""Desargues and its dual, harmonic points, Menelaus and Ceva: both sides vanish together."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from geometry_cases import apart, collineation

from mitsuba_bezier.errors import GeometryError
from mitsuba_bezier.geometry import theorems as th
from mitsuba_bezier.geometry.cross_ratio import affine_ratio, cross_ratio
from mitsuba_bezier.geometry.projective import incidence, join, line_points, meet, point

# Three or four products of vectors in generic position: a digit or two of sixteen each
EXACT = 1e-11
cases = pytest.mark.parametrize(("seed", "c"), list(itertools.product(range(6), (3, 4))))


def perspective(seed: int, c: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Two triangles in perspective from a point; in space not in one plane."""
    rng = np.random.default_rng([seed, c])
    center, first = rng.normal(size=c), rng.normal(size=(3, c))
    return center, first, first + rng.uniform(0.5, 2, (3, 1)) * center


@cases
def test_desargues(seed, c):
    center, a, b = perspective(seed, c)
    found = th.desargues(a, b)
    assert found.from_center < EXACT and found.from_axis < EXACT
    assert apart(found.center, center) < 1e-9
    assert found.axis is not None and found.meets is not None
    if c == 3:
        assert incidence(found.meets, found.axis).max() < 1e-9
    else:  # in space the axis is the line of both planes
        line = meet(join(*a), join(*b))
        assert apart(found.axis, line) < 1e-8
    moved = b + 0.1 * np.random.default_rng(seed).normal(size=b.shape)
    other = th.desargues(a, moved)
    assert other.center is None and other.axis is None
    assert other.from_center > 1e-4 and other.from_axis > 1e-4  # neither without the other


@cases
def test_the_dual_of_desargues(seed, c):
    center, a, b = perspective(seed, c)
    found = th.desargues(a, b, dual=True)  # the same numbers, read as lines or planes
    same = th.desargues(a, b)
    assert found.from_center < EXACT and found.from_axis < EXACT
    assert apart(found.center, center) < 1e-9
    if c == 3:
        assert apart(found.axis, same.axis) < 1e-12  # point and line have changed names
        # corners of the three-sides are in perspective from the line `center`
        corners = [np.stack([meet(t[k - 2], t[k - 1]) for k in range(3)]) for t in (a, b)]
        again = th.desargues(*corners)
        assert apart(again.axis, found.center) < 1e-8
        assert apart(again.center, found.axis) < 1e-8
    else:
        assert apart(found.axis, np.roll(same.axis, 3)) < 1e-9
    other = th.desargues(a, b + 0.1 * np.eye(3, c) * [[1], [0], [0]], dual=True)
    assert other.center is None and other.axis is None


@pytest.mark.parametrize("seed", range(6))
def test_a_plane_figure_of_desargues_in_space(seed):
    """The triangles may lie in one plane of space."""
    center, a, b = perspective(seed, 3)
    plane = np.random.default_rng(seed).normal(size=(3, 4))
    found = th.desargues(a @ plane, b @ plane)
    assert apart(found.center, center @ plane) < 1e-9
    assert found.axis is not None


@pytest.mark.parametrize("seed", range(6))
def test_harmonic_points(seed):
    rng = np.random.default_rng(seed)
    m = collineation(rng, 3)
    a, b, c = (m @ [x, 0.0, 1.0] for x in (0.0, 1.0, 0.3))
    d = th.harmonic_conjugate(a, b, c)
    assert abs(cross_ratio(a, c, d, b) + 1) < 1e-12
    assert apart(th.harmonic_conjugate(a, b, d), c) < 1e-12
    for _ in range(5):  # the construction with a straightedge: whatever is chosen
        apex, factor = rng.normal(size=3), rng.uniform(0.2, 3)
        assert apart(th.harmonic_by_quadrangle(a, b, c, apex, factor), d) < 1e-10
    assert apart(th.harmonic_conjugate([0, 0, 1], [2, 0, 1], [1, 0, 1]), [1, 0, 0]) < 1e-15


@cases
def test_menelaus_and_ceva(seed, c):
    rng = np.random.default_rng([seed, c])
    t = point(rng.normal(size=(3, c - 1)))
    line = rng.normal(size=c)
    p = th.menelaus_points(t, line)
    found = th.menelaus(t, p)
    assert abs(found.product + 1) < 1e-10 and found.distance < EXACT
    following = np.roll(t, -1, axis=0)
    np.testing.assert_allclose(found.ratios, affine_ratio(t, p, following), rtol=1e-9)
    inner = rng.uniform(0.2, 1, 3) @ t
    q = th.ceva_points(t, inner)
    found = th.ceva(t, q)
    assert abs(found.product - 1) < 1e-10 and found.distance < EXACT
    # no collineation changes the products, though it does the ratios
    m = collineation(rng, c)
    image = th.ceva(t @ m.T, q @ m.T)
    assert abs(image.product - 1) < 1e-10
    # Ceva's points are not on a line, Menelaus' lines not through a point
    assert th.menelaus(t, q).distance > 1e-3 and th.ceva(t, p).distance > 1e-3
    # one point moved along its side: both sides of either theorem fail by as much
    for values, right in ((p, -1), (q, 1)):
        moved = values.copy()
        moved[0] = moved[0] + 1e-3 * t[0]
        other = (th.menelaus if right < 0 else th.ceva)(t, moved)
        assert abs(other.product - right) > 1e-5 and other.distance > 1e-6
    # harmonic: where the lines of Ceva's points meet the sides, Menelaus' line
    harmonic = [th.harmonic_conjugate(t[k], following[k], q[k]) for k in range(3)]
    assert abs(th.menelaus(t, harmonic).product + 1) < 1e-9


def test_menelaus_with_an_ideal_point():
    t = point([[0, 0], [4, 0], [0, 4]])
    p = th.menelaus_points(t, [1, 0, -1.0])  # x = 1, parallel to the side ca
    assert abs(p[2, 2]) < 1e-15
    found = th.menelaus(t, p)
    np.testing.assert_allclose(found.ratios, [1 / 3, 3, -1])


A = [[0, 0, 1], [1, 0, 1], [0, 1, 1]]


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: th.desargues(A, np.eye(4)[:3]), "two triangles"),
        (lambda: th.desargues(A, [[0, 0, 1], [1, 0, 1], [2, 0, 1]]), "second: expected a triangle"),
        (lambda: th.desargues(A, [[0, 0, 1], [2, 0, 1], [0, 2, 1]]), "same element"),
        (lambda: th.desargues(A, [[2, 0, 1], [3, 0, 1], [3, 5, 1]]), "a common side"),
        (lambda: th.harmonic_conjugate([0, 0, 1], [0, 0, 1], [1, 0, 1]), "different"),
        (lambda: th.harmonic_by_quadrangle(*A, [2, 2, 1]), "c: expected a point on the line"),
        (
            lambda: th.harmonic_by_quadrangle(A[0], A[1], [3, 0, 1], [5, 0, 1]),
            "apex: expected a point off",
        ),
        (
            lambda: th.harmonic_by_quadrangle(A[0], A[1], [3, 0, 1], [5, 2, 1], 0),
            "other than 0",
        ),
        (lambda: th.menelaus(A, A), "a corner"),
        (lambda: th.menelaus(A, [[5, 5, 1]] * 3), "one outside"),
        (lambda: th.ceva([[0, 0, 1], [1, 1, 1], [2, 2, 1]], A), "dependent corners"),
        (lambda: th.menelaus_points(A, [0, 1, 0]), "same element"),
        (lambda: th.ceva_points(A, [0, 0, 1]), "same element"),
    ],
)
def test_bad_theorems(call, says):
    with pytest.raises(GeometryError) as caught:
        call()
    assert says in str(caught.value)


def test_line_points_are_used():
    """The axis in space holds all three meets."""
    _center, a, b = perspective(2, 4)
    found = th.desargues(a, b)
    p, q = line_points(found.axis)
    rows = np.vstack([p, q, found.meets])
    sigma = np.linalg.svd(rows / np.linalg.norm(rows, axis=1)[:, None], compute_uv=False)
    assert sigma[2] < 1e-9
