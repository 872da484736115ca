"""The surface of a volume mesh: faces of cells that belong to one cell only."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from .cells import CellField, Cells, add_cells
from .report import Collector

__all__ = ["VOLUMES", "add_surface", "corner_keys", "corner_keys_of_faces", "part_of"]

#: Kinds of cells that have a surface.
VOLUMES = ("tetra", "hexahedron", "wedge", "pyramid")


def _sides(kind: str, lattice: np.ndarray) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Yield the faces of a cell: their kind, which nodes are on them, and where these lie there.

    Normals point outward where the directions of the lattice are right-handed.
    """
    if kind == "tetra":
        for missing, corners in {3: (0, 2, 1), 2: (0, 1, 3), 0: (1, 2, 3), 1: (0, 3, 2)}.items():
            on = lattice[:, missing] == 0
            yield "triangle", on, lattice[on][:, corners]
    elif kind == "hexahedron":
        for axis in range(3):
            first, second = (axis + 1) % 3, (axis + 2) % 3
            for side, axes in ((lattice[:, axis].max(), (first, second)), (0, (second, first))):
                on = lattice[:, axis] == side
                yield "quad", on, lattice[on][:, axes]
    elif kind == "wedge":  # a triangle of corners A, B, C along a line
        for side, corners in ((0, (0, 2, 1)), (lattice[:, 3].max(), (0, 1, 2))):
            on = lattice[:, 3] == side
            yield "triangle", on, lattice[on][:, corners]
        for missing, along in ((2, 1), (0, 2), (1, 0)):
            on = lattice[:, missing] == 0
            yield "quad", on, lattice[on][:, (along, 3)]
    else:  # a pyramid: i and j run to n - k
        i, j, k = lattice.T
        n = k.max()
        on = k == 0
        yield "quad", on, lattice[on][:, (1, 0)]
        rest = n - k
        for on, first, second in (
            (j == 0, rest - i, i),
            (i == rest, rest - j, j),
            (j == rest, i, rest - i),
            (i == 0, j, rest - j),
        ):
            yield "triangle", on, np.stack([first, second, k], axis=1)[on]


def _turned(kind: str, lattice: np.ndarray) -> np.ndarray:
    """Return where nodes of a face lie as seen from its other side."""
    return lattice[:, (1, 0)] if kind == "quad" else lattice[:, (0, 2, 1)]


def _handed(cells: Cells, points: np.ndarray) -> np.ndarray:
    """Return a mask of the left-handed cells, ``(C,)``.

    Files order the nodes of wedges both ways, and of other cells sometimes.
    """
    x = cells.lattice.astype(np.float64)
    if cells.kind == "tetra" or cells.kind == "wedge":
        x = x[:, 1:]
    elif cells.kind == "pyramid":
        x[:, :2] += x[:, 2:] / 2
    x = x - x.mean(axis=0)
    weight = points[:, 3:]
    with np.errstate(divide="ignore", invalid="ignore"):
        euclidean = np.where(weight != 0, points[:, :3] / weight, points[:, :3])
    jacobian = np.einsum("kd,pkc->pdc", x, euclidean[cells.nodes])
    return np.linalg.det(jacobian) < 0


def part_of(cells: Cells, chosen: np.ndarray) -> Cells:
    """Return some of the cells."""
    fields = {k: replace(f, nodes=f.nodes[chosen]) for k, f in cells.fields.items()}
    copies = None if cells.copies is None else cells.copies[chosen]
    return replace(cells, nodes=cells.nodes[chosen], copies=copies, fields=fields)


