"""Evaluation of nets of any degree by code that does not depend on it, and what it is transposed.

With barycentrics ``u, v, w`` as three variables a patch is the sum of ``c_ijk u^i v^j w^k``, with
the control points times ``n! / (i! j! k!)`` as coefficients. Horner's method in `u` over the levels
``j + k``, and in `v` within each, has only positive terms: it is as exact as de Casteljau's. It has
partials by the three variables, too. Those by the parameters, ``d/du - d/dw`` and ``d/dv - d/dw``,
are their differences, as those of control points are in de Casteljau's.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from math import comb
from typing import Any

import drjit as dr

from .arrays import four_zeros, gather_row
from .two_float import TwoFloat, coarse, fma, full, select

__all__ = ["add_gradient", "partials_up_to", "rolled_partials"]

#: Highest power of two in a degree.
_BITS = 6


@cache
def _orders(most: int, variables: int) -> tuple[tuple[int, ...], ...]:
    """Return how often each variable may be differentiated by, `most` times together."""
    if variables == 0:
        return ((),)
    return tuple(
        (*rest, k) for rest in _orders(most, variables - 1) for k in range(most + 1 - sum(rest))
    )


@cache
def _terms(p: int, q: int) -> tuple[tuple[tuple[int, int, int], int], ...]:
    """Return the partials by barycentrics, with factors, of which one by u and v is the sum."""
    found: dict[tuple[int, int, int], int] = {}
    for i in range(p + 1):
        for j in range(q + 1):
            left = p - i + q - j
            key = (i, j, left)
            found[key] = found.get(key, 0) + comb(p, i) * comb(q, j) * (-1) ** left
    return tuple(found.items())


def partials_up_to(order: int) -> tuple[tuple[int, int], ...]:
    """Return ``(p, q)`` of the partials ``d^(p+q) / du^p dv^q``: value, u, v, uu, uv, vv, ..."""
    return tuple((m - q, q) for m in range(order + 1) for q in range(m + 1))


def rolled_partials(
    rows: Any,
    first: Any,
    degree: Any,
    u: Any,
    v: Any,
    active: Any,
    order: int = 2,
    is_plain: Any = None,
) -> dict[tuple[int, int], list[Any]]:
    """Evaluate homogeneous points and partials of nets in memory, each of its own degree.

    Parameters
    ----------
    rows : Float
        Four numbers a row, in net order: control points times their multinomials.
    first, degree : UInt
        Number of the first row of a net, and its degree.
    u, v : Float
        Their type is that of all arithmetic.
    active : Bool
        Which are wanted.
    order : int
        Of the highest partials.
    is_plain : Bool, optional
        Nets that are control points themselves.

    Returns
    -------
    dict
        By ``(p, q)`` of `partials_up_to`, lists of four Float.
    """
    number, uint = _number_of(u), dr.uint32_array_t(type(coarse(u)))
    first, degree, active = uint(first), uint(degree), dr.mask_t(coarse(u))(active)
    w = 1.0 - u - v
    inner, outer = _orders(order, 2), _orders(order, 3)
    one = dr.full(type(coarse(u)), 1.0)

    def level(at: Any, row: Any, choices: Any, p: Any) -> Any:
        def step(k: Any, row: Any, factor: Any, powers: Any, r: Any) -> Any:
            c = [number(x) for x in gather_row(rows, row, active)]
            if is_plain is not None:
                c = [x * factor for x in c]
                factor = select(is_plain, factor * number(at - k) / number(k + 1), number(one))
            r = [
                _plus(r[n], v, r[inner.index((a - 1, b))], a)
                if a
                else [fma(x, v, y * powers[b]) for x, y in zip(r[n], c)]
                for n, (a, b) in enumerate(inner)
            ]
            powers = _next_powers(powers, w)
            return k + 1, row + 1, factor, powers, r

        _k, row, _factor, _powers, r = dr.while_loop(
            (
                uint(0),
                row,
                choices,
                _first_powers(u, order),
                [four_zeros(u) for _ in inner],
            ),
            cond=lambda k, *_: active & (k <= at),
            body=step,
            labels=("k", "row", "factor", "powers", "r"),
            label="bezier row",
        )
        p = [
            _plus(p[n], u, p[outer.index((x - 1, a, b))], x)
            if x
            else [fma(y, u, z) for y, z in zip(p[n], r[inner.index((a, b))])]
            for n, (x, a, b) in enumerate(outer)
        ]
        if is_plain is not None:
            # of n! / (i! (n - i)!), i = n - at
            choices = select(is_plain, choices * number(degree - at) / number(at + 1), number(one))
        return at + 1, row, choices, p

    _at, _row, _choices, p = dr.while_loop(
        (uint(0), first, full(number(one)), [four_zeros(u) for _ in outer]),
        cond=lambda at, *_: active & (at <= degree),
        body=level,
        labels=("level", "row", "choices", "p"),
        label="bezier level",
    )
    return {
        key: [
            sum(factor * p[outer.index(which)][a] for which, factor in _terms(*key))
            for a in range(4)
        ]
        for key in partials_up_to(order)
    }


def add_gradient(
    rows: Any,
    first: Any,
    degree: Any,
    u: Any,
    v: Any,
    active: Any,
    gradient: dict[tuple[int, int], list[Any]],
    is_plain: Any,
) -> None:
    """Bring the gradient by what `rolled_partials` returns to the nets, which have derivatives.

    Parameters
    ----------
    gradient : dict
        By ``(p, q)`` lists of four Float. Other parameters are those of `rolled_partials`; `rows`
        is of a type with derivatives, and attached.
    """
    number, uint = type(u), dr.uint32_array_t(type(u))
    first, degree, active = uint(first), uint(degree), dr.mask_t(number)(active)
    w = 1.0 - u - v
    order = max(p + q for p, q in gradient)
    outer = _orders(order, 3)
    by_three: dict[tuple[int, ...], list[Any]] = {}
    for key, values in gradient.items():
        for which, factor in _terms(*key):
            before = by_three.get(which, [0.0] * 4)
            by_three[which] = [b + factor * x for b, x in zip(before, values)]
    of_w = [w]
    for _ in range(_BITS - 1):
        of_w.append(of_w[-1] * of_w[-1])

    def power(exponent: Any) -> Any:
        out = dr.full(number, 1.0)
        for bit, x in enumerate(of_w):
            out = dr.select((exponent & (1 << bit)) != 0, out * x, out)
        return out

    def level(i: Any, choices: Any, of_u: Any) -> Any:
        at = degree - i
        last = first + ((at * (at + 1)) >> 1) + at  # the row with v^0

        def step(j: Any, factor: Any, of_v: Any) -> Any:
            k = at - j
            of_w, falling = [], dr.full(number, 1.0)
            for b in range(order + 1):
                of_w.append(falling * power(dr.select(k > b, k - b, 0)))
                falling = falling * (number(k) - b)
            weights = [0.0] * 4
            for x, a, b in outer:
                basis = factor * of_u[x] * of_v[a] * of_w[b]
                weights = [dr.fma(basis, g, s) for g, s in zip(by_three[x, a, b], weights)]
            with dr.resume_grad():
                values = gather_row(rows, last - j, active)
                total = sum(y * type(rows)(g) for y, g in zip(values, weights))
                if dr.grad_enabled(total):  # not where all gradients are literally zero
                    dr.backward_from(total)
            following = factor * number(k) / number(j + 1)
            return j + 1, dr.select(is_plain, following, 1.0), _next_powers(of_v, v)

        dr.while_loop(
            (uint(0), choices, _first_powers(u, order)),
            cond=lambda j, *_: active & (j <= at),
            body=step,
            labels=("j", "factor", "powers"),
            label="bezier row",
        )
        following = choices * number(at) / number(i + 1)
        return i + 1, dr.select(is_plain, following, 1.0), _next_powers(of_u, u)

    dr.while_loop(
        (uint(0), dr.full(number, 1.0), _first_powers(u, order)),
        cond=lambda i, *_: active & (i <= degree),
        body=level,
        labels=("i", "choices", "powers"),
        label="bezier level",
    )


def _plus(s: list[Any], x: Any, before: list[Any], times: int) -> list[Any]:
    """Return a derivative of a sum in Horner's method, after one more factor `x`."""
    return [fma(a, x, b if times == 1 else times * b) for a, b in zip(s, before)]


def _number_of(like: Any) -> Callable[[Any], Any]:
    """Return what makes numbers of the type of `like`, from arrays."""
    if not isinstance(like, TwoFloat):
        return type(like)
    return lambda x: TwoFloat(type(like.hi)(x)).full()


def _first_powers(x: Any, order: int) -> list[Any]:
    """Return ``x^0`` and its derivatives."""
    number = _number_of(x)
    one, zero = (dr.full(type(coarse(x)), k) for k in (1.0, 0.0))
    return [number(one), *(number(zero) for _ in range(order))]


def _next_powers(powers: list[Any], x: Any) -> list[Any]:
    """Return ``x^(k+1)`` and its derivatives from those of ``x^k``."""
    return [fma(a, x, b * powers[b - 1]) if b else a * x for b, a in enumerate(powers)]
