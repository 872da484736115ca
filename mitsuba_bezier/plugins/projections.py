"""Texture coordinates of Mitsuba's sphere, cylinder, rectangle and disk on any surface."""

from __future__ import annotations

import difflib
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..errors import BezierError
from ..kernels.arrays import gather_wide, upload, upload_wide
from ..kernels.two_float import coarse
from .wide_vectors import PairVector, place_of, single, vector, wide_types

__all__ = ["PROJECTIONS", "Projected", "Projections", "read_projection"]

#: Values of the parameter ``uv``, and the shape of Mitsuba's that each is named after.
PROJECTIONS = {
    "spherical": "sphere",
    "cylindrical": "cylinder",
    "planar": "rectangle",
    "polar": "disk",
}
#: Numbers a shape in `Projections.rows`: linear part and translation of ``to_world``, the inverse
#: of the linear part, how far from the axis a point is not on it, and 0 to the next whole packet.
_ROW = 24
#: That distance, of the size of the shape: far below what rounds a point, so that poles and the
#: seam are hit.
_AXIS = 1e-12
#: Cosine between the normal and the direction of a projection below which a surface has no
#: partials by texture coordinates: float32 normals are good to 1e-7.
_ALONG = 1e-6


def read_projection(props: mi.Properties) -> str | None:
    """Take the parameter ``uv`` out of the properties, None if there is none.

    Raises
    ------
    BezierError
        If it is no name of a projection, or stands beside ``texcoords``.
    """
    if "uv" not in props:
        return None
    value = props["uv"]
    del props["uv"]
    if value not in PROJECTIONS:
        names = ", ".join(f'"{name}"' for name in PROJECTIONS)
        raise BezierError.expected("uv", f"one of {names}", repr(value) + _hint(value))
    if "texcoords" in props:
        raise BezierError.expected("uv", "at most one of uv and texcoords", "both")
    return str(value)


def _hint(value: Any) -> str:
    if not isinstance(value, str):
        return ""
    # a half: half of a word of that length
    words = [*PROJECTIONS, *PROJECTIONS.values()]
    near = difflib.get_close_matches(value.lower(), words, n=1, cutoff=0.5)
    meant = {theirs: ours for ours, theirs in PROJECTIONS.items()}
    return f"; did you mean '{meant.get(near[0], near[0])}'?" if near else ""


@dataclass
class Projected:
    """Texture coordinates of points and, where there are some, the partials by them."""

    here: Any  #: Bool, where the shape has a projection
    uv: Any  #: mi.Point2f
    du: Any  #: mi.Vector3f, dp_du
    dv: Any
    regular: Any  #: Bool, where there are partials


@dataclass
class Projections:
    """The projections of a list of shapes.

    A projection gives texture coordinates to a point of object space. The partials of a surface
    by them are the tangents on which one grows by 1 and the other stays: they follow from the
    point and the normal, whatever the parameters of the patches are, also where these are
    singular.
    """

    kinds: tuple[str, ...]  #: which there are, "" for none
    kind_of: Any  #: UInt per shape, index into `kinds`
    rows: Any  #: wide, `_ROW` per shape

    @staticmethod
    def of(shapes: list[Any]) -> Projections | None:
        """Return those of a list of shapes, None if they have none."""
        used = [shape.projection or "" for shape in shapes]
        kinds = tuple(sorted(set(used)))
        if kinds == ("",):
            return None
        rows = np.zeros((len(shapes), _ROW))
        for row, shape in zip(rows, shapes):
            linear = shape.object_to_world[:3, :3]
            row[:9], row[9:12] = linear.ravel(), shape.object_to_world[:3, 3]
            row[12:21] = np.linalg.inv(linear).ravel()
            row[21] = _AXIS * _size(shape.object_patches.control_points)
        return Projections(
            kinds,
            upload(mi.UInt32, np.array([kinds.index(kind) for kind in used])),
            upload_wide(wide_types(), rows),
        )

    def attached(self, shapes: list[Any]) -> Projections:
        """Return the same with maps that carry the derivatives of their shapes' ``to_world``."""
        rows = type(self.rows)(dr.detach(self.rows))
        for number, shape in enumerate(shapes):
            if shape.projection is None or not dr.grad_enabled(shape.to_world):
                continue
            m = mi.Matrix4f(shape.to_world.matrix)
            linear = mi.Matrix3f([[m[i, j] for j in range(3)] for i in range(3)])
            inverse = dr.rcp(linear)
            values = [
                *(linear[i, j] for i in range(3) for j in range(3)),
                *(m[i, 3] for i in range(3)),
                *(inverse[i, j] for i in range(3) for j in range(3)),
            ]
            for k, value in enumerate(values):
                place = place_of(rows, number * _ROW + k)
                dr.scatter(rows, type(rows)(value), mi.UInt32(place))
        return replace(self, rows=dr.replace_grad(self.rows, rows))

    def project(self, shape: Any, p: Any, n: Any, active: Any, linear: Any = None) -> Projected:
        """Return texture coordinates and partials.

        Parameters
        ----------
        shape : UInt
            Numbers of shapes.
        p : wide vector
            Points of the surfaces, where `to_world` has brought them.
        n : mi.Normal3f
            Unit normals there, or of the instances; either side.
        active : Bool
        linear : matrix, optional
            Linear parts of the maps to instances.
        """
        kind = dr.gather(mi.UInt32, self.kind_of, shape, active)
        rows = gather_wide(self.rows, shape, 22, active)
        away = p - vector(isinstance(p, PairVector), rows[9:12])
        if isinstance(p, PairVector):  # what is left is as exact in float32 as texture coordinates
            rows = [coarse(x) for x in rows]
            there, q = mi.Matrix3f(*rows[:9]), mi.Matrix3f(*rows[12:21]) @ single(away)
        else:
            there, q = mi.Matrix3d(*rows[:9]), mi.Matrix3d(*rows[12:21]) @ away
        if linear is not None:
            there = linear @ there
        m = there.T @ type(q)(n)
        uv, du, dv = mi.Point2f(0.0), type(q)(0.0), type(q)(0.0)
        regular, here = mi.Bool(False), mi.Bool(False)
        for number, name in enumerate(self.kinds):
            if name:
                mine = kind == number
                found = _FORMULAS[name](q, m, rows[21])
                uv, du, dv = (dr.select(mine, a, b) for a, b in zip(found, (uv, du, dv)))
                regular, here = dr.select(mine, found[3], regular), here | mine
        here &= active
        return Projected(here, uv, mi.Vector3f(there @ du), mi.Vector3f(there @ dv), regular & here)


