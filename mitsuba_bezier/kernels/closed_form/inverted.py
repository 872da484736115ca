"""Find out by its parameters whether a point of a quadric is on a patch."""

from __future__ import annotations

from typing import Any

import drjit as dr

from ...leaves.closed_form import newton as plane_inverse
from ..arrays import dot3, reciprocal
from ..net import horner, horner_value
from ..quadric_records import INVERSE
from ..query import Query
from .polynomials import equations_of, newton_step

__all__ = ["inverted_parameters"]

#: Newton's method ends after this many steps; next to a pole the builder accepts up to sixteen.
MOST_STEPS = 24
#: Where the map is singular no step is small; there it ends at an error in the plane that is
#: rounding: of coordinates near one, and of sums of a dozen terms.
AT_HAND = 5e-7
#: Rounding of the form that tells which of two points with the same coordinates is meant; on a
#: patch it is at most one.
SIDE = 1e-6


def inverted_parameters(
    query: Query, leaf: Any, p: list[Any], tolerance: Any, active: Any
) -> tuple[Any, Any, Any]:
    """Find out whether a point of a quadric is on a patch; see `leaves.closed_form.inverted`.

    Parameters
    ----------
    p : three wide numbers
        The point, from the group's origin.
    tolerance : Float
        How far outside of the patch, in the plane, a point may be.

    Returns
    -------
    inside : Bool
    u, v : Float
    """
    s, ty = query.s, query.ty
    m = INVERSE.gather(s.inverses, dr.select(active, leaf - s.first_group, 0), active)
    x, y, rest, side = (ty.narrow(dot3(row, p) + row[3]) for row in (*m.rows, m.fourth))
    scale = reciprocal(x + y + rest)
    a, b = dr.fma(x, scale, -0.5), dr.fma(y, scale, -0.5)
    equations, degree = equations_of(s, leaf, a, b, active)

    start = [dr.maximum(plane_inverse.LEAST_START, z) for z in (a + 0.5, b + 0.5, -a - b)]
    scale = reciprocal(start[0] + start[1] + start[2])
    u, v = dr.fma(start[0], scale, -1 / 3), dr.fma(start[1], scale, -1 / 3)

    def body(
        run: Any,
        step: Any,
        u: Any,
        v: Any,
        before: Any,
        back_u: Any,
        back_v: Any,
        by_u: Any,
        by_v: Any,
        by_both: Any,
    ) -> Any:
        (f, g), (fu, gu), (fv, gv) = evaluated = horner(equations, degree, u, v)
        du, dv, det = newton_step(*evaluated)
        size = dr.maximum(dr.abs(du), dr.abs(dv))
        # what parameters change in the plane
        by_u, by_v = dr.abs(fu) + dr.abs(gu), dr.abs(fv) + dr.abs(gv)
        by_both = dr.abs(fu - fv) + dr.abs(gu - gv)
        # and the plane in them, times the determinant
        area, known = dr.abs(det), dr.maximum(by_u, by_v)
        # the equations are those of the plane times Q, which is one in the middle
        at_hand = dr.maximum(dr.abs(f), dr.abs(g)) < AT_HAND
        small = size * size * (area + known) < plane_inverse.LAST_STEP**2 * area  # false for NaN
        too_far = (det <= plane_inverse.LEAST_DROP * before) & ~at_hand
        factor = dr.select(at_hand & ~small, 0.0, dr.minimum(1.0, reciprocal(size)))
        du = dr.select(too_far, -back_u, dr.select(factor > 0.0, factor * du, 0.0))
        dv = dr.select(too_far, -back_v, dr.select(factor > 0.0, factor * dv, 0.0))
        back_u = dr.select(too_far, back_u + back_u, plane_inverse.BACK * du)
        back_v = dr.select(too_far, back_v + back_v, plane_inverse.BACK * dv)
        before = dr.select(too_far, before, det)
        step = step + 1
        run = run & (too_far | ~(small | at_hand)) & (step < MOST_STEPS)
        return run, step, u + du, v + dv, before, back_u, back_v, by_u, by_v, by_both

    zero = dr.zeros(ty.Float)
    _run, _step, u, v, *_rest, by_u, by_v, by_both = dr.while_loop(
        (active, ty.UInt(0), u, v, zero, zero, zero, zero, zero, zero),
        cond=lambda *st: st[0],
        body=body,
        labels=(
            *("run", "step", "u", "v", "before", "back_u", "back_v"),
            *("by_u", "by_v", "by_both"),
        ),
        label="bezier inversion",
    )

    # What counts is how far the point is from one of the patch. Parameters beyond an edge are taken
    # back by way of the one that changes the point least: at a pole they are not known, but nor do
    # they matter
    u, v = u + 1 / 3, v + 1 / 3
    below = dr.minimum(u, 0.0)
    v = dr.select(by_u > by_both, v + below, v)
    u = dr.maximum(u, 0.0)
    below = dr.minimum(v, 0.0)
    u = dr.select(by_v > by_both, u + below, u)
    v = dr.maximum(v, 0.0)
    over = dr.maximum(u + v - 1.0, 0.0)
    u, v = dr.select(by_u < by_v, u - over, u), dr.select(by_u < by_v, v, v - over)
    u, v = dr.clip(u, 0.0, 1.0), dr.clip(v, 0.0, 1.0)
    f, g = horner_value(equations, degree, u - 1 / 3, v - 1 / 3)
    inside = active & (dr.maximum(dr.abs(f), dr.abs(g)) <= tolerance) & (side >= -SIDE)
    return inside, u, v
