"""Hold the parts of a model: what a file tells apart by name, colour and place.

A part holds its nets once, in its own coordinates, and the places where it stands. The nets of a
`Model` are those of all places, one after the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ..geometry.triangles import BezierTriangles
from ..geometry.trims import Trims

__all__ = ["Colour", "Part", "flattened", "srgb"]

#: Linear RGB, each from 0 to 1.
Colour = tuple[float, float, float]


@dataclass
class Part:
    """A part of a model.

    Attributes
    ----------
    name : str
        No two parts of a model have the same.
    groups : list of BezierTriangles
        The patches in the part's own coordinates, one group for each degree, lowest first.
    sources : list of (P,) int arrays
        For each group, the number of the face, within the part, that each patch comes from.
    trims : list of (Trims or None)
        For each group the trims of its patches, None if they are whole.
    placements : (N, 4, 4) array
        Affine maps from the part's coordinates to those of the model: the part stands N times.
    places : list of str
        The name of each placement: the path through the assembly, with ``/`` between.
    colour : (float, float, float) or None
        Linear RGB; None if the file tells none.
    paints : list of colours
        Those of faces that have a colour of their own.
    painted : list of (P,) int arrays
        For each group, the number in `paints` of each patch, -1 for the colour of the part. Empty
        if no face has its own.
    layer, material : str
        What the file says, empty if nothing.
    visible : bool
        Whether the file shows it.
    faces : int
        Faces of the file it was made of, at one place.
    """

    name: str
    groups: list[BezierTriangles]
    sources: list[np.ndarray]
    trims: list[Trims | None]
    placements: np.ndarray = field(default_factory=lambda: np.eye(4)[None])
    places: list[str] = field(default_factory=list)
    colour: Colour | None = None
    paints: list[Colour] = field(default_factory=list)
    painted: list[np.ndarray] = field(default_factory=list)
    layer: str = ""
    material: str = ""
    visible: bool = True
    faces: int = 0

    def __post_init__(self) -> None:
        if not self.places:
            many = len(self.placements) > 1
            self.places = [
                f"{self.name}.{k + 1}" if many else self.name for k in range(len(self.placements))
            ]
        if not self.trims:
            self.trims = [None] * len(self.groups)
        self.faces = self.faces or 1 + max(
            (int(source.max()) for source in self.sources if len(source)), default=-1
        )

    def __len__(self) -> int:
        """Return the number of patches, at one place."""
        return sum(map(len, self.groups))

    def paint_of(self, group: int) -> np.ndarray:
        """Return the number in `paints` of each patch of a group, -1 for the part's colour."""
        if self.painted:
            return self.painted[group]
        return np.full(len(self.groups[group]), -1)


def flattened(
    parts: Sequence[Part],
) -> tuple[list[BezierTriangles], list[np.ndarray], list[Trims | None]]:
    """Return the patches of all places of parts: groups by degree, sources and trims.

    Faces are numbered through, place by place.
    """
    found: dict[int, list[tuple[np.ndarray, np.ndarray, Trims | None]]] = {}
    first = 0
    for part in parts:
        for matrix in part.placements:
            for group, source, trims in zip(part.groups, part.sources, part.trims):
                nets = group.control_points
                if (matrix != np.eye(4)).any():
                    nets = nets @ matrix.T
                found.setdefault(group.degree, []).append((nets, source + first, trims))
            first += part.faces
    groups, sources = [], []
    all_trims: list[Trims | None] = []
    for degree in sorted(found):
        pieces = found[degree]
        groups.append(BezierTriangles(np.concatenate([nets for nets, _s, _t in pieces])))
        sources.append(np.concatenate([source for _n, source, _t in pieces]))
        if all(trims is None for _n, _s, trims in pieces):
            all_trims.append(None)
        else:
            filled = [Trims.none(len(n)) if t is None else t for n, _s, t in pieces]
            all_trims.append(Trims.join(filled))
    some = any(trims is not None for trims in all_trims)
    return groups, sources, all_trims if some else []


def srgb(colour: Colour) -> str:
    """Return a linear colour as ``#rrggbb``."""
    x = np.clip(np.array(colour, dtype=np.float64), 0.0, 1.0)
    encoded = np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
    return "#" + "".join(f"{round(255 * v):02x}" for v in encoded.tolist())
