"""Polynomials in one unknown with integer coefficients: division, greatest divisors, real roots.

A polynomial is a list of integers, the constant first and the highest not zero; ``[]`` is zero.
Python's integers have no limit, so that all of this is exact. Only signs and zeros of the results
matter: divisors and remainders are returned up to a positive factor.
"""

from __future__ import annotations

from fractions import Fraction
from functools import cache
from itertools import pairwise
from math import comb, factorial, gcd, lcm

__all__ = [
    "Polynomial",
    "common_divisor",
    "determinant",
    "interpolated",
    "isolated_roots",
    "product",
    "quotient",
    "refined",
    "remainder",
    "sign",
    "square_free",
    "total",
]

Polynomial = list[int]

#: A prime of Mersenne: any would do, a large one rarely divides what matters.
_PRIME = (1 << 61) - 1


def _trimmed(p: Polynomial) -> Polynomial:
    while p and not p[-1]:
        p.pop()
    return p


def _primitive(p: Polynomial) -> Polynomial:
    content = gcd(*p)
    return [c // content for c in p] if content > 1 else p


def total(p: Polynomial, q: Polynomial, factor: int = 1) -> Polynomial:
    """Return ``p + factor q``."""
    out = p + [0] * (len(q) - len(p))
    for i, c in enumerate(q):
        out[i] += factor * c
    return _trimmed(out)


def product(p: Polynomial, q: Polynomial) -> Polynomial:
    """Return ``p q``."""
    if not p or not q:
        return []
    out = [0] * (len(p) + len(q) - 1)
    for i, a in enumerate(p):
        for j, b in enumerate(q):
            out[i + j] += a * b
    return out


def remainder(p: Polynomial, q: Polynomial) -> Polynomial:
    """Return a positive multiple of the remainder of `p` by `q`, without a common factor."""
    lead, sense = abs(q[-1]), 1 if q[-1] > 0 else -1
    out = list(p)
    while len(out) >= len(q):
        shift, factor = len(out) - len(q), sense * out[-1]
        out = [c * lead for c in out]
        for i, c in enumerate(q):
            out[shift + i] -= factor * c
        _trimmed(out)
    return _primitive(out)


def quotient(p: Polynomial, q: Polynomial) -> Polynomial:
    """Return `p` over its divisor `q`, up to a positive factor."""
    rest = [Fraction(c) for c in p]
    out = [Fraction(0)] * (len(p) - len(q) + 1)
    for k in range(len(out) - 1, -1, -1):
        out[k] = rest[k + len(q) - 1] / q[-1]
        for i, c in enumerate(q):
            rest[k + i] -= out[k] * c
    scale = 1
    for x in out:
        scale = lcm(scale, x.denominator)
    return _primitive([int(x * scale) for x in out])


def _coprime_modulo(p: Polynomial, q: Polynomial) -> bool:
    """Tell whether `p` and `q` have no common divisor modulo a prime, and then none at all."""
    if not p or not q or not p[-1] % _PRIME or not q[-1] % _PRIME:
        return False
    p, q = [c % _PRIME for c in p], [c % _PRIME for c in q]
    while q:
        inverse = pow(q[-1], -1, _PRIME)
        while len(p) >= len(q):
            factor, shift = p[-1] * inverse, len(p) - len(q)
            for i, c in enumerate(q):
                p[shift + i] = (p[shift + i] - factor * c) % _PRIME
            _trimmed(p)
        p, q = q, p
    return len(p) == 1


def common_divisor(p: Polynomial, q: Polynomial) -> Polynomial:
    """Return the greatest common divisor."""
    if _coprime_modulo(p, q):
        return [1]
    p, q = _primitive(p), _primitive(q)
    while q:
        p, q = q, remainder(p, q) if len(p) >= len(q) else p
    return p


def _derivative(p: Polynomial) -> Polynomial:
    return [i * c for i, c in enumerate(p)][1:]


def square_free(p: Polynomial) -> list[tuple[Polynomial, int]]:
    """Return factors without multiple roots, and the multiplicity of the roots of each (Yun)."""
    found = []
    rest = common_divisor(p, _derivative(p))  # each root once less than in p
    distinct = quotient(p, rest)
    multiplicity = 1
    while len(distinct) > 1:
        repeated = common_divisor(distinct, rest)
        factor = quotient(distinct, repeated)
        if len(factor) > 1:
            found.append((factor, multiplicity))
        distinct, rest = repeated, quotient(rest, repeated)
        multiplicity += 1
    return found


def sign(p: Polynomial, x: Fraction) -> int:
    """Return the sign of the value at `x`: -1, 0 or 1."""
    value, power = 0, 1
    for c in reversed(p):
        value = value * x.numerator + c * power
        power *= x.denominator
    return (value > 0) - (value < 0)


def _shifted(p: Polynomial) -> Polynomial:
    """Return ``p(x + 1)``."""
    out = list(p)
    for k in range(len(out) - 1):
        for i in range(len(out) - 2, k - 1, -1):
            out[i] += out[i + 1]
    return out


def _sign_changes(p: Polynomial) -> int:
    signs = [c > 0 for c in p if c]
    return sum(a != b for a, b in pairwise(signs))


def isolated_roots(p: Polynomial, low: int, high: int) -> list[tuple[Fraction, Fraction]]:
    """Return one interval for each real root in ``[low, high]``, by Descartes' rule of signs.

    `p` has no multiple roots (Collins, Akritas 1976). At the ends of an interval `p` is not zero,
    unless the interval is one point, the root itself.
    """
    found: list[tuple[Fraction, Fraction]] = []

    def split(q: Polynomial, a: Fraction, b: Fraction) -> None:
        """Find the roots in ``[a, b)``; `q` is `p` there as a polynomial on ``[0, 1]``."""
        if not q[0]:
            found.append((a, a))
            q = q[1:]
        changes = _sign_changes(_shifted(q[::-1]))
        if not changes:
            return
        if changes == 1 and sign(p, a) and sign(p, b):
            found.append((a, b))
            return
        middle = (a + b) / 2
        left = [c << (len(q) - 1 - i) for i, c in enumerate(q)]
        split(left, a, middle)
        split(_shifted(left), middle, b)

    whole: Polynomial = []
    for c in reversed(p):  # p(low + (high - low) x)
        whole = total(product(whole, [low, high - low]), [c])
    split(whole, Fraction(low), Fraction(high))
    if not sign(p, Fraction(high)):
        found.append((Fraction(high), Fraction(high)))
    return found


def refined(
    p: Polynomial, interval: tuple[Fraction, Fraction], bits: int
) -> tuple[Fraction, Fraction]:
    """Return the interval of a root bisected until it is ``2**-bits`` wide."""
    a, b = interval
    rising = sign(p, b)
    while b - a > Fraction(1, 1 << bits):
        middle = (a + b) / 2
        at = sign(p, middle)
        if not at:
            return middle, middle
        a, b = (a, middle) if at == rising else (middle, b)
    return a, b


def determinant(rows: list[list[int]]) -> int:
    """Return the determinant of a matrix of integers, by Bareiss's elimination."""
    m = [list(row) for row in rows]
    sense, before = 1, 1
    for k in range(len(m) - 1):
        pivot = next((i for i in range(k, len(m)) if m[i][k]), None)
        if pivot is None:
            return 0
        if pivot != k:
            m[k], m[pivot] = m[pivot], m[k]
            sense = -sense
        for i in range(k + 1, len(m)):
            for j in range(k + 1, len(m)):
                m[i][j] = (m[i][j] * m[k][k] - m[i][k] * m[k][j]) // before
        before = m[k][k]
    return sense * m[-1][-1]


@cache
def _binomials(n: int) -> list[Polynomial]:
    """Return ``n! x (x - 1) ... (x - k + 1) / k!`` for ``k = 0 .. n``."""
    falling: Polynomial = [1]
    out = []
    for k in range(n + 1):
        out.append([c * (factorial(n) // factorial(k)) for c in falling])
        falling = product(falling, [-k, 1])
    return out


def interpolated(values: list[int]) -> Polynomial:
    """Return the polynomial with integer coefficients that has these values at 0, 1, 2, ..."""
    n = len(values) - 1
    out: Polynomial = []
    for k, p in enumerate(_binomials(n)):
        difference = sum((-1) ** (k - i) * comb(k, i) * values[i] for i in range(k + 1))
        out = total(out, p, difference)
    return [c // factorial(n) for c in out]
