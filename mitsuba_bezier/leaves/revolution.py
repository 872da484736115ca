"""Leaves of even aspheres: bounds of the sag, in cells of the squared distance from the axis.

In units of the aperture's radius an asphere is the graph of ``z = f(x^2 + y^2)`` over the unit
disk. The interval of ``s = x^2 + y^2`` is cut into cells by the leading bits of a float32 number,
the *grade* ``1 - g s``. With g the bend ``(1 + k) c^2`` of the conic, cells shrink where its root
``sqrt(1 - g s)`` has its end, and where that is outside of the interval cells are equal. So in each
of them f is close to a polynomial of degree four, and the kernel finds its cell without a search.

Bounds are proved in float64. The conic's part has the derivatives

    ``q^(n)(s) = c / 2 (1/2) (3/2) ... (n - 3/2) g^(n-1) (1 - g s)^(1/2 - n)``,

each monotone in s, so that their extremes are at the ends of a cell. The polynomial is expanded
about the middle of the cell; all that is left out is bounded by its absolute values. Cells count
as `OVERLAP` wider than they are, for what the kernel rounds.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import comb, factorial

import numpy as np

from ..geometry.aspheres import EvenAsphere
from .records import RevolutionLeaves

__all__ = ["MARGIN", "OVERLAP", "Profile", "asphere_box", "make_profile", "revolution_leaf"]

#: Cells cover s up to 1 + this: a point that the rim's tolerance lets count has bounds.
MARGIN = 2e-5
#: By how much, in s, bounds hold beyond a cell: roundings of the point, and the step out of it.
OVERLAP = 4e-6
#: Degree of the polynomials.
_DEGREE = 4
#: Bits of the mantissa that number the cells of one octave of the grade, at least and at most.
_BITS = range(3, 11)
#: The polynomials are as good as this ...
_REMAINDER = 1e-8
#: ... and the second derivative of f changes in a cell by this part of its own size, and this of
#: the largest there is.
_CHANGE, _CHANGE_MORE = 0.25, 0.1


@dataclass(frozen=True)
class Profile:
    """The sag of an asphere in units of its aperture's radius, with bounds.

    Attributes
    ----------
    surface : EvenAsphere
        With aperture 1.
    grading : float
        g, a float32 number.
    bits : int
        Of the mantissa of the grade that number the cells.
    first : int
        The bits of the first cell.
    cells : ndarray
        ``(C, 8)`` float32: the polynomial in s about the middle of the cell, from the constant on,
        the least and the largest second derivative, and how far f is from the polynomial.
    low, high : float
        Bounds of z.
    """

    surface: EvenAsphere
    grading: float
    bits: int
    first: int
    cells: np.ndarray
    low: float
    high: float


def make_profile(surface: EvenAsphere) -> Profile:
    """Return the sag of an asphere with its bounds, in units of its aperture."""
    unit = surface.normalised()
    # elsewhere the root's end is twice as far away as the rim, at least
    grading = float(np.float32(unit.bend if abs(unit.bend) > 0.5 else 0.5))
    for bits in _BITS:
        first, table, ends = _cells(unit, grading, bits)
        change = table[:, 6] - table[:, 5]
        size = np.abs(table[:, 5:7]).max(axis=1)
        allowed = _CHANGE * size + _CHANGE_MORE * (1 + size.max())
        if (table[:, 7] <= _REMAINDER).all() and (change <= allowed).all():
            break
    used = ends[:, 1] > unit.inner**2
    half = (ends[:, 1] - ends[:, 0]) / 2
    # |f - c_0| on a cell
    reach = table[:, 7] + sum(np.abs(table[:, n]) * half**n for n in range(1, _DEGREE + 1))
    low, high = (table[:, 0] - reach)[used].min(), (table[:, 0] + reach)[used].max()
    return Profile(unit, grading, bits, first, table.astype(np.float32), float(low), float(high))


def _cells(unit: EvenAsphere, grading: float, bits: int) -> tuple[int, np.ndarray, np.ndarray]:
    """Return the bits of the first cell, the cells ``(C, 8)``, and their ends in s."""
    shift = 23 - bits
    ends = np.sort(np.array([1.0, 1.0 - grading * (1.0 + MARGIN)]))
    code = ends.astype(np.float32).view(np.uint32) >> np.uint32(shift)
    number = np.arange(int(code[0]), int(code[1]) + 1, dtype=np.uint32)
    grade = [((number + np.uint32(k)) << np.uint32(shift)).view(np.float32) for k in (0, 1)]
    s = np.sort([(1.0 - g.astype(float)) / grading for g in grade], axis=0)
    return int(code[0]), _bounds(unit, s[0], s[1]), s.T


def _bounds(unit: EvenAsphere, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return polynomials and bounds of cells from `low` to `high`."""
    middle = (low + high) / 2
    half = (high - low) / 2 + OVERLAP
    # the conic's root exists a little beyond the rim only; a cell that reaches further counts
    # up to there, where no ray is looked for
    ends = np.stack([middle - half, middle + half])
    if unit.bend > 0:
        ends[1] = np.minimum(ends[1], np.maximum(1 + 2 * MARGIN, middle))
    c, g = unit.curvature, unit.bend
    root = np.sqrt(1 - g * np.stack([middle, *ends]))

    def conic(n: int) -> np.ndarray:
        """Return derivative n of the conic's part, in the middle and at both ends."""
        if n == 0:
            return c * np.stack([middle, *ends]) / (1 + root)
        rising = np.prod([k - 0.5 for k in range(1, n)]) if n > 1 else 1.0
        return c / 2 * rising * g ** (n - 1) * root ** (1 - 2 * n)

    # the polynomial about the middle, which rounding moves by 1e-15 of its terms
    a = (0.0, *unit.coefficients)
    shifted = [
        sum(
            (comb(i, n) * a[i] * middle ** (i - n) for i in range(n, len(a)) if a[i]),
            np.zeros_like(middle),
        )
        for n in range(max(len(a), _DEGREE + 1))
    ]
    sizes = sum((abs(x) for x in a), 0.0) + abs(c)
    out = np.zeros((len(middle), 8))
    for n in range(_DEGREE + 1):
        out[:, n] = conic(n)[0] / factorial(n) + shifted[n]
    top = _DEGREE + 1
    out[:, 7] = (
        np.abs(conic(top)).max(axis=0) / factorial(top) * half**top
        + sum(
            (np.abs(shifted[n]) * half**n for n in range(top, len(shifted))),
            np.zeros_like(middle),
        )
        + 1e-15 * sizes
    )
    second = np.sort(conic(2)[1:], axis=0)
    more = sum(
        (n * (n - 1) * np.abs(shifted[n]) * half ** (n - 2) for n in range(3, len(shifted))),
        1e-14 * sizes + np.zeros_like(middle),
    )
    bounds = second + 2 * shifted[2]
    more = more + 1e-6 * np.abs(bounds).max(axis=0)  # float32 rounds them
    out[:, 5], out[:, 6] = bounds[0] - more, bounds[1] + more
    return out


def revolution_leaf(surface: EvenAsphere, matrix: np.ndarray) -> RevolutionLeaves:
    """Return the leaf of an asphere under an affine map ``(4, 4)``, of patch 0."""
    profile = make_profile(surface)
    return RevolutionLeaves.zeros(
        1,
        domain=np.eye(3)[None],
        shift=matrix[None, :3, 3],
        axes=np.linalg.inv(matrix[:3, :3] * surface.aperture)[None],
        profile=np.array([profile], dtype=object),
        box=asphere_box(profile, surface.aperture, matrix)[None],
    )


def asphere_box(profile: Profile, aperture: float, matrix: np.ndarray) -> np.ndarray:
    """Return the box ``(2, 3)`` of an asphere under an affine map, a little wider."""
    x, y, z = aperture * matrix[:3, :3].T
    heights = np.sort([z * profile.low, z * profile.high], axis=0)
    across = np.hypot(x, y)
    wider = 1e-6 * (np.abs(x) + np.abs(y) + np.abs(z) * max(1.0, profile.high, -profile.low))
    return np.stack([heights[0] - across - wider, heights[1] + across + wider]) + matrix[:3, 3]
