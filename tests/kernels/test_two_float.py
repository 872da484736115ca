"""Sums of two float32 against exact fractions, and next to zero and to infinity."""

from __future__ import annotations

from fractions import Fraction

import drjit as dr
import numpy as np
import pytest
from backend_cases import Float, ad

from mitsuba_bezier.kernels import two_float as tf
from mitsuba_bezier.kernels.two_float import TwoFloat

COUNT = 2000
#: The square of a rounding of float32; limits are those that the module states.
SQUARE = Fraction(1, 2**48)


def numbers(seed: int, octaves: float = 20.0) -> tuple[TwoFloat, list[Fraction]]:
    rng = np.random.default_rng(seed)
    values = rng.normal(size=COUNT) * 2.0 ** rng.uniform(-octaves, octaves, COUNT)
    hi, lo = tf.split(values)
    return TwoFloat(Float(hi), Float(lo)), fractions(hi, lo)


def fractions(hi, lo) -> list[Fraction]:
    pairs = zip(np.broadcast_to(hi, COUNT).tolist(), np.broadcast_to(lo, COUNT).tolist())
    return [Fraction(a) + Fraction(b) for a, b in pairs]


def exact(x: TwoFloat) -> list[Fraction]:
    """The numbers that are meant; the first of two is the nearest float32 to both."""
    hi, lo = np.array(x.hi), np.array(x.lo)
    assert np.array_equal((hi.astype(float) + lo).astype(np.float32), hi)
    return fractions(hi, lo)


X, Y, Z = numbers(1), numbers(2), numbers(3)
SINGLE = (Float(X[0].hi), [Fraction(v) for v in np.array(X[0].hi).tolist()])
TENTH = sum(Fraction(float(x)) for x in tf.split(np.array(0.1)))
CASES = {
    "sum": (X[0] + Y[0], lambda k: X[1][k] + Y[1][k], 3),
    "difference": (X[0] - Y[0], lambda k: X[1][k] - Y[1][k], 3),
    "sum with float32": (Y[0] + SINGLE[0], lambda k: Y[1][k] + SINGLE[1][k], 2),
    "sum with a number": (0.1 + X[0], lambda k: X[1][k] + TENTH, 3),
    "difference from a number": (1.0 - X[0], lambda k: 1 - X[1][k], 2),
    "product": (X[0] * Y[0], lambda k: X[1][k] * Y[1][k], 4),
    "product with float32": (Y[0] * SINGLE[0], lambda k: Y[1][k] * SINGLE[1][k], 2),
    "product of float32": (TwoFloat(SINGLE[0]) * SINGLE[0], lambda k: SINGLE[1][k] ** 2, 0),
    "quotient": (X[0] / Y[0], lambda k: X[1][k] / Y[1][k], 15),
    "inverse": (1.0 / X[0], lambda k: 1 / X[1][k], 15),
}


@pytest.mark.parametrize("name", CASES)
def test_operators(name):
    found, expected, limit = CASES[name]
    for k, value in enumerate(exact(found)):
        assert abs(value - expected(k)) <= limit * SQUARE * abs(expected(k)), k


def test_fused_sums():
    for a, b, c in ((X, Y, Z), (SINGLE, Y, Z), (X, SINGLE, SINGLE), (Y, Z, SINGLE)):
        found = exact(tf.fma(TwoFloat.of(a[0]), b[0], c[0]))
        for k, value in enumerate(found):
            p, q = a[1][k] * b[1][k], c[1][k]
            assert abs(value - (p + q)) <= 6 * SQUARE * max(abs(p), abs(q)), k


def test_what_cancels_is_exact():
    hi = np.random.default_rng(4).normal(size=COUNT).astype(np.float32)
    rest = TwoFloat.of(Float(hi)) * Float(hi) - Float(hi * hi)
    assert fractions(np.array(rest.hi), np.array(rest.lo)) == [
        Fraction(x) ** 2 - Fraction(y) for x, y in zip(hi.tolist(), (hi * hi).tolist())
    ]
    assert (np.array((X[0] - X[0]).hi) == 0).all()
    # the root of a difference that float32 has nothing of
    small = tf.fma(TwoFloat.of(Float(1 + 2**-20)), Float(1 - 2**-20), -1.0)
    assert np.array(small.hi) == -(2.0**-40)


def test_roots():
    found = exact(tf.sqrt(tf.absolute(X[0])))
    for root, x in zip(found, X[1]):
        # of a square twice what it is of the root
        assert abs(root * root - abs(x)) <= 2 * 4 * SQUARE * abs(x)
    zero = tf.sqrt(TwoFloat(Float(0.0), Float(0.0)))
    assert np.array(zero.hi) == 0 and np.array(zero.lo) == 0
    assert np.isnan(np.array(tf.sqrt(TwoFloat(Float(-1.0))).hi)).all()


def test_comparisons():
    # neighbours differ in the second number only
    hi = X[0].hi
    near = TwoFloat(hi, X[0].lo + dr.abs(hi) * 2.0**-46)
    pairs = [(X, Y), (X, X), (X, (near, exact(near))), ((near, exact(near)), X), (X, SINGLE)]
    for (a, p), (b, q) in pairs:
        for found, expected in (
            (a < b, [x < y for x, y in zip(p, q)]),
            (a <= b, [x <= y for x, y in zip(p, q)]),
            (a > b, [x > y for x, y in zip(p, q)]),
            (a >= b, [x >= y for x, y in zip(p, q)]),
        ):
            assert np.array(found).tolist() == expected
    assert np.array(X[0] > 0.5).tolist() == [x > 0.5 for x in X[1]]


