"""Rays against even aspheres by the kernel, and by an oracle in float64."""

from __future__ import annotations

import drjit as dr
import numpy as np
import pytest
from asphere_cases import ASPHERES, rays_at
from backend_cases import Float

from mitsuba_bezier.geometry.aspheres import LEG, START, EvenAsphere
from mitsuba_bezier.kernels.structure import build_structure
from mitsuba_bezier.kernels.traverse import intersect
from mitsuba_bezier.leaves.records import ClosedFormLeaves, GraphLeaves, Leaves
from mitsuba_bezier.leaves.revolution import revolution_leaf
from mitsuba_bezier.oracles.aspheres import first_hits

#: A ray that passes a surface at less than this, in apertures, may do either: it is some hundred
#: roundings of float64, in which both sides decide.
GRAZING = 1e-12
#: The rim's tolerance is 1e-6; float64 decides.
RIM = 2e-6


def structure(*surfaces: EvenAsphere, matrices=None):
    matrices = [np.eye(4)] * len(surfaces) if matrices is None else matrices
    parts = [
        Leaves(GraphLeaves.zeros(), ClosedFormLeaves.zeros(), revolution_leaf(s, m)).of_patches(
            np.array([k])
        )
        for k, (s, m) in enumerate(zip(surfaces, matrices))
    ]
    return build_structure(Leaves.join(parts), Float)


def columns(a: np.ndarray) -> list:
    return [Float(np.ascontiguousarray(a[:, k])) for k in range(3)]


def traced(s, o, d, t_max=np.inf, any_hit=False):
    hit = intersect(s, columns(o), columns(d), Float(t_max), True, any_hit)
    dr.eval(hit)
    return [np.array(x) for x in hit]


@pytest.mark.parametrize("name", ASPHERES)
def test_first_hits_are_those_of_the_sag(name):
    surface = ASPHERES[name]
    o, d, kind = rays_at(surface, 4000, 3)
    s = structure(surface)
    valid, t, patch, u, v = traced(s, o, d)
    o, d = o.astype(float), d.astype(float)
    truth = first_hits(surface, o, d)
    asked = (truth.grazing > GRAZING) & (truth.rim > RIM)
    # most rays along the axis, and to what is flat, turn round on the surface itself
    assert asked.mean() > 0.8
    hits = np.isfinite(truth.t)
    wrong = np.flatnonzero((valid != hits) & asked)
    assert len(wrong) == 0, (kind[wrong], o[wrong], d[wrong])
    both = hits & asked
    length = np.linalg.norm(d, axis=1)
    scale = surface.aperture + truth.t[both] * length[both]
    # a rounding of t in float32
    assert (np.abs(t[both] - truth.t[both]) * length[both] / scale).max() < 1e-7
    p = o[both] + truth.t[both, None] * d[both]
    uv = np.stack([u, v], axis=1)[both]
    # as do roundings of u and v, for rays that are not cut short by the rounding of t
    assert np.abs(uv * LEG - START - p[:, :2] / surface.aperture).max() < 3e-7
    assert (patch[valid] == 0).all()
    # any hit is the same question
    assert (traced(s, o.astype(np.float32), d.astype(np.float32), any_hit=True)[0] == valid).all()


def test_hits_before_the_end_of_a_ray_count():
    surface = ASPHERES["gull"]
    o, d, _kind = rays_at(surface, 4000, 5)
    s = structure(surface)
    t = traced(s, o, d)[1]
    for any_hit in (False, True):
        ends = np.where(np.isfinite(t), t, 1.0)
        assert not traced(s, o, d, np.nextafter(ends, 0).astype(np.float32), any_hit)[0].any()
        longer = traced(s, o, d, np.nextafter(ends, np.inf).astype(np.float32), any_hit)[0]
        assert (longer == np.isfinite(t)).all()


def test_an_asphere_that_is_turned_squeezed_and_far_away():
    surface = ASPHERES["lens"]
    o, d, _kind = rays_at(surface, 4000, 6)
    rng = np.random.default_rng(1)
    matrix = np.eye(4)
    matrix[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0] @ np.diag([1, 3, 0.2]) * 0.7
    matrix[:3, 3] = 5000, -300, 70
    # through float32, and back to the asphere's own frame
    wo = (o @ matrix[:3, :3].T + matrix[:3, 3]).astype(np.float32)
    wd = (d @ matrix[:3, :3].T).astype(np.float32)
    inverse = np.linalg.inv(matrix[:3, :3])
    lo, ld = (wo - matrix[:3, 3]) @ inverse.T, wd @ inverse.T
    truth = first_hits(surface, lo, ld)
    valid, t, *_ = traced(structure(surface, matrices=[matrix]), wo, wd)
    asked = (truth.grazing > GRAZING) & (truth.rim > RIM)
    assert (valid == np.isfinite(truth.t))[asked].all()
    both = valid & asked
    assert np.abs(t[both] / truth.t[both] - 1).max() < 2e-7


def test_many_aspheres_of_one_structure():
    names = ["lens", "r^40", "ring", "paraboloid"]
    surfaces = [ASPHERES[n] for n in names]
    matrices = []
    for k, surface in enumerate(surfaces):
        m = np.eye(4)
        m[:3, :3] /= surface.aperture
        m[2, 3] = 0.7 * k
        matrices.append(m)
    rng = np.random.default_rng(2)
    o = (rng.normal(size=(4000, 3)) * 3 + [0, 0, 1]).astype(np.float32)
    target = rng.normal(size=(4000, 3)) * [0.6, 0.6, 1.5] + [0, 0, 1]
    d = (target - o).astype(np.float32)
    valid, t, patch, *_ = traced(structure(*surfaces, matrices=matrices), o, d)
    best, which = np.full(len(o), np.inf), np.zeros(len(o), int)
    asked = np.ones(len(o), bool)
    for k, (surface, m) in enumerate(zip(surfaces, matrices)):
        inverse = np.linalg.inv(m[:3, :3])
        truth = first_hits(surface, (o - m[:3, 3]) @ inverse.T, d @ inverse.T)
        which[truth.t < best] = k
        best = np.minimum(best, truth.t)
        asked &= (truth.grazing > GRAZING) & (truth.rim > RIM)
    assert asked.mean() > 0.95
    assert (valid == np.isfinite(best))[asked].all()
    assert (patch == which)[valid & asked].all()
    both = valid & asked
    assert np.abs(t[both] / best[both] - 1).max() < 2e-7
    assert len(np.unique(patch[valid])) == 4
