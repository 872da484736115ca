"""Find the parameters of a hit on a patch that is bounded by plane sections of its quadric."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import drjit as dr

from ...geometry import bernstein
from ..net import horner
from ..query import Query
from .polynomials import equations_of, newton_step

__all__ = ["section_parameters"]

#: Newton's method ends after a step below this: the error is then its square.
LAST_STEP = 1e-4
#: ... or after this many steps; patches that the builder accepts need at most eight.
MAX_STEPS = 12


def section_parameters(
    query: Query, _domain: SimpleNamespace | None, leaf: Any, x: Any, y: Any, active: Any
) -> tuple[Any, Any]:
    """Return the parameters at which ``P / Q`` is ``x + i y``, less the middle ``(1 + i) / 2``.

    With the complex polynomials of `leaves.closed_form.plane_sections`, ``P - (x + i y) Q = 0``
    are two real equations of the degree of `P` and `Q`, which is at most half of the patch's.
    """
    # the coefficients are small from the middle on, so are their roundings
    equations, degree = equations_of(query.s, leaf, x - 0.5, y - 0.5, active)

    def body(run: Any, step: Any, u: Any, v: Any) -> Any:
        du, dv, _det = newton_step(*horner(equations, degree, u, v))
        size = dr.maximum(dr.abs(du), dr.abs(dv))
        usable = size < 1.0  # false for NaN
        u, v = dr.select(usable, u + du, u), dr.select(usable, v + dv, v)
        step = step + 1
        run = run & usable & (size > LAST_STEP) & (step < MAX_STEPS)
        return run, step, u, v

    # the first step, from the middle, where all powers are zero
    rows = (bernstein.row(degree, *powers) for powers in ((0, 0), (1, 0), (0, 1)))
    u, v, _det = newton_step(*(equations[2 * k : 2 * k + 2] for k in rows))
    _run, _step, u, v = dr.while_loop(
        (active, query.ty.UInt(1), u, v),
        cond=lambda *st: st[0],
        body=body,
        labels=("run", "step", "u", "v"),
        label="bezier section",
    )
    return dr.select(active, u + 1 / 3, x), dr.select(active, v + 1 / 3, y)
