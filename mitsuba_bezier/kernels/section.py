"""Parameters of a hit on a patch that is bounded by plane sections of its quadric."""

from __future__ import annotations

from typing import Any

import drjit as dr

from .arrays import Types, gather_packets
from .net import horner
from .structure import Structure

__all__ = ["section_parameters"]

#: Newton's method ends after a step below this: the error is then its square.
LAST_STEP = 1e-4
#: ... or after so many steps; patches that the builder accepts need three to five.
MAX_STEPS = 12


def section_parameters(
    s: Structure, ty: Types, leaf: Any, u: Any, v: Any, active: Any
) -> tuple[Any, Any]:
    """Return the parameters at which the planes' values have the ratios ``u : v : 1 - u - v``.

    With ``A_j(u, v)`` the value of plane `j` on the patch (times its weight) and ``S`` their sum,
    solve ``A_0 = u* S, A_1 = v* S``.
    """
    n = s.degree
    net = gather_packets(s.planes, leaf - s.first_group, (n + 1) * (n + 2) * 2, active)

    def body(run, step, u, v, goal_u, goal_v):
        a, au, av = horner(net, n, u, v)
        total, total_u, total_v = (x[0] + x[1] + x[2] for x in (a, au, av))
        f0, f1 = dr.fma(-goal_u, total, a[0]), dr.fma(-goal_v, total, a[1])
        f0u, f0v = dr.fma(-goal_u, total_u, au[0]), dr.fma(-goal_u, total_v, av[0])
        f1u, f1v = dr.fma(-goal_v, total_u, au[1]), dr.fma(-goal_v, total_v, av[1])
        inv = dr.rcp(dr.fma(f0u, f1v, -f0v * f1u))
        du, dv = dr.fma(f0v, f1, -f1v * f0) * inv, dr.fma(f1u, f0, -f0u * f1) * inv
        size = dr.maximum(dr.abs(du), dr.abs(dv))
        usable = size < 0.5  # false for NaN
        u, v = dr.select(usable, u + du, u), dr.select(usable, v + dv, v)
        step = step + 1
        run = run & usable & (size > LAST_STEP) & (step < MAX_STEPS)
        return run, step, u, v, goal_u, goal_v

    _run, _step, u, v, _goal_u, _goal_v = dr.while_loop(
        (active, ty.UInt(0), u, v, u, v),
        cond=lambda *st: st[0],
        body=body,
        labels=("run", "step", "u", "v", "goal_u", "goal_v"),
        label="bezier section",
    )
    return u, v
