"""Choose the parts of a model that are shown, by name, layer or pattern."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase

import numpy as np

from ..errors import BezierError
from ..io.parts import Part

__all__ = ["Selection", "exploded", "matching", "renamed", "selected"]


@dataclass(frozen=True)
class Selection:
    """Parts that are shown.

    Attributes
    ----------
    only, hide : tuple of str
        Names of parts, of places (``assembly/part``), of layers, or patterns (``bolt*``); without
        `only` all parts are shown that the file shows.
    """

    only: tuple[str, ...] = ()
    hide: tuple[str, ...] = ()


def _fits(name: str, pattern: str) -> bool:
    name, pattern = name.lower(), pattern.lower()
    return name == pattern or fnmatchcase(name, pattern)


def _places(part: Part, pattern: str) -> np.ndarray:
    """Return a mask of which places of a part a pattern names."""
    if _fits(part.name, pattern) or (part.layer and _fits(part.layer, pattern)):
        return np.ones(len(part.placements), dtype=bool)
    return np.array([_on_path(place, pattern) for place in part.places], dtype=bool)


def _on_path(place: str, pattern: str) -> bool:
    """Return whether a pattern names a place, an assembly it is in, or the end of its path."""
    steps = place.split("/")
    ends = ["/".join(steps[k:m]) for k in range(len(steps)) for m in range(k + 1, len(steps) + 1)]
    return any(_fits(end, pattern) for end in ends)


def matching(parts: Sequence[Part], pattern: str, parameter: str) -> list[Part]:
    """Return the parts that a pattern names.

    Raises
    ------
    BezierError
        If there are none; the nearest names are told.
    """
    found = [part for part in parts if _places(part, pattern).any()]
    if not found:
        names = list(dict.fromkeys(part.name for part in parts))
        known = {name.lower(): name for name in names}
        known |= {
            step.lower(): step for p in parts for place in p.places for step in place.split("/")
        }
        known |= {part.layer.lower(): part.layer for part in parts if part.layer}
        near = [
            known[k] for k in difflib.get_close_matches(pattern.lower(), known, n=3, cutoff=0.5)
        ]
        listed = ", ".join(names[:12]) + (", ..." if len(names) > 12 else "")
        hint = f"did you mean {' or '.join(map(repr, near))}?" if near else f"there are {listed}"
        raise BezierError.expected(parameter, "the name of a part", f"{pattern!r} ({hint})")
    return found


def selected(parts: Sequence[Part], selection: Selection) -> list[Part]:
    """Return the parts that are shown, each with its places that are.

    Raises
    ------
    BezierError
        If a name is none, or nothing is left.
    """
    for parameter, patterns in (("only", selection.only), ("hide", selection.hide)):
        for pattern in patterns:
            matching(parts, pattern, parameter)
    out = []
    for part in parts:
        shown = np.full(len(part.placements), part.visible and not selection.only)
        for pattern in selection.only:
            shown |= _places(part, pattern)
        for pattern in selection.hide:
            shown &= ~_places(part, pattern)
        if shown.any():
            places = [place for place, seen in zip(part.places, shown) if seen]
            out.append(replace(part, placements=part.placements[shown], places=places))
    if not out:
        raise BezierError.expected(
            "only, hide", "at least one part that is shown", f"none of {len(parts)}"
        )
    return out


def renamed(parts: Sequence[Part]) -> list[Part]:
    """Return parts of several models with names that no two of them have."""
    taken: set[str] = set()
    out = []
    for part in parts:
        name, k = part.name, 1
        while name in taken:
            k += 1
            name = f"{part.name}.{k}"
        taken.add(name)
        out.append(part if name == part.name else replace(part, name=name))
    return out


def exploded(parts: Sequence[Part], factor: float) -> list[Part]:
    """Return parts whose places are moved away from the middle of all.

    Parameters
    ----------
    parts : sequence of Part
    factor : float
        How far, relative to the distance of a place's middle from that of all.
    """
    from .bounds import surface_points

    middles = []
    for part in parts:
        own = surface_points([replace(part, placements=np.eye(4)[None], places=[part.name])])
        middle = (own.min(axis=0) + own.max(axis=0)) / 2
        middles.append(part.placements[:, :3, :3] @ middle + part.placements[:, :3, 3])
    every = np.concatenate(middles)
    centre = (every.min(axis=0) + every.max(axis=0)) / 2
    out = []
    for part, own in zip(parts, middles):
        placements = part.placements.copy()
        placements[:, :3, 3] += factor * (own - centre)
        out.append(replace(part, placements=placements))
    return out