def _faces(cells: Cells, points: np.ndarray) -> list[Cells]:
    """Return the faces of volume cells, normals pointing outward, in the order of the cells."""
    left = _handed(cells, points)
    if left.any() and not left.all():
        return [face for part in (~left, left) for face in _faces(part_of(cells, part), points)]
    turn = bool(left.any())

    def placed(kind: str, lattice: np.ndarray) -> np.ndarray:
        return _turned(kind, lattice) if turn else lattice

    out = []
    of_fields = {name: list(_sides(cells.kind, own.lattice)) for name, own in cells.fields.items()}
    for number, (kind, on, lattice) in enumerate(_sides(cells.kind, cells.lattice)):
        fields: dict[str, CellField] = {}
        for name, own in cells.fields.items():
            _kind, there, own_lattice = of_fields[name][number]
            fields[name] = replace(
                own, lattice=placed(kind, own_lattice), nodes=own.nodes[:, there]
            )
        out.append(
            Cells(
                kind,
                _whole(kind, placed(kind, lattice)),
                cells.nodes[:, on],
                cells.bezier,
                cells.copies,
                cells.spacing,
                {k: replace(f, lattice=_whole(kind, f.lattice)) for k, f in fields.items()},
            )
        )
    return out


def _whole(kind: str, lattice: np.ndarray) -> np.ndarray:
    """Return a lattice without a common factor (that of `cell_lattices` with middles of faces)."""
    if kind == "triangle":
        n = int(lattice[0].sum())
        if n == 6 and len(lattice) < 7:  # of middles of faces this face has none
            return lattice // (3 if len(lattice) == 6 else 6)
    elif lattice.max() == 6 and len(lattice) <= 9:
        return lattice // (3 if (lattice == 3).any() else 6)
    return lattice


def corner_keys(cells: Cells) -> np.ndarray:
    """Return the sorted corner nodes of each face, ``(C, 4)``; -1 fills up triangles."""
    if cells.kind == "triangle":
        n = cells.lattice[0].sum()
        corners = cells.nodes[:, (cells.lattice == n).any(axis=1)]
    else:
        ends = (cells.lattice == 0) | (cells.lattice == cells.lattice.max(axis=0))
        corners = cells.nodes[:, ends.all(axis=1)]
    keys = np.full((len(corners), 4), -1)
    keys[:, : corners.shape[1]] = np.sort(corners, axis=1)
    return keys


def corner_keys_of_faces(cells: Cells) -> np.ndarray:
    """Return what `corner_keys` does, of all faces of volume cells."""
    sides = _sides(cells.kind, cells.lattice)
    return np.concatenate(
        [corner_keys(Cells(kind, lattice, cells.nodes[:, on])) for kind, on, lattice in sides]
    )


def add_surface(
    collector: Collector,
    volumes: list[Cells],
    surfaces: list[Cells],
    points: np.ndarray,
    first: int,
) -> None:
    """Convert the faces that belong to one volume cell only: the surface of a volume mesh.

    Parameters
    ----------
    collector : Collector
        Where they go.
    volumes : list of Cells
        Of the kinds `VOLUMES`.
    surfaces : list of Cells
        Triangles and quadrilaterals that are in the file themselves: where one of them lies on
        the surface, it is not converted twice.
    points : (N, 4) array
        Homogeneous points.
    first : int
        The number the first face gets.
    """
    faces = [face for cells in volumes for face in _faces(cells, points)]
    if not faces:
        return
    keys = np.concatenate([corner_keys(face) for face in faces])
    _unique, inverse, count = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
    outer = count[inverse.ravel()] == 1
    outer &= ~np.concatenate(
        [np.zeros(len(f.nodes), bool) if f.copies is None else f.copies for f in faces]
    )
    if surfaces:
        given = np.concatenate([corner_keys(cells) for cells in surfaces])
        both = np.concatenate([given, keys])
        _unique, index, inverse = np.unique(both, axis=0, return_index=True, return_inverse=True)
        outer &= index[inverse.ravel()[len(given) :]] >= len(given)
    numbers = first + np.cumsum(outer) - 1
    start = 0
    for face in faces:
        here = slice(start, start + len(face.nodes))
        start = here.stop
        chosen = outer[here]
        if chosen.any():
            part = replace(part_of(face, chosen), copies=None)
            add_cells(collector, part, points, numbers[here][chosen])
    cells = sum(len(v.nodes) for v in volumes)
    collector.report.remarks.append(
        f"the surface of {cells} volume cells: {outer.sum()} faces that belong to one cell only"
    )
