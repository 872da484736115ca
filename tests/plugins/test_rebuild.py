"""Tests of updates: only what changed is cut again, and the result is that of a new build."""

from __future__ import annotations

from dataclasses import fields

import mitsuba as mi
import numpy as np
import pytest
from backend_cases import VARIANT
from mitsuba_cases import ball_rays, bezier, ray_of

import mitsuba_bezier as mb
from mitsuba_bezier.leaves import builder as leaf_builder
from mitsuba_bezier.leaves.builder import build_leaves, rebuild_leaves
from mitsuba_bezier.leaves.nets import Nets
from mitsuba_bezier.leaves.records import LeafSettings, Leaves


def moved(patches: mb.BezierTriangles, numbers: list[int], seed: int) -> mb.BezierTriangles:
    """Shake the control points of some patches."""
    net = patches.control_points.copy()
    net[numbers, :, :3] += 0.01 * np.random.default_rng(seed).normal(size=net[numbers, :, :3].shape)
    return mb.BezierTriangles(net)


def in_order(leaves: Leaves) -> Leaves:
    """Sort leaves by patch and place."""
    middle = leaves.corners().mean(axis=1)
    return leaves.select(np.lexsort((*middle.T.round(9), leaves.patch)))


MIXED = mb.BezierTriangles(
    np.concatenate(
        [
            mb.sphere(cover="tetrahedral")
            .elevate(2)
            .control_points,  # quartics that are elevations
            mb.sphere().control_points,  # octants
            mb.torus().control_points,
        ]
    )
)


@pytest.mark.parametrize("numbers", [[20], [3, 21, 49], [12], []])
def test_a_rebuild_is_a_build(numbers):
    settings = LeafSettings()
    before = build_leaves(MIXED, settings)
    patches = moved(MIXED, numbers, 1)
    fresh = in_order(build_leaves(patches, settings))
    again = in_order(rebuild_leaves(patches, settings, MIXED, before))
    assert np.array_equal(fresh.patch, again.patch)
    assert np.array_equal(fresh.kind, again.kind)
    for part in ("graph", "closed_form"):
        a, b = getattr(fresh, part), getattr(again, part)
        for field in fields(a):
            if field.name != "group":
                # batches of another size round differently, in float64; charts to float32 after it
                off = 2e-7 if field.name in ("shift", "chart", "rows") else 1e-6
                values = getattr(a, field.name), getattr(b, field.name)
                if isinstance(values[0], Nets):
                    assert np.array_equal(values[0].degree, values[1].degree)
                    values = values[0].padded(), values[1].padded()
                assert np.allclose(*values, rtol=off, atol=off), field.name
    # groups have other numbers, but the same members
    groups = (x.closed_form.group for x in (fresh, again))
    assert np.array_equal(*(group[:, None] == group for group in groups))


def test_only_changed_patches_are_cut_again(monkeypatch):
    torus, cut = mb.torus(), []
    subdivide = leaf_builder.subdivide

    def watched(nets, *rest):
        cut.append(len(nets))
        return subdivide(nets, *rest)

    monkeypatch.setattr(leaf_builder, "subdivide", watched)
    before = build_leaves(torus)
    rebuild_leaves(moved(torus, [4, 9], 2), LeafSettings(), torus, before)
    assert cut == [32, 2]


def test_another_number_of_patches_is_a_new_build():
    torus = mb.torus()
    half = torus[np.arange(16)]
    again = rebuild_leaves(half, LeafSettings(), torus, build_leaves(torus))
    assert np.array_equal(again.patch, build_leaves(half).patch)


def test_shapes_remember_their_leaves_after_an_update(monkeypatch):
    mi.set_variant(VARIANT)
    cut = []
    subdivide = leaf_builder.subdivide

    def watched(nets, *rest):
        cut.append(len(nets))
        return subdivide(nets, *rest)

    monkeypatch.setattr(leaf_builder, "subdivide", watched)
    torus = mb.BezierTriangles(mb.torus().control_points.astype(np.float32).astype(float))
    scene = mi.load_dict(
        {"type": "scene", "a": bezier(torus), "b": bezier(mb.torus(center=(0, 0, 1)))}
    )
    o, d = ball_rays(2000, seed=3)
    ray = ray_of(o, d)
    mb.ray_intersect(scene, ray)
    params = mi.traverse(scene)
    for step in range(3):
        torus = moved(torus, [4, 9 + step], step)
        params["a.control_points"] = mi.TensorXf(torus.control_points.astype(np.float32))
        params.update()
        found = mb.ray_intersect(scene, ray)
        fresh = {"type": "scene", "a": bezier(torus), "b": bezier(mb.torus(center=(0, 0, 1)))}
        expected = mb.ray_intersect(mi.load_dict(fresh), ray)
        # the float32 tensor holds the rounded net, the file the one before rounding
        assert np.allclose(found.t, expected.t, atol=1e-5)
    # two shapes; the first update of a scene builds all, later ones what changed
    own = [n for n in cut if n < 32]
    assert own == [2, 2] and cut.count(32) == 2 + 2 + 3 * 2
