"""Curves on patches in scenes: boundary curves and isoparametric lines, as thin tubes."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from ..._files import write_file
from ...errors import GeometryError, VariantError
from ...geometry.checks import length
from ...geometry.curves import BezierCurve
from ...geometry.isoparametric import boundary_curve_of, isoparametric
from ...geometry.projective import count, norm
from ...geometry.triangles import BezierTriangles
from .nets import LEG

__all__ = ["boundary_curves", "curve_tubes", "isoparametric_lines", "tube_points"]


def tube_points(curve: BezierCurve, radius: float, parts: int, reach: float) -> list[np.ndarray]:
    """Return control points ``(m + 3, 4)`` of cubic B-splines along a curve: x, y, z, radius.

    The quasi-interpolant ``p_i - (p_{i-1} - 2 p_i + p_{i+1}) / 6`` differs from the curve by the
    fourth power of the spacing. Where the curve goes to infinity it is cut: what lies further than
    `reach` from the origin is left out.
    """
    t = np.arange(-2, parts + 3) / parts
    h = curve.evaluate(t)
    if h.shape[1] == 3:
        h = np.insert(h, 2, 0.0, axis=1)
    good = np.abs(h[:, 3]) > 1e-9 * norm(h)
    x = h[:, :3] / np.where(good, h[:, 3], 1.0)[:, None]
    good &= norm(x) <= reach
    # a point that would be needed beyond an end, but is at infinity or behind it
    breaks = ~good[:-1] | ~good[1:] | (np.sign(h[:-1, 3]) != np.sign(h[1:, 3]))
    out, first = [], 0
    for end in [*np.flatnonzero(breaks), len(t) - 1]:
        piece = x[first : end + 1]
        if first > 0 or not good[0]:
            piece = np.concatenate([2 * piece[:1] - piece[1:2], piece]) if len(piece) > 2 else piece
        if end < len(t) - 1 and len(piece) > 2:
            piece = np.concatenate([piece, 2 * piece[-1:] - piece[-2:-1]])
        if len(piece) >= 6:
            c = piece[1:-1] - (piece[:-2] - 2 * piece[1:-1] + piece[2:]) / 6
            out.append(np.column_stack([c, np.full(len(c), radius)]))
        first = int(end) + 1
    return out


def curve_tubes(
    curves: Iterable[BezierCurve],
    radius: float,
    bsdf: Any = None,
    parts: int = 32,
    reach: float = 100.0,
    name: str = "curves",
) -> dict[str, Any]:
    """Return curves as one shape of a scene: thin tubes (Mitsuba's `bsplinecurve`).

    Parameters
    ----------
    curves : iterable of BezierCurve
        In space, or in the plane z = 0.
    radius : float
        Of the tubes.
    bsdf : dict, optional
        Material.
    parts : int
        Into how many segments a curve is cut; the tubes are off by the fourth power of that.
    reach : float
        Curves that go to infinity are cut at this distance from the origin.
    name : str
        Key of the shape.

    Returns
    -------
    dict
        With one object, made by the variant that is set, to be merged into that of a scene.

    Raises
    ------
    GeometryError
        If there is no curve, or a parameter is not of this kind.
    VariantError
        If no variant is set: the tubes are made at once.
    """
    r, most = length("radius", radius), length("reach", reach)
    parts = count(parts, "parts", 4)
    pieces = [p for c in curves for p in tube_points(c, r, parts, most)]
    if not pieces:
        raise GeometryError.expected("curves", "a curve within reach", "none")
    if mi.variant() is None:
        raise VariantError.expected("curves", "a variant, by mi.set_variant", "none")
    # the plugin reads files only
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "curves.txt"
        rows = ("\n".join(" ".join(f"{v:.9g}" for v in row) for row in p) for p in pieces)
        write_file(path, ("\n\n".join(rows) + "\n").encode())
        tubes = mi.load_dict(
            {"type": "bsplinecurve", "filename": str(path), "bsdf": LEG if bsdf is None else bsdf}
        )
    return {name: tubes}


def _checked(patches: Any) -> BezierTriangles:
    if not isinstance(patches, BezierTriangles):
        raise GeometryError.expected("patches", "BezierTriangles", f"{type(patches).__name__}")
    return patches


def boundary_curves(
    patches: BezierTriangles,
    radius: float,
    bsdf: Any = None,
    name: str = "boundary",
    **options: Any,
) -> dict[str, Any]:
    """Return the boundary curves of patches as a shape of a scene; those that two share, once.

    Parameters as for `curve_tubes`; sides that have shrunk to a point are left out.

    Examples
    --------
    >>> mi.set_variant("llvm_ad_rgb")
    >>> edges = mb.boundary_curves(mb.sphere(), radius=0.02)
    >>> list(edges)
    ['boundary']
    """
    found: dict[tuple[float, ...], BezierCurve] = {}
    for patch in range(len(_checked(patches))):
        for edge in range(3):
            curve = boundary_curve_of(patches, patch, edge)
            if curve is None:
                continue
            h = curve.evaluate([0.0, 0.25, 0.5, 0.75, 1.0])
            u = h / norm(h)[:, None]
            u = u * np.where(u[np.arange(5), np.abs(u).argmax(axis=1)] < 0, -1.0, 1.0)[:, None]
            ends = sorted((tuple(u[:3].round(6).ravel()), tuple(u[:1:-1].round(6).ravel())))
            found.setdefault(ends[0] + ends[1], curve)
    return curve_tubes(found.values(), radius, bsdf, name=name, **options)


def isoparametric_lines(
    patches: BezierTriangles,
    radius: float,
    lines: int = 4,
    bsdf: Any = None,
    name: str = "lines",
    **options: Any,
) -> dict[str, Any]:
    """Return isoparametric lines of patches in all three directions, `lines` each, as a shape.

    Other parameters as for `curve_tubes`.

    Examples
    --------
    >>> mi.set_variant("llvm_ad_rgb")
    >>> list(mb.isoparametric_lines(mb.sphere(), radius=0.01, lines=3))
    ['lines']
    """
    steps = np.arange(1, count(lines, "lines", 1) + 1) / (lines + 1)
    corners, found = np.eye(3), []
    for patch in range(len(_checked(patches))):
        for k in range(3):
            a, b, c = (corners[(k + m) % 3] for m in range(3))
            for s in steps:
                curve = isoparametric(patches, patch, (1 - s) * a + s * c, (1 - s) * b + s * c)
                if curve is not None:
                    found.append(curve)
    return curve_tubes(found, radius, bsdf, name=name, **options)
