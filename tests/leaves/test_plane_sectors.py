"""Plane sectors of all kinds: what is hit is the sector, against roots in float64.

A sector has the control points of its two straight edges in their middles. With the coordinates
``a, b, 1 - a - b`` of a point for the corners of the arc and the apex, and those of twice the arc's
control point less its corners, the parameters are ``u = a + k e, v = b + k f`` with a root ``k`` of
``k = (a + k e) (b + k f)``.
"""

from __future__ import annotations

import numpy as np
import pytest
from leaf_cases import TURN, traced

import mitsuba_bezier as mb
from mitsuba_bezier.geometry import bernstein
from mitsuba_bezier.leaves.builder import build_leaves

#: What belongs to a sector is decided to this of its size: the tolerance of edges, 1e-6, where the
#: parameters of a patch are even, and five times that where its weights differ by a hundred.
BAND = 5e-6
#: Control points in float32 lie elsewhere by so much of the largest number: five roundings.
ROUNDING = 3e-7


def sector(apex, first, last, arc, weight=1.0, weights=(1.0, 1.0, 1.0)) -> np.ndarray:
    """Return the net of a sector; `weight` is that of the arc, `weights` those of the corners."""
    a, p, q, r = (
        w * np.array([x, y, 0, 1])
        for (x, y), w in zip((apex, first, arc, last), (weights[0], weights[1], weight, weights[2]))
    )
    return np.array([p, q, (p + a) / 2, r, (r + a) / 2, a])


def of_circle(angle: float, at: tuple[float, float] = (0, 0), turn: float = 0.0) -> np.ndarray:
    """Return a sector of the unit circle of an angle in degrees, below 180."""
    half = np.radians(angle) / 2
    ends = [(np.cos(turn + x) + at[0], np.sin(turn + x) + at[1]) for x in (-half, half)]
    arc = [np.cos(turn) / np.cos(half) + at[0], np.sin(turn) / np.cos(half) + at[1]]
    return sector(at, *ends, arc, np.cos(half))


def moved(net: np.ndarray, x: float, y: float, size: float = 1.0) -> np.ndarray:
    out = net * [size, size, 1, 1]
    return out + np.outer(net[:, 3], [x, y, 0, 0])


