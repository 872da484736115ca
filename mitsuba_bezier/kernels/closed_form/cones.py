"""Find the parameters of points on sectors of cones; see `leaves.closed_form.sectors`."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import drjit as dr

from ..arrays import Types, dot3
from ..query import Query

__all__ = ["cone_parameters", "from_corner"]


def cone_parameters(
    ty: Types, m: SimpleNamespace, p: list[Any], bary: list[Any], uv: tuple[Any, Any]
) -> tuple[Any, Any]:
    """Return the first two parameters from the corner on that is the apex; `uv` on other leaves.

    Parameters
    ----------
    ty : Types
    m : record
        `INVERSE` of the leaf.
    p : three wide numbers
        The point, from the group's origin.
    bary : three Float
        What the rows are there.
    uv : two Float
    """
    b0, b1, b2 = bary
    # all that is no sector has a fourth row of zeros
    last = ty.narrow(dot3(m.fourth, p) + m.fourth[3])
    is_cone = last != 0.0
    # through the larger: where a coordinate is small its root is not well known
    first = b0 >= b2
    large = dr.maximum(dr.select(first, b0, b2), 1e-30)
    one = dr.sqrt(large / last)
    other = one * b1 / (2.0 * large)
    u = dr.select(is_cone, dr.select(first, one, other), uv[0])
    v = dr.select(is_cone, dr.select(first, other, one), uv[1])
    return u, v


def from_corner(
    _query: Query, domain: SimpleNamespace | None, _leaf: Any, u: Any, v: Any, _active: Any
) -> tuple[Any, Any]:
    """Return the first two of parameters that are counted from the corner of the apex on."""
    assert domain is not None
    w = 1.0 - u - v
    first, second = domain.corner == 0, domain.corner == 1
    return (
        dr.select(first, w, dr.select(second, v, u)),
        dr.select(first, u, dr.select(second, w, v)),
    )
