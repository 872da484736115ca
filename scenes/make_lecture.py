"""Write the models of the lecture's scenes: ``python scenes/make_lecture.py``.

Surfaces are written as exact patches, in world coordinates. Thin curves (boundary conics,
threads, drawn lines) are written as control points of Mitsuba's ``bsplinecurve``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

import mitsuba_bezier as mb
from mitsuba_bezier.geometry import plane_shapes
from mitsuba_bezier.geometry.curves import BezierCurve
from mitsuba_bezier.geometry.triangles import BezierTriangles

__all__ = [
    "FOLDER",
    "boxes",
    "figure2",
    "figure2_arcs",
    "main",
    "models",
    "prism",
    "quads",
    "railroad",
    "tube",
]

FOLDER = Path(__file__).resolve().parent / "models"

#: Distance of the inner edges of the rails, and the section of a rail, in metres.
GAUGE, RAIL_WIDTH, RAIL_HEIGHT = 1.435, 0.1, 0.17
#: Height of the ballast above the ground and of the sleepers above the ballast.
BALLAST, SLEEPER = 0.3, 0.08
#: Direction of the track; its ideal point is a control vector of every rail.
TRACK = np.array([0.0, 1.0, 0.0])


# ---------------------------------------------------------------------- building blocks


def quads(corners: Any) -> BezierTriangles:
    """Return plane quadrilaterals ``(N, 4, 3)`` as two linear patches each.

    Corners run counter-clockwise as seen from the side of the normal.
    """
    x = np.asarray(corners, dtype=np.float64).reshape(-1, 4, 3)
    x = np.concatenate([x, np.ones((*x.shape[:2], 1))], axis=-1)
    return BezierTriangles(x[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3, 4))


#: The faces of a box as numbers of its corners, outwards: bottom, top, and the four sides.
_FACES = {
    "-z": (0, 2, 3, 1), "+z": (4, 5, 7, 6),
    "-y": (0, 1, 5, 4), "+y": (2, 6, 7, 3),
    "-x": (0, 4, 6, 2), "+x": (1, 3, 7, 5),
}  # fmt: skip


def boxes(lower: Any, upper: Any, faces: Iterable[str] = tuple(_FACES)) -> BezierTriangles:
    """Return axis-aligned boxes, twelve linear patches each (or fewer faces), outwards.

    Parameters
    ----------
    lower, upper : (N, 3) array_like
        Opposite corners.
    faces : iterable of str
        Which faces: "-x", "+x", ...
    """
    lo, hi = np.atleast_2d(lower), np.atleast_2d(upper)
    bits = np.array([[(k >> c) & 1 for c in range(3)] for k in range(8)], dtype=bool)
    corners = np.where(bits, hi[:, None], lo[:, None])
    return quads(corners[:, [_FACES[f] for f in faces]])


def prism(section: Any, start: float) -> BezierTriangles:
    """Return the half-infinite prism over an open polygon, along +y to the horizon.

    Each side is one linear patch with two corners at y = `start` and the third in the ideal
    point of the y axis.

    Parameters
    ----------
    section : (N, 2) array_like
        Vertices ``(x, z)``; the outside is on the left of the polygon's way, seen along +y.
    start : float
        The y of the front end, which is open.
    """
    p = np.asarray(section, dtype=np.float64)
    ends = np.column_stack([p[:, 0], np.full(len(p), start), p[:, 1], np.ones(len(p))])
    ideal = np.array([*TRACK, 0.0])
    return BezierTriangles([[ideal, a, b] for a, b in zip(ends[:-1], ends[1:])])


def tube(curve: Callable[[np.ndarray], np.ndarray], count: int, radius: float) -> np.ndarray:
    """Return control points ``(count + 3, 4)`` of a cubic B-spline along a curve.

    Parameters
    ----------
    curve : callable
        Points ``(N, 3)`` for parameters ``(N,)``; the curve is drawn over [0, 1] and
        sampled a little beyond.
    count : int
        Number of segments.
    radius : float
        Radius of the tube, the fourth column.

    Returns
    -------
    (count + 3, 4) array
        Rows ``x, y, z, radius``. The quasi-interpolant ``p_i - (p_{i-1} - 2 p_i + p_{i+1}) / 6``
        differs from the curve by the fourth power of the spacing.
    """
    p = curve(np.arange(-2, count + 3) / count)
    c = p[1:-1] - (p[:-2] - 2 * p[1:-1] + p[2:]) / 6
    return np.column_stack([c, np.full(len(c), radius)])


def segment(a: Any, b: Any, radius: float) -> np.ndarray:
    """Return the control points of a straight tube, see `tube`."""
    a, b = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    return tube(lambda t: a + np.multiply.outer(t, b - a), 1, radius)


# ---------------------------------------------------------------------- railroad


def railroad() -> dict[str, BezierTriangles]:
    """Return the parts of the railroad along +y: everything long ends at the horizon."""
    y = 0.65 * np.arange(-12, 600)
    top = BALLAST + SLEEPER
    lower = np.column_stack([np.full(len(y), -1.25), y, np.full(len(y), BALLAST - 0.05)])
    upper = np.column_stack([np.full(len(y), 1.25), y + 0.26, np.full(len(y), top)])
    near = 100  # beyond, only the tops of the sleepers are larger than a pixel
    sleepers = [
        boxes(lower[:near], upper[:near], ("+z", "-y", "-x", "+x")),
        boxes(lower[near:], upper[near:], ("+z",)),
    ]
    behind = -20.0
    ballast = prism([(-2.6, 0), (-1.7, BALLAST), (1.7, BALLAST), (2.6, 0)], behind)
    # wires pass over the arms of the posts
    posts_y = 14.0 * np.arange(1, 45) - 6
    x = -6.0
    size = np.array([0.11, 0.11, 0])
    feet = np.column_stack([np.full(len(posts_y), x), posts_y, np.zeros(len(posts_y))])
    posts = boxes(feet - size, feet + size + [0, 0, 6.3], ("+z", "-y", "-x", "+x"))
    arms = boxes(feet + [-0.9, -0.08, 5.6], feet + [0.9, 0.08, 5.8], ("+z", "-z", "-y", "-x", "+x"))
    wires = [
        prism([(x + a, 5.83), (x + a - 0.015, 5.845), (x + a, 5.86), (x + a + 0.015, 5.845),
               (x + a, 5.83)], behind)
        for a in (-0.8, 0.8)
    ]  # fmt: skip
    return {
        # four wedges around a point under the camera: a whole plane, normal upwards
        "ground": plane_shapes.plane((0, 0, 0), (10, 0, 0), (0, 10, 0)),
        "ballast": ballast,
        "sleepers": BezierTriangles.join(sleepers),
        "rail_left": rail(-1, behind),
        "rail_right": rail(1, behind),
        "posts": BezierTriangles.join([posts, arms]),
        "wires": BezierTriangles.join(wires),
    }


def rail(side: int, start: float) -> BezierTriangles:
    """Return a rail, the left (-1) or the right one (+1): two sides and the head."""
    inner = side * GAUGE / 2
    a, b = sorted((inner, inner + side * RAIL_WIDTH))
    low = BALLAST + SLEEPER
    return prism([(a, low), (a, low + RAIL_HEIGHT), (b, low + RAIL_HEIGHT), (b, low)], start)


# ---------------------------------------------------------------------- figure 2


def figure2() -> dict[str, BezierTriangles]:
    """Return the ten patches of the tetrahedral cover of the unit sphere, one by one."""
    cover = mb.sphere(cover="tetrahedral")
    names = [f"face_{k}" for k in range(4)] + [f"lune_{k}" for k in range(6)]
    return {name: cover[k] for k, name in enumerate(names)}


def figure2_arcs() -> list[BezierCurve]:
    """Return the twelve boundary conics: the edges of the four faces."""
    nets = mb.sphere(cover="tetrahedral").control_points[:4]
    return [BezierCurve(net[list(e)]) for net in nets for e in ((0, 1, 3), (3, 4, 5), (5, 2, 0))]


# ---------------------------------------------------------------------- files


def write_tubes(name: str, tubes: Iterable[np.ndarray]) -> None:
    """Write tubes as a file of Mitsuba's ``bsplinecurve``."""
    lines = ["\n".join(" ".join(f"{x:.7g}" for x in row) for row in t) for t in tubes]
    (FOLDER / f"{name}.txt").write_text("\n\n".join(lines) + "\n")


def models() -> dict[str, dict[str, BezierTriangles]]:
    """Return the patches of all scenes: ``models()[scene][part]``."""
    return {"railroad": railroad(), "figure2": figure2()}


def main() -> None:
    """Write all files."""
    FOLDER.mkdir(exist_ok=True)
    for scene, parts in models().items():
        for name, patches in parts.items():
            patches.save(FOLDER / f"{scene}_{name}.vtu")
    write_tubes("figure2_conics", (tube(c.points, 24, 0.016) for c in figure2_arcs()))


if __name__ == "__main__":
    main()
