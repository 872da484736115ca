"""Evaluation of a net from monomial coefficients, with partial derivatives."""

from __future__ import annotations

from typing import Any

import drjit as dr

from ..geometry import bernstein
from .arrays import reciprocal

__all__ = ["graph_point", "horner", "horner_value"]


def horner(coefficients: list[Any], n: int, u: Any, v: Any) -> tuple[list[Any], ...]:
    """Evaluate a polynomial map and its first partials.

    Parameters
    ----------
    coefficients : list
        ``K * C`` arrays, rows in net order (`bernstein.multi_indices`: ``u^i v^j``), `C`
        components a row.
    n : int
        Degree.
    u, v : Float
        Parameters.

    Returns
    -------
    value, d_du, d_dv : lists of `C` arrays
    """
    width = len(coefficients) // bernstein.size(n)
    value: list[Any] = []
    d_du: list[Any] = []
    d_dv: list[Any] = []
    for c in range(width):
        s = su = sv = None
        for i in range(n, -1, -1):
            r = coefficients[bernstein.row(n, i, n - i) * width + c]
            rv = None
            for j in range(n - i - 1, -1, -1):
                rv = r if rv is None else dr.fma(rv, v, r)
                r = dr.fma(r, v, coefficients[bernstein.row(n, i, j) * width + c])
            if s is None:
                s = r
                continue
            su = s if su is None else dr.fma(su, u, s)
            s = dr.fma(s, u, r)
            sv = rv if sv is None else dr.fma(sv, u, rv)
        value.append(s)
        d_du.append(su)
        d_dv.append(sv)
    return value, d_du, d_dv


def graph_point(
    net: list[Any], n: int, u: Any, v: Any
) -> tuple[tuple[Any, ...], tuple[Any, ...], tuple[Any, ...]]:
    """Evaluate the net of a graph leaf in its chart.

    The identity is split off x, y and the weight, which is one where it is not stored.

    Returns
    -------
    point, d_du, d_dv : three numbers each
    """
    p, pu, pv = horner(net, n, u, v)
    x, y, z = u + p[0], v + p[1], p[2]
    xu, xv, yu, yv, zu, zv = 1.0 + pu[0], pv[0], pu[1], 1.0 + pv[1], pu[2], pv[2]
    if len(p) == 4:
        inv = reciprocal(1.0 + p[3])
        x, y, z = x * inv, y * inv, z * inv
        xu, xv = (xu - x * pu[3]) * inv, (xv - x * pv[3]) * inv
        yu, yv = (yu - y * pu[3]) * inv, (yv - y * pv[3]) * inv
        zu, zv = (zu - z * pu[3]) * inv, (zv - z * pv[3]) * inv
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
