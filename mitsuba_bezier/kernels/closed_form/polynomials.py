"""Write a point of a quadric as two equations in the plane, and do Newton steps to their roots."""

from __future__ import annotations

from typing import Any

import drjit as dr

from ...geometry import bernstein
from ..arrays import gather_packets, reciprocal
from ..structure import Structure

__all__ = ["equations_of", "newton_step", "shared_rows"]


def newton_step(value: list[Any], by_u: list[Any], by_v: list[Any]) -> tuple[Any, Any, Any]:
    """Return the step to where the linear parts of two equations vanish, and the determinant."""
    (f, g), (fu, gu), (fv, gv) = value, by_u, by_v
    det = dr.fma(fu, gv, -fv * gu)
    inv = reciprocal(det)
    return dr.fma(fv, g, -gv * f) * inv, dr.fma(gu, f, -fu * g) * inv, det


def equations_of(s: Structure, leaf: Any, a: Any, b: Any, active: Any) -> tuple[list[Any], int]:
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
