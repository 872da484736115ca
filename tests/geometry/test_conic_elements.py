"""Foci, centre, axes, vertices and directrices of conics, through all types."""

from __future__ import annotations

import numpy as np
import pytest
from geometry_cases import apart, rotation

from mitsuba_bezier.errors import GeometryError
from mitsuba_bezier.geometry import conics
from mitsuba_bezier.geometry.conic_elements import conic_by_focus, conic_elements
from mitsuba_bezier.geometry.polarity import polar, pole
from mitsuba_bezier.geometry.projective import IDEAL_LINE, affine, incidence, is_ideal, point

ECCENTRICITIES = [0.0, 0.3, 0.8, 0.999, 1.0, 1.001, 1.5, 6.0]
eccentricities = pytest.mark.parametrize("e", ECCENTRICITIES)
S = np.linspace(0.02, 0.98, 13)


def place(seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.normal(size=2), rotation(rng, 2)[0]


def some_points(a: np.ndarray) -> np.ndarray:
    x = np.concatenate([arc.evaluate(S) for arc in conics.conic_arcs(a)])
    x = affine(x[~is_ideal(x, 1e-3)])
    return x


@eccentricities
@pytest.mark.parametrize("seed", range(4))
def test_distances_from_focus_and_directrix(e, seed):
    focus, direction = place(seed)
    a = conic_by_focus(focus, direction, 0.7, e)
    found = conic_elements(-3 * a)
    assert found.kind == ("ellipse" if e < 1 else "parabola" if e == 1 else "hyperbola")
    # a focus moves with the square root of what rounding does to a circle
    assert abs(found.eccentricity - e) < (1e-7 if e == 0 else 1e-12)
    assert abs(found.parameter - 0.7) < 1e-10
    x = some_points(a)
    far = np.linalg.norm(x, axis=1).max()
    for f, line in zip(found.foci, found.directrices):
        if is_ideal(f) or is_ideal(line, dual=True):
            assert e in (0.0, 1.0)
            continue
        r = np.linalg.norm(x - affine(f), axis=1)
        d = np.abs(x @ line[:2] + line[2]) / np.linalg.norm(line[:2])
        # the far directrix of an ellipse near the parabola is at 1/(1 - e), squared 1e6
        np.testing.assert_allclose(r, e * d, atol=1e-8 * far)
    assert min(np.linalg.norm(affine(f) - focus) for f in found.foci if not is_ideal(f)) < 1e-9


@pytest.mark.parametrize("e", [e for e in ECCENTRICITIES if e != 1])  # for 1 see the next test
def test_sum_or_difference_of_distances(e):
    focus, direction = place(7)
    a = conic_by_focus(focus, direction, 0.7, e)
    found = conic_elements(a)
    x = some_points(a)
    r = np.stack([np.linalg.norm(x - affine(f), axis=1) for f in found.foci])
    whole = np.linalg.norm(np.diff(affine(found.vertices), axis=0))
    total = r.sum(axis=0) if e < 1 else np.abs(r[0] - r[1])
    np.testing.assert_allclose(total, whole, rtol=1e-9)


def test_light_from_the_blind_focus_goes_to_the_other():
    """A parabola reflects what comes from its ideal focus into the finite one."""
    focus, direction = place(3)
    a = conic_by_focus(focus, direction, 0.7, 1.0)
    found = conic_elements(a)
    assert is_ideal(found.foci[1])
    axis = found.foci[1, :2] / np.linalg.norm(found.foci[1, :2])
    for x in some_points(a):
        normal = (a @ [*x, 1])[:2]
        normal = normal / np.linalg.norm(normal)
        out = axis - 2 * (axis @ normal) * normal
        to = focus - x
        assert abs(out[0] * to[1] - out[1] * to[0]) < 1e-12 * np.linalg.norm(to)


def test_the_blind_focus_is_a_limit():
    """All elements depend continuously on the conic as it goes through the parabola."""
    focus, direction = place(5)
    limit = conic_elements(conic_by_focus(focus, direction, 0.7, 1.0))
    for step in (1e-3, 1e-4, 1e-5):
        for e in (1 - step, 1 + step):
            found = conic_elements(conic_by_focus(focus, direction, 0.7, e))
            for name in ("center", "foci", "directrices", "axes", "vertices"):
                # they move by the inverse of their distance, 1/(1 - e), times some unit
                assert apart(getattr(found, name), getattr(limit, name)) < 10 * step, (name, e)


@pytest.mark.parametrize("seed", range(4))
def test_elements_are_poles_and_polars(seed):
    for e in (0.4, 1.0, 2.0):
        a = conic_by_focus(*place(seed), 1.3, e)
        found = conic_elements(a)
        assert apart(pole(a, IDEAL_LINE), found.center) < 1e-12
        assert apart(polar(a, found.foci), found.directrices) < 1e-12
        # the axes are lines of symmetry: through the centre, and the polar of an ideal point
        assert incidence(found.axes, found.center).max() < 1e-12
        assert incidence(found.axes[0], found.foci).max() < 1e-12
        assert incidence(found.axes[0], found.vertices).max() < 1e-12
        assert abs(np.einsum("ki,ij,kj->k", found.vertices, a, found.vertices)).max() < 1e-11
        if found.co_vertices is not None:
            assert incidence(found.axes[1], found.co_vertices).max() < 1e-12
        if found.asymptotes is not None:
            assert incidence(found.asymptotes, found.center).max() < 1e-12


def test_kinds_and_what_only_they_have():
    circle = conic_elements(np.diag([1.0, 1, -4]))
    assert circle.eccentricity == 0 and circle.parameter == 2
    assert is_ideal(circle.directrices, dual=True).all()
    assert apart(circle.foci, point([[0, 0], [0, 0]])) < 1e-15
    assert conic_elements(np.diag([1.0, 4, -4])).co_vertices is not None
    assert conic_elements(np.diag([1.0, 4, -4])).asymptotes is None
    hyperbola = conic_elements(np.diag([1.0, -4, -4]))
    assert sorted(affine(hyperbola.vertices)[:, 0].round(12)) == [-2, 2]
    assert hyperbola.co_vertices is None
    slopes = hyperbola.asymptotes[:, 0] / hyperbola.asymptotes[:, 1]
    np.testing.assert_allclose(sorted(slopes), [-0.5, 0.5])


# ---------------------------------------------------------------- balanced arcs


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("kind", ["ellipse", "parabola", "hyperbola"])
def test_arcs_are_balanced(kind, seed):
    rng = np.random.default_rng(seed)
    e = {"ellipse": rng.uniform(0, 0.9999), "parabola": 1.0, "hyperbola": rng.uniform(1.0001, 9)}
    # far from the origin: the map of eigenvectors put control points a hundred sizes away
    a = conic_by_focus(rng.normal(size=2) * 30, rng.normal(size=2), 0.7, e[kind])
    found = conic_elements(a)
    if kind == "parabola":
        middle = affine(found.vertices[0])
        bound = 5 * found.parameter / 2
    else:
        middle = affine(found.center)
        ends = found.vertices if found.co_vertices is None else found.co_vertices
        half = max(np.linalg.norm(affine(v) - middle) for v in [*found.vertices, *ends])
        if kind == "hyperbola":
            half = max(half, half * np.sqrt(found.eccentricity**2 - 1))
        bound = 3 * half
    arcs = conics.conic_arcs(a)
    for arc, following in zip(arcs, arcs[1:] + arcs[:1]):
        x = arc.control_points
        finite = affine(x[~is_ideal(x, 1e-12)])
        assert np.linalg.norm(finite - middle, axis=1).max() < bound * (1 + 1e-9)
        assert apart(conics.conic_matrix(arc).ravel(), a.ravel()) < 1e-8  # 30 sizes away, squared
        assert apart(arc.evaluate(1.0), following.evaluate(0.0)) < 1e-14


@pytest.mark.parametrize("arcs", [2, 3, 4, 6])
def test_points_of_arcs_at_infinity_are_control_vectors(arcs):
    for e in (1.0, 2.0):
        for arc in conics.conic_arcs(conic_by_focus([1, 2], [3, 1], 0.7, e), arcs):
            x = arc.control_points
            w = np.abs(x[:, 2]) / np.linalg.norm(x, axis=1)
            assert ((w == 0) | (w > 1e-3)).all()


# ---------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: conic_elements(np.diag([1.0, -1, 0])), "got two lines"),
        (lambda: conic_elements(np.diag([1.0, 0, -1])), "got two parallel lines"),
        (lambda: conic_elements(np.diag([1.0, 0, 0])), "got double line"),
        (lambda: conic_elements(np.eye(3)), "got empty"),
        (lambda: conic_elements(np.eye(4)), "3x3"),
        (lambda: conic_elements(np.full((3, 3), np.nan)), "finite"),
        (lambda: conic_by_focus([0, 0], [0, 0], 1, 1), "other than 0"),
        (lambda: conic_by_focus([0, 0], [1, 0], 0, 1), "p > 0"),
        (lambda: conic_by_focus([0, 0], [1, 0], 1, -1), "e >= 0"),
        (lambda: conic_by_focus([0, 0, 0], [1, 0], 1, 1), "two numbers"),
    ],
)
def test_bad_conics(call, says):
    with pytest.raises(GeometryError) as caught:
        call()
    assert says in str(caught.value)
