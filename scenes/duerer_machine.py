"""Dürer's machine for drawing a lute (woodcut of 1525), for `make_lecture`.

The eye is a hook in the wall; threads lead from it through a frame to points of the lute. Where a
thread pierces the plane of the frame, x = 0, the drawing has its point. So the drawing is the
central projection of the lute from the eye, and a projected Bézier curve is the Bézier curve of
the projected control points.
"""

from __future__ import annotations

import numpy as np
from lecture_tools import boxes

from mitsuba_bezier.geometry import shapes
from mitsuba_bezier.geometry.collineations import central_projection
from mitsuba_bezier.geometry.covers import sphere_lune
from mitsuba_bezier.geometry.curves import BezierCurve
from mitsuba_bezier.geometry.triangles import BezierTriangles

__all__ = ["EYE", "PICTURE", "drawn_curves", "lute", "outline", "place", "strings", "threads"]

#: The eye, homogeneous, and the plane of the picture.
EYE = np.array([2.4, 0.1, 1.25, 1.0])
PICTURE = np.array([1.0, 0.0, 0.0, 0.0])

#: The lute in its own coordinates: the soundboard in z = 0, the neck along +x. The body is a
#: unit ball, the cone that touches it from the apex, and `DEPTH` times as deep.
APEX, DEPTH = 1.9, 0.72
TOUCH = 1 / APEX  # x of the circle in which the cone touches the ball
_RADIUS = np.sqrt(1 - TOUCH**2)
_ANGLE = float(np.arccos(TOUCH))
NECK = ((1.25, -0.13, -0.1), (2.75, 0.13, 0.03))
ROSE = (0.28, 0.0, 0.004, 0.3)  # centre, just above the soundboard, and radius


def place() -> np.ndarray:
    """Return the map ``(4, 4)`` from the lute's coordinates to the table, 0.48 units a radius."""

    def turn(axis: int, degrees: float) -> np.ndarray:
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        a, b = (axis + 1) % 3, (axis + 2) % 3
        out = np.eye(4)
        out[a, a], out[a, b], out[b, a], out[b, b] = c, -s, s, c
        return out

    # the soundboard leans towards the eye, the neck points up and away
    out = turn(2, 112) @ turn(1, -12) @ turn(0, 40) @ np.diag([0.48, 0.48, 0.48, 1.0])
    # the lowest point of the ellipsoid c + M u, |u| = 1, is as deep as the last row of M is long
    out[:3, 3] = [-0.75, -0.35, np.linalg.norm(out[2, :3] * [1, 1, DEPTH])]
    return out


def lute() -> dict[str, BezierTriangles]:
    """Return the parts of the lute on the table, all of degree 1 or 2."""
    tips = np.array([[TOUCH, -_RADIUS, 0], [TOUCH, _RADIUS, 0]])
    ball = sphere_lune(tips[0], tips[1], [1, 0, 0], [TOUCH, 0, _RADIUS])
    # two quarters of the circle of touch, below the soundboard
    cone = []
    apex = np.array([APEX, 0, 0, 1])
    for arc in _quarters():
        cone.append([arc[0], arc[1], apex, arc[2], apex, apex])
    flat = np.diag([1, 1, DEPTH, 1.0])
    m = place()
    center, tip = np.array([0, 0, 0, 1.0]), apex
    sectors = [_sector(center, arc.control_points) for arc in _rim()]
    a, b = np.append(tips, np.ones((2, 1)), axis=1)
    board = BezierTriangles.join(
        [BezierTriangles(sectors), BezierTriangles([[a, tip, center], [tip, b, center]])]
    )
    x, y, z, r = ROSE
    neck = _box(*NECK)
    head = np.eye(4)
    head[0, [0, 2]] = 0.25, -0.97
    head[2, [0, 2]] = 0.97, 0.25
    head[:3, 3] = NECK[1][0], 0, -0.1
    pegbox = _box((-0.7, -0.11, -0.05), (0.02, 0.11, 0.09)).transform(head)
    return {
        "bowl": BezierTriangles([ball, *cone]).transform(m @ flat),
        "board": board.transform(m),
        "neck": BezierTriangles.join([neck, pegbox]).transform(m),
        "rose": shapes.disk((x, y, z), (r, r)).transform(m),
        "bridge": _box((-0.62, -0.4, 0), (-0.52, 0.4, 0.04)).transform(m),
    }


