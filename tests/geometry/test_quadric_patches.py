"""The characterisation of quadratic triangles on quadrics, and of polynomial ones."""

from __future__ import annotations

import numpy as np
import pytest
from geometry_cases import rotation

from mitsuba_bezier.errors import NetError
from mitsuba_bezier.geometry.covers import tetrahedral
from mitsuba_bezier.geometry.quadric_patches import (
    _common_point,
    _contracted_line,
    characterize,
    paraboloid_of,
)
from mitsuba_bezier.geometry.quadrics import quadric_patch, whiten
from mitsuba_bezier.geometry.shapes import cone, cylinder, hyperboloid_one_sheet

ROWS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


def parallel(a: np.ndarray, b: np.ndarray) -> float:
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    return float(min(np.abs(a - b).max(), np.abs(a + b).max()))


def regular(rng: np.random.Generator) -> np.ndarray:
    """A collineation of condition at most 4."""
    q = rotation(rng, 4)
    r = rotation(rng, 4)
    return q @ np.diag(rng.uniform(0.5, 2, 4)) @ r


def conics_through_a_point(rng, twist: float) -> tuple[np.ndarray, np.ndarray]:
    """Return a net whose boundary conics all pass through a point S, and S.

    ``b_ii = 2 l_i P_i``, ``b_ij = l_j P_i + l_i P_j - g_ij S``; edge ij passes S at the
    parameters ``l_j : -l_i``. With a twist t, on one edge ``l_j P_i t + l_i P_j / t``, it
    still does, but its tangent there is turned from ``P_i/l_i - P_j/l_j`` to
    ``t^2 P_i/l_i - P_j/l_j``, out of the plane of the others.
    """
    p, s = regular(rng)[:3], regular(rng)[3]
    l, g = rng.uniform(0.5, 2, 3) * rng.choice([-1, 1], 3), rng.uniform(0.5, 2, 3)
    net = []
    for i, j in ROWS:
        t = twist if (i, j) == (1, 2) else 1.0
        off = 0 if i == j else g[i + j - 1]
        net.append(t * l[j] * p[i] + l[i] / t * p[j] - off * s)
    return np.array(net), s


def test_consistent_conics_lie_on_a_quadric():
    rng = np.random.default_rng(1)
    for _ in range(50):
        net, s = conics_through_a_point(rng, 1.0)
        found = characterize(net)
        assert found.A is not None
        # 1e-11: white coordinates of a random net have conditions up to 1e3
        assert parallel(found.center, s) < 1e-11
        assert found.meeting < 1e-11 and found.coplanarity < 1e-11
        assert found.arcs_through in (0, 2)


def test_complementary_arc_leaves_the_quadric():
    # the same conics, but one edge of the patch is the other arc of its conic
    rng = np.random.default_rng(9)
    for _ in range(50):
        net, s = conics_through_a_point(rng, -1.0)
        found = characterize(net)
        assert found.A is None and parallel(found.center, s) < 1e-11
        assert found.meeting < 1e-11 and found.coplanarity < 1e-11
        assert found.arcs_through in (1, 3)


def test_tangents_out_of_plane_leave_every_quadric():
    rng = np.random.default_rng(2)
    for twist in (1.5, 0.5, -1.5, 1.01):
        net, s = conics_through_a_point(rng, twist)
        found = characterize(net)
        assert found.A is None and found.name is None
        assert parallel(found.center, s) < 1e-11
        assert found.meeting < 1e-11  # the conics do meet ...
        assert found.coplanarity > 1e-4  # ... but their tangents span space


def test_conics_that_do_not_meet():
    rng = np.random.default_rng(3)
    for _ in range(20):
        found = characterize(rng.normal(size=(6, 4)))
        assert found.A is None and found.meeting > 1e-3


def test_both_ways_to_the_center_agree():
    rng = np.random.default_rng(4)
    for _ in range(20):
        net, _s = conics_through_a_point(rng, 1.0)
        white = whiten(net[None])[0][0]
        assert parallel(_contracted_line(white), _common_point(white)) < 1e-11
        # only patches on quadrics contract a line
        other, _s = conics_through_a_point(rng, 1.3)
        assert _contracted_line(whiten(other[None])[0][0]) is None


