"""Cut patches into leaves: those with a closed form first, the rest by subdivision."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from .._threads import one_thread
from ..geometry.proper_nets import free_of_factor, spans_area
from ..geometry.triangles import BezierTriangles
from ..geometry.trim_cells import UntrimmedParts
from ..geometry.trims import Trims
from .closed_form.affine_frames import affine_frames
from .closed_form.degree_reduction import reduce_degree
from .closed_form.groups import in_space_of
from .closed_form.kinds import CLOSED_FORM_KINDS, Finder
from .graph.subdivision import subdivide
from .records import ClosedFormLeaves, GraphLeaves, LeafSettings, Leaves

__all__ = ["build_leaves", "rebuild_leaves"]

#: Patches looked at together, and subdivided: bounds the memory of the build, not its result, but
#: that patches on one quadric on both sides of such a border are two groups.
_CHUNK = 4096


@one_thread()
def build_leaves(
    patches: BezierTriangles, settings: LeafSettings | None = None, trims: Trims | None = None
) -> Leaves:
    """Cut `patches` into leaves.

    Parameters
    ----------
    patches : BezierTriangles
        Any degree, any weights.
    settings : LeafSettings, optional
        Thresholds of the subdivision.
    trims : Trims, optional
        Parts of patches that are trimmed away need no leaves; they may be singular there.

    Returns
    -------
    Leaves
        The domains of the leaves of one patch tile its triangle, or what is left of it. Points and
        curves have none.
    """
    settings = settings or LeafSettings()
    nets = free_of_factor(patches.control_points)
    surfaces = np.flatnonzero(spans_area(nets))
    if len(surfaces) < len(patches):  # no ray meets the others
        if not len(surfaces):
            return Leaves(GraphLeaves.zeros(), ClosedFormLeaves.zeros())
        left_over = None if trims is None else trims[surfaces]
        proper = build_leaves(BezierTriangles(nets[surfaces]), settings, left_over)
        return proper.of_patches(surfaces)
    if nets is not patches.control_points:
        patches = BezierTriangles(nets)
    numbers = np.arange(len(patches))
    parts: list[ClosedFormLeaves] = []
    if settings.closed_form:
        finders = _finders(settings)
        left = np.ones(len(patches), dtype=bool)
        for frame in affine_frames(patches):
            body = patches[frame.which]
            for leaves in _closed_forms(frame.apply(body), finders)[0]:
                parts.append(in_space_of(frame, leaves, body))
                left[parts[-1].patch] = False
        numbers = np.flatnonzero(left)
        if len(numbers):
            others, rest = _closed_forms(patches[numbers], finders)
            parts += [replace(leaves, patch=numbers[leaves.patch]) for leaves in others]
            numbers = numbers[rest]
        nets = nets[numbers]
    graphs: list[GraphLeaves] = []
    # without graph leaves, there is nothing to ask
    wanted = None if trims is None or not len(numbers) else UntrimmedParts(trims)
    for first in range(0, len(numbers), _CHUNK):
        chunk = slice(first, first + _CHUNK)
        graphs.extend(subdivide(nets[chunk], numbers[chunk], settings, wanted))
    return Leaves(GraphLeaves.join(graphs), ClosedFormLeaves.join(parts))


def _finders(settings: LeafSettings) -> list[Finder]:
    """Return what looks for closed forms, in order."""
    wanted = [f for f in CLOSED_FORM_KINDS if settings.sections or f.gives_parameters]
    lower = [f.find for f in wanted if f.of_elevations]
    others = [f.find for f in wanted if not f.of_elevations]
    return [*lower, partial(_elevated_leaves, finders=lower), *others]


def _closed_forms(
    patches: BezierTriangles, finders: Sequence[Finder]
) -> tuple[list[ClosedFormLeaves], np.ndarray]:
    """Let each of `finders` look at what those before it left; return leaves and what is left."""
    parts = []
    numbers = np.arange(len(patches))
    for find in finders:
        left = []
        for first in range(0, len(numbers), _CHUNK):
            chunk = numbers[first : first + _CHUNK]
            found, leaves = find(patches[chunk])
            if len(leaves):
                leaves.patch = chunk[leaves.patch]
                parts.append(leaves)
            left.append(chunk[~found])
        numbers = np.concatenate([numbers[:0], *left])
    return parts, numbers


def _elevated_leaves(
    patches: BezierTriangles, finders: Sequence[Finder]
) -> tuple[np.ndarray, ClosedFormLeaves]:
    """Find patches that are elevations of those that `finders` find."""
    found = np.zeros(len(patches), dtype=bool)
    parts = []
    for degree in range(1, min(patches.degree, 3)):
        numbers = np.flatnonzero(~found)
        if not len(numbers):
            break
        reducible, lower, residual = reduce_degree(patches[numbers], degree)
        if lower is None:
            continue
        for leaves in _closed_forms(lower, finders)[0]:
            leaves.deviation += residual[leaves.patch]
            leaves.patch = numbers[reducible][leaves.patch]
            found[leaves.patch] = True
            parts.append(leaves)
    return found, ClosedFormLeaves.join(parts)


def rebuild_leaves(
    patches: BezierTriangles,
    settings: LeafSettings,
    before: BezierTriangles,
    leaves: Leaves,
    trims: Trims | None = None,
) -> Leaves:
    """Cut `patches` of which only some differ from those `before`, whose `leaves` are known.

    Leaves of a patch depend on its own net alone, unless they have a closed form: these are looked
    for anew.

    Parameters
    ----------
    patches : BezierTriangles
    settings : LeafSettings
        With which `leaves` were built, too.
    before : BezierTriangles
    leaves : Leaves
        Of `before`.
    trims : Trims, optional
        Of both.
    """
    nets, old = patches.control_points, before.control_points
    if nets.shape != old.shape:
        return build_leaves(patches, settings, trims)
    changed = (nets != old).any(axis=(1, 2))
    changed[leaves.closed_form.patch] = True
    if changed.all():
        return build_leaves(patches, settings, trims)
    kept = leaves.select(~changed[leaves.patch])
    if not changed.any():
        return kept
    again = build_leaves(patches[changed], settings, None if trims is None else trims[changed])
    return Leaves.join([kept, again.of_patches(np.flatnonzero(changed))])
