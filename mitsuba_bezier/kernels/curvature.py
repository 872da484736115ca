"""Evaluation of patches from their Bernstein nets, with first and second partials."""

from __future__ import annotations

from typing import Any

import drjit as dr

from ..geometry import bernstein
from .arrays import gather_packets, reciprocal
from .patch import affine_partials, bernstein_basis
from .two_float import TwoFloat, coarse, fma, full

__all__ = ["affine_second_partials", "evaluate_second", "second_of_net"]

#: Second differences by uu, uv, vv of the points q_200, q_110, q_101, q_020, q_011, q_002.
_SECOND = ((1, 0, -2, 0, 0, 1), (0, 1, -1, 0, -1, 1), (0, 0, 0, 1, -2, 1))


def evaluate_second(
    buffer: Any, n: int, patch: Any, u: Any, v: Any, active: Any = True
) -> list[list[Any]]:
    """Evaluate homogeneous points, first and second partials.

    From the six points ``q`` of the last de Casteljau step but one: the second partials are
    ``n (n-1)`` times their second differences. From the three points ``c`` of the last one the
    value is ``u c_0 + v c_1 + w c_2``, the first partials are ``n (c_0 - c_2)`` and
    ``n (c_1 - c_2)``. Bernstein form: convex combinations, no cancellation.

    Parameters
    ----------
    buffer : Float
        Nets, `kernels.patch.padded_width` floats each.
    n : int
        Degree.
    patch : UInt
    u, v : Float
        Their type is that of all arithmetic: with `Float64` only the net is rounded. With
        `TwoFloat` so are value and first partials, second ones are coarse.
    active : Bool

    Returns
    -------
    value, d_du, d_dv, d_duu, d_duv, d_dvv : lists of 4 Float
    """
    return second_of_net(gather_packets(buffer, patch, bernstein.size(n) * 4, active), n, u, v)


def second_of_net(net: list[Any], n: int, u: Any, v: Any) -> list[list[Any]]:
    """Evaluate nets whose numbers are at hand; see `evaluate_second`."""
    pairs = isinstance(u, TwoFloat)
    number = type(coarse(u))
    net = [TwoFloat(x) if pairs else number(x) for x in net]
    w = 1.0 - u - v
    if n == 1:
        rows = [[net[4 * r + a] for a in range(4)] for r in range(3)]
        zero = [dr.zeros(number) for _ in range(4)]
        seconds = [zero, zero, zero]
    else:
        basis = bernstein_basis(n - 2, u, v, w)
        q: list[list[Any]] = [[None] * 4 for _ in range(6)]
        for b, (i, j, _k) in zip(basis, bernstein.multi_indices(n - 2).tolist()):
            for point, (di, dj, _dk) in zip(q, bernstein.multi_indices(2).tolist()):
                r = bernstein.row(n, i + di, j + dj)
                for a in range(4):
                    term = net[4 * r + a]
                    point[a] = term * b if point[a] is None else fma(term, b, point[a])
        rows = [
            [fma(u, q[i][a], fma(v, q[j][a], w * q[k][a])) for a in range(4)]
            for i, j, k in ((0, 1, 2), (1, 3, 4), (2, 4, 5))
        ]
        seconds = [
            [
                n * (n - 1) * sum(c * coarse(q[i][a]) for i, c in enumerate(row) if c)
                for a in range(4)
            ]
            for row in _SECOND
        ]
    c0, c1, c2 = rows
    value = [fma(u, c0[a], fma(v, c1[a], w * c2[a])) for a in range(4)]
    d_du, d_dv = ([n * (c[a] - c2[a]) for a in range(4)] for c in (c0, c1))
    return [*([full(x) for x in h] for h in (value, d_du, d_dv)), *seconds]


def affine_second_partials(h: list[list[Any]]) -> tuple[list[Any], ...]:
    """Return the affine point and its partials p, pu, pv, puu, puv, pvv (quotient rule).

    Parameters
    ----------
    h : list
        What `evaluate_second` returns.
    """
    inv = reciprocal(h[0][3])
    p, pu, pv = affine_partials(*h[:3])
    wu, wv = h[1][3], h[2][3]

    def second(d: list[Any], pa: list[Any], pb: list[Any], wa: Any, wb: Any) -> list[Any]:
        return [(d[a] - p[a] * d[3] - pa[a] * wb - pb[a] * wa) * inv for a in range(3)]

    return (
        p,
        pu,
        pv,
        second(h[3], pu, pu, wu, wu),
        second(h[4], pu, pv, wu, wv),
        second(h[5], pv, pv, wv, wv),
    )
