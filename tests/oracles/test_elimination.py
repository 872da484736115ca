"""Exact roots: against roots known beforehand, the float64 reference, quadrics and SymPy."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from reference_cases import rays_through, wavy

from mitsuba_bezier.geometry.triangles import BezierTriangles
from mitsuba_bezier.oracles import integer_polynomials as ip
from mitsuba_bezier.oracles.elimination import Continuum, exact_roots
from mitsuba_bezier.oracles.reference import candidates

#: x = u, y = v, z = 1 - u - v: the plane x + y + z = 1, of degree 1.
PLANE = np.array([[1.0, 0, 0, 1], [0, 1, 0, 1], [0, 0, 1, 1]])


def parabola() -> np.ndarray:
    """Return the net of (u, v, (u - 1/4)^2, 1), of degree 2."""
    net = np.zeros((6, 4))
    net[:, 0] = [1, 0.5, 0.5, 0, 0, 0]
    net[:, 1] = [0, 0.5, 0, 1, 0.5, 0]
    # of u^2 - u/2 + 1/16: b200 = 9/16, b1.. = (0 - 1/2)/2 ..., by blossoming
    net[:, 2] = [9 / 16, -3 / 16, -3 / 16, 1 / 16, 1 / 16, 1 / 16]
    net[:, 3] = 1
    return net


def product(*factors: list[int]) -> list[int]:
    out = [1]
    for factor in factors:
        out = ip.product(out, factor)
    return out


def test_square_free_factors_and_their_real_roots():
    # (x - 1)^3 (2 x - 1)^2 (x^2 + 1) (3 x - 5)
    p = product(*[[-1, 1]] * 3, *[[-1, 2]] * 2, [1, 0, 1], [-5, 3])
    found = []
    for factor, multiplicity in ip.square_free(p):
        for interval in ip.isolated_roots(factor, 0, 2):
            low, high = ip.refined(factor, interval, 40)
            found.append((float(low + high) / 2, multiplicity))
    assert sorted(found) == [(0.5, 2), (1.0, 3), (pytest.approx(5 / 3, abs=1e-12), 1)]


def test_roots_that_are_near_to_each_other_are_isolated():
    scale = 10**18  # apart by 1e-18, which floats cannot show
    p = product([-(scale // 3), scale], [-(scale // 3) - 1, scale], [-1, 4])
    intervals = ip.isolated_roots(p, 0, 1)
    assert len(intervals) == 3
    ends = sorted(ip.refined(p, interval, 80) for interval in intervals)
    assert ends[0][0] == ends[0][1] == Fraction(1, 4)
    assert ends[1][1] < ends[2][0]


def test_no_common_divisor_modulo_a_prime_is_none_at_all():
    assert ip.common_divisor([-1, 0, 1], [-1, 1]) == [-1, 1]
    assert ip.common_divisor([-1, 0, 1], [-2, 1]) == [1]
    prime = (1 << 61) - 1  # leads that vanish modulo the prime decide nothing
    assert len(ip.common_divisor([-1, prime], [-1, prime])) == 2


def test_interpolation_gives_back_integers():
    p = [7, -3, 0, 12345678901234567890]
    assert ip.interpolated([sum(c * x**i for i, c in enumerate(p)) for x in range(6)]) == p


def test_a_plane():
    (root,) = exact_roots(PLANE, [0.25, 0.25, -1.0], [0.0, 0.0, 2.0])
    assert (root.u, root.v, root.t) == (Fraction(1, 4), Fraction(1, 4), Fraction(3, 4))
    assert (root.multiplicity, root.on_edge, root.base_point) == (1, False, False)


@pytest.mark.parametrize(
    ("origin", "direction", "expected"),
    [
        ((0, 0.25, -1), (0, 0, 1), True),  # on the edge u = 0, exactly
        ((1e-300, 0.25, -1), (0, 0, 1), False),  # beside it by less than floats of size 1 have
        ((-1e-300, 0.25, -1), (0, 0, 1), None),
    ],
)
def test_edges_are_decided_exactly(origin, direction, expected):
    roots = exact_roots(PLANE, origin, direction)
    assert [root.on_edge for root in roots] == ([] if expected is None else [expected])


def test_a_tangent_ray_meets_twice_at_one_point():
    # y = 1/4, z = 0 touches z = (x - 1/4)^2 at x = 1/4
    (root,) = exact_roots(parabola(), [-1.0, 0.25, 0.0], [1.0, 0.0, 0.0])
    assert (root.u, root.v, root.t, root.multiplicity) == (0.25, 0.25, Fraction(5, 4), 2)


@pytest.mark.parametrize(("height", "count"), [(2.0**-80, 2), (-(2.0**-80), 0)])
def test_nearly_tangent_rays_meet_twice_or_not_at_all(height, count):
    roots = exact_roots(parabola(), [-1.0, 0.25, height], [1.0, 0.0, 0.0])
    assert [root.multiplicity for root in roots] == [1] * count
    for root in roots:
        assert abs(abs(root.u - Fraction(1, 4)) - Fraction(2) ** -40) < Fraction(2) ** -85


def test_points_at_infinity_and_base_points():
    # (u, v, 1, u) is (1, v/u, 1/u): the plane x = 1, whose edge u = 0 is at infinity
    net = np.array([[1.0, 0, 1, 1], [0, 1, 1, 0], [0, 0, 1, 0]])
    (away,) = exact_roots(net, [0.0, 0.5, 0.0], [0.0, 0.0, 1.0])  # parallel to the plane
    assert away.t is None and not away.base_point and (away.u, away.v) == (0, 0)
    (root,) = exact_roots(net, [0.0, 0.5, 2.0], [1.0, 0.0, 0.0])
    assert (root.u, root.v, root.t) == (0.5, 0.25, 1)
    quadratic = parabola()
    quadratic[5] = 0  # all four coordinates vanish at u = v = 0
    roots = exact_roots(quadratic, [0.3, 0.3, -1.0], [0.1, 0.2, 1.0])
    assert [root.base_point for root in roots if (root.u, root.v) == (0, 0)] == [True]


def test_a_ray_in_the_patch_is_an_error():
    with pytest.raises(Continuum):
        exact_roots(PLANE, [1.0, 0.0, 0.0], [-1.0, 1.0, 0.0])


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("signs", [False, True])
def test_elimination_and_subdivision_agree(n, signs):
    rng = np.random.default_rng(n)
    nets = wavy(rng, n, patches=3, signs=signs)
    o, d, patch, _uv, _t = rays_through(rng, nets, 5 if n < 5 else 2)
    count = 0
    for ray in range(len(o)):
        net = nets.control_points[patch[ray]]
        exact = exact_roots(net, o[ray], d[ray])
        rows = candidates(BezierTriangles(net), o[ray], d[ray], extend=0.0)
        assert (rows.graze[rows.inside] > 1e-9).all()  # no ray of these is tangent
        rows = rows.select(rows.inside & (rows.kind >= 0))
        assert len(exact) == len(rows.t)
        for root, t, cosine, scale in zip(exact, rows.t, rows.cosine, rows.scale):
            # what float64 can know: 30 roundings of the coefficients, over the cosine
            off = abs(float(root.t) - t) * np.linalg.norm(d[ray])
            assert off < 30 * 2.0**-53 * scale / abs(cosine)
        count += len(exact)
    assert count >= 2


@pytest.mark.parametrize("bad", ["net", "origin", "direction"])
def test_bad_input_is_one_message(bad):
    given = {"net": PLANE, "origin": [0, 0, 1.0], "direction": [0, 0, 1.0]}
    given[bad] = np.full_like(np.asarray(given[bad], dtype=float), np.nan)
    with pytest.raises(ValueError, match=f"{bad}: expected"):
        exact_roots(**given)
    with pytest.raises(ValueError, match="direction: expected a vector that is not zero"):
        exact_roots(PLANE, [0, 0, 1.0], [0, 0, 0])