def contains(net: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """Tell which points of the plane are on a sector."""
    p, q, _pa, r, _ra, a = net[:, [0, 1, 3]]
    inverse = np.linalg.inv(np.stack([p, r, a], axis=1))
    at = np.column_stack([xy, np.ones(len(xy))]) @ inverse.T
    a, b = at[:, 0] / at.sum(axis=1), at[:, 1] / at.sum(axis=1)
    d = inverse @ (2 * q - p - r)
    e, f = d.sum() * a - d[0], d.sum() * b - d[1]
    square, linear, rest = e * f, a * f + b * e - 1, a * b
    disc = linear**2 - 4 * square * rest
    out = np.zeros(len(xy), dtype=bool)
    with np.errstate(all="ignore"):
        h = -(linear + np.copysign(np.sqrt(disc), linear)) / 2
        for k in (h / square, rest / h):
            u, v = a + k * e, b + k * f
            out |= np.minimum(np.minimum(u, v), 1 - u - v) >= -1e-14  # roundings of float64
    return out


def around(net: np.ndarray, count: int, rng: np.random.Generator) -> tuple[np.ndarray, float]:
    """Return points of the plane in a box a little larger than a sector, and the sector's size."""
    points = bernstein.basis(2, bernstein.multi_indices(60)[:, :2] / 60) @ net
    points = points[:, :2] / points[:, 3:]
    middle = points.mean(axis=0)
    axes = np.linalg.svd(points - middle, full_matrices=False)[2]  # some are long, and inclined
    along = (points - middle) @ axes.T
    low, high = along.min(axis=0), along.max(axis=0)
    extra = 0.1 * (high - low)
    xy = rng.uniform(low - extra, high + extra, size=(count, 2)) @ axes + middle
    return xy, float(np.ptp(points, axis=0).max())


TILT = np.eye(4)
TILT[:3, :3], TILT[:3, 3] = TURN, [0.3, -0.5, 0.8]
CORNER = ((0, 0), (1, 0), (0, 1), (0.9, 0.9))
SETS = {
    **{f"{angle} degrees": [of_circle(angle)] for angle in (1, 10, 60, 120, 170, 179)},
    "circle": [of_circle(72, turn=2 * np.pi * k / 5) for k in range(5)],
    "concave": [sector((0, 0), (1, 0), (0, 1), (0.3, 0.3), 0.9)],
    # the plane's own example: it lies far from the apex, and bends towards it
    "of a part": [
        sector((0, 0), (-59.009872, 14.559872), (-63.5, 12.7), (-60.869744, 12.7), 0.92388)
    ],
    **{
        f"apex {far} away": [sector((-far, 0.3 * far), (0, 0), (0.3, 1), (0.4, 0.3), 0.9)]
        for far in (1, 10, 100, 1000)
    },
    **{
        f"apex {near} from the chord": [sector((0.5 - near, 0.5 - near), *CORNER[1:3], (0.8, 0.8))]
        for near in (1e-1, 1e-3)
    },
    **{f"weight {w}": [sector(*CORNER, w)] for w in (0.01, 0.1, 10, 100)},
    **{f"weight {w} of the apex": [sector(*CORNER, 1, (w, 1, 1))] for w in (0.01, 0.1, 10, 100)},
    **{f"weights {w} of corners": [sector(*CORNER, 1, (1, w, 1 / w))] for w in (0.01, 0.1, 10)},
    "fan": [of_circle(17, turn=0.3 * k) for k in range(20)],
    "far apart": [moved(of_circle(90), 600 * i, 340 * j) for i in range(4) for j in range(4)],
    "of several sizes": [moved(of_circle(90), 3 * k, 0, 10.0**-k) for k in range(5)],
}


@pytest.mark.parametrize("form", ["float64", "float32", "tilted, float32", "negative", "elevated"])
def test_what_is_hit_is_the_sector(form):
    for name, nets in SETS.items():
        if "float32" not in form and len(nets) == 1 and "0.1" in name:
            continue  # less of the same
        matrix = TILT if "tilted" in form else np.eye(4)
        patches = mb.BezierTriangles(np.array(nets)).transform(matrix)
        if form == "negative":
            patches = mb.BezierTriangles(-patches.control_points)
        if form == "elevated":
            patches = patches.elevate(2)
        rounding = 0.0
        if "float32" in form:
            patches = mb.BezierTriangles(patches.control_points.astype(np.float32))
            rounding = ROUNDING * np.abs(patches.control_points[..., :3]).max()
        rng = np.random.default_rng(7)
        places = [around(net, 4000 // len(nets), rng) for net in nets]
        xy = np.concatenate([points for points, _size in places])
        size = np.repeat([size for _points, size in places], 4000 // len(nets))
        target = np.column_stack([xy, np.zeros(len(xy))])
        d = rng.normal(size=target.shape)
        d[:, 2] = -np.abs(d[:, 2]) - np.linalg.norm(d[:, :2], axis=1) / 2
        o = target - size[:, None] * d / np.linalg.norm(d, axis=1, keepdims=True)
        o, target = (x @ matrix[:3, :3].T + matrix[:3, 3] for x in (o, target))
        o = o.astype(np.float32)
        d = (target - o).astype(np.float32)
        # what these rays meet, in the plane of the sectors
        o_there, d_there = (o - matrix[:3, 3]) @ matrix[:3, :3], d.astype(float) @ matrix[:3, :3]
        xy = (o_there - d_there * (o_there[:, 2:] / d_there[:, 2:]))[:, :2]
        band = (BAND * size + rounding)[:, None]
        ring = [band * [np.cos(x), np.sin(x)] for x in np.pi / 4 * np.arange(8)]
        inside = [np.any([contains(net, xy + r) for net in nets], axis=0) for r in (*ring, 0 * xy)]
        valid = np.array(traced(build_leaves(patches), o, d).valid)
        assert not (valid & ~np.any(inside, axis=0)).any(), f"{name}: hits beside the sector"
        assert not (~valid & np.all(inside, axis=0)).any(), f"{name}: hits missed"
        assert np.all(inside, axis=0).mean() > 0.2 and np.any(inside, axis=0).mean() < 0.99


def test_half_a_disk_and_more():
    # from 180 degrees on the arc's control point is at infinity, or its weight negative
    half = np.array([[0, -1, 0, 1.0], [1, 0, 0, 0], [0, -0.5, 0, 1], [0, 1, 0, 1], [0, 0.5, 0, 1]])
    half = np.vstack([half, [[0, 0, 0, 1]]])
    rng = np.random.default_rng(3)
    xy = rng.uniform(-1.1, 1.1, size=(20_000, 2))
    o = np.column_stack([xy, np.full(len(xy), 2.0)]).astype(np.float32)
    d = np.broadcast_to(np.float32([0, 0, -1]), o.shape)
    for factor in (1, -1):
        patches = mb.BezierTriangles(factor * half[None])
        valid = np.array(traced(build_leaves(patches), o, d).valid)
        x, r = o[:, 0], np.hypot(*o[:, :2].T)
        judged = (np.abs(x) > 1e-5) & (np.abs(r - 1) > 1e-5)
        assert (valid == ((x > 0) & (r < 1)))[judged].all()
    # beyond, the patch folds over itself near the apex, and its image is that of all parameters
    c, s = np.cos(np.radians(120)), np.sin(np.radians(120))
    net = np.array([[c, -s, 0, 1], [1, 0, 0, c], [c / 2, -s / 2, 0, 1], [c, s, 0, 1]])
    net = np.vstack([net, [[c / 2, s / 2, 0, 1], [0, 0, 0, 1]]])
    valid = np.array(traced(build_leaves(mb.BezierTriangles(net[None])), o, d).valid)
    ring = [1e-5 * np.array([np.cos(x), np.sin(x)]) for x in np.pi / 4 * np.arange(8)]
    inside = [contains(net, o[:, :2].astype(float) + r) for r in ring]
    assert not (valid & ~np.any(inside, axis=0)).any()
    assert not (~valid & np.all(inside, axis=0)).any()
