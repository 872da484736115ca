"""Find parameters of points of patches on quadrics by Newton's method in the plane.

Those of a hit on a patch that is bounded by plane sections of its quadric, and those that tell
whether a point of the quadric is on a patch at all.
"""

from __future__ import annotations

from typing import Any

import drjit as dr

from ...geometry import bernstein
from ...leaves.closed_form import newton as plane_inverse
from ..arrays import Types, dot3, gather_packets, reciprocal
from ..net import horner, horner_value
from ..quadric_records import INVERSE
from ..structure import Structure

__all__ = ["inverted_parameters", "section_parameters", "shared_rows"]

#: Newton's method ends after a step below this: the error is then its square.
LAST_STEP = 1e-4
#: ... or after so many steps; patches that the builder accepts need at most eight.
MAX_STEPS = 12
#: ... or sixteen, next to a pole, where it tells whether a point is on a patch.
MOST_STEPS = 24
#: Where the map is singular no step is small; there it ends at an error in the plane that is
#: rounding: of coordinates near one, and of sums of a dozen terms.
AT_HAND = 5e-7
#: Rounding of the form that tells which of two points with the same coordinates is meant; on a
#: patch it is at most one.
SIDE = 1e-6


def section_parameters(
    s: Structure, ty: Types, leaf: Any, x: Any, y: Any, active: Any
) -> tuple[Any, Any]:
    """Return the parameters at which ``P / Q`` is ``x + i y``, less the middle ``(1 + i) / 2``.

    With the complex polynomials of `leaves.closed_form.plane_sections`, ``P - (x + i y) Q = 0``
    are two real equations of the degree of `P` and `Q`, which is at most half of the patch's.
    """
    # the coefficients are small from the middle on, so are their roundings
    equations, degree = _equations(s, leaf, x - 0.5, y - 0.5, active)

    def body(run: Any, step: Any, u: Any, v: Any) -> Any:
        du, dv, _det = _newton(*horner(equations, degree, u, v))
        size = dr.maximum(dr.abs(du), dr.abs(dv))
        usable = size < 1.0  # false for NaN
        u, v = dr.select(usable, u + du, u), dr.select(usable, v + dv, v)
        step = step + 1
        run = run & usable & (size > LAST_STEP) & (step < MAX_STEPS)
        return run, step, u, v

    # the first step, from the middle, where all powers are zero
    rows = (bernstein.row(degree, *powers) for powers in ((0, 0), (1, 0), (0, 1)))
    u, v, _det = _newton(*(equations[2 * k : 2 * k + 2] for k in rows))
    _run, _step, u, v = dr.while_loop(
        (active, ty.UInt(1), u, v),
        cond=lambda *st: st[0],
        body=body,
        labels=("run", "step", "u", "v"),
        label="bezier section",
    )
    return dr.select(active, u + 1 / 3, x), dr.select(active, v + 1 / 3, y)


def _newton(value: list[Any], by_u: list[Any], by_v: list[Any]) -> tuple[Any, Any, Any]:
    """Return the step to where the linear parts of two equations vanish, and the determinant."""
    (f, g), (fu, gu), (fv, gv) = value, by_u, by_v
    det = dr.fma(fu, gv, -fv * gu)
    inv = reciprocal(det)
    return dr.fma(fv, g, -gv * f) * inv, dr.fma(gu, f, -fu * g) * inv, det


def inverted_parameters(
    s: Structure, ty: Types, leaf: Any, p: list[Any], tolerance: Any, active: Any
) -> tuple[Any, Any, Any]:
    """Find out whether a point of a quadric is on a patch; see `leaves.closed_form.inverted`.

    Parameters
    ----------
    p : three Float64
        The point, from the group's origin.
    tolerance : Float
        How far outside of the patch, in the plane, a point may be.

    Returns
    -------
    inside : Bool
    u, v : Float
    """
    m = INVERSE.gather(s.inverses, dr.select(active, leaf - s.first_group, 0), active)
    x, y, rest, side = (ty.Float(dot3(row, p) + row[3]) for row in (*m.rows, m.fourth))
    scale = reciprocal(x + y + rest)
    a, b = dr.fma(x, scale, -0.5), dr.fma(y, scale, -0.5)
    equations, degree = _equations(s, leaf, a, b, active)

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
        du, dv, det = _newton(*evaluated)
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


def _equations(s: Structure, leaf: Any, a: Any, b: Any, active: Any) -> tuple[list[Any], int]:
    """Return the coefficients of the real and imaginary part of ``P - (a + i b) Q``."""
    degree = s.polynomial_degree
    net = (
        s.shared_section[len(shared_rows(s)) * 4 :]
        if s.shared_section
        else gather_packets(s.polynomials, leaf - s.first_group, bernstein.size(degree) * 4, active)
    )
    equations: list[Any] = []
    for k in range(bernstein.size(degree)):
        p_re, p_im, q_re, q_im = net[4 * k : 4 * k + 4]
        equations.append(dr.fma(-a, q_re, dr.fma(b, q_im, p_re)))
        equations.append(dr.fma(-a, q_im, dr.fma(-b, q_re, p_im)))
    return equations, degree


def shared_rows(s: Structure) -> list[list[Any]]:
    """Return the rows of `Structure.shared_section`."""
    assert s.shared_section is not None
    return [s.shared_section[4 * r : 4 * r + 4] for r in range(3)]