def _size(nets: np.ndarray) -> float:
    """Return the largest coordinate of control points that are not at infinity."""
    net = nets.reshape(-1, 4)
    net = net[net[:, 3] != 0]
    return float(np.abs(net[:, :3] / net[:, 3:]).max(initial=0.0))


# ------------------------------------------------------------- one for each shape
#
# With the gradients a, b of the texture coordinates and a normal m, the partials are
# b x m and m x a over a . (b x m). What cancels is cancelled: nothing is divided by the
# distance from the axis but its own coordinates.


def _angle(x: Any, y: Any) -> Any:
    """Return the angle around the axis, as a part of the circle from 0 to 1."""
    phi = dr.atan2(mi.Float(y), mi.Float(x))
    return dr.select(phi < 0, phi + dr.two_pi, phi) * dr.inv_two_pi


def _around(q: Any, least: Any) -> tuple[Any, ...]:
    """Return x, y, their distance from the axis, which is 1 on it, and where that is."""
    square = dr.fma(q.x, q.x, q.y * q.y)
    axis = ~(square > least * least)
    # a ray along the seam is to see its beginning, whatever the sign of a rounding
    y = dr.replace_grad(dr.select(dr.abs(q.y) > least, q.y, 0.0), q.y)
    # derivatives stay finite, too
    return (
        dr.select(axis, 1.0, q.x),
        dr.select(axis, 0.0, y),
        dr.sqrt(dr.select(axis, 1.0, square)),
        axis,
    )


def _inverse(x: Any, a: Any, b: Any = 1.0) -> tuple[Any, Any]:
    """Return 1 / x, and where `x` is not small beside the product of `a` and `b`."""
    regular = dr.abs(x) > _ALONG * a * b
    return 1.0 / dr.select(regular, x, 1.0), regular


def _spherical(q: Any, m: Any, least: Any) -> tuple[Any, ...]:
    x, y, rho, axis = _around(q, least)
    r2 = dr.squared_norm(q)
    facing, regular = _inverse(dr.dot(q, m), dr.sqrt(r2), dr.norm(m))
    # the gradients, times 2 pi rho^2 and pi r^2
    down = type(q)(q.z * x, q.z * y, -rho * rho) / rho
    east = type(q)(-y, x, 0.0) / rho
    out, up = mi.Float(dr.select(axis, 0.0, rho)), mi.Float(q.z)
    up = dr.select(axis & (up == 0), 1.0, up)  # the origin
    uv = mi.Point2f(_angle(x, y), dr.atan2(out, up) * dr.inv_pi)
    du = dr.select(axis, 0.0, dr.cross(m, down) * (dr.two_pi * rho * facing))
    dv = dr.cross(east, m) * (dr.pi * r2 * facing)
    # Mitsuba's sphere takes the x axis at either pole
    dv = dr.select(axis & (q.z < 0), -dv, dv)
    return uv, du, dv, regular


def _cylindrical(q: Any, m: Any, least: Any) -> tuple[Any, ...]:
    x, y, rho, axis = _around(q, least)
    height = dr.fma(x, m.x, y * m.y)
    facing, regular = _inverse(height, rho, dr.norm(m))
    du = type(q)(-m.y, m.x, 0.0) * (dr.two_pi * rho * rho * facing)
    dv = type(q)(-m.z * x * facing, -m.z * y * facing, 1.0)
    return mi.Point2f(_angle(x, y), mi.Float(q.z)), du, dv, regular & ~axis


def _planar(q: Any, m: Any, _least: Any) -> tuple[Any, ...]:
    facing, regular = _inverse(m.z, dr.norm(m))
    uv = mi.Point2f(mi.Float(0.5 * q.x + 0.5), mi.Float(0.5 * q.y + 0.5))
    du = type(q)(2.0, 0.0, -2.0 * m.x * facing)
    return uv, du, type(q)(0.0, 2.0, -2.0 * m.y * facing), regular


def _polar(q: Any, m: Any, least: Any) -> tuple[Any, ...]:
    x, y, rho, axis = _around(q, least)
    facing, regular = _inverse(m.z, dr.norm(m))
    out, east = type(q)(x, y, 0.0) / rho, type(q)(-y, x, 0.0) / rho
    uv = mi.Point2f(mi.Float(dr.select(axis, 0.0, rho)), _angle(x, y))
    # on the axis nothing, as of Mitsuba's disk
    du = dr.select(axis, 0.0, dr.cross(east, m) * facing)
    dv = dr.select(axis, 0.0, dr.cross(m, out) * (dr.two_pi * rho * facing))
    return uv, du, dv, regular


_FORMULAS = {
    "spherical": _spherical,
    "cylindrical": _cylindrical,
    "planar": _planar,
    "polar": _polar,
}
