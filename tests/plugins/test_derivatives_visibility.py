"""Derivatives of visibility: silhouettes, edges, shadows, against central differences."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from backend_cases import VARIANT
from derivative_cases import BENT, attach, central, film, front_camera, inner, weights
from mitsuba_cases import bezier, tensor

import mitsuba_bezier as mb
from mitsuba_bezier.geometry.contours import contour_segments, edge_segments


@pytest.fixture(scope="module", autouse=True)
def variant() -> None:
    mi.set_variant(VARIANT)


# ---------------------------------------------------------------- curves


@pytest.mark.parametrize("cover", ["octants", "tetrahedral"])
def test_contours_of_a_sphere(cover):
    ball = mb.sphere(cover=cover)
    eye = np.array([0.3, 0.2, 4.0])
    found = contour_segments(ball, eye)
    a, b = ball.points(found.patch, found.a), ball.points(found.patch, found.b)
    # points of the polar plane of the eye; 1e-8: 1e-10 of an edge of 1/48, in parameters
    assert np.abs(a @ eye - 1).max() < 1e-8 and np.abs(b @ eye - 1).max() < 1e-8
    length = 2 * np.pi * np.sqrt(1 - 1 / (eye @ eye))
    # chords of some degrees are shorter than their arcs by a few 1e-5
    assert np.linalg.norm(a - b, axis=1).sum() == pytest.approx(length, rel=1e-4)
    assert not found.is_edge.any()


@pytest.mark.parametrize("cover", ["octants", "tetrahedral"])
def test_from_within_a_sphere_has_no_contour(cover):
    # at collapsed edges the facing is a rounding of either sign; ends there must still coincide
    assert len(contour_segments(mb.sphere(cover=cover), np.array([0.0, 0.0, 0.1]))) == 0


def test_contours_do_not_depend_on_a_common_factor():
    ball, eye = mb.torus(), np.array([0.3, 4.0, 1.5])
    plain = contour_segments(ball, eye)
    # the facing is a product of three: of 1e-120 it is below all numbers
    small = contour_segments(mb.BezierTriangles(ball.control_points * 2.0**-400), eye)
    assert len(plain) > 100 and np.array_equal(plain.a, small.a)


def test_creases_are_told_for_all_edges_at_once(monkeypatch):
    from mitsuba_bezier.geometry import contours

    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
    faces = [(0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 4, 5), (2, 3, 6, 7), (0, 2, 4, 6), (1, 3, 5, 7)]
    rows = np.array([corners[list(t)] for a, b, c, d in faces for t in ((a, b, c), (b, d, c))])
    cube = mb.BezierTriangles(np.concatenate([rows, np.ones((12, 3, 1))], axis=2))
    whole = contours.open_edges(cube)
    assert len(whole) == 12  # creases; the diagonals of the faces are smooth
    assert len(contours.open_edges(cube, creases=False)) == 0
    monkeypatch.setattr(contours, "_CHUNK", 5)
    assert np.array_equal(contours.open_edges(cube), whole)


def test_open_edges_and_creases():
    assert len(edge_segments(mb.sphere(), 1)) == 0
    assert len(edge_segments(mb.sphere(cover="tetrahedral"), 1)) == 0
    assert len(edge_segments(mb.torus(), 1)) == 0
    one, two = mb.sphere()[:1], mb.sphere()[:2]
    assert len(edge_segments(one, 1)) == 3
    assert len(edge_segments(two, 1)) == 4  # what they share is smooth
    # the same face twice, one turned about an edge: that edge is a crease, and counts once
    flat = mb.BezierTriangles([[[1, 0, 0, 1], [0, 1, 0, 1], [0, 0, 0, 1]]])
    folded = mb.BezierTriangles([[[0, 1, 0, 1], [1, 0, 0, 1], [1, 1, 1, 1]]])
    assert len(edge_segments(mb.BezierTriangles.join([flat, folded]), 1)) == 5
    same = mb.BezierTriangles([[[0, 1, 0, 1], [1, 0, 0, 1], [1, 1, 0, 1]]])
    assert len(edge_segments(mb.BezierTriangles.join([flat, same]), 1)) == 4
    # a lune: its collapsed edge is a point
    assert len(edge_segments(mb.sphere(cover="tetrahedral")[4:5], 1)) in (2, 3)


# ---------------------------------------------------------------- silhouettes the camera sees

SIDE = 8


def in_view(net: np.ndarray) -> Any:
    """A surface before a lit backdrop: its silhouettes and edges are in the image."""
    colour = {"type": "rgb", "value": [0.8, 0.6, 0.5]}
    return mi.load_dict(
        {
            "type": "scene",
            "camera": front_camera(SIDE),
            "surface": bezier(
                net, bsdf={"type": "twosided", "one": {"type": "diffuse", "reflectance": colour}}
            ),
            "point": {"type": "point", "position": [1, 3, 4.0], "intensity": 20.0},
            "back": {
                "type": "rectangle",
                "to_world": mi.ScalarTransform4f().translate([0, 0, -3]).scale(6),
                "bsdf": {"type": "diffuse", "reflectance": 0.0},
                "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [0.2, 0.5, 1]}},
            },
        }
    )


def along(net: np.ndarray) -> dict[str, np.ndarray]:
    """Return changes of a net: it grows, and it moves."""
    shift = np.zeros((4, 4))
    shift[0, 3], shift[1, 3] = 1, -0.7
    return {"grow": net @ np.diag([1.0, 1, 1, 0]), "shift": net @ shift.T}


def derivative(integrator: Any, scene: Any, net: np.ndarray, w: np.ndarray, spp: int) -> Any:
    points = attach(mi.traverse(scene), net)
    integrator.render_backward(scene, None, mi.TensorXf(w), seed=1, spp=spp)
    return np.array(dr.grad(points)).reshape(net.shape)


@pytest.mark.parametrize("kind", ["ball", "patch"])
def test_silhouettes_in_the_image(kind):
    # a closed surface has contours only; a bent patch has edges, and before some a contour
    net = mb.sphere(cover="octants").control_points if kind == "ball" else BENT
    scene = in_view(net)
    params = mi.traverse(scene)
    path = mi.load_dict({"type": "bezierpath", "max_depth": 2})
    full = mi.load_dict({"type": "bezier_direct_projective", "sppi": 0})
    w = weights(SIDE)
    got = derivative(full, scene, net, w, 4096)
    interior = derivative(path, scene, net, w, 256)
    for name, change in along(net).items():
        # samples cross the outline one by one: 8192 of them make 2 % of the sum of sizes
        want = central(
            lambda: mi.render(scene, integrator=path, spp=8100, seed=1),
            params, net, change, w, 0.03,
        )  # fmt: skip
        size = np.abs(got * change).sum()
        assert (got * change).sum() == pytest.approx(want, rel=0.1, abs=0.01 * size), name
        if name == "grow":
            assert abs((interior * change).sum() - want) > 0.8 * abs(want)  # it alone is wrong


def test_forward_is_reverse():
    scene = in_view(BENT)
    full = mi.load_dict({"type": "bezier_prb_projective", "max_depth": 2, "sppc": 0, "sppi": 0})
    w = weights(SIDE)
    got = derivative(full, scene, BENT, w, 64)
    change = np.random.default_rng(0).normal(size=BENT.shape)
    points = attach(mi.traverse(scene), BENT)
    dr.set_grad(points, tensor(change))
    image = full.render_forward(scene, None, seed=1, spp=64)
    assert np.abs(np.array(image)).max() > 0
    # the same samples: only the order of sums differs
    assert inner(image, w) == pytest.approx(float((got * change).sum()), rel=1e-4)


# ---------------------------------------------------------------- shadows


def out_of_view(net: np.ndarray) -> Any:
    """A surface above a floor: the camera sees its soft shadow only."""
    return mi.load_dict(
        {
            "type": "scene",
            "camera": {
                "type": "perspective",
                "fov": 40,
                "to_world": mi.ScalarTransform4f().look_at([0, -6, 3], [0, 0, 0], [0, 0, 1]),
                **film(4),
            },
            "surface": bezier(net, to_world=mi.ScalarTransform4f().translate([0, 0, 4])),
            "lamp": {
                "type": "rectangle",
                "to_world": mi.ScalarTransform4f().look_at([0.5, 0, 8], [0, 0, 0], [0, 1, 0]),
                "emitter": {"type": "area", "radiance": 10.0},
            },
            "floor": {"type": "rectangle", "to_world": mi.ScalarTransform4f().scale(10)},
        }
    )


@pytest.mark.parametrize("kind", ["ball", "patch"])
def test_shadows(kind):
    net = mb.sphere(cover="tetrahedral").control_points if kind == "ball" else BENT
    scene = out_of_view(net)
    params = mi.traverse(scene)
    path = mi.load_dict({"type": "bezierpath", "max_depth": 2})
    full = mi.load_dict({"type": "bezier_direct_projective", "sppc": 4, "sppp": 0})
    w = weights(4)
    got = derivative(full, scene, net, w, 16384)
    assert not derivative(path, scene, net, w, 4).any()  # without it there is nothing
    change = along(net)["grow"]
    want = central(
        lambda: mi.render(scene, integrator=path, spp=4096, seed=1), params, net, change, w, 0.04
    )
    # of the lines that touch the surface few pass lamp and floor: 2 % are noise
    assert (got * change).sum() == pytest.approx(want, rel=0.1)


# ---------------------------------------------------------------- parameters


@pytest.mark.parametrize(
    ("name", "parameters", "message"),
    [
        ("bezier_prb_projective", {"sppp": -1}, "sppp: expected an integer >= 0, got -1"),
        ("bezier_prb_projective", {"sppi": "x"}, "sppi: expected an integer >= 0, got 'x'"),
        ("bezier_prb_projective", {"max_depth": -2}, "max_depth: expected an integer >= 0"),
        ("bezier_direct_projective", {"max_depth": 3}, "max_depth: expected no value"),
        ("bezier_prb_projective", {"guidin": 1}, "unknown parameter 'guidin'"),
    ],
)
def test_bad_parameters(name, parameters, message):
    with pytest.raises(RuntimeError, match=message):
        mi.load_dict({"type": name, **parameters})


def test_only_perspective_cameras():
    scene = mi.load_dict(
        {
            "type": "scene",
            "camera": {"type": "orthographic", **film(2)},
            "surface": bezier(BENT, emitter={"type": "area"}),
        }
    )
    attach(mi.traverse(scene), BENT)
    integrator = mi.load_dict({"type": "bezier_direct_projective", "sppc": 0})
    with pytest.raises(mb.BezierError, match="sensor: expected a perspective camera"):
        integrator.render_backward(scene, None, mi.TensorXf(weights(2)), spp=1)
