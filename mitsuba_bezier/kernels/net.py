"""Evaluation of a net from monomial coefficients, with partial derivatives."""

from __future__ import annotations

from typing import Any

import drjit as dr

from ..geometry import bernstein

__all__ = ["horner", "horner_value"]


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