@pytest.mark.parametrize("signature", [(1, 1, 1, -1), (1, 1, -1, -1)])
def test_measures_do_not_depend_on_coordinates(signature):
    rng = np.random.default_rng(5)
    for _ in range(20):
        m = regular(rng)
        d = np.array(signature, dtype=float)
        x = rng.normal(size=4)
        for part in (d > 0, d < 0):
            x[part] /= np.linalg.norm(x[part])
        net = quadric_patch(np.diag(d), x, regular(rng)[:3])
        found = characterize(net @ m.T)
        assert parallel(found.center, m @ x) < 1e-10
        assert found.coplanarity < 1e-10 and found.meeting < 1e-10
        twisted, _s = conics_through_a_point(rng, 1.4)
        a, b = characterize(twisted), characterize(-3 * twisted @ m.T)
        # 1e-9 relative: conditions of the net (1e3) and of the collineation
        assert np.isclose(a.coplanarity, b.coplanarity, rtol=1e-9)


def test_sphere_cover_has_its_corners_as_centers():
    patches = tetrahedral().control_points
    corners = patches[:4, 0] / patches[:4, :1, 3]
    for net in patches:
        found = characterize(net)
        assert found.name == "ellipsoid" and found.meeting < 1e-14 and found.coplanarity < 1e-14
        assert found.center[3] > 0 and not found.polynomial and found.paraboloid is None
    # a face is projected from the opposite corner, a lune from one of its own corners
    for net in patches[4:]:
        assert parallel(characterize(net).center, net[5]) < 1e-14
    for k, net in enumerate(patches[:4]):
        opposite = -(net[[0, 3, 5], :3] / net[[0, 3, 5], 3:]).sum(axis=0)
        assert np.allclose(opposite, characterize(net).center[:3] / characterize(net).center[3]), k
    assert corners.shape == (4, 4)


def test_straight_edges_have_no_conic():
    for net in cylinder().control_points:
        found = characterize(net)
        assert found.name == "elliptic cylinder" and found.meeting < 1e-13
        center = found.center[:3] / found.center[3]
        assert np.isclose(center[:2] @ center[:2], 1) and min(center[2], 1 - center[2]) < 1e-13
    for net in hyperboloid_one_sheet().control_points:
        assert characterize(net).name == "hyperboloid of one sheet"
    # double rulings at the apex: on a quadric, but projected from no point of it
    found = characterize(cone().control_points[0])
    assert found.name == "cone" and found.center is None


@pytest.mark.parametrize(
    ("q", "name"),
    [
        (np.diag([1.0, 2.0]), "elliptic paraboloid"),
        (np.array([[0.0, 1], [1, 0]]), "hyperbolic paraboloid"),
        (np.diag([1.0, 0]), "parabolic cylinder"),
    ],
)
def test_polynomial_triangles_on_paraboloids(q, name):
    rng = np.random.default_rng(6)
    for _ in range(20):
        p = rng.normal(size=(3, 2))
        net = np.array([[*(p[i] + p[j]) / 2, p[i] @ q @ p[j], 1] for i, j in ROWS])
        m = np.eye(4)
        m[:3, :3] = rotation(rng, 3) @ np.diag(rng.uniform(0.5, 2, 3))
        m[:3, 3] = rng.normal(size=3)
        found = characterize(2.5 * net @ m.T)
        assert found.polynomial and found.paraboloid == name
        assert np.array_equal(paraboloid_of(2.5 * net @ m.T), found.A)
        # S is the ideal point of the axis
        assert parallel(found.center, m[:, 2]) < 1e-11


def test_other_polynomial_triangles_lie_on_no_paraboloid():
    rng = np.random.default_rng(7)
    net = rng.normal(size=(6, 4))
    net[:, 3] = 1
    assert characterize(net).polynomial and paraboloid_of(net) is None
    # on a paraboloid, but rational
    a = np.diag([1.0, 1, 0, 0])
    a[2, 3] = a[3, 2] = -0.5
    net = quadric_patch(a, [0, 0, 0, 1], [[1, 0, 1, 1], [0, 1, 1, 1], [-1, 0, 1, 1]])
    found = characterize(net)
    assert found.name == "elliptic paraboloid" and not found.polynomial
    assert paraboloid_of(net) is None


def test_plane_nets_have_no_center():
    rng = np.random.default_rng(8)
    found = characterize(rng.normal(size=(6, 3)) @ rng.normal(size=(3, 4)))
    assert found == (None, None, None, None, None, None, False)


@pytest.mark.parametrize("net", [np.zeros((3, 4)), np.zeros((15, 4)), np.full((6, 4), np.inf)])
def test_errors(net):
    with pytest.raises(NetError, match=r"net: expected finite numbers of shape \(6, 4\)"):
        characterize(net)
