"""Surfaces of OpenCASCADE as grids of rational Bézier patches, exact where they can be.

Planes, cylinders, cones, spheres, tori, surfaces of revolution and of extrusion are built here
from rational arcs and lines, B-spline and Bézier surfaces are taken as they are. Only what is
left (offset surfaces) is converted, that is approximated, by OpenCASCADE.

Source of the parametrisations: the class documentation of ``Geom_CylindricalSurface`` and its
kin, https://dev.opencascade.org/doc/refman/html/
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ..nurbs import curve_to_bezier
from ..nurbs_surface import PatchGrid
from .closed_surfaces import ClosedAxes

__all__ = [
    "angle_map",
    "angular_axes",
    "arc",
    "closed_axes",
    "curve_pieces",
    "parameter_map",
    "surface_grid",
]


def arc(low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the unit circle from one angle to another as rational parabolas.

    Returns
    -------
    pieces : (S, 3, 3) array
        Rows ``(w cos, w sin, w)``; end weights 1, at most 120 degrees each.
    breaks : (S+1,) array
        The angles at which they begin and end.
    """
    count = max(1, int(np.ceil((high - low) / (2 * np.pi / 3) - 1e-9)))
    breaks = np.linspace(low, high, count + 1)
    half = (high - low) / (2 * count)
    ends = np.stack([np.cos(breaks), np.sin(breaks), np.ones(count + 1)], axis=1)
    middle = (breaks[:-1] + breaks[1:]) / 2
    between = np.stack([np.cos(middle), np.sin(middle), np.full(count, np.cos(half))], axis=1)
    return np.stack([ends[:-1], between, ends[1:]], axis=1), breaks


