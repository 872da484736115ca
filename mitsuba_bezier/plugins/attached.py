"""Derivatives of hits: nets that follow their parameters."""

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
from ..kernels.patch import padded_width

__all__ = ["attached_tables", "is_attached"]


def is_attached(shape: Any) -> bool:
    """Return whether derivatives by the parameters of a shape are wanted now."""
    more = shape.instance_maps, shape.trim_points  # or None
    return bool(dr.grad_enabled(shape.control_points, shape.to_world, *shape.sag_parameters, *more))


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
    first = 0
    for shape, (degree, row) in zip(shapes, tables.layout.shapes):
        count = shape.control_points.shape[0]
        if is_attached(shape):
            values = _packed(shape, tables, first, degree, 4 * row)
            dr.scatter(nets, values, dr.arange(mi.UInt32, dr.width(values)) + 4 * row)
        first += count
    projections = tables.projections
    if projections is not None:
        projections = projections.attached(shapes)
    aspheres = tables.aspheres
    if aspheres is not None:
        aspheres = aspheres.attached(shapes)
    nets = dr.replace_grad(tables.nets, nets)
    places = _places(tables.places, shapes)
    return replace(tables, nets=nets, projections=projections, aspheres=aspheres, places=places)


def _places(places: Any, shapes: list[Any]) -> Any:
    """Return the maps of instances with derivatives."""
    moved = [s.instance_maps for s in shapes if s.instances is not None]
    if places is None or not dr.grad_enabled(*moved):
        return places
    rows = mi.Float(dr.detach(places))
    first = 0
    for maps in moved:
        index = dr.arange(mi.UInt32, dr.width(maps.array))
        instance, row, column = index // 12, index % 12 // 4, index % 4
        place = dr.select(column == 3, 9 + row, 3 * row + column)
        dr.scatter(rows, maps.array, 16 * (first + instance) + place)
        first += maps.shape[0]
    return dr.replace_grad(places, rows)


def _packed(shape: Any, tables: Any, first: int, degree: int | None, place: int) -> Any:
    """Return the nets of a shape as `tables` have them.

    Parameters
    ----------
    first : int
        The number of its first patch.
    degree : int or None
        In which its nets are stored.
    place : int
        Where they are.
    """
    count, rows, _four = shape.control_points.shape
    index = dr.arange(mi.UInt32, count * rows) * 4
    flat = shape.control_points.array
    point = mi.Vector4f(*(dr.gather(mi.Float, flat, index + c) for c in range(4)))
    there = mi.Matrix4f(shape.to_world.matrix) @ point
    origin = tables.origin(first + index // (4 * rows), mi.Bool(True))
    local = mi.Vector3f(there.x, there.y, there.z) - there.w * mi.Vector3f(origin)
    world = dr.ravel(mi.Vector4f(local.x, local.y, local.z, there.w))
    terms = _on_device(shape, bernstein.degree_of(rows), degree)
    slots = dr.width(terms[0][0])
    index = dr.arange(mi.UInt32, count * slots)
    patch, slot = index // slots, index % slots
    result = dr.zeros(mi.Float, count * slots)
    for source, weight in terms:
        there, row = dr.gather(mi.Float, weight, slot), dr.gather(mi.UInt32, source, slot)
        result += there * dr.gather(mi.Float, world, patch * (4 * rows) + row, there != 0)
    # nets are free of a common factor there: one weight tells it
    heavy = 4 * tables.heaviest(first + patch) + 3
    mine = dr.gather(mi.Float, dr.detach(result), patch * slots + heavy)
    theirs = dr.gather(mi.Float, dr.detach(tables.nets), place + patch * slots + heavy)
    return result * dr.select(mine != 0, theirs / mine, 1)


def _on_device(shape: Any, n: int, degree: int | None) -> list[tuple[Any, Any]]:
    """Return what `_elevation` does, uploaded; shapes keep it, where frozen functions find it."""
    key = f"{n} {degree}"
    if key not in shape.elevations:
        shape.elevations[key] = [
            (upload(mi.UInt32, source), upload(mi.Float, weight))
            for source, weight in zip(*_elevation(n, degree))
        ]
    return shape.elevations[key]


@cache
def _elevation(n: int, degree: int | None) -> tuple[np.ndarray, np.ndarray]:
    """Return degree elevation as a sparse matrix from a flat net to a padded one.

    Without a degree the net is not elevated but scaled (`kernels.patch.scaled`).

    Returns
    -------
    source, weight : (T, width) arrays
        Slot `k` is the sum of ``weight[t, k]`` times number ``source[t, k]`` of the net.
    """
    if degree is None:
        degree, matrix = n, np.diag(bernstein.multinomials(n))
    else:
        matrix = bernstein.elevation_matrix(n, degree)
    full = np.zeros((padded_width(degree), bernstein.size(n) * 4))
    full[: bernstein.size(degree) * 4] = np.kron(matrix, np.eye(4))
    terms = max(1, int((full != 0).sum(axis=1).max()))
    source = np.argsort(full == 0, axis=1, kind="stable")[:, :terms].T
    weight = np.take_along_axis(full, source.T, axis=1).T
    return source.astype(np.uint32), weight.astype(np.float32)
