"""Parameters of a hit on a patch that is bounded by plane sections of its quadric."""

from __future__ import annotations

from typing import Any

import drjit as dr

from ..geometry import bernstein
from .arrays import Types, gather_packets
from .net import horner
from .quadric_records import MEMBER
from .structure import Structure

__all__ = ["section_parameters"]

#: Newton's method ends after a step below this: the error is then its square.
LAST_STEP = 1e-4
#: ... or after so many steps; patches that the builder accepts need at most eight.
MAX_STEPS = 12


def section_parameters(
    s: Structure, ty: Types, leaf: Any, x: Any, y: Any, active: Any
) -> tuple[Any, Any]:
    """Return the parameters at which ``P / Q`` is ``x + i y``, less the middle ``(1 + i) / 2``.

    With the complex polynomials of `geometry.section_leaves`, ``P - (x + i y) Q = 0`` are two
    real equations of the degree of `P` and `Q`, which is at most half of the patch's.
    """
    degree = _degree(s)
    net = gather_packets(s.planes, leaf - s.first_group, bernstein.size(degree) * 4, active)
    a, b = x - 0.5, y - 0.5  # the coefficients are small, so are their roundings
    equations: list[Any] = []
    for k in range(bernstein.size(degree)):
        p_re, p_im, q_re, q_im = net[4 * k : 4 * k + 4]
        equations.append(dr.fma(-a, q_re, dr.fma(b, q_im, p_re)))
        equations.append(dr.fma(-a, q_im, dr.fma(-b, q_re, p_im)))

    def body(run, step, u, v):
        (f, g), (fu, gu), (fv, gv) = horner(equations, degree, u, v)
        inv = dr.rcp(dr.fma(fu, gv, -fv * gu))
        du, dv = dr.fma(fv, g, -gv * f) * inv, dr.fma(gu, f, -fu * g) * inv
        size = dr.maximum(dr.abs(du), dr.abs(dv))
        usable = size < 1.0  # false for NaN
        u, v = dr.select(usable, u + du, u), dr.select(usable, v + dv, v)
        step = step + 1
        run = run & usable & (size > LAST_STEP) & (step < MAX_STEPS)
        return run, step, u, v

    _run, _step, u, v = dr.while_loop(
        (active, ty.UInt(0), dr.zeros(ty.Float), dr.zeros(ty.Float)),
        cond=lambda *st: st[0],
        body=body,
        labels=("run", "step", "u", "v"),
        label="bezier section",
    )
    return dr.select(active, u + 1 / 3, x), dr.select(active, v + 1 / 3, y)


def _degree(s: Structure) -> int:
    """Return the degree of the polynomials, of which each leaf has a record."""
    floats = dr.width(s.planes) * MEMBER // dr.width(s.rows)
    degree = 1
    while bernstein.size(degree + 1) * 4 <= floats:
        degree += 1
    return degree