def _quarters() -> list[np.ndarray]:
    """Return the lower half of the circle of touch as two arcs, outwards as part of the cone."""
    r, x = _RADIUS, TOUCH
    h = np.sqrt(0.5)
    left, low, right = [x, -r, 0, 1], [x, 0, -r, 1], [x, r, 0, 1]
    return [
        np.array([left, [h * x, -h * r, -h * r, h], low]),
        np.array([low, [h * x, h * r, -h * r, h], right]),
    ]


def _rim() -> list[BezierCurve]:
    """Return the round part of the soundboard's outline as three arcs in space."""
    step = (2 * np.pi - 2 * _ANGLE) / 3
    return [_arc(0, 0, 0, 1, _ANGLE + k * step, _ANGLE + (k + 1) * step) for k in range(3)]


def _arc(x: float, y: float, z: float, r: float, start: float, end: float) -> BezierCurve:
    """Return an arc of a horizontal circle as a rational quadratic."""
    middle, half = (start + end) / 2, (end - start) / 2
    w = np.cos(half)
    angles = np.array([start, middle, end])
    reach = np.array([r * 1.0, r / w, r])
    net = np.column_stack(
        [x + reach * np.cos(angles), y + reach * np.sin(angles), np.full(3, z), np.ones(3)]
    )
    return BezierCurve(net * np.array([1, w, 1])[:, None])


def _sector(center: np.ndarray, arc: np.ndarray) -> np.ndarray:
    """Return the plane quadratic patch between a point and an arc, corner weights 1."""
    return np.array([arc[0], arc[1], (arc[0] + center) / 2, arc[2], (arc[2] + center) / 2, center])


def _box(lower: tuple, upper: tuple) -> BezierTriangles:
    return boxes([lower], [upper])


def outline() -> dict[str, BezierCurve]:
    """Return the curves of the lute that are drawn, in space."""

    def line(a: tuple, b: tuple) -> BezierCurve:
        return BezierCurve.from_points([a, b])

    (x0, y0, _z0), (x1, y1, z1) = NECK
    x, y, z, r = ROSE
    tips = [(TOUCH, -_RADIUS, 0), (TOUCH, _RADIUS, 0)]
    apex = np.array([APEX, 0, 0])
    # as far as the neck
    along = 1 - y1 / _RADIUS
    ends = [tip + (apex - tip) * along for tip in np.array(tips)]
    local = {f"rim_{k}": arc for k, arc in enumerate(_rim())}
    local |= {f"side_{k}": line(tips[k], tuple(ends[k])) for k in range(2)}
    local |= {
        "neck_0": line((x0, y0, z1), (x1, y0, z1)),
        "neck_1": line((x0, y1, z1), (x1, y1, z1)),
        "nut": line((x1, y0, z1), (x1, y1, z1)),
    }
    third = 2 * np.pi / 3
    local |= {f"rose_{k}": _arc(x, y, z, r, k * third, (k + 1) * third) for k in range(3)}
    m = place()
    return {name: BezierCurve(c.control_points @ m.T) for name, c in local.items()}


def drawn_curves() -> dict[str, BezierCurve]:
    """Return the drawing: the central projections of `outline`, curves in the picture plane."""
    project = central_projection(EYE, PICTURE)
    return {name: BezierCurve(c.control_points @ project.T) for name, c in outline().items()}


def strings() -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the six courses of strings, from the bridge to the nut."""
    m = place()
    y = np.linspace(-1, 1, 6)
    ends = [
        np.column_stack([np.full(6, x), width * y, np.full(6, 0.06), np.ones(6)]) @ m.T
        for x, width in ((-0.57, 0.27), (NECK[1][0], 0.09))
    ]
    return list(zip(ends[0][:, :3], ends[1][:, :3]))


def threads() -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the threads as pairs: the eye and a point of the lute's outline."""
    curves = outline()
    at = [("rim_0", 0.0), ("rim_0", 0.5), ("rim_1", 0.0), ("rim_1", 0.5), ("rim_2", 0.0),
          ("rim_2", 0.5), ("side_0", 0.0), ("nut", 0.0), ("nut", 1.0)]  # fmt: skip
    return [(EYE[:3], curves[name].points(t)) for name, t in at]
