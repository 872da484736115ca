"""Fields of Bézier triangles as arrays of ``.vtu`` files.

What other programs can show is an array as theirs are: constants are cell data, and polynomials of
at most the degree of the patches, if those have no weights, are point data. All others are cell
arrays of our own, which VTK keeps but does not know, of the name ``BezierField.C.R.NAME``: `C`
components and, where `R` is 1, the weights, for each ordinate of a patch in net order.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from ...errors import FileFormatError
from ...geometry import bernstein
from ...geometry.fields import BezierField
from ...geometry.triangles import BezierTriangles
from ..lattices import triangle_lattice

__all__ = ["SIDES", "field_arrays", "own_field", "own_name"]

#: Cell array of three numbers: which sides of a patch are sides of a face.
SIDES = "ElementSides"

_OWN = re.compile(r"BezierField\.(\d{1,4})\.([01])\.(.*)", re.DOTALL)


def field_arrays(
    patches: BezierTriangles, fields: Sequence[BezierField], edges: np.ndarray | None
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Return point and cell arrays by name.

    Raises
    ------
    FileFormatError
        If a field, or `edges`, is of another number of patches.
    """
    count, degree = len(patches), patches.degree
    weight = patches.control_points[..., 3]
    plain = bool((weight == 1).all())
    rows = [bernstein.row(degree, i, j) for i, j, _k in triangle_lattice(degree).tolist()]
    points: dict[str, np.ndarray] = {}
    cells: dict[str, np.ndarray] = {}
    for field in fields:
        if len(field) != count:
            raise FileFormatError.expected(f"field {field.name!r}", f"{count} patches", len(field))
        if field.weights is None and field.degree == 0:
            cells[field.name] = field.ordinates[:, 0]
        elif field.weights is None and plain and field.degree <= degree:
            elevated = field.elevate(degree).ordinates
            points[field.name] = elevated[:, rows].reshape(-1, field.components)
        else:
            values = field.ordinates
            if field.weights is not None:
                values = np.concatenate([values, field.weights[..., None]], axis=2)
            cells[own_name(field)] = values.reshape(count, -1)
    if edges is not None:
        sides = np.asarray(edges, dtype=np.float64)
        if sides.shape != (count, 3):
            raise FileFormatError.expected("edges", f"shape ({count}, 3)", f"{sides.shape}")
        cells[SIDES] = sides
    return points, cells


def own_name(field: BezierField) -> str:
    """Return what an array of our own is called."""
    return f"BezierField.{field.components}.{int(field.weights is not None)}.{field.name}"


def own_field(name: str, values: np.ndarray) -> tuple[str, int, bool] | None:
    """Return name, components and whether there are weights, of a cell array of our own.

    None for any other array, and for one of a number of ordinates that is none.
    """
    match = _OWN.fullmatch(name)
    if not match:
        return None
    components, rational = int(match[1]), match[2] == "1"
    size, rest = divmod(values.shape[1], max(components + rational, 1))
    known = {bernstein.size(n) for n in range(41)}
    return (match[3], components, rational) if not rest and size in known and components else None
