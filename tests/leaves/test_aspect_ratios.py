"""Thin bodies: nothing leaks, whatever their proportions, and hits are those of even ones.

An affine map takes a body of even proportions to a thin one, and rays with it; their parameters at
a hit stay as they are. So the float64 reference answers there.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from leaf_cases import TURN, traced

import mitsuba_bezier as mb
from mitsuba_bezier.geometry import shapes
from mitsuba_bezier.leaves.builder import build_leaves
from mitsuba_bezier.oracles.reference import first_hit

#: Closed bodies, and a point well inside of each.
BODIES = {
    "octants": (mb.sphere(), (0, 0, 0)),
    "tetrahedral": (mb.sphere(cover="tetrahedral"), (0, 0, 0)),
    "lunes": (mb.sphere(cover="lunes"), (0, 0, 0)),
    "paraboloid": (shapes.elliptic_paraboloid(capped=True), (0, 0, 0.5)),
    "one sheet": (shapes.hyperboloid_one_sheet(capped=True), (0, 0, 0)),
    "two sheets": (shapes.hyperboloid_two_sheets(capped=True), (0, 0, 1.6)),
    "cone": (shapes.cone(capped=True), (0, 0, 0.3)),
    "cylinder": (shapes.cylinder(capped=True), (0, 0, 0.5)),
}
LONG = {s: np.diag([s**0.5, 1, s**-0.5]) for s in (40, 1e6)}
MAPS = {
    **{f"{s:g}": a for s, a in LONG.items()},
    **{f"{s:g}, turned": TURN @ a @ TURN for s, a in LONG.items()},
    "needle": TURN @ np.diag([1e-6, 1e-6, 1]),
    "leaf": np.diag([1, 1, 1e-6]) @ TURN,
}


@pytest.mark.parametrize("name", BODIES)
@pytest.mark.parametrize("rounded", [False, True], ids=["float64", "float32"])
def test_nothing_leaks_out_of_thin_bodies(name, rounded):
    body, middle = BODIES[name]
    for label, linear in MAPS.items():
        if rounded and ("turned" in label or label in ("needle", "leaf")):
            continue  # float32 would round away what is thin
        matrix = np.eye(4)
        matrix[:3, :3] = linear
        matrix[:3, 3] = 0.0 if rounded else (0.3, -0.2, 0.5)
        thin = body.transform(matrix)
        if rounded:
            thin = mb.BezierTriangles(thin.control_points.astype(np.float32))
        rng = np.random.default_rng(4)
        n = 3000
        o = middle + rng.uniform(-0.1, 0.1, size=(n, 3))
        # a third each: to corners and edges, over the surface, in directions of space
        at = rng.dirichlet([0.5, 0.5, 0.5], n)
        at[np.arange(n // 3), rng.integers(0, 3, n // 3)] = 0.0
        at[: n // 9] = np.eye(3)[rng.integers(0, 3, n // 9)]
        at /= at.sum(axis=1, keepdims=True)
        target = body.points(rng.integers(0, len(body), n), at[:, :2])
        target = np.where(np.isfinite(target), target, middle)
        o, target = (x @ linear.T + matrix[:3, 3] for x in (o, target))
        o = o.astype(np.float32)
        d = target - o
        d[-n // 3 :] = rng.normal(size=(n // 3, 3))
        d = (d / np.linalg.norm(d, axis=1, keepdims=True)).astype(np.float32)
        back = np.linalg.inv(linear)
        o_there, d_there = (o - matrix[:3, 3]) @ back.T, d.astype(float) @ back.T
        # rounding may have moved origins out of a body that is thin
        keep = np.abs(o_there - middle).max(axis=1) < 0.15
        assert keep.mean() > 0.5
        o, d, o_there, d_there = o[keep], d[keep], o_there[keep], d_there[keep]
        leaves = build_leaves(thin)
        assert leaves.is_closed_form.all()
        hit = traced(leaves, o, d)
        assert np.array(hit.valid).all(), f"{label}: {(~np.array(hit.valid)).sum()} escape"
        assert np.array(traced(leaves, o, d, any_hit=True).valid).all(), label
        few = rng.choice(len(o), 50, replace=False)
        length = np.linalg.norm(d_there[few], axis=1)
        expected = first_hit(body, o_there[few], d_there[few] / length[:, None])
        # at an edge the reference may miss
        known = np.isfinite(expected.t)
        assert known.mean() > 0.9
        off = np.array(hit.t, dtype=float)[few] * length / expected.t - 1
        # a rounding of t; nets in float32 are off by as much, which counts over the cosine
        limit = 1.2e-7 + 1e-6 * rounded / np.maximum(expected.margin.cosine[known], 0.05)
        assert (np.abs(off[known]) < limit).all(), label


def test_the_ray_that_found_it():
    o = np.float32([[-25.836627960205078, 0.639073371887207, 0.002395579358562827]])
    d = np.float32([[-0.9999623894691467, -0.008675086311995983, -3.229608773835935e-05]])
    for cover in ("octants", "tetrahedral"):
        hit = traced(build_leaves(mb.ellipsoid(radii=(100, 1, 0.01), cover=cover)), o, d)
        assert float(hit.t[0]) == pytest.approx(74.165, abs=1e-3)


def test_bodies_in_one_set_have_axes_of_their_own():
    bodies = [
        mb.sphere(),
        mb.ellipsoid(center=(5, 0, 0), radii=(1, 1, 1e-4)),
        mb.ellipsoid(center=(0, 5, 0), radii=(1e-4, 1, 1), cover="tetrahedral"),
        shapes.cylinder(center=(0, 0, 9), capped=True),
    ]
    patches = mb.BezierTriangles.join([b if b.degree == 4 else b.elevate(2) for b in bodies])
    leaves = build_leaves(patches)
    ends = np.cumsum([0, *(len(b) for b in bodies)])
    axes, patch = leaves.closed_form.axes, leaves.closed_form.patch
    even = [(axes[np.isin(patch, range(*e))] == np.eye(3)).all() for e in pairwise(ends)]
    assert even == [True, False, False, True]
    rng = np.random.default_rng(1)
    for centre in ((0, 0, 0), (5, 0, 0), (0, 5, 0)):
        o = np.broadcast_to(np.float32(centre), (500, 3))
        d = rng.normal(size=(500, 3)).astype(np.float32)
        hit = traced(leaves, o, d)
        assert np.array(hit.valid).all()
        uv = np.stack([np.array(hit.u), np.array(hit.v)], axis=1).astype(float)
        point = patches.points(np.array(hit.patch), uv)
        assert np.abs(point - (o + np.array(hit.t)[:, None] * d)).max() < 1e-6