def test_choices():
    assert exact(tf.maximum(X[0], Y[0])) == [max(x, y) for x, y in zip(X[1], Y[1])]
    assert exact(tf.minimum(X[0], Y[0])) == [min(x, y) for x, y in zip(X[1], Y[1])]
    assert exact(tf.absolute(-X[0])) == [abs(x) for x in X[1]]
    assert exact(tf.clip(X[0], -0.5, 0.25)) == [min(max(x, -0.5), 0.25) for x in X[1]]
    mask = dr.arange(Float, COUNT) - 2 * dr.floor(dr.arange(Float, COUNT) / 2) == 0
    assert exact(tf.select(mask, X[0], SINGLE[0])) == [
        x if k % 2 == 0 else y for k, (x, y) in enumerate(zip(X[1], SINGLE[1]))
    ]
    signed = exact(
        tf.copysign(
            TwoFloat(dr.full(Float, 0.1), dr.full(Float, 0.1 - float(np.float32(0.1)))), Y[0]
        )
    )
    assert all((x < 0) == (y < 0) for x, y in zip(signed, Y[1]))
    assert all(abs(abs(x) - Fraction(0.1)) <= SQUARE for x in signed)


def test_plain_numbers_are_left_to_drjit():
    a, b = Float(2.0), Float(3.0)
    for found, expected in (
        (tf.fma(a, b, 1.0), 7.0),
        (tf.maximum(a, b), 3.0),
        (tf.minimum(a, b), 2.0),
        (tf.sqrt(a), dr.sqrt(2.0)),
        (tf.absolute(-a), 2.0),
        (tf.copysign(a, -b), -2.0),
        (tf.clip(b, 0.0, 1.0), 1.0),
        (tf.select(a < b, a, b), 2.0),
        (tf.coarse(a), 2.0),
    ):
        assert type(found) is Float and np.allclose(np.array(found), expected, rtol=1e-6)


def test_at_the_ends_of_float32():
    # too small: the first number is that of float32, only the second is lost to the flush to zero
    small = TwoFloat.of(Float(1.1e-18)) * Float(1.3e-18)
    assert np.array(small.hi) == np.float32(1.1e-18) * np.float32(1.3e-18)
    # a product of this size has all 48 bits still
    x = np.float32(1.1e-13)
    product = TwoFloat.of(Float(x)) * Float(x)
    assert (
        Fraction(float(product.hi[0])) + Fraction(float(product.lo[0])) == Fraction(float(x)) ** 2
    )
    # too large: no number, and no comparison is true
    large = TwoFloat.of(Float(1e30)) * Float(1e30) + 1.0
    assert not (large > 0.0)[0] and not (large < 0.0)[0]
    for x in (1e30, -1e30):  # the largest that is squared
        square = TwoFloat.of(Float(x)) * Float(1e7)
        assert np.array(square.hi) == np.float32(x) * np.float32(1e7)


def test_splitting():
    values = np.array([0.1, -1e-30, 3e38, np.inf, 0.0, 1e300])
    with np.errstate(over="ignore"):
        hi, lo = tf.split(values)
    assert hi.dtype == lo.dtype == np.float32
    assert (
        np.abs(hi[:3].astype(float) + lo[:3] - values[:3]) <= 2.0**-48 * np.abs(values[:3])
    ).all()
    assert np.isinf(hi[[3, 5]]).all() and (lo[3:] == 0).all()
    third = TwoFloat.of(1 / 3)
    assert Fraction(third.hi) + Fraction(third.lo) == Fraction(1 / 3)


def test_in_the_state_of_a_loop():
    """The sum of 1 / k^2 from the largest on, in float32 but for the sum."""

    def body(k, total):
        return k + 1.0, total + 1.0 / (TwoFloat(k) * k)

    _k, total = dr.while_loop(
        (Float(1.0), TwoFloat.zeros(Float)), cond=lambda k, _total: k < 4000.0, body=body
    )
    expected = float(sum(1 / Fraction(k) ** 2 for k in range(1, 4000)))
    # the rounding of 4000 sums at most, each of 3 squares
    assert abs(float(total.hi[0]) + float(total.lo[0]) - expected) < 4000 * 3 * 2.0**-48 * expected


def test_derivatives():
    """Those of the numbers that are meant, whichever of the two carries them."""
    for f, slope in (
        (
            lambda x: (x * x + 1.0) / (x + 2.0),
            lambda x: (x * x + 4 * x - 1) / (x + 2) ** 2,
        ),
        (lambda x: tf.sqrt(tf.fma(x, x, x)), lambda x: (2 * x + 1) / (2 * np.sqrt(x * x + x))),
    ):
        x = ad.Float([0.3, 1.7, 40.0])
        dr.enable_grad(x)
        y = f(TwoFloat(x))
        dr.set_grad(x, 1.0)
        found = np.array(dr.forward_to(y.hi + y.lo))
        assert np.allclose(found, slope(np.array([0.3, 1.7, 40.0])), rtol=1e-6)
