"""The numbers of the lecture's scenes: exact rays through their pixels against the geometry."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

import mitsuba_bezier as mb
from mitsuba_bezier.geometry.projective import affine, is_ideal, meet

mi.set_variant("llvm_ad_rgb")

from lecture_cases import SCENES, edge_between, make_lecture, shot  # noqa: E402


@pytest.fixture(autouse=True)
def variant():
    mi.set_variant("llvm_ad_rgb")


def line_through(x):
    """Return the line ``(3,)`` of least squares through pixels ``(N, 2)`` and its largest error."""
    middle = x.mean(axis=0)
    normal = np.linalg.svd(x - middle)[2][1]
    return np.array([*normal, -normal @ middle]), np.abs((x - middle) @ normal).max()


def flat_models():
    """Return all models of the script as ``(name of file, patches)``."""
    for group, models in make_lecture().models().items():
        for name, patches in models.items():
            yield f"{group}_{name}.vtu", patches


def test_files_are_those_of_the_script():
    """The committed models are what the script makes."""
    count = 0
    for name, patches in flat_models():
        saved = mb.load(SCENES / "models" / name)
        # 1e-12: points are stored divided by their weights in float64
        np.testing.assert_allclose(
            saved.control_points, patches.control_points, rtol=1e-12, atol=1e-12, err_msg=name
        )
        count += 1
    assert count > 15


# ---------------------------------------------------------------------- railroad


def rail_edges(s, name, rows):
    """Return the left and the right edge of a rail at pixel rows, ``(2, N, 2)``."""
    width = s.camera.film_size[0]
    x = np.arange(0.25, width, 0.25)
    edges = np.empty((2, len(rows), 2))
    for k, y in enumerate(rows):
        on = np.flatnonzero(s.sees(np.column_stack([x, np.full(len(x), y)]), name))
        assert len(on), f"no {name} at row {y}"
        for side, (first, step) in enumerate(((on[0], -1), (on[-1], 1))):
            edges[side, k] = edge_between(
                lambda p: s.sees(p, name), [[x[first], y]], [[x[first + step], y]]
            )
    return edges


def test_rails_meet_in_the_vanishing_point():
    s = shot("railroad")
    vanishing = affine(s.camera.vanishing_point(make_lecture().TRACK))
    rows = np.linspace(vanishing[1] + 25, vanishing[1] + 110, 8)
    lines = []
    for name in ("rail_left", "rail_right"):
        for edge in rail_edges(s, name, rows):
            line, error = line_through(edge)
            # float32 directions and distances: some 1e-4 px; straight to a tenth of the goal
            assert error < 0.01
            # the goal of the lecture: 0.1 px, 25 px above the nearest row of the fit
            assert abs(line @ [*vanishing, 1]) < 0.1
            lines.append(line)
    outer = meet(lines[0], lines[3])
    np.testing.assert_allclose(affine(outer), vanishing, rtol=0, atol=0.1)


def test_plane_ends_at_the_horizon():
    s = shot("railroad")
    horizon = s.camera.horizon([0, 0, 1, 0])
    x = np.linspace(2, s.camera.film_size[0] - 2, 60)
    expected = -(horizon[0] * x + horizon[2]) / horizon[1]
    # posts, ballast and wires stand in the way of some columns
    below = np.column_stack([x, expected + 1.0])
    free = s.sees(below, "ground") & (s.look(below - [0, 2.0])[0] == -1)
    assert free.sum() > 40
    below = below[free]
    seen = edge_between(lambda p: s.sees(p, "ground"), below, below - [0, 2.0])
    # the goal is 0.1 px; a float32 direction is 1e-7 off, 1e-4 px in the image
    np.testing.assert_allclose(seen[:, 1], expected[free], rtol=0, atol=1e-3)


def test_the_ground_is_met_as_far_as_float32_can_say():
    """A hundredth of a pixel below the horizon, the plane is hit kilometres away."""
    s = shot("railroad")
    horizon = s.camera.horizon([0, 0, 1, 0])
    x = s.camera.film_size[0] - 3.0
    y = -(horizon[0] * x + horizon[2]) / horizon[1] + 0.01
    _seen, si = s.look(np.array([[x, y]]))
    assert s.sees(np.array([[x, y]]), "ground").all()
    # height 2.1 m, 0.01 px at 525 px focal length: 110 km; a direction is off by up to 1 %
    focal = s.camera.film_size[0] / (2 * np.tan(np.radians(s.camera.x_fov / 2)))
    far = s.camera.center[2] * focal / 0.01
    assert 0.9 * far < float(si.t[0]) < 1.2 * far
    np.testing.assert_allclose(np.array(si.n).T, [[0, 0, 1]], rtol=0, atol=1e-6)


def test_railroad_ends_in_ideal_points():
    models = make_lecture().railroad()
    for name in ("ballast", "rail_left", "rail_right", "wires"):
        ends = models[name].evaluate(np.arange(len(models[name])), [[1.0, 0.0]] * len(models[name]))
        assert is_ideal(ends).all() and (ends[:, [0, 2]] == 0).all(), name


# ---------------------------------------------------------------------- figure 2


def test_ten_patches_tile_the_sphere_in_figure2():
    """Every ray that meets the sphere meets one patch of the whole ball, where the sphere is."""
    s = shot("figure2")
    w, h = s.camera.film_size
    x, y = np.meshgrid(np.arange(0.5, w, 2), np.arange(0.5, h, 2))
    pixels = np.column_stack([x.ravel(), y.ravel()])
    ray = s.rays(pixels)
    o, d = (np.array(a, dtype=np.float64).T for a in (ray.o, ray.d))
    center, radius = np.array([-1.25, 0, 1.0]), 1.0
    oc = o - center
    b, c = (oc * d).sum(axis=1), (oc * oc).sum(axis=1) - radius**2
    root = b * b - (d * d).sum(axis=1) * c
    t = -b - np.sqrt(np.maximum(root, 0))
    seen, si = s.look(pixels)
    names = np.array([*s.ids, "none"])[seen]
    whole = np.char.startswith(names, "whole_")
    tubes = names == "conics"
    # the tubes (0.016 thick) stand out of the sphere, hence the silhouette
    inside = root > 1e-5
    assert inside.sum() > 1000 and (whole | tubes)[inside].all()
    assert not whole[root < -1e-5].any()
    # float32: 1e-6 of a distance of ten, more at grazing angles
    np.testing.assert_allclose(np.array(si.t)[whole & inside], t[whole & inside], rtol=0, atol=1e-4)
    assert len({n for n in names if n.startswith("whole_")}) >= 5


def test_figure2_has_the_areas_of_the_sphere():
    areas = {name: p.area()[0] for name, p in make_lecture().figure2().items()}
    # 1e-9: the quadrature's tolerance
    assert np.isclose(sum(areas.values()), 4 * np.pi, rtol=1e-9)
    faces = sum(a for name, a in areas.items() if name.startswith("face"))
    assert np.isclose(faces / (4 * np.pi), 2 / 3, rtol=1e-9)


def test_drawn_conics_are_the_boundaries_of_the_patches():
    """The tubes' axes are circles on the sphere through the centres of projection."""
    values = np.loadtxt(SCENES / "models" / "figure2_conics.txt")
    arcs = make_lecture().figure2_arcs()
    tubes = values[:, :3].reshape(len(arcs), -1, 3)
    for arc, net in zip(arcs, tubes):
        # B-spline points at the knots
        knots = (net[:-2] + 4 * net[1:-1] + net[2:]) / 6
        t = np.linspace(0, 1, len(knots))
        # the quasi-interpolant errs by (h^4 / 36) p'''' or so: 1e-5 of a 24th of an arc
        np.testing.assert_allclose(knots, arc.points(t), rtol=0, atol=2e-5)
        assert np.allclose(np.linalg.norm(arc.points(t), axis=1), 1)
