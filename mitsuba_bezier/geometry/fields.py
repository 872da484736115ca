"""Fields on patches: numbers that are Bernstein polynomials of the parameters, or their quotients.

A field has a degree of its own. It is polynomial, whatever the weights of the patches, unless it
has weights: then its value is a quotient, as a point of a rational patch is.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import isqrt
from typing import Any

import numpy as np

from ..errors import GeometryError
from . import bernstein
from .triangles import BezierTriangles

__all__ = ["MAGNITUDE", "BezierField", "products", "warped"]

#: The component that stands for the length of the vector of all components.
MAGNITUDE = "magnitude"

#: Bounds of a range are found up to this part of the range, by at most so many splits.
_TIGHT, _SPLITS = 1e-7, 40
#: Pieces that are looked at together; polynomials have few where the largest value may be.
_PIECES = 200_000


class BezierField:
    """Values on the patches of a net, one Bernstein polynomial a patch and component.

    Parameters
    ----------
    name : str
        What it is called.
    ordinates : (P, K, C) array_like
        Bernstein ordinates of `C` components in net order; with `weights`, they are already
        multiplied by these. ``K = 1`` is a constant on each patch. NaN stands for patches without
        a value.
    weights : (P, K) array_like, optional
        Makes the field a quotient.
    unit : str
        What the numbers are counted in.

    Raises
    ------
    GeometryError
        If the shapes do not fit.
    """

    def __init__(self, name: str, ordinates: Any, weights: Any = None, unit: str = "") -> None:
        self.name, self.unit = name, unit
        self.ordinates = np.asarray(ordinates, dtype=np.float64)
        count = self.ordinates.shape[1] if self.ordinates.ndim == 3 else 0
        n = _degree(count)
        if n < 0 or self.ordinates.shape[2] < 1:
            raise GeometryError.expected(
                "ordinates",
                "shape (P, K, C) with K = (m+1)(m+2)/2 ordinates (1, 3, 6, 10, ...)",
                f"{self.ordinates.shape}",
            )
        self.degree = n
        self.weights = None if weights is None else np.asarray(weights, dtype=np.float64)
        if self.weights is not None and self.weights.shape != self.ordinates.shape[:2]:
            raise GeometryError.expected(
                "weights", f"shape {self.ordinates.shape[:2]}", f"{self.weights.shape}"
            )

    def __len__(self) -> int:
        """Return the number of patches."""
        return len(self.ordinates)

    def __repr__(self) -> str:
        kind = "" if self.weights is None else ", rational"
        unit = f" in {self.unit}" if self.unit else ""
        return (
            f"BezierField({self.name!r}{unit}: {len(self)} patches, degree {self.degree}, "
            f"{self.components} components{kind})"
        )

    @property
    def components(self) -> int:
        """The number of components."""
        return self.ordinates.shape[2]

    def __getitem__(self, index: Any) -> BezierField:
        """Return the field on some of the patches."""
        weights = None if self.weights is None else self.weights[index]
        return BezierField(self.name, self.ordinates[index], weights, self.unit)

    def missing(self) -> np.ndarray:
        """Return a mask of the patches on which it has no finite values, ``(P,)``."""
        good = np.isfinite(self.ordinates).all(axis=(1, 2))
        if self.weights is not None:
            good = good & np.isfinite(self.weights).all(axis=1)
        return ~np.asarray(good)

    def elevate(self, degree: int) -> BezierField:
        """Return the same field with ordinates of a higher degree."""
        ordinates, weights = self.ordinates, self.weights
        for n in range(self.degree, degree):
            ordinates = bernstein.elevated(ordinates, n)
            if weights is not None:
                weights = bernstein.elevated(weights[..., None], n)[..., 0]
        return BezierField(self.name, ordinates, weights, self.unit)

    def evaluate(self, patch: Any, uv: Any) -> np.ndarray:
        """Return values ``(N, C)`` on patches ``(N,)`` at parameters ``(N, 2)``."""
        basis = bernstein.basis(self.degree, np.asarray(uv, dtype=np.float64))
        patch = np.asarray(patch)
        value = np.einsum("nk,nkc->nc", basis, self.ordinates[patch])
        if self.weights is not None:
            value = value / np.einsum("nk,nk->n", basis, self.weights[patch])[:, None]
        return value

    def component(self, which: int | str | None = None) -> int | str:
        """Check the name or number of a component; None is the only one, or the magnitude.

        Raises
        ------
        GeometryError
            If the field has no such component.
        """
        if which is None:
            which = 0 if self.components == 1 else MAGNITUDE
        text = str(which).strip().lower()
        if text == MAGNITUDE:
            return MAGNITUDE
        letters = "xyz"[: self.components] if self.components <= 3 else ""
        if text in tuple(letters):
            return letters.index(text)
        if text.isdecimal() and len(text) < 10 and int(text) < self.components:
            return int(text)
        raise GeometryError.expected(
            "component",
            f"a number from 0 to {self.components - 1} or '{MAGNITUDE}', for field {self.name!r} "
            f"of {self.components} component{'s' * (self.components > 1)}",
            repr(which),
        )

    def range(self, component: int | str | None = None) -> tuple[float, float]:
        """Return the least and the largest value on the patches.

        Ordinates bound the values, and bounds of pieces are as good as one likes: only pieces that
        may hold a value beyond those known are split, until both ends are certain to 1e-7 of the
        range.

        Raises
        ------
        GeometryError
            If no patch has a finite value, or the field has a pole.
        """
        which = self.component(component)
        good = self[~self.missing()]
        if not len(good):
            raise GeometryError.expected(
                f"field {self.name!r}", "finite values", "none on any patch"
            )
        if (
            good.weights is not None
            and ((good.weights > 0).any(axis=1) & (good.weights < 0).any(axis=1)).any()
        ):
            raise GeometryError.expected(
                f"field {self.name!r}", "weights of one sign on each patch", "a pole"
            )
        if isinstance(which, str):
            if self.components == 1:
                low, high = good.range(0)
                inside = low <= 0 <= high
                return 0.0 if inside else min(abs(low), abs(high)), max(abs(low), abs(high))
            values, weights = good._squares()
        else:
            values, weights = good.ordinates[..., which], good.weights
        if weights is None:
            weights = np.ones_like(values)
        else:
            sign = np.where(weights.sum(axis=1, keepdims=True) < 0, -1.0, 1.0)
            values, weights = values * sign, weights * sign
        high = _largest(values, weights)
        low = -_largest(-values, weights)
        if which == MAGNITUDE:
            return float(np.sqrt(max(low, 0.0))), float(np.sqrt(max(high, 0.0)))
        return low, high

    def _squares(self) -> tuple[np.ndarray, np.ndarray | None]:
        """Return ordinates ``(P, K')`` of the squared magnitude, and its weights."""
        squares = products(self.ordinates, self.ordinates).sum(axis=2)
        if self.weights is None:
            return squares, None
        w = self.weights[..., None]
        return squares, products(w, w)[..., 0]


def _degree(count: int) -> int:
    """Return the degree that has so many ordinates, -1 if none has."""
    return 0 if count == 1 else -1 if count < 3 else _triangular(count)


def _triangular(count: int) -> int:
    n = (isqrt(8 * count + 1) - 3) // 2
    return n if bernstein.size(n) == count else -1


def _largest(values: np.ndarray, weights: np.ndarray) -> float:
    """Return the largest value of quotients of Bernstein polynomials, from below."""
    n = _degree(values.shape[1])
    if n == 0:
        return float((values / weights).max())
    corners = list(bernstein.corner_rows(n))
    split = bernstein.split_matrices(n)
    lowest = np.inf
    known = -np.inf
    for _ in range(_SPLITS):
        with np.errstate(divide="ignore", invalid="ignore"):
            hull = values / weights
        known = max(known, float(np.nanmax(hull[:, corners])))
        lowest = min(lowest, float(np.nanmin(hull[:, corners])))
        # where a weight is zero the hull says nothing
        top = np.where(np.isfinite(hull).all(axis=1), hull.max(axis=1), np.inf)
        size = max(known - lowest, 1e-12 * abs(known))
        open_ = top > known + _TIGHT * size
        if not open_.any() or open_.sum() * 4 > _PIECES * 4:
            break
        values = np.einsum("eij,pj->pei", split, values[open_]).reshape(-1, values.shape[1])
        weights = np.einsum("eij,pj->pei", split, weights[open_]).reshape(-1, weights.shape[1])
    return known


def products(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the Bernstein ordinates of products of polynomials.

    Parameters
    ----------
    a : (P, K_m, C) array
        Of degree m.
    b : (P, K_n, C) or (P, K_n, 1) array
        Of degree n.

    Returns
    -------
    (P, K_{m+n}, C) array
    """
    m, n = _degree(a.shape[1]), _degree(b.shape[1])
    if m == 0 or n == 0:
        return a * b
    out = np.zeros((len(a), bernstein.size(m + n), max(a.shape[2], b.shape[2])))
    # scaled by multinomials, ordinates multiply as coefficients do
    scaled = [x * bernstein.multinomials(d)[:, None] for x, d in ((a, m), (b, n))]
    first, second = bernstein.multi_indices(m), bernstein.multi_indices(n)
    for r, (i, j, _k) in enumerate(first.tolist()):
        rows = bernstein_rows(m + n, i + second[:, 0], j + second[:, 1])
        out[:, rows] += scaled[0][:, r : r + 1] * scaled[1]
    return out / bernstein.multinomials(m + n)[:, None]


def bernstein_rows(n: int, i: np.ndarray, j: np.ndarray) -> np.ndarray:
    """Return `bernstein.row` of many indices."""
    level = n - i
    return level * (level + 1) // 2 + level - j


def warped(patches: BezierTriangles, field: BezierField, factor: float = 1.0) -> BezierTriangles:
    """Return patches whose points are moved by a vector field, exactly.

    The degree is that of the sum: the higher of both where neither has weights, or both the same;
    the sum of the degrees elsewhere.

    Parameters
    ----------
    patches : BezierTriangles
    field : BezierField
        Of two or three components, on these patches.
    factor : float
        What its vectors are multiplied by.

    Raises
    ------
    GeometryError
        If the field has another number of components or patches, or values that are not finite.
    """
    if field.components not in (2, 3):
        raise GeometryError.expected(
            "warp",
            "a field of 2 or 3 components",
            f"{field.name!r} of {field.components}",
        )
    if len(field) != len(patches):
        raise GeometryError.expected("warp", f"a field on {len(patches)} patches", len(field))
    if (missing := field.missing()).any():
        raise GeometryError.expected(
            "warp",
            f"a field with finite values on all {len(patches)} patches",
            f"{field.name!r}, which has none on {int(missing.sum())} of them",
        )
    if not np.isfinite(factor):
        raise GeometryError.expected("factor", "a finite number", factor)
    net = patches.control_points
    moved = np.zeros((*field.ordinates.shape[:2], 3))
    moved[..., : field.components] = factor * field.ordinates
    weight = net[..., 3]
    plain = bool((weight == weight[:, :1]).all())
    top = max(patches.degree, field.degree)
    if field.weights is None and plain:
        net = bernstein.elevated(net, patches.degree, top).copy()
        net[..., 3] = weight[:, :1]  # without the rounding of elevation
        net[..., :3] += bernstein.elevated(moved, field.degree, top) * weight[:, :1, None]
        return BezierTriangles(net)
    if field.weights is not None and field.degree == patches.degree:
        # VTK's way: both are quotients of the same weights, up to a factor a patch
        ratio = field.weights[:, :1] / weight[:, :1]
        with np.errstate(invalid="ignore"):
            close = np.abs(field.weights - ratio * weight) <= 1e-14 * np.abs(field.weights)
        if close.all():
            net = net.copy()
            net[..., :3] += moved / ratio[..., None]
            return BezierTriangles(net)
    if field.weights is None:
        ones = np.ones((len(net), bernstein.size(field.degree), 1))
        out = products(net, ones)
        out[..., :3] += products(moved, weight[..., None])
        return BezierTriangles(out)
    own = field.weights[..., None]
    out = products(net, own)
    out[..., :3] += products(moved, weight[..., None])
    return BezierTriangles(out)


def nearest_names(name: str, known: Sequence[str]) -> list[str]:
    """Return the known names that are most like a name, at most five."""
    from difflib import get_close_matches

    lower = {k.lower(): k for k in known}
    found = [lower[k] for k in get_close_matches(name.lower(), list(lower), n=5, cutoff=0.4)]
    return found or list(known)[:5]
