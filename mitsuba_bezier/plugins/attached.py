"""Derivatives of hits: nets that follow their parameters, and one attached Newton step."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..errors import BezierError
from ..geometry import bernstein
from ..kernels.arrays import upload
from ..kernels.patch import evaluate, padded_width

__all__ = ["attached_tables", "follow_ray", "is_attached"]


def is_attached(shape: Any) -> bool:
    """Tell whether derivatives by the parameters of a shape are wanted now."""
    return bool(dr.grad_enabled(shape.control_points) or dr.grad_enabled(shape.to_world))


def attached_tables(tables: Any, shapes: list[Any]) -> Any:
    """Return the tables with nets that carry derivatives; the values stay what they are.

    Parameters
    ----------
    tables : PatchTables
    shapes : list of BezierTriangle
        The shapes of the tables, in their order.

    Returns
    -------
    PatchTables
        `tables` itself where no parameter of a shape has derivatives enabled.

    Raises
    ------
    BezierError
        Inside a recorded loop, where arrays of another size cannot be made.
    """
    if not any(is_attached(shape) for shape in shapes):
        return tables
    if dr.flag(dr.JitFlag.SymbolicScope):
        raise BezierError(
            "control_points: expected derivatives to be tracked outside of recorded loops and "
            "calls (or through an integrator); got them inside of one"
        )
    nets = mi.Float(dr.detach(tables.nets))
    width = padded_width(tables.degree)
    first = 0
    for shape in shapes:
        count = shape.control_points.shape[0]
        if is_attached(shape):
            values = _packed(shape, tables.degree)
            dr.scatter(nets, values, dr.arange(mi.UInt32, count * width) + first * width)
        first += count
    return replace(tables, nets=dr.replace_grad(tables.nets, nets))


def _packed(shape: Any, degree: int) -> Any:
    """Return the nets of a shape in the world, elevated and padded as `kernels.patch.pack` does."""
    count, rows, _four = shape.control_points.shape
    index = dr.arange(mi.UInt32, count * rows) * 4
    flat = shape.control_points.array
    point = mi.Vector4f(*(dr.gather(mi.Float, flat, index + c) for c in range(4)))
    world = dr.ravel(mi.Matrix4f(shape.to_world.matrix) @ point)
    terms = _on_device(shape, bernstein.degree_of(rows), degree)
    slots = dr.width(terms[0][0])
    index = dr.arange(mi.UInt32, count * slots)
    patch, slot = index // slots, index % slots
    result = dr.zeros(mi.Float, count * slots)
    for source, weight in terms:
        there, row = dr.gather(mi.Float, weight, slot), dr.gather(mi.UInt32, source, slot)
        result += there * dr.gather(mi.Float, world, patch * (4 * rows) + row, there != 0)
    return result


def _on_device(shape: Any, n: int, degree: int) -> list[tuple[Any, Any]]:
    """Return what `_elevation` does, uploaded; shapes keep it, where frozen functions find it."""
    key = f"{n} {degree}"
    if key not in shape.elevations:
        shape.elevations[key] = [
            (upload(mi.UInt32, source), upload(mi.Float, weight))
            for source, weight in zip(*_elevation(n, degree))
        ]
    return shape.elevations[key]


@cache
def _elevation(n: int, degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Return degree elevation as a sparse matrix from a flat net to a padded one.

    Returns
    -------
    source, weight : (T, padded_width(degree)) arrays
        Slot `k` is the sum of ``weight[t, k]`` times number ``source[t, k]`` of the net.
    """
    matrix = np.eye(bernstein.size(n))
    for m in range(n, degree):
        matrix = bernstein.elevation_matrix(m) @ matrix
    full = np.zeros((padded_width(degree), bernstein.size(n) * 4))
    full[: bernstein.size(degree) * 4] = np.kron(matrix, np.eye(4))
    terms = max(1, int((full != 0).sum(axis=1).max()))
    source = np.argsort(full == 0, axis=1, kind="stable")[:, :terms].T
    weight = np.take_along_axis(full, source.T, axis=1).T
    return source.astype(np.uint32), weight.astype(np.float32)


def follow_ray(
    tables: Any, patch: Any, u: Any, v: Any, t: Any, ray: Any, active: Any
) -> tuple[Any, Any, Any]:
    """Give parameters of a hit their derivatives by the net and the ray.

    One Newton step at the solution for ``X(u, v) - w(u, v) (o + t d) = 0``, homogeneous and
    so without a division: its matrix is a number, its residual is 0 but has derivatives, and
    the step has those of the implicit function theorem.

    Parameters
    ----------
    tables : PatchTables
    patch : UInt
    u, v, t : Float
        The solution, without derivatives.
    ray : mi.Ray3f
    active : Bool

    Returns
    -------
    u, v, t : Float
        The same values.
    """
    value, d_du, d_dv = evaluate(tables.nets, tables.degree, patch, u, v, active)
    point = ray.o + t * ray.d
    residual = mi.Vector3f(*value[:3]) - value[3] * point
    foot, w = mi.Vector3f(dr.detach(point)), dr.detach(value[3])
    a = dr.detach(mi.Vector3f(*d_du[:3])) - dr.detach(d_du[3]) * foot
    b = dr.detach(mi.Vector3f(*d_dv[:3])) - dr.detach(d_dv[3]) * foot
    c = -w * dr.detach(mi.Vector3f(ray.d))
    ab, bc, ca = dr.cross(a, b), dr.cross(b, c), dr.cross(c, a)
    determinant = dr.dot(c, ab)
    # at a silhouette, and where nothing was hit, nothing follows
    regular = active & (determinant != 0)
    inverse = dr.select(regular, dr.rcp(dr.select(regular, determinant, 1)), 0)
    return (
        dr.replace_grad(u, -inverse * dr.dot(bc, residual)),
        dr.replace_grad(v, -inverse * dr.dot(ca, residual)),
        dr.replace_grad(t, -inverse * dr.dot(ab, residual)),
    )
