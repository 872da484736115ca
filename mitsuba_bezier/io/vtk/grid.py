"""A VTK grid, from whatever file, as Bézier triangles with fields."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ...errors import FileFormatError
from ...geometry import bernstein
from ...geometry.trims import Trims
from ..cells import MAX_LAGRANGE, CellField, Cells, add_cells
from ..report import Collector
from ..tensor_nets import fans
from ..volume_faces import VOLUMES, add_surface
from .cell_types import CELL_NAMES, READ, cell_lattice
from .field_arrays import own_field

__all__ = ["MAX_DEGREE", "Array", "Grid", "add_grid", "note_ghosts"]

#: Highest degree of triangles, read or made; VTK itself stops at 10 for most cells.
MAX_DEGREE = 40

_BEZIER_TRIANGLE = 76
_STRIP, _POLYGON = 6, 7

#: How many numbers tell a place in a cell.
_WIDTH = {"triangle": 3, "quad": 2, "tetra": 4, "hexahedron": 3, "wedge": 4, "pyramid": 3}


@dataclass
class Array:
    """Values ``(N, c)`` at points or on cells, and their unit."""

    values: np.ndarray
    unit: str = ""
    polynomial: bool = False  #: at Bézier points: not divided by weights


@dataclass
class Grid:
    """Cells of one piece of a file.

    Attributes
    ----------
    points : (N, 3) array
        As VTK sees them.
    net : (N, 4) array
        The same, homogeneous, for Bézier cells.
    types, offsets, connectivity : int arrays
        ``(C,)``, ``(C + 1,)``, and the points of all cells.
    degrees : (C, 3) int array
        Zeros where the file does not tell.
    copies, hidden : (C,) bool arrays
        Cells that show nothing; see `ghosts`.
    no_points : (N,) bool array
        Points that hide their cells.
    trims : Trims or None
        Of Bézier triangles.
    point_arrays, cell_arrays : dict of Array
    rational : bool
        The points have weights.
    old_order : bool
        Hexahedra have the order of VTK before 9.1.
    sides : (C, 3) bool array or None
        Of triangles, as edges of `Model`.
    """

    points: np.ndarray
    net: np.ndarray
    types: np.ndarray
    offsets: np.ndarray
    connectivity: np.ndarray
    degrees: np.ndarray
    copies: np.ndarray
    hidden: np.ndarray
    no_points: np.ndarray
    trims: Trims | None = None
    point_arrays: dict[str, Array] = field(default_factory=dict)
    cell_arrays: dict[str, Array] = field(default_factory=dict)
    rational: bool = False
    old_order: bool = False
    sides: np.ndarray | None = None

    def fields(self, kind: str, lattice: np.ndarray, index: np.ndarray, cells: np.ndarray,
               bezier: bool) -> dict[str, CellField]:  # fmt: skip
        """Return the fields on some cells, of points `index` and numbers `cells`."""
        out = {}
        weights = self.net[:, 3] if bezier and self.rational else None
        for name, array in self.point_arrays.items():
            own = None if array.polynomial else weights
            out[name] = CellField(lattice, index, array.values, own, bezier, unit=array.unit)
        constant = np.zeros((1, _WIDTH[kind]), int)
        for name, array in self.cell_arrays.items():
            own_name = own_field(name, array.values) if kind == "triangle" else None
            if own_name is not None:
                out[own_name[0]] = _ordinates(own_name, array, cells)
                continue
            if name in out:
                name = f"{name} (cells)"
            out[name] = CellField(constant, cells[:, None], array.values, unit=array.unit)
        return out


def _ordinates(own: tuple[str, int, bool], array: Array, cells: np.ndarray) -> CellField:
    """Return a field that our writer has written."""
    _name, components, rational = own
    values = array.values.reshape(-1, components + rational)
    size = len(values) // max(len(array.values), 1)
    n = next(n for n in range(41) if bernstein.size(n) == size)
    rows = cells[:, None] * size + np.arange(size)
    weights = None
    if rational:  # they are multiplied already
        weights = values[:, -1]
        with np.errstate(divide="ignore", invalid="ignore"):
            values = np.where(weights[:, None] != 0, values[:, :-1] / weights[:, None], 0.0)
    lattice = bernstein.multi_indices(n)
    return CellField(lattice, rows, values, weights, bezier=True, unit=array.unit)


def needed(types: np.ndarray, copies: np.ndarray, hidden: np.ndarray) -> np.ndarray:
    """Return a mask of cells that are converted, or stand before such, ``(C,)``."""
    known = np.isin(types, [*READ, _STRIP, _POLYGON])
    volume = np.isin(types, [n for n, (kind, _bezier) in READ.items() if kind in VOLUMES])
    return known & ~hidden & (volume | ~copies)


def add_grid(
    collector: Collector, grid: Grid, first: int, error: Callable[[str, object], FileFormatError]
) -> int:
    """Convert the cells of a grid.

    Parameters
    ----------
    collector : Collector
        Where they go.
    grid : Grid
    first : int
        The number of its first cell.
    error : callable
        Makes the error of a damaged file, from what was expected and what came.

    Returns
    -------
    int
        How many cells were left out because they are copies or hidden.
    """
    types, offsets = grid.types, grid.offsets
    sizes = np.diff(offsets)
    shown = ~(grid.copies | grid.hidden)
    known = np.isin(types, [*READ, _STRIP, _POLYGON])
    for number, count in zip(*np.unique(types[~known & shown], return_counts=True)):
        name = f"VTK_{CELL_NAMES.get(int(number), '?')}"
        what = f"cells of type {number}"
        if number in (1, 2, 3, 4, 21, 35, 68, 75):
            collector.report.remarks.append(f"{count} {what} ({name}: no surface)")
        else:
            collector.report.refuse(what, f"{name}: not supported", int(count))
    ghosts = int((~shown).sum())
    chosen = needed(types, grid.copies, grid.hidden)
    if not chosen.any():
        return ghosts
    plain = np.concatenate([grid.points, np.ones((len(grid.points), 1))], axis=1)
    keys = np.column_stack([types, sizes, grid.degrees])
    surfaces: list[Cells] = []
    volumes: list[Cells] = []
    found, inverse = np.unique(keys[chosen], axis=0, return_inverse=True)
    order = np.argsort(inverse.ravel(), kind="stable")
    ends = np.searchsorted(inverse.ravel()[order], np.arange(1, len(found)))
    for key, group in zip(found, np.split(np.flatnonzero(chosen)[order], ends)):
        number, size, p, q, r = key.tolist()
        index = grid.connectivity[offsets[group][:, None] + np.arange(size)]
        bad = ((index < 0) | (index >= len(plain))).any(axis=1)
        if bad.any():
            cell = int(np.argmax(bad))
            raise error(
                f"point numbers from 0 to {len(plain) - 1}",
                f"{index[cell].tolist()} in cell {group[cell]}",
            )
        seen = ~grid.no_points[index].any(axis=1)
        if not seen.all():
            ghosts += int((~seen & ~grid.copies[group]).sum())
            group, index = group[seen], index[seen]
        if number in (_STRIP, _POLYGON):
            if len(group):
                _add_polygons(collector, grid, plain, number, index, group, first)
            continue
        kind, is_bezier = READ[number]
        lattice = cell_lattice(number, size, (p, q, r), grid.old_order)
        if lattice is None:
            if kind == "pyramid":
                collector.report.refuse(
                    f"cells of type {number}, {size} points",
                    "pyramids above degree 2: VTK defines no order of their points",
                    len(group),
                )
                continue
            raise error(
                f"a number of points that fits VTK_{CELL_NAMES[number]}",
                f"{size} points in cell {group[0] if len(group) else '?'}",
            )
        most = MAX_DEGREE if is_bezier else MAX_LAGRANGE
        top, both = _degrees(kind, lattice)
        if top > most or both > MAX_DEGREE:
            reason = f"degree above {most} (the sum of both above {MAX_DEGREE}): not supported"
            count = int((~grid.copies[group]).sum())
            collector.report.refuse(f"cells of type {number}, degree {top}", reason, count)
            continue
        if not len(group):
            continue
        fields = grid.fields(kind, lattice, index, group, is_bezier)
        part = Cells(kind, lattice, index, is_bezier, grid.copies[group], fields=fields)
        if kind in VOLUMES:
            volumes.append(part)
        else:
            surfaces.append(part)
            net = grid.net if is_bezier else plain
            trimmed = grid.trims is not None and number == _BEZIER_TRIANGLE
            own = grid.trims[group] if trimmed and grid.trims is not None else None
            sides = None if grid.sides is None or kind != "triangle" else grid.sides[group]
            add_cells(collector, part, net, first + group, own, edges=sides)
    for is_bezier in (False, True):
        some = [v for v in volumes if v.bezier == is_bezier]
        net = grid.net if is_bezier else plain
        add_surface(collector, some, surfaces, net, first + len(types))
    return ghosts


def _degrees(kind: str, lattice: np.ndarray) -> tuple[int, int]:
    """Return the highest degree of a cell, and the highest sum of both of a quadrilateral."""
    ends = sorted(lattice.max(axis=0).tolist())
    if len(lattice) in (7, 19, 21):
        return 3, 4
    if kind in ("triangle", "tetra"):
        return ends[-1], ends[-1]
    return ends[-1], ends[-1] + (lattice[:, 3].max() if kind == "wedge" else ends[-2])


def _add_polygons(
    collector: Collector,
    grid: Grid,
    points: np.ndarray,
    number: int,
    index: np.ndarray,
    group: np.ndarray,
    first: int,
) -> None:
    """Convert polygons, or strips of triangles, all of one number of corners."""
    size = index.shape[1]
    what = f"cells of type {number}"
    if size < 3:
        collector.report.refuse(what, "fewer than three corners", len(group))
        return
    if number == _STRIP:
        k = np.arange(size - 2)
        odd = k % 2
        corners = np.stack([k, k + 1 + odd, k + 2 - odd], axis=1)
        real = np.ones((size - 2, 3), bool)
    else:
        convex = fans(points[index])[1] if size > 3 else np.ones(len(index), bool)
        if not convex.all():
            reason = "polygon that is not convex, or without area"
            collector.report.refuse(what, reason, int((~convex).sum()))
            group, index = group[convex], index[convex]
        k = np.arange(1, size - 1)
        corners = np.stack([np.zeros_like(k), k, k + 1], axis=1)
        real = np.stack([k > 0, k == size - 2, k == 1], axis=1)
    if not len(group):
        return
    nodes = index[:, corners].reshape(-1, 3)
    cells = np.repeat(group, len(corners))
    lattice = np.array([(1, 0, 0), (0, 1, 0), (0, 0, 1)])
    fields = grid.fields("triangle", lattice, nodes, cells, False)
    part = Cells("triangle", lattice, nodes, fields=fields)
    add_cells(
        collector, part, points, first + cells, edges=np.tile(real, (len(group), 1)),
        faces=len(group),
    )  # fmt: skip


def note_ghosts(collector: Collector, count: int) -> None:
    """Enter how many cells were left out."""
    if count:
        collector.report.notes.append(
            f"{count} ghost cells (vtkGhostType: copies of cells of other pieces, or hidden) are "
            "left out"
        )
