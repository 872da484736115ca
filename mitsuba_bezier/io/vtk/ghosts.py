"""Find cells of a ``.vtu`` file that must not be seen: ghosts of other pieces, hidden cells.

VTK marks them in the cell array ``vtkGhostType``, bit by bit; old files have ``vtkGhostLevels``. A
cell with a hidden point is hidden, too.

Source: vtkDataSetAttributes, https://vtk.org/doc/nightly/html/classvtkDataSetAttributes.html
"""

from __future__ import annotations

import numpy as np

from ..files import damaged
from .xml import Element, VtkXml

__all__ = ["ghost_cells", "hidden_points"]

_TYPE, _LEVELS = "vtkGhostType", "vtkGhostLevels"

_DUPLICATE_CELL, _REFINED_CELL, _HIDDEN_CELL = 1, 8, 32
_HIDDEN_POINT = 2


def ghost_cells(xml: VtkXml, piece: Element, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return which of the `count` cells of a piece are copies, and which are hidden, ``(count,)``.

    A copy shows nothing, but what lies behind it is no boundary of the piece. A hidden cell, or
    one that finer cells replace, is as if it were not there.
    """
    data = piece.first("CellData")
    bits = _values(xml, data, _TYPE, count)
    copies = (bits & _DUPLICATE_CELL != 0) | (_values(xml, data, _LEVELS, count) > 0)
    return copies, bits & (_HIDDEN_CELL | _REFINED_CELL) != 0


def hidden_points(xml: VtkXml, piece: Element, count: int) -> np.ndarray:
    """Return which of the `count` points of a piece are hidden, ``(count,)``."""
    return _values(xml, piece.first("PointData"), _TYPE, count) & _HIDDEN_POINT != 0


def _values(xml: VtkXml, data: Element | None, name: str, count: int) -> np.ndarray:
    for element in data.all("DataArray") if data is not None else ():
        if element.attributes.get("Name") == name:
            components = element.attributes.get("NumberOfComponents", "1")
            if components != "1":
                raise damaged(xml.path, f"1 component in {name!r}", components, line=element.line)
            return xml.array(element, count, "integer")
    return np.zeros(count, np.int64)