def angle_map(breaks: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Return the map of an angle to the parameter of `arc` pieces run through from break to break.

    On a piece ``[a, b]`` it is ``tan((angle - middle) / 2) = tan((b - a) / 4) (2 t - 1)``.
    """
    breaks = np.unique(breaks)

    def place(x: np.ndarray) -> np.ndarray:
        k = np.clip(np.searchsorted(breaks, x, side="right") - 1, 0, len(breaks) - 2)
        a, b = breaks[k], breaks[k + 1]
        return (a + b) / 2 + (b - a) / 2 * np.tan((x - (a + b) / 2) / 2) / np.tan((b - a) / 4)

    return place


def _vector(xyz: Any) -> np.ndarray:
    return np.array([xyz.X(), xyz.Y(), xyz.Z()])


def _frame(position: Any) -> np.ndarray:
    """Return the rows X, Y, Z, O of a placement, homogeneous."""
    out = np.zeros((4, 4))
    out[0, :3] = _vector(position.XDirection())
    out[1, :3] = _vector(position.YDirection())
    out[2, :3] = _vector(position.Direction())
    out[3] = [*_vector(position.Location()), 1.0]
    return out


def _line(low: float, high: float) -> np.ndarray:
    """Return the identity on [low, high] as one piece ``(1, 2, 2)`` of rows (v, 1)."""
    return np.array([[[low, 1.0], [high, 1.0]]])


def _turned(profile: np.ndarray, circle: np.ndarray, frame: np.ndarray) -> np.ndarray:
    """Turn profiles about the axis of a frame.

    Parameters
    ----------
    profile : (Sv, q+1, 3) array
        Rows ``(w f, w g, w)``: distance f from the axis, height g.
    circle : (Su, 3, 3) array
        Of `arc`.
    frame : (4, 4) array
        Rows X, Y, Z, O.

    Returns
    -------
    (Su, Sv, 3, q+1, 4) array
    """
    f, g, w = np.moveaxis(profile, -1, 0)
    c, s, one = np.moveaxis(circle, -1, 0)
    terms = ((c, f), (s, f), (one, g), (one, w))
    return sum(
        np.einsum("ui,vj,c->uvijc", along, across, row)
        for (along, across), row in zip(terms, frame)
    )


def curve_pieces(spline: Any, dimension: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the Bézier pieces ``(S, p+1, dimension+1)`` and breaks of a B-spline curve."""
    if spline.IsPeriodic():
        spline.SetNotPeriodic()
    rows = []
    for i in range(1, spline.NbPoles() + 1):
        pole, w = spline.Pole(i), spline.Weight(i)
        x = [pole.X(), pole.Y(), pole.Z()] if dimension == 3 else [pole.X(), pole.Y()]
        rows.append([*(w * np.array(x)), w])
    knots: list[float] = []
    for k in range(1, spline.NbKnots() + 1):
        knots += [spline.Knot(k)] * spline.Multiplicity(k)
    p = spline.Degree()
    breaks = np.unique(knots[p : len(knots) - p])
    return curve_to_bezier(np.array(rows), knots, p), breaks


def _basis_curve(occ: Any, curve: Any, low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
    """Return part of a space curve as Bézier pieces ``(S, p+1, 4)`` with their breaks."""
    while isinstance(curve, occ.geom.Geom_TrimmedCurve):
        curve = curve.BasisCurve()
    if not curve.IsPeriodic():
        low, high = max(low, curve.FirstParameter()), min(high, curve.LastParameter())
    if isinstance(curve, occ.geom.Geom_Line):
        a, b = (_vector(curve.Value(t)) for t in (low, high))
        return np.array([[[*a, 1.0], [*b, 1.0]]]), np.array([low, high])
    if isinstance(curve, (occ.geom.Geom_Circle, occ.geom.Geom_Ellipse)):
        circle = isinstance(curve, occ.geom.Geom_Circle)
        radii = (
            (curve.Radius(), curve.Radius())
            if circle
            else (curve.MajorRadius(), curve.MinorRadius())
        )
        frame = _frame(curve.Position())
        pieces, breaks = arc(low, high)
        rows = np.stack([radii[0] * frame[0], radii[1] * frame[1], frame[3]])
        return pieces @ rows, breaks
    part = occ.geom.Geom_TrimmedCurve(curve, low, high)
    return curve_pieces(occ.curve(part), 3)


def _spline_grid(spline: Any) -> PatchGrid:
    """Return a B-spline surface of OpenCASCADE, which is changed: pass a copy."""
    if spline.IsUPeriodic():
        spline.SetUNotPeriodic()
    if spline.IsVPeriodic():
        spline.SetVNotPeriodic()
    m, n = spline.NbUPoles(), spline.NbVPoles()
    net = np.empty((m, n, 4))
    for i in range(m):
        for j in range(n):
            pole, w = spline.Pole(i + 1, j + 1), spline.Weight(i + 1, j + 1)
            net[i, j] = pole.X() * w, pole.Y() * w, pole.Z() * w, w
    knots: list[list[float]] = [[], []]
    for k in range(1, spline.NbUKnots() + 1):
        knots[0] += [spline.UKnot(k)] * spline.UMultiplicity(k)
    for k in range(1, spline.NbVKnots() + 1):
        knots[1] += [spline.VKnot(k)] * spline.VMultiplicity(k)
    degrees = (spline.UDegree(), spline.VDegree())
    return PatchGrid.from_nurbs(net, knots[0], knots[1], degrees)


def surface_grid(occ: Any, surface: Any, box: np.ndarray) -> PatchGrid:
    """Return a surface over a rectangle of its parameters, or a little more.

    The parameters of the patches are those of the surface at the breaks; between them an angle
    is another one, see `parameter_map`.

    Parameters
    ----------
    occ : namespace
        What `cad` imports.
    surface : Geom_Surface
        The surface.
    box : (2, 2) array
        ``[[u0, u1], [v0, v1]]``.
    """
    geom = occ.geom
    (u0, u1), (v0, v1) = box.tolist()
    if isinstance(surface, (geom.Geom_BSplineSurface, geom.Geom_BezierSurface)):
        closed = (surface.IsUPeriodic(), surface.IsVPeriodic())
        copy = occ.convert.SurfaceToBSplineSurface_s(surface.Copy())
        grid = _spline_grid(copy)
        for axis in range(2):
            if closed[axis]:
                grid = grid.tiled(axis, *box[axis])
        return grid
    if isinstance(surface, geom.Geom_SurfaceOfLinearExtrusion):
        pieces, breaks = _basis_curve(occ, surface.BasisCurve(), u0, u1)
        way = np.array([*_vector(surface.Direction()), 0.0])
        patches = np.stack([pieces + pieces[..., 3:] * t * way for t in (v0, v1)], axis=2)
        return PatchGrid(patches[:, None], breaks, np.array([v0, v1]))
    if isinstance(surface, geom.Geom_SurfaceOfRevolution):
        pieces, breaks = _basis_curve(occ, surface.BasisCurve(), v0, v1)
        circle, angles = arc(u0, u1)
        axis_line = surface.Axis()
        origin, z = _vector(axis_line.Location()), _vector(axis_line.Direction())
        local = pieces[..., :3] - pieces[..., 3:] * origin
        height = (local @ z)[..., None] * z
        radial = local - height
        across = np.cross(z, radial)
        c, s, one = np.moveaxis(circle, -1, 0)
        space = (
            np.einsum("ui,vjc->uvijc", c, radial)
            + np.einsum("ui,vjc->uvijc", s, across)
            + np.einsum("ui,vjc->uvijc", one, height + pieces[..., 3:] * origin)
        )
        weight = np.einsum("ui,vj->uvij", one, pieces[..., 3])
        return PatchGrid(np.concatenate([space, weight[..., None]], axis=-1), angles, breaks)
    if isinstance(surface, geom.Geom_Plane):
        frame = _frame(surface.Position())
        corners = [[frame[3] + u * frame[0] + v * frame[1] for v in (v0, v1)] for u in (u0, u1)]
        return PatchGrid(np.array(corners)[None, None], np.array([u0, u1]), np.array([v0, v1]))
    turned = _profile(occ, surface, v0, v1)
    if turned is not None:
        circle, angles = arc(u0, u1)
        profile, breaks = turned
        return PatchGrid(_turned(profile, circle, _frame(surface.Position())), angles, breaks)
    part = geom.Geom_RectangularTrimmedSurface(surface, u0, u1, v0, v1)
    return _spline_grid(occ.convert.SurfaceToBSplineSurface_s(part))


def _profile(
    occ: Any, surface: Any, low: float, high: float
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return what is turned to make an elementary surface, for `_turned`, with its breaks."""
    geom = occ.geom
    line, ends = _line(low, high), np.array([low, high])
    v, one = line[..., 0], line[..., 1]
    if isinstance(surface, geom.Geom_CylindricalSurface):
        return np.stack([surface.Radius() * one, v, one], axis=-1), ends
    if isinstance(surface, geom.Geom_ConicalSurface):
        angle = surface.SemiAngle()
        f = surface.RefRadius() + v * np.sin(angle)
        return np.stack([f, v * np.cos(angle), one], axis=-1), ends
    if isinstance(surface, geom.Geom_SphericalSurface):
        major, minor = 0.0, surface.Radius()
        low, high = max(low, -np.pi / 2), min(high, np.pi / 2)
    elif isinstance(surface, geom.Geom_ToroidalSurface):
        major, minor = surface.MajorRadius(), surface.MinorRadius()
    else:
        return None
    pieces, breaks = arc(low, high)
    c, s, w = np.moveaxis(pieces, -1, 0)
    return np.stack([major * w + minor * c, minor * s, w], axis=-1), breaks


def closed_axes(occ: Any, surface: Any) -> ClosedAxes:
    """Return along which parameters a surface is closed, and where it has poles."""
    u0, u1, v0, v1 = surface.Bounds()
    bounds = np.array([[u0, u1], [v0, v1]])
    period = np.zeros(2)
    if surface.IsUClosed():
        period[0] = surface.UPeriod() if surface.IsUPeriodic() else u1 - u0
    if surface.IsVClosed():
        period[1] = surface.VPeriod() if surface.IsVPeriodic() else v1 - v0
    poles: tuple[list[float], list[float]] = ([], [])
    if isinstance(surface, occ.geom.Geom_ConicalSurface):
        poles[1].append(float(-surface.RefRadius() / np.sin(surface.SemiAngle())))
    for axis in range(2):
        if period[axis] or not period[1 - axis] or np.abs(bounds[axis]).max() > 1e50:
            continue
        along = bounds[1 - axis, 0] + period[1 - axis] * np.array([0.0, 0.23, 0.46, 0.71])
        lines = [
            np.array([_vector(surface.Value(*((x, y) if axis == 0 else (y, x)))) for y in along])
            for x in [*bounds[axis], bounds[axis].mean()]
        ]
        size = np.ptp(np.concatenate(lines), axis=0).max()
        for x, line in zip(bounds[axis], lines):
            # 1e-7 of the size: the precision OpenCASCADE works with
            if np.ptp(line, axis=0).max() <= 1e-7 * size:
                poles[axis].append(float(x))
    return ClosedAxes(bounds[:, 0], period, poles)


def _identity(x: np.ndarray) -> np.ndarray:
    return x


def _chosen_map(grid: PatchGrid, angular: tuple[bool, bool]) -> Callable[[np.ndarray], np.ndarray]:
    maps = [
        angle_map(breaks) if turned else _identity
        for breaks, turned in zip((grid.u, grid.v), angular)
    ]

    def place(uv: np.ndarray) -> np.ndarray:
        inside = np.clip(uv, grid.domain[:, 0], grid.domain[:, 1])
        return np.stack([maps[axis](inside[:, axis]) for axis in range(2)], axis=1)

    return place


def angular_axes(surface: Any, grid: PatchGrid, box: np.ndarray) -> tuple[bool, bool] | str:
    """Tell which parameters of a surface are angles of the arcs of its patches.

    Parameter lines are kept, so u and v are the same each on its own, or the angle of an arc.
    Which it is, three points tell.

    Returns
    -------
    (bool, bool), or str
        For u and v; a reason if the parameters could not be related.
    """
    low, high = np.maximum(box[:, 0], grid.domain[:, 0]), np.minimum(box[:, 1], grid.domain[:, 1])
    probes = low + (high - low) * [[0.21, 0.6], [0.47, 0.1], [0.83, 0.95]]
    wanted = np.array([_vector(surface.Value(*uv)) for uv in probes.tolist()])
    for first in (False, True):
        for second in (False, True):
            place = _chosen_map(grid, (first, second))
            # 1e-9 of the size: rounding, far below the difference of two parametrisations
            if np.abs(grid.jet(place(probes))[0] - wanted).max() < 1e-9 * grid.size:
                return first, second
    return "its parameters could not be related to those of its NURBS form"


def parameter_map(
    surface: Any, grid: PatchGrid, box: np.ndarray
) -> Callable[[np.ndarray], np.ndarray] | str | None:
    """Return the map of the parameters of a surface to those of its patches.

    Returns
    -------
    callable, str or None
        From ``(N, 2)`` to ``(N, 2)``; None if the parameters are the same; a reason if they
        could not be related.
    """
    angular = angular_axes(surface, grid, box)
    if isinstance(angular, str):
        return angular
    return _chosen_map(grid, angular) if any(angular) else None
