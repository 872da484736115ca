"""Leaves of tensor-product patches hold nets in powers of the patch's own parameters."""

from __future__ import annotations

import numpy as np
import pytest
from backend_cases import Float
from leaf_cases import rays

import mitsuba_bezier as mb
from mitsuba_bezier.geometry import bernstein
from mitsuba_bezier.kernels.structure import build_structure
from mitsuba_bezier.kernels.traverse import intersect
from mitsuba_bezier.leaves.builder import build_leaves
from mitsuba_bezier.leaves.graph import subdivision
from mitsuba_bezier.leaves.graph.lower_degrees import TOLERANCE
from mitsuba_bezier.leaves.graph.tensor_nets import patch_powers
from mitsuba_bezier.leaves.nets import Nets, Powers, substituted
from mitsuba_bezier.leaves.records import LeafSettings

GENERAL = LeafSettings(closed_form=False)


def wavy(p: int, q: int, weight: float = 0.0) -> mb.BezierTriangles:
    """A height field of degree ``(p, q)``, bent more along one direction, as two triangles."""
    x, y = np.meshgrid(np.arange(p + 1) / p, np.arange(q + 1) / q, indexing="ij")
    z = 0.3 * np.sin(5 * x + 0.5 * y) * np.cos(1.5 * y)
    net = np.stack([x, y, z, np.ones_like(x)], axis=-1)
    return mb.tensor_to_triangles(net * (1 + weight * np.sin(3 * x))[..., None])


def whole(nets: np.ndarray) -> np.ndarray:
    """All powers of the degree: what leaves have where nobody looks for fewer."""
    return np.full((len(nets), 3), bernstein.degree_of(nets.shape[1]))


@pytest.mark.parametrize(("p", "q"), [(3, 3), (3, 1), (2, 4), (5, 5), (8, 8)])
def test_powers_of_patches(p, q):
    patches = wavy(p, q)
    assert patch_powers(patches.control_points).tolist() == [[p, q, p + q]] * 2
    up = patches.elevate(2).control_points
    assert patch_powers(up).tolist() == [[p, q, p + q]] * 2
    n = p + q
    # of weights that differ, of float32, and with one more power
    assert (patch_powers(wavy(p, q, 0.1).control_points) == n).all()
    rounded = patches.transform(np.diag([0.7, 1.1, 1.3, 1.0])).control_points.astype(np.float32)
    assert (patch_powers(rounded.astype(np.float64)) == n).all()
    other = patches.control_points.copy()
    other[..., 2] += 1e-3 * np.random.default_rng(0).normal(size=other.shape[:2])
    assert (patch_powers(other) == n).all()


@pytest.mark.parametrize(("p", "q"), [(3, 3), (3, 1), (5, 5)])
def test_leaves_are_the_same_surface_in_fewer_numbers(p, q, monkeypatch):
    patches = wavy(p, q)
    fewer = build_leaves(patches, GENERAL).graph
    monkeypatch.setattr(subdivision, "patch_powers", whole)
    leaves = build_leaves(patches, GENERAL).graph
    np.testing.assert_array_equal(fewer.chart, leaves.chart)
    assert (fewer.nets.powers == (p, q, p + q)).all(axis=1).mean() >= 0.7
    # some are cut along one direction: their legs are not along u and v of the patch
    assert 0 < fewer.nets.is_framed.mean() < 1 or p + q > 8
    assert len(fewer.nets.rows) < 0.8 * len(leaves.nets.rows) or p + q > 8
    n = p + q
    uv = bernstein.multi_indices(9)[:, :2] / 9
    i, j = bernstein.multi_indices(n)[:, :2].T
    value = uv[:, :1] ** i * uv[:, 1:] ** j
    off = np.abs(value @ fewer.nets.padded(n) - value @ leaves.nets.padded(n)).max()
    # 2: those of degree 10 are lowered where `whole` has them
    assert off <= 2 * TOLERANCE


@pytest.mark.parametrize(("p", "q"), [(3, 3), (1, 4), (5, 5), (7, 7)])
def test_rays_meet_what_they_did(p, q, monkeypatch):
    patches = wavy(p, q)
    o, d = rays(patches, 4000)
    columns = [[Float(np.ascontiguousarray(a[:, k])) for k in range(3)] for a in (o, d)]
    found = []
    for find in (patch_powers, whole):
        monkeypatch.setattr(subdivision, "patch_powers", find)
        structure = build_structure(build_leaves(patches, GENERAL), Float)
        hits = intersect(structure, *columns, Float(np.inf))
        any_hit = intersect(structure, *columns, Float(np.inf), any_hit=True)
        found.append([np.array(x) for x in (hits.valid, any_hit.valid, hits.t, hits.u, hits.v)])
        found[-1].append(np.array(hits.patch))
        found[-1].append(structure.bytes)
    (valid, some, t, u, v, patch, size), other = found
    assert 0.2 < valid.mean() < 1
    # above degree 8 lower degrees may do with as few
    assert size < other[6] if p + q <= 8 else size <= other[6]
    t, other[2] = (np.where(valid & other[0], x, 0.0) for x in (t, other[2]))
    # 1 in 1000: at silhouettes and edges roundings decide
    same = (valid == other[0]) & (some == other[1])
    assert same.mean() >= 0.999
    both = valid & other[0] & (patch == other[5])
    assert both.sum() > 0.99 * valid.sum()
    # a rounding of the leaf, over the cosine of rays that graze
    for a, b in ((t, other[2]), (u, other[3]), (v, other[4])):
        off = np.abs(a - b)[both]
        assert np.median(off) < 1e-6 and (off < 1e-4).mean() > 0.999


def test_nets_of_few_powers():
    rng = np.random.default_rng(0)
    powers = [Powers(3, 2, 5), Powers(2, 2, 3), Powers.whole(2)]
    assert [x.size for x in powers] == [12, 8, 6]
    np.testing.assert_array_equal(Powers.whole(4).indices, bernstein.multi_indices(4)[:, :2])
    frame = rng.normal(size=(3, 2, 2))
    rows = [rng.normal(size=(x.size, 4)) for x in powers]
    nets = Nets(np.concatenate(rows), np.array(powers), frame)
    assert nets.count.tolist() == [12, 8, 6] and nets.degree.tolist() == [5, 3, 2]
    u, v = 0.3, -0.4
    i, j = bernstein.multi_indices(5)[:, :2].T
    at = (u**i * v**j) @ nets.padded()
    stored = nets.stored(Powers(3, 2, 5))
    a, b = Powers(3, 2, 5).indices.T
    for k, (x, net) in enumerate(zip(powers, rows)):
        s, t = frame[k] @ (u, v)
        exact = (s ** x.indices[:, 0] * t ** x.indices[:, 1]) @ net
        np.testing.assert_allclose(at[k], exact, atol=1e-13)
        np.testing.assert_allclose((s**a * t**b) @ stored[k], exact, atol=1e-13)
    back = substituted(substituted(nets.padded(), frame), np.linalg.inv(frame))
    np.testing.assert_allclose(back, nets.padded(), atol=1e-10)
