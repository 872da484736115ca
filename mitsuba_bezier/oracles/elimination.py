"""All intersections of a line with one patch, in exact arithmetic and with their multiplicities.

A line is the meet of two planes. Put into the net they give polynomials `f` and `g` in the
parameters. One unknown is eliminated: with ``u = x - lambda y``, ``v = y``, the roots `x` of the
resultant of `f` and `g` by `y` are the places of the common roots, and, for all but finitely many
`lambda`, no two of them share an `x`. Then the multiplicity of a root of the resultant is the
intersection multiplicity (Cox, Little, O'Shea, Using Algebraic Geometry, section 3.2), and
the first subresultant that is not zero there is a power of ``y - y0`` (Gonzalez-Vega, El Kahoui
1996), from which `y` is read. Whether `lambda` is one of the few is decided exactly; then the
next one is used.

Nothing here is rounded: floats are rational numbers. Roots are intervals that Sturm's theorem
isolates; signs come from intervals narrow enough, zeros (a root on an edge, at infinity, a base
point) from common divisors. This is another method than that of `reference`, which subdivides.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from math import comb, lcm
from typing import Any

import numpy as np

from ..errors import GeometryError
from ..geometry import bernstein
from ..geometry.checks import finite_array
from . import integer_polynomials as ip
from .integer_polynomials import Polynomial

__all__ = ["Continuum", "ExactRoot", "exact_roots"]

#: Tried in turn; a line of degree n has at most n^2 roots, so few of them can be bad.
_SHEARS = (3, 5, 2, 7, 11, 13, 4, 17, 6, 19, 9, 23)

#: Widths, as powers of two, to which an interval is refined before a zero is decided exactly.
_BITS = (96, 192, 384)


class Continuum(GeometryError):
    """The line lies in the patch, or meets it along a curve of parameters."""


@dataclass(frozen=True)
class ExactRoot:
    """One common root in the closed triangle.

    Attributes
    ----------
    u, v : Fraction
        Barycentric coordinates, exact to 2**-90 or better.
    t : Fraction or None
        ``x = o + t d``, to a relative 2**-80; None at infinity and at a base point.
    multiplicity : int
        How many roots fall together here; of a surface without singularity 1, or 2 and more
        where the line is tangent.
    on_edge : bool
        Whether u, v or w is exactly zero.
    base_point : bool
        Whether all four coordinates vanish here: no point of the surface.
    """

    u: Fraction
    v: Fraction
    t: Fraction | None
    multiplicity: int
    on_edge: bool
    base_point: bool


@dataclass(frozen=True)
class _Interval:
    """A number between two rational ones."""

    low: Fraction
    high: Fraction

    def __add__(self, other: _Interval) -> _Interval:
        return _Interval(self.low + other.low, self.high + other.high)

    def __sub__(self, other: _Interval) -> _Interval:
        return _Interval(self.low - other.high, self.high - other.low)

    def __mul__(self, other: _Interval) -> _Interval:
        ends = [a * b for a in (self.low, self.high) for b in (other.low, other.high)]
        return _Interval(min(ends), max(ends))

    def __truediv__(self, other: _Interval) -> _Interval:
        return self * _Interval(1 / other.high, 1 / other.low)

    @property
    def middle(self) -> Fraction:
        return (self.low + self.high) / 2

    @property
    def sign(self) -> int | None:
        """The sign, None if the interval does not tell."""
        if self.low > 0 or self.high < 0:
            return 1 if self.low > 0 else -1
        return 0 if self.low == self.high else None

    def narrow(self, bits: int) -> bool:
        """Tell whether the relative width is at most ``2**-bits``."""
        size = min(abs(self.low), abs(self.high))
        return (self.high - self.low) * (1 << bits) <= size

    def rounded(self, bits: int) -> _Interval:
        """Return an interval around this one whose ends have few digits."""
        scale = 1 << bits
        low, high = self.low * scale, self.high * scale
        return _Interval(
            Fraction(low.numerator // low.denominator, scale),
            Fraction(-(-high.numerator // high.denominator), scale),
        )


def _point(x: int | Fraction) -> _Interval:
    return _Interval(Fraction(x), Fraction(x))


def _value(p: Polynomial, x: _Interval) -> _Interval:
    out = _point(0)
    for c in reversed(p):
        out = out * x + _point(c)
    return out


def _integers(values: list[Fraction]) -> list[int]:
    scale = lcm(*(x.denominator for x in values))
    return [int(x * scale) for x in values]


class _Line:
    """A line and a net in integers: the coordinates, up to positive factors that do not matter."""

    def __init__(self, net: np.ndarray, origin: np.ndarray, direction: np.ndarray) -> None:
        self.n = bernstein.degree_of(len(net), "net")
        self.index = bernstein.multi_indices(self.n).tolist()
        self.number = [comb(self.n, i) * comb(self.n - i, j) for i, j, _k in self.index]
        flat = _integers([Fraction(x) for x in net.ravel().tolist()])
        self.net = [flat[4 * r : 4 * r + 4] for r in range(len(net))]
        self.origin = [Fraction(x) for x in origin.tolist()]
        self.direction = [Fraction(x) for x in direction.tolist()]
        d = _integers(self.direction)
        # the line is the meet of two planes that hold d: e x d for the axes e that are not its own
        main = max(range(3), key=lambda c: abs(d[c]))
        self.planes = []
        for axis in (c for c in range(3) if c != main):
            normal = [0, 0, 0]
            normal[axis], normal[main] = d[main], -d[axis]
            offset = -sum((a * b for a, b in zip(normal, self.origin)), Fraction(0))
            plane = _integers([*(Fraction(c) for c in normal), offset])
            self.planes.append([sum(a * b for a, b in zip(plane, row)) for row in self.net])

    def in_y(self, shear: int, x: int) -> list[Polynomial]:
        """Return `f` and `g` as polynomials in `y` at one integer `x`."""
        powers = []
        for factor in ([x, -shear], [0, 1], [1 - x, shear - 1]):
            column: list[Polynomial] = [[1]]
            for _ in range(self.n):
                column.append(ip.product(column[-1], factor))
            powers.append(column)
        out: list[Polynomial] = [[], []]
        for (i, j, k), number, f, g in zip(self.index, self.number, *self.planes):
            basis = ip.product(ip.product(powers[0][i], powers[1][j]), powers[2][k])
            out[0] = ip.total(out[0], basis, number * f)
            out[1] = ip.total(out[1], basis, number * g)
        return out


class _Eliminated:
    """Resultant and subresultants of `f` and `g` by `y`; `good` unless the shear is a bad one."""

    def __init__(self, line: _Line, shear: int) -> None:
        count = line.n * line.n + 1
        pairs = [line.in_y(shear, x) for x in range(max(count, line.n + 1))]
        degrees = [max(len(pair[c]) for pair in pairs) - 1 for c in (0, 1)]
        if min(degrees) < 0:
            raise Continuum("a plane through the line holds the whole patch")
        leads = [[(p[c] + [0] * 99)[degrees[c]] for p in pairs] for c in (0, 1)]
        # of the highest total degree the coefficient of its power of y is a constant
        self.good = all(lead.count(lead[0]) == len(lead) for lead in leads)
        self.pairs, (self.a, self.b) = pairs, degrees

    def subresultant(self, k: int, j: int) -> Polynomial:
        """Return the coefficient of ``y^j`` in the `k`-th subresultant; of the 0th, the resultant.

        Where both polynomials have degree `k`, this is `g` itself.
        """
        size = self.a + self.b - 2 * k
        columns = [*range(self.a + self.b - k - 1, k, -1), j][-size:] if size else []
        values = []
        for f, g in self.pairs:
            if not size:
                values.append(g[j] if j < len(g) else 0)
                continue
            rows = []
            for p, copies in ((f, self.b - k), (g, self.a - k)):
                for lift in range(copies - 1, -1, -1):
                    rows.append([p[c - lift] if 0 <= c - lift < len(p) else 0 for c in columns])
            values.append(ip.determinant(rows))
        return ip.interpolated(values)


@dataclass(frozen=True)
class _Fibre:
    """Roots of one square-free factor: ``y = top / below`` at the roots of `factor`."""

    factor: Polynomial
    multiplicity: int
    top: Polynomial
    below: Polynomial


def _fibres(line: _Line, shear: int) -> list[_Fibre] | None:
    """Return all common roots, None if two of them may share an `x`."""
    e = _Eliminated(line, shear)
    if not e.good:
        return None
    if min(e.a, e.b) == 0:
        return []
    resultant = e.subresultant(0, 0)
    if not resultant:
        raise Continuum("the line meets the patch along a curve")
    out = []
    for factor, multiplicity in ip.square_free(resultant):
        rest = factor
        for k in range(1, min(e.a, e.b) + 1):
            lead = e.subresultant(k, k)
            later = ip.common_divisor(rest, lead) if lead else rest
            part = ip.quotient(rest, later)
            rest = later
            if len(part) > 1:
                lower = [e.subresultant(k, j) for j in range(k)]
                if not _is_power(part, lead, lower):
                    return None
                top = [-c for c in lower[-1]]
                out.append(_Fibre(part, multiplicity, top, [k * c for c in lead]))
            if len(rest) == 1:
                break
    return out


def _is_power(part: Polynomial, lead: Polynomial, lower: list[Polynomial]) -> bool:
    """Tell whether ``lead y^k + ...`` is ``lead (y - y0)^k`` at all roots of `part`."""
    k = len(lower)
    for j, coefficient in enumerate(lower[:-1]):
        left, right = coefficient, [comb(k, j)]
        for _ in range(k - j - 1):
            left = ip.product(left, [k * c for c in lead])
        left = [k * c for c in left]
        for _ in range(k - j):
            right = ip.product(right, lower[-1])
        if ip.remainder(ip.total(left, right, -1), part):
            return False
    return True


class _Root:
    """One real root `x` of a fibre, and all quantities at it, to any number of bits."""

    def __init__(
        self, line: _Line, shear: int, fibre: _Fibre, interval: tuple[Fraction, Fraction]
    ) -> None:
        self.line, self.fibre, self.interval = line, fibre, interval
        # homogeneous parameters: u, v and w times `below`
        y, below = fibre.top, fibre.below
        u = ip.total(ip.product([0, 1], below), y, -shear)
        self.parameters = [u, y, ip.total(ip.total(below, u, -1), y, -1)]

    def refine(self, bits: int) -> None:
        self.interval = ip.refined(self.fibre.factor, self.interval, bits)

    def vanishes(self, p: Polynomial) -> bool:
        """Tell exactly whether `p` is zero at the root."""
        low, high = self.interval
        if low == high:
            return not ip.sign(p, low)
        common = ip.common_divisor(self.fibre.factor, p) if p else self.fibre.factor
        return len(common) > 1 and ip.sign(common, low) != ip.sign(common, high)

    def coordinate(self, c: int) -> Polynomial:
        """Return one homogeneous coordinate of the point as a polynomial in `x`."""
        out: Polynomial = []
        for index, number, row in zip(self.line.index, self.line.number, self.line.net):
            term = [number * row[c]]
            for p, power in zip(self.parameters, index):
                for _ in range(power):
                    term = ip.product(term, p)
            out = ip.total(out, term)
        return out

    def barycentric(self) -> list[_Interval]:
        x = _Interval(*self.interval)
        below = _value(self.fibre.below, x)
        if below.sign is None:
            return [_Interval(Fraction(-(1 << 60)), Fraction(1 << 60))] * 3
        return [_value(p, x) / below for p in self.parameters]

    def point(self, uvw: list[_Interval]) -> list[_Interval]:
        out = [_point(0)] * 4
        for index, number, row in zip(self.line.index, self.line.number, self.line.net):
            basis = _point(number)
            for p, power in zip(uvw, index):
                for _ in range(power):
                    basis = basis * p
            out = [a + basis * _point(c) for a, c in zip(out, row)]
        return out


def _in_triangle(line: _Line, shear: int, fibre: _Fibre) -> Iterator[ExactRoot]:
    # x runs from 0 to `shear`; halves of a power of two meet roots with few binary digits
    for interval in ip.isolated_roots(fibre.factor, 0, 1 << shear.bit_length()):
        root = _Root(line, shear, fibre, interval)
        signs: list[int | None] = [None] * 3
        for bits in _BITS:
            root.refine(bits)
            uvw = root.barycentric()
            signs = [p.sign for p in uvw]
            if -1 in signs or None not in signs:
                break
        if -1 in signs:
            continue
        # what even narrow intervals leave open is zero, or else exceedingly near to it
        for c in (c for c in range(3) if signs[c] is None):
            if root.vanishes(root.parameters[c]):
                signs[c], uvw[c] = 0, _point(0)
            else:
                signs[c] = _slow_sign(root, c)
        if -1 in signs:
            continue
        t, base = _ray_parameter(root)
        u, v, _w = (p.middle for p in uvw)
        yield ExactRoot(u, v, t, fibre.multiplicity, 0 in signs, base)


def _slow_sign(root: _Root, c: int) -> int:
    """Return the sign of a barycentric coordinate that is not zero."""
    bits = _BITS[-1]
    while True:
        bits *= 2
        root.refine(bits)
        found = root.barycentric()[c].sign
        if found is not None:
            return found


def _ray_parameter(root: _Root) -> tuple[Fraction | None, bool]:
    """Return `t`, None at infinity; and whether the root is a base point."""
    line, bits = root.line, _BITS[0]
    exact = [False] * 4  # coordinates known to be zero
    while True:
        uvw = [p.rounded(bits) for p in root.barycentric()]
        point = root.point(uvw)
        if point[3].sign is None and bits >= _BITS[-1] and not exact[3]:
            exact[3] = root.vanishes(root.coordinate(3))
        if exact[3]:
            return None, all(root.vanishes(root.coordinate(c)) for c in range(3))
        w = point[3]
        if w.sign == 0:
            return None, all(p.sign == 0 or root.vanishes(root.coordinate(c))
                             for c, p in enumerate(point[:3]))  # fmt: skip
        if w.sign is not None:
            top, below = _point(0), sum((d * d for d in line.direction), Fraction(0))
            for p, o, d in zip(point, line.origin, line.direction):
                top = top + (p - w * _point(o)) * _point(d)
            t = top / (w * _point(below))
            if t.narrow(80) or t.high - t.low < Fraction(1, 1 << 300):
                return t.middle, False
        bits *= 2
        root.refine(bits)


def exact_roots(net: Any, origin: Any, direction: Any) -> list[ExactRoot]:
    """Find all intersections of a line with a patch.

    Parameters
    ----------
    net : (K, 4) array_like
        Homogeneous control points; floats are taken as the rational numbers they are.
    origin, direction : (3,) array_like
        The line ``origin + t direction``, all `t`.

    Returns
    -------
    list of ExactRoot
        Rising in `t`, those without a `t` last.

    Raises
    ------
    Continuum
        If the line meets the patch along a curve, or a factor of both polynomials hides roots.
    """
    net = finite_array("net", net, (None, 4), GeometryError)
    origin = finite_array("origin", origin, (3,), GeometryError)
    direction = finite_array("direction", direction, (3,), GeometryError)
    if not direction.any():
        raise GeometryError.expected("direction", "a vector that is not zero", "zero")
    line = _Line(net, origin, direction)
    for shear in _SHEARS:
        fibres = _fibres(line, shear)
        if fibres is not None:
            found = [root for fibre in fibres for root in _in_triangle(line, shear, fibre)]
            return sorted(found, key=lambda r: (r.t is None, r.t or 0))
    raise Continuum("no elimination separates the roots")
