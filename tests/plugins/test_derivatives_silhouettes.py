"""The methods of `mi.Shape` for silhouettes: exact points, densities, inverses, projections."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from backend_cases import VARIANT
from mitsuba_cases import bezier, numbers, ray_of, tensor

import mitsuba_bezier as mb

EYE = np.array([0.3, 0.2, 4.0])
COUNT = 3000


@pytest.fixture(scope="module", autouse=True)
def variant() -> None:
    mi.set_variant(VARIANT)


@pytest.fixture(scope="module")
def ball(variant) -> Any:
    return mi.load_dict(bezier(mb.sphere(radius=2.0)))


@pytest.fixture(scope="module")
def octant(variant) -> Any:
    return mi.load_dict(bezier(mb.sphere()[:1]))


def uniform(count: int = COUNT) -> Any:
    return mi.Point3f(*np.random.default_rng(0).random((3, count), dtype=np.float32))


def flags(*names: str) -> int:
    value = mi.DiscontinuityFlags.DirectionSphere.value
    for name in names:
        value |= getattr(mi.DiscontinuityFlags, name).value
    return value


def test_kinds(ball, octant):
    interior, perimeter = (
        getattr(mi.DiscontinuityFlags, k).value for k in ("InteriorType", "PerimeterType")
    )
    assert ball.silhouette_discontinuity_types() == interior
    assert octant.silhouette_discontinuity_types() == interior | perimeter
    assert not np.array(ball.sample_silhouette(uniform(9), flags("PerimeterType")).is_valid()).any()


def test_tangents_of_a_ball(ball):
    ss = ball.sample_silhouette(uniform(), flags("InteriorType"))
    assert np.array(ss.is_valid()).all()
    p, n, d = numbers(ss.p), numbers(ss.n), numbers(ss.d)
    # 2e-6: roundings of float32 in sums of fifteen terms, and of the second partials
    np.testing.assert_allclose(n, p / 2, atol=2e-6)
    np.testing.assert_allclose(np.einsum("ni,ni->n", n, d), 0, atol=4e-6)
    np.testing.assert_allclose(ss.foreshortening, 0.5, atol=2e-6)
    # uniform by area, to what the sampling of surfaces promises, and by angle
    np.testing.assert_allclose(ss.pdf, 1 / (16 * np.pi) / (2 * np.pi), rtol=5e-3)
    # three standard deviations of the mean of a coordinate
    assert np.abs(d.mean(axis=0)).max() < 3 * np.sqrt(1 / 3 / COUNT)


def test_inverse(ball, octant):
    for shape, kinds in (
        (ball, ("InteriorType",)),
        (octant, ("InteriorType",)),
        (octant, ("PerimeterType",)),
        (octant, ("InteriorType", "PerimeterType")),
    ):
        ss = shape.sample_silhouette(uniform(), flags(*kinds))
        again = shape.sample_silhouette(shape.invert_silhouette_sample(ss), flags(*kinds))
        assert np.array(ss.is_valid()).all()
        # 5e-5: cells are chosen by numbers near one whose last bit is 6e-8 of the surface
        np.testing.assert_allclose(numbers(again.p), numbers(ss.p), atol=5e-5)
        np.testing.assert_allclose(numbers(again.d), numbers(ss.d), atol=5e-5)
        np.testing.assert_allclose(again.pdf, ss.pdf, rtol=1e-3)


def test_edges_of_an_octant(octant):
    ss = octant.sample_silhouette(uniform(), flags("PerimeterType"))
    p, n, d, along = (numbers(x) for x in (ss.p, ss.n, ss.d, ss.silhouette_d))
    assert (np.abs(p).min(axis=1) < 1e-6).all()  # on three quarters of great circles
    np.testing.assert_allclose(np.einsum("ni,ni->n", p, along), 0, atol=2e-6)
    np.testing.assert_allclose(np.einsum("ni,ni->n", n, along), 0, atol=2e-6)
    np.testing.assert_allclose(np.einsum("ni,ni->n", n, d), 0, atol=2e-6)
    # away from the surface: its inside is towards the middle of the octant
    inside = np.array([1, 1, 1]) / np.sqrt(3) - p
    inside -= p * np.einsum("ni,ni->n", inside, p)[:, None]
    assert (np.einsum("ni,ni->n", n, inside) < 1e-6).all()
    sine = np.linalg.norm(np.cross(d, along), axis=1)
    np.testing.assert_allclose(ss.foreshortening, sine, atol=2e-6)
    # the average of 1/pdf is the length times 4 pi; segments are chosen by chords, 1e-3 shorter
    total = 1.5 * np.pi * 4 * np.pi
    assert np.mean(1 / np.array(ss.pdf)) == pytest.approx(total, rel=2e-3)


def test_silhouettes_from_a_point(ball):
    index, weight = ball.precompute_silhouette(mi.ScalarPoint3f(*EYE.tolist()))
    length = 4 * np.pi * np.sqrt(1 - 4 / (EYE @ EYE))
    assert dr.sum(weight)[0] == pytest.approx(length, rel=1e-4)  # chords
    rng = np.random.default_rng(1)
    chosen = rng.choice(len(index), COUNT, p=np.array(weight) / np.array(weight).sum())
    eye = mi.Point3f(*EYE.tolist())
    ss = ball.sample_precomputed_silhouette(
        eye, mi.UInt32(chosen.astype(np.uint32)), mi.Float(rng.random(COUNT, dtype=np.float32))
    )
    p, n, d = numbers(ss.p), numbers(ss.n), numbers(ss.d)
    assert np.array(ss.is_valid()).all()
    np.testing.assert_allclose(p @ EYE, 4, atol=1e-5)  # the polar plane of the eye
    np.testing.assert_allclose(n, p / 2, atol=3e-6)
    np.testing.assert_allclose(d, (p - EYE) / np.linalg.norm(p - EYE, axis=1)[:, None], atol=1e-6)
    # density by length within a segment, times that of the segment: uniform on the circle
    pdf = np.array(ss.pdf) * np.array(weight)[chosen] / np.array(weight).sum()
    np.testing.assert_allclose(pdf, 1 / length, rtol=1e-2)


def test_projection(ball, octant):
    target = np.random.default_rng(2).normal(size=(500, 3)) * [1, 1, 0]
    ray = ray_of(EYE, target - EYE)
    eye = mi.Point3f(*EYE.tolist())
    si = ball.ray_intersect(ray)
    hit = np.array(si.is_valid())
    ss = ball.primitive_silhouette_projection(
        eye, si, flags("InteriorType"), mi.Float(0), si.is_valid()
    )
    found = np.array(ss.is_valid())
    assert found.sum() > 0.7 * hit.sum() and not found[~hit].any()
    np.testing.assert_allclose(numbers(ss.p)[found] @ EYE, 4, atol=2e-3)
    si = octant.ray_intersect(ray)
    hit = np.array(si.is_valid())
    sample = mi.Float(np.random.default_rng(3).random(500, dtype=np.float32))
    ss = octant.primitive_silhouette_projection(
        eye, si, flags("PerimeterType"), sample, si.is_valid()
    )
    assert hit.sum() > 20 and (np.array(ss.is_valid()) == hit).all()
    assert (np.abs(numbers(ss.p)[hit]).min(axis=1) < 1e-6).all()
    assert {int(k) for k in np.abs(numbers(ss.p)[hit]).argmin(axis=1)} == {0, 1, 2}


def test_motion(octant):
    params = mi.traverse(octant)
    net = mb.sphere()[:1]
    points = tensor(net)
    dr.enable_grad(points)
    params["control_points"] = points
    params.update()
    ss = octant.sample_silhouette(uniform(100), flags("InteriorType"))
    si = dr.zeros(mi.SurfaceInteraction3f, 100)
    si.prim_index, si.uv, si.p = ss.prim_index, ss.uv, ss.p
    moved = octant.differential_motion(si)
    np.testing.assert_allclose(numbers(dr.detach(moved)), numbers(ss.p), atol=1e-6)
    dr.set_grad(points, tensor(net.control_points * [0, 0, 1, 0]))
    dr.forward_to(moved)
    # the numerators of z grow by their own size: so does z everywhere
    want = numbers(ss.p) * [0, 0, 1]
    np.testing.assert_allclose(numbers(dr.grad(moved)), want, atol=2e-6)
