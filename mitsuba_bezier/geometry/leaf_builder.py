"""From patches to leaves: closed forms first, subdivision for the rest (see `leaves`)."""

from __future__ import annotations

import numpy as np

from .exact_leaves import exact_leaves
from .graph_leaves import subdivide
from .leaves import LeafSettings, Leaves
from .section_leaves import section_leaves
from .triangles import BezierTriangles

__all__ = ["build_leaves"]

#: Patches subdivided at a time: bounds the memory of the build, not its result.
_CHUNK = 4096


def build_leaves(patches: BezierTriangles, settings: LeafSettings | None = None) -> Leaves:
    """Cut `patches` into leaves.

    Parameters
    ----------
    patches : BezierTriangles
        Any degree, any weights.
    settings : LeafSettings, optional
        Thresholds of the subdivision.

    Returns
    -------
    Leaves
        The domains of the leaves of one patch tile its triangle.
    """
    settings = settings or LeafSettings()
    nets = patches.control_points
    numbers = np.arange(len(patches))
    parts: list[Leaves] = []
    if settings.closed_form:
        for find in (exact_leaves, section_leaves)[: 2 if settings.sections else 1]:
            if not len(numbers):
                break
            found, exact = find(patches[numbers])
            if len(exact):
                exact.patch = numbers[exact.patch]
                parts.append(exact)
            numbers, nets = numbers[~found], nets[~found]
    for first in range(0, len(numbers), _CHUNK):
        chunk = slice(first, first + _CHUNK)
        parts.extend(subdivide(nets[chunk], numbers[chunk], settings))
    return Leaves.join(parts)
