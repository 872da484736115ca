"""Affine and projective types, normal forms, and the collineations to paraboloids."""

from __future__ import annotations

import numpy as np
import pytest
from geometry_cases import rotation
from surface_checks import implicit

from mitsuba_bezier.errors import GeometryError
from mitsuba_bezier.geometry.quadric_types import (
    classify_quadric,
    collineation_to_paraboloid,
    normal_form,
    projective_type,
)


def linear(x: float, y: float) -> np.ndarray:
    """``x X^2 + y Y^2 = 2 Z``."""
    return np.array([[x, 0, 0, 0], [0, y, 0, 0], [0, 0, 0, -1.0], [0, 0, -1.0, 0]])


CASES = [
    ("ellipsoid", "oval", np.diag([1.0, 4, 9, -1])),
    ("imaginary ellipsoid", "empty", np.diag([1.0, 4, 9, 1])),
    ("point", "point", np.diag([1.0, 4, 9, 0])),
    ("hyperboloid of one sheet", "ruled", np.diag([1.0, 4, -9, -1])),
    ("hyperboloid of one sheet", "ruled", np.diag([1.0, -4, -9, 1])),
    ("hyperboloid of two sheets", "oval", np.diag([1.0, 4, -9, 1])),
    ("hyperboloid of two sheets", "oval", np.diag([1.0, -4, -9, -1])),
    ("cone", "cone", np.diag([1.0, 4, -9, 0])),
    ("elliptic paraboloid", "oval", linear(1, 4)),
    ("hyperbolic paraboloid", "ruled", linear(1, -4)),
    ("parabolic cylinder", "cone", linear(1, 0)),
    ("plane and ideal plane", "pair of planes", linear(0, 0)),
    ("elliptic cylinder", "cone", np.diag([1.0, 4, 0, -1])),
    ("imaginary elliptic cylinder", "point", np.diag([1.0, 4, 0, 1])),
    ("line", "line", np.diag([1.0, 4, 0, 0])),
    ("hyperbolic cylinder", "cone", np.diag([1.0, -4, 0, -1])),
    ("hyperbolic cylinder", "cone", np.diag([1.0, -4, 0, 1])),
    ("pair of planes", "pair of planes", np.diag([1.0, -4, 0, 0])),
    ("pair of parallel planes", "pair of planes", np.diag([1.0, 0, 0, -1])),
    ("pair of imaginary parallel planes", "line", np.diag([1.0, 0, 0, 1])),
    ("double plane", "double plane", np.diag([1.0, 0, 0, 0])),
    ("double ideal plane", "double plane", np.diag([0.0, 0, 0, 1])),
]
SURFACES = [c for c in CASES if c[1] in ("oval", "ruled", "cone")]
OTHERS = [c for c in CASES if c[1] not in ("oval", "ruled", "cone")]
IDS = [f"{c[0]} {k}" for k, c in enumerate(CASES)]


def affine(rng: np.random.Generator, unit: float) -> np.ndarray:
    """A map of condition at most 10, with a shift by some units, to lengths of `unit`."""
    m = np.eye(4)
    for factor in (rng.uniform(0.5, 5, 3), np.ones(3)):
        q = rotation(rng, 3)
        m[:3, :3] = np.diag(factor) @ q @ m[:3, :3]
    m[:3, 3] = rng.normal(size=3)
    m[:3] *= unit
    return m


@pytest.mark.parametrize(("name", "projective", "a"), CASES, ids=IDS)
def test_types_do_not_depend_on_coordinates(name, projective, a):
    rng = np.random.default_rng(1)
    for unit in (1.0, 1e-4, 1e4):
        for factor in (1.0, -1e-7, 1e9):
            inverse = np.linalg.inv(affine(rng, unit))
            b = factor * inverse.T @ a @ inverse
            b = (b + b.T) / 2
            assert classify_quadric(b) == name
            assert projective_type(b) == projective


@pytest.mark.parametrize(("name", "projective", "a"), CASES, ids=IDS)
def test_projective_type_bears_collineations(name, projective, a):
    rng = np.random.default_rng(6)
    for _ in range(10):
        q = rotation(rng, 4)
        inverse = q @ np.diag(rng.uniform(0.5, 2, 4))
        b = inverse.T @ a @ inverse
        assert projective_type(-(b + b.T)) == projective


# without a quadratic part there is nothing to compare rounding in that part with
QUADRATIC = [c for c in CASES if c[2][:3, :3].any()]


@pytest.mark.parametrize(("name", "projective", "a"), QUADRATIC, ids=[c[0] for c in QUADRATIC])
def test_types_bear_rounding(name, projective, a):
    rng = np.random.default_rng(5)
    for _ in range(20):
        inverse = np.linalg.inv(affine(rng, 1.0))
        b = inverse.T @ a @ inverse
        # 1e-13 of the largest entry; the tolerance is 1e-10 of terms about as large as that
        noise = rng.uniform(-1, 1, (4, 4)) * 1e-13 * np.abs(b).max()
        assert classify_quadric(b + b.T + noise + noise.T) == name


