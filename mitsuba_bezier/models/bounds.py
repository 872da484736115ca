"""Find points of the surface of parts, trims applied: what a camera has to see, and the lowest."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..errors import BezierError
from ..geometry import bernstein
from ..geometry.boxes import reaches_infinity
from ..geometry.proper_nets import spans_area
from ..geometry.triangles import BezierTriangles
from ..geometry.trims import Trims
from ..io.parts import Part

__all__ = ["check_finite", "lowest", "surface_points"]

#: Points that are looked at in all, roughly, and patches of a step.
_POINTS, _CHUNK = 60_000, 2048
#: Divisions of a patch's edges: at least, and at most.
_LEAST, _MOST = 3, 24
#: Points from which the lowest is sought, and steps that halve their distance.
_SEEDS, _STEPS = 24, 12


def check_finite(parts: Sequence[Part], name: str) -> None:
    """Make sure that parts are surfaces in finite space, and have a size.

    Raises
    ------
    BezierError
        If not.
    """
    if not any(len(part) for part in parts):
        raise BezierError.expected(name, "a model with a surface", "one without")
    area = False
    for part in parts:
        for group in part.groups:
            count = int(reaches_infinity(group.control_points).sum())
            if count:
                raise BezierError.expected(
                    name,
                    "a surface of finite size, around which a camera can be placed",
                    f"{count} patches of {part.name} that reach infinity (give a scene instead)",
                )
            area = area or bool(spans_area(group.control_points).any())
    if not area:
        raise BezierError.expected(name, "a surface", "points or curves only, of no area")


def _lattice(divisions: int) -> np.ndarray:
    return bernstein.multi_indices(divisions)[:, :2] / divisions


def _affine(h: np.ndarray) -> np.ndarray:
    with np.errstate(all="ignore"):
        points = h[..., :3] / h[..., 3:]
    return points


def _inside(trims: Trims | None, patch: np.ndarray, uv: np.ndarray) -> np.ndarray:
    if trims is None:
        return np.ones(len(patch), dtype=bool)
    return np.asarray(trims.inside(patch, uv))


def _group_points(
    group: BezierTriangles, trims: Trims | None, divisions: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return points of a group on a lattice of each patch, their patches and parameters."""
    uv = _lattice(divisions)
    basis = bernstein.basis(group.degree, uv)
    out, patches, places = [], [], []
    for first in range(0, len(group), _CHUNK):
        nets = group.control_points[first : first + _CHUNK]
        points = _affine(basis @ nets).reshape(-1, 3)
        patch = np.repeat(np.arange(first, first + len(nets)), len(uv))
        at = np.tile(uv, (len(nets), 1))
        good = np.isfinite(points).all(axis=1)
        good[good] &= _inside(trims, patch[good], at[good])
        out.append(points[good])
        patches.append(patch[good])
        places.append(at[good])
    return np.concatenate(out), np.concatenate(patches), np.concatenate(places)


def _divisions(parts: Sequence[Part]) -> int:
    count = max(sum(len(part) for part in parts), 1)
    return int(np.clip(np.sqrt(2 * _POINTS / count), _LEAST, _MOST))


def surface_points(parts: Sequence[Part]) -> np.ndarray:
    """Return points ``(N, 3)`` of all places of parts, close enough to frame a picture by.

    They lie on the surface as it is trimmed, so that what is cut away needs no room.
    """
    divisions = _divisions(parts)
    out = []
    for part in parts:
        for group, trims in zip(part.groups, part.trims):
            points = _group_points(group, trims, divisions)[0]
            if not len(points):  # a sliver between the points of the lattice
                points = _group_points(group, None, 1)[0]
            out += [points @ m[:3, :3].T + m[:3, 3] for m in part.placements]
    return np.concatenate(out)


def lowest(parts: Sequence[Part], up: Any) -> float:
    """Return the smallest coordinate of a surface along a direction, nearly to rounding.

    The lowest points of a lattice are starting points; steps around them, half as wide each time,
    find the lowest point of the surface near them.
    """
    up = np.asarray(up, dtype=np.float64)
    divisions = _divisions(parts)
    best = np.inf
    for part in parts:
        for group, trims in zip(part.groups, part.trims):
            points, patch, uv = _group_points(group, trims, divisions)
            if not len(points):
                continue
            for matrix in part.placements:
                direction = up @ matrix[:3, :3]
                heights = points @ direction
                seeds = np.argsort(heights)[:_SEEDS]
                height = _descend(
                    group, trims, direction, patch[seeds], uv[seeds], heights[seeds], divisions
                )
                best = min(best, height + float(up @ matrix[:3, 3]))
    return best


def _descend(
    group: BezierTriangles,
    trims: Trims | None,
    direction: np.ndarray,
    patch: np.ndarray,
    uv: np.ndarray,
    height: np.ndarray,
    divisions: int,
) -> float:
    around = np.array([[i, j] for i in (-1, 0, 1) for j in (-1, 0, 1)], dtype=np.float64)
    step = 0.5 / divisions
    for _ in range(_STEPS):
        at = (uv[:, None] + step * around).clip(0.0, 1.0)
        beyond = np.maximum(at.sum(axis=-1, keepdims=True) - 1.0, 0.0)
        at = (at - beyond / 2).clip(0.0, 1.0).reshape(-1, 2)
        which = np.repeat(patch, len(around))
        h = _affine(group.evaluate(which, at)) @ direction
        h = np.where(np.isfinite(h), h, np.inf)
        lower = h < np.repeat(height, len(around))
        lower[lower] &= _inside(trims, which[lower], at[lower])
        h = np.where(lower, h, np.inf).reshape(len(patch), -1)
        pick = h.argmin(axis=1)
        better = h[np.arange(len(patch)), pick] < height
        uv = np.where(better[:, None], at.reshape(len(patch), -1, 2)[range(len(patch)), pick], uv)
        height = np.where(better, h[np.arange(len(patch)), pick], height)
        step /= 2
    return float(height.min())
