"""The kinds of leaves with a closed form: what finds them, and what bounds them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...geometry.triangles import BezierTriangles
from ..records import ClosedFormLeaves, LeafKind
from .inverted import inverted_leaves, margin_planes
from .plane_sections import edge_planes, section_leaves
from .sectors import cone_planes, sector_leaves
from .stereographic import linear_leaves

__all__ = ["CLOSED_FORM_KINDS", "ClosedForm", "Finder", "bounding_planes"]

#: Finds patches with a closed form; returns a mask of them, and their leaves.
Finder = Callable[[BezierTriangles], tuple[np.ndarray, ClosedFormLeaves]]


@dataclass(frozen=True)
class ClosedForm:
    """A closed form that patches may have."""

    find: Finder
    kinds: tuple[LeafKind, ...]  #: of the leaves it finds
    #: Returns planes ``(L, 3, 4)``, rows on ``(p - shift, 1)`` that are not negative on a leaf.
    #: None where the leaves' rows give multiples of barycentrics, positive or negative.
    planes: Callable[[ClosedFormLeaves], np.ndarray] | None
    of_elevations: bool  #: whether it is looked for in nets that are reduced in degree, too
    gives_parameters: bool  #: whether the parameters of every hit are known, as trims need them


#: All closed forms, the fastest first.
CLOSED_FORM_KINDS = (
    ClosedForm(linear_leaves, (LeafKind.LINEAR,), None, True, True),
    ClosedForm(sector_leaves, (LeafKind.CONE,), cone_planes, True, False),
    ClosedForm(section_leaves, (LeafKind.PLANE_SECTIONS,), edge_planes, False, False),
    ClosedForm(
        inverted_leaves, (LeafKind.INVERTED, LeafKind.INVERTED_APEX), margin_planes, False, True
    ),
)


def bounding_planes(leaves: ClosedFormLeaves) -> tuple[np.ndarray, np.ndarray]:
    """Return planes ``(L, 3, 4)``, or the rows of leaves without any, and a mask of the others."""
    planes = leaves.rows[:, :3].copy()
    bounded = np.zeros(len(leaves), dtype=bool)
    for form in CLOSED_FORM_KINDS:
        which = np.flatnonzero(leaves.is_one_of(frozenset(form.kinds)))
        if form.planes is not None and len(which):
            planes[which] = form.planes(leaves.select(which))
            bounded[which] = True
    return planes, bounded