SIGNATURES = {
    "oval": (3, 1),
    "ruled": (2, 2),
    "cone": (2, 1),
    "pair of planes": (1, 1),
    "double plane": (1, 0),
    "empty": (4, 0),
    "point": (3, 0),
    "line": (2, 0),
}


@pytest.mark.parametrize(("name", "projective", "a"), CASES, ids=IDS)
def test_projective_type_is_the_signature(name, projective, a):
    eigen = np.linalg.eigvalsh(a)
    counts = sorted(((eigen > 1e-9).sum(), (eigen < -1e-9).sum()), reverse=True)
    assert tuple(counts) == SIGNATURES[projective]


@pytest.mark.parametrize(("name", "projective", "a"), CASES, ids=IDS)
def test_normal_form_maps_the_normal_quadric(name, projective, a):
    rng = np.random.default_rng(2)
    for _ in range(10):
        inverse = np.linalg.inv(affine(rng, 1.0))
        b = inverse.T @ a @ inverse
        b = (b + b.T) / 2
        form = normal_form(b)
        assert form.matrix[3].tolist() == [0, 0, 0, 1]
        assert np.linalg.det(form.matrix) > 0
        got = form.matrix.T @ b @ form.matrix
        factor = np.vdot(got, form.normal) / np.vdot(form.normal, form.normal)
        # 1e-11: rounding times the square of the condition (10, and axes 1 : 3)
        assert np.abs(got / factor - form.normal).max() < 1e-11
        assert classify_quadric(form.normal) == name


def test_extreme_ellipsoids_are_ellipsoids():
    q = rotation(np.random.default_rng(3), 3)
    for radii in ([1, 1, 3e4], [1, 3e4, 3e4], [1e-6] * 3, [1e6] * 3):
        for center in (np.zeros(3), np.array([3.0, 2, 1]) * radii[0]):
            b = q @ np.diag(1 / np.square(np.array(radii, dtype=float))) @ q.T
            a = np.block([[b, -(b @ center)[:, None]], [-(b @ center), center @ b @ center - 1]])
            form = normal_form(a)
            assert form.name == "ellipsoid"
            axes = np.sort(np.linalg.norm(form.matrix[:3, :3], axis=0))
            # 1e-6: the smallest eigenvalue is 1e-9 of the largest, at 1e-16 rounding
            assert np.allclose(axes, np.sort(radii), rtol=1e-6)


def test_a_small_sphere_far_away_is_a_sphere():
    c, r = np.array([300.0, -200, 100]), 0.1
    a = np.block([[np.eye(3), -c[:, None]], [-c, np.array([[c @ c - r * r]])]])
    form = normal_form(a)
    assert form.name == "ellipsoid"
    # r^2 is 1e-7 of the terms in A, so 1e-9 of it is left of 1e-16
    assert np.allclose(form.matrix[:3, :3] @ form.matrix[:3, :3].T, r * r * np.eye(3), atol=1e-10)
    assert np.allclose(form.matrix[:3, 3], c, rtol=1e-14)


@pytest.mark.parametrize(("name", "projective", "a"), SURFACES, ids=[c[0] for c in SURFACES])
def test_every_surface_is_a_collineation_of_a_paraboloid(name, projective, a):
    rng = np.random.default_rng(4)
    x, y = rng.normal(size=(2, 100))
    z, equation = {
        "oval": (x**2 + y**2, "z = x^2 + y^2"),
        "ruled": (x**2 - y**2, "z = x^2 - y^2"),
        "cone": (x**2, "z = x^2"),
    }[projective]
    points = np.column_stack([x, y, z, np.ones(100)])
    for _ in range(10):
        inverse = np.linalg.inv(affine(rng, 1.0))
        b = inverse.T @ a @ inverse
        found = collineation_to_paraboloid((b + b.T) / 2)
        assert found.equation == equation
        # 1e-13: rounding times the condition of the map, squared in A
        assert implicit(found.paraboloid, points) < 1e-15
        assert implicit(b, points @ found.inverse.T) < 1e-13
        assert np.allclose(found.matrix @ found.inverse, np.eye(4), atol=1e-13)


@pytest.mark.parametrize("a", [c[2] for c in OTHERS], ids=[c[0] for c in OTHERS])
def test_no_paraboloid_without_a_curved_surface(a):
    with pytest.raises(GeometryError, match="A: expected an oval or ruled quadric or a cone, got"):
        collineation_to_paraboloid(a)


@pytest.mark.parametrize("call", [classify_quadric, projective_type, normal_form])
@pytest.mark.parametrize(
    "a", [np.zeros((4, 4)), np.eye(3), np.triu(np.ones((4, 4))), [[1, 2], [3]]]
)
def test_errors(call, a):
    with pytest.raises(GeometryError, match="A: expected"):
        call(a)
