"""Evaluation of a net from monomial coefficients, with partial derivatives."""

from __future__ import annotations

from typing import Any

import drjit as dr

from ..geometry import bernstein
from ..leaves.nets import Powers
from .arrays import four_zeros, gather_row, gather_row_wide, reciprocal
from .two_float import TwoFloat, coarse, fma

__all__ = ["graph_point", "horner", "horner_value", "rolled_horner"]


def horner(coefficients: list[Any], powers: int | Powers, u: Any, v: Any) -> tuple[list[Any], ...]:
    """Evaluate a polynomial map and its first partials.

    Parameters
    ----------
    coefficients : list
        Arrays, `C` components a row, rows in the order of `Powers.indices`: ``u^a v^b``.
    powers : Powers or int
        Of all components; a number is a degree.
    u, v : Float
        Parameters. If they are `TwoFloat`, so is the value; partials are coarse.

    Returns
    -------
    value, d_du, d_dv : lists of `C` arrays
    """
    powers = Powers.whole(powers) if isinstance(powers, int) else powers
    width = len(coefficients) // powers.size
    value: list[Any] = []
    d_du: list[Any] = []
    d_dv: list[Any] = []
    for c in range(width):
        s = su = sv = None
        row = iter(coefficients[c::width])
        for a in range(powers.p, -1, -1):
            r, rv = next(row), None
            for _ in range(powers.top(a)):
                rv = coarse(r) if rv is None else dr.fma(rv, coarse(v), coarse(r))
                r = fma(r, v, next(row))
            if s is not None:
                su = coarse(s) if su is None else dr.fma(su, coarse(u), coarse(s))
            s = r if s is None else fma(s, u, r)
            sv = rv if sv is None else dr.fma(sv, coarse(u), rv)
        value.append(s)
        d_du.append(su)
        d_dv.append(sv)
    return value, d_du, d_dv


def rolled_horner(
    rows: Any,
    first: Any,
    powers: tuple[Any, Any, Any],
    u: Any,
    v: Any,
    active: Any,
    pairs: bool = False,
) -> tuple[list[Any], ...]:
    """Do what `horner` does with nets in memory, of four components, and each of its own powers.

    The rows are read in the order in which Horner's method wants them: first those of ``u^p``, then
    those with ``u^(p-1)``, and so on. So all rays of a packet are in the same of these levels,
    and those whose nets are of low degree are the first to be done.

    Parameters
    ----------
    rows : Float
        Four numbers a row.
    first : UInt
        Number of the first row of a net.
    powers : three UInt
        Its `Powers`.
    u, v : Float
        Their type is that of all arithmetic; see `horner`.
    active : Bool
        Which are wanted.
    pairs : bool
        Whether rows are pairs of float32, as `upload_wide` has them.

    Returns
    -------
    value, d_du, d_dv : lists of four arrays
    """
    uint = dr.uint32_array_t(first)
    gather = gather_row_wide if pairs else gather_row
    p, q, n = powers
    room = n - p  # for powers of v beside u^p; one more on each level

    def converted(x: Any) -> Any:
        if isinstance(u, TwoFloat):
            return TwoFloat.of(x)
        return type(u)(coarse(x))

    def level(at: Any, row: Any, s: Any, su: Any, sv: Any) -> Any:
        def step(left: Any, row: Any, r: Any, rv: Any) -> Any:
            c = gather(rows, row, active)
            rv = [dr.fma(a, coarse(v), coarse(b)) for a, b in zip(rv, r)]
            r = [fma(a, v, converted(b)) for a, b in zip(r, c)]
            return left - 1, row + 1, r, rv

        _left, row, r, rv = dr.while_loop(
            (dr.minimum(at + room, q) + 1, row, four_zeros(u), four_zeros(coarse(u))),
            cond=lambda left, *_: active & (left != 0),
            body=step,
            labels=("left", "row", "r", "rv"),
            label="bezier row",
        )
        su = [dr.fma(a, coarse(u), coarse(b)) for a, b in zip(su, s)]
        s = [fma(a, u, b) for a, b in zip(s, r)]
        sv = [dr.fma(a, coarse(u), b) for a, b in zip(sv, rv)]
        return at + 1, row, s, su, sv

    _at, _row, s, su, sv = dr.while_loop(
        (uint(0), first, four_zeros(u), four_zeros(coarse(u)), four_zeros(coarse(u))),
        cond=lambda at, *_: active & (at <= p),
        body=level,
        labels=("level", "row", "s", "su", "sv"),
        label="bezier level",
    )
    return s, su, sv


def graph_point(
    p: list[Any], pu: list[Any], pv: list[Any], u: Any, v: Any
) -> tuple[tuple[Any, ...], tuple[Any, ...], tuple[Any, ...]]:
    """Return a point of a graph leaf in its chart from the values of its net, and partials.

    The identity is split off x, y and the weight, which is one where it is not stored.

    Parameters
    ----------
    p, pu, pv : lists of three or four numbers
        As from `horner`.
    u, v : Float

    Returns
    -------
    point, d_du, d_dv : three numbers each
    """
    x, y, z = u + p[0], v + p[1], p[2]
    xu, xv, yu, yv, zu, zv = 1.0 + pu[0], pv[0], pu[1], 1.0 + pv[1], pu[2], pv[2]
    if len(p) == 4:
        inv = reciprocal(1.0 + p[3])
        x, y, z = x * inv, y * inv, z * inv
        cx, cy, cz, inv = coarse(x), coarse(y), coarse(z), coarse(inv)
        xu, xv = (xu - cx * pu[3]) * inv, (xv - cx * pv[3]) * inv
        yu, yv = (yu - cy * pu[3]) * inv, (yv - cy * pv[3]) * inv
        zu, zv = (zu - cz * pu[3]) * inv, (zv - cz * pv[3]) * inv
    return (x, y, z), (xu, yu, zu), (xv, yv, zv)


def horner_value(coefficients: list[Any], n: int, u: Any, v: Any) -> list[Any]:
    """Evaluate the values only; see `horner`."""
    width = len(coefficients) // bernstein.size(n)
    value = []
    for c in range(width):
        s = None
        for i in range(n, -1, -1):
            r = coefficients[bernstein.row(n, i, n - i) * width + c]
            for j in range(n - i - 1, -1, -1):
                r = dr.fma(r, v, coefficients[bernstein.row(n, i, j) * width + c])
            s = r if s is None else dr.fma(s, u, r)
        value.append(s)
    return value
