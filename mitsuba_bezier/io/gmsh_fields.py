"""Fields of Gmsh files: the sections ``$NodeData``, ``$ElementData`` and ``$ElementNodeData``.

Source: the Gmsh reference manual, "Gmsh file formats".
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .cells import CellField

__all__ = ["SECTIONS", "View", "named_views", "read_view"]

#: The sections, and what their rows belong to.
SECTIONS = {"NodeData": "node", "ElementData": "element", "ElementNodeData": "element node"}

#: Components that Gmsh knows: scalars, vectors, tensors.
_COMPONENTS = (1, 3, 9)


@dataclass
class View:
    """One section: numbers of nodes or elements, and their values.

    Attributes
    ----------
    kind : str
        One of the values of `SECTIONS`.
    name : str
    step : int
        Number of the time step.
    components : int
    tags : (N,) int array
    values : (N, c) array
        For ``"element node"`` by number of nodes: `groups`.
    groups : dict
        Number of nodes to ``(tags, (N, nodes, c) values)``.
    scheme : str
        Name of an interpolation scheme, which is not read.
    """

    kind: str
    name: str
    step: int
    components: int
    scheme: str = ""
    tags: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    values: np.ndarray = field(default_factory=lambda: np.zeros((0, 1)))
    groups: dict[int, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)

    def at_nodes(self, tags: np.ndarray) -> np.ndarray:
        """Return the values at nodes of these numbers, NaN where there is none."""
        return self._found(self.tags, self.values, tags)

    def _found(self, own: np.ndarray, values: np.ndarray, tags: np.ndarray) -> np.ndarray:
        out = np.full((len(tags), *values.shape[1:]), np.nan)
        if len(own):
            order = np.argsort(own, kind="stable")
            at = np.minimum(np.searchsorted(own[order], tags), len(own) - 1)
            same = own[order][at] == tags
            out[same] = values[order[at[same]]]
        return out

    def on_cells(
        self, elements: np.ndarray, lattice: np.ndarray, rows: np.ndarray, nodes: np.ndarray
    ) -> CellField | None:
        """Return the field on elements.

        Parameters
        ----------
        elements : (C,) int array
            Their numbers.
        lattice : (K, d) int array
        rows : (C, K) int array
            Their nodes.
        nodes : (N, c) array
            What `at_nodes` tells of all nodes.
        """
        if self.kind == "node":
            return CellField(lattice, rows, nodes)
        count = len(elements)
        if self.kind == "element":
            values = self._found(self.tags, self.values, elements)
            return CellField(0 * lattice[:1], np.arange(count)[:, None], values)
        linear = lattice[_is_corner(lattice)] // lattice.max()
        wanted = {len(linear): linear, len(lattice): lattice}
        for size, (tags, values) in self.groups.items():
            if size in wanted and np.isin(elements, tags).any():
                found = self._found(tags, values, elements).reshape(-1, values.shape[2])
                index = np.arange(count * size).reshape(count, size)
                return CellField(wanted[size], index, found)
        return None


def _is_corner(lattice: np.ndarray) -> np.ndarray:
    """Return a mask of the corners: the first ones of Gmsh's elements."""
    top = lattice.max()
    return ((lattice == 0) | (lattice == top)).all(axis=1)


def read_view(file: Any, section: str) -> View:
    """Read a section, from after its name; see `gmsh` for `file`.

    Raises
    ------
    FileFormatError
        If it is damaged.
    """
    strings = [file.quoted() for _ in range(_small(file, "string tags"))]
    reals = [file.real() for _ in range(_small(file, "real tags"))]
    integers = [file.integer() for _ in range(_small(file, "integer tags"))]
    if len(integers) < 3:
        raise file.error("three integer tags: step, components, entries", str(integers))
    step, components, count = integers[:3]
    if components not in _COMPONENTS:
        raise file.error("1, 3 or 9 components", components)
    if not 0 <= count <= file.size:
        raise file.error("a number of entries that fits the size of the file", count)
    del reals
    view = View(
        SECTIONS[section],
        strings[0] if strings else section,
        step,
        components,
        strings[1] if len(strings) > 1 else "",
    )
    if section != "ElementNodeData":
        view.tags, values = file.rows(count, components)
        view.values = values
        return view
    gathered: dict[int, tuple[list[int], list[np.ndarray]]] = {}
    for _ in range(count):
        tag, size = file.pair()
        if not 1 <= size <= 10_000:
            raise file.error("a number of nodes", size)
        tags, parts = gathered.setdefault(size, ([], []))
        tags.append(tag)
        parts.append(file.take("f8", size * components, "values"))
    for size, (tags, parts) in gathered.items():
        view.groups[size] = np.array(tags), np.array(parts).reshape(-1, size, components)
    return view


def _small(file: Any, what: str) -> int:
    count = file.integer()
    if not 0 <= count <= 100:
        raise file.error(f"a number of {what}", count)
    return count


def named_views(views: list[View]) -> dict[str, View]:
    """Return views by names: of several steps the last has the name, the others ``NAME@STEP``."""
    out: dict[str, View] = {}
    last: dict[tuple[str, str], View] = {}
    for view in views:
        key = (view.name, view.kind)
        if key not in last or view.step >= last[key].step:
            last[key] = view
    for view in views:
        name = view.name
        if last[view.name, view.kind] is not view:
            name = f"{name}@{view.step}"
        elif name in out:
            name = f"{name} ({view.kind}s)"
        out[name] = view
    return out
