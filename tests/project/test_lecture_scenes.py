"""The numbers of the lecture's scenes: exact rays through their pixels against the geometry."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest
from backend_cases import VARIANT

import mitsuba_bezier as mb
from mitsuba_bezier.geometry.collineations import homology
from mitsuba_bezier.geometry.developable import gaussian_curvature
from mitsuba_bezier.geometry.projective import affine, is_ideal, meet
from mitsuba_bezier.geometry.quadric_types import classify_quadric

mi.set_variant(VARIANT)

from lecture_cases import SCENES, edge_between, make_lecture, shot  # noqa: E402
from mitsuba_cases import tensor  # noqa: E402


@pytest.fixture(autouse=True)
def variant():
    mi.set_variant(VARIANT)


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


# ---------------------------------------------------------------------- Dürer's machine


def machine():
    """Return the module with the lute, which `make_lecture` imports."""
    return make_lecture().duerer_machine


def test_drawing_is_the_projection_of_the_outline():
    """The drawn curves lie in the picture plane, on the lines from the eye to the lute."""
    camera = shot("duerer", 1).camera
    # the sensor has its eye and its map in float32
    np.testing.assert_allclose(camera.center, machine().EYE, rtol=0, atol=1e-6)
    t = np.linspace(0, 1, 41)
    drawn, outline = machine().drawn_curves(), machine().outline()
    for name, curve in drawn.items():
        x, p = curve.points(t), outline[name].points(t)
        np.testing.assert_allclose(x @ machine().PICTURE[:3], 0, atol=1e-14)
        # the same t, by the theorem on projected control points; 1e-4 px: float32 camera
        np.testing.assert_allclose(camera.pixels(x), camera.pixels(p), rtol=0, atol=1e-4)


def test_drawn_tubes_follow_the_drawing():
    values = np.loadtxt(SCENES / "models" / "duerer_drawing.txt")
    drawn = machine().drawn_curves().values()
    for curve, net in zip(drawn, values[:, :3].reshape(len(drawn), -1, 3)):
        knots = (net[:-2] + 4 * net[1:-1] + net[2:]) / 6
        # fourth power of the spacing, see `tube`; a pixel is 0.003 wide there
        expected = curve.points(np.linspace(0, 1, len(knots)))
        np.testing.assert_allclose(knots, expected, rtol=0, atol=1e-5)


def test_drawing_covers_the_lute_as_the_eye_sees_it():
    """Exact rays behind the picture plane find the soundboard's edge where the drawing is."""
    # past the frame, the drawing and most of the threads
    s = shot("duerer", 1).behind(machine().PICTURE + np.array([0, 0, 0, 0.1]))
    t = np.linspace(0.03, 0.97, 25)
    for kinds, of in (
        (("rim", "side"), ("board", "rose", "bridge", "neck", "strings")),
        (("rose",), ("rose", "strings")),
    ):
        curves = [c for name, c in machine().drawn_curves().items() if name.startswith(kinds)]
        x = s.camera.pixels(np.concatenate([c.points(t) for c in curves]))
        step = s.camera.pixels(np.concatenate([c.points(t + 1e-4) for c in curves])) - x
        normal = np.column_stack([-step[:, 1], step[:, 0]])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        a, b = x + 2 * normal, x - 2 * normal
        in_a, in_b = s.sees(a, *of), s.sees(b, *of)
        clear = in_a != in_b
        # the neck, the strings and the ends of threads hide some of it
        assert clear.mean() > 0.85
        a, b = np.where(in_a[:, None], a, b)[clear], np.where(in_a[:, None], b, a)[clear]
        edge = edge_between(lambda p, of=of: s.sees(p, *of), a, b)
        off = np.abs(((edge - x[clear]) * normal[clear]).sum(axis=1))
        # float32 rays and the bisection leave 1e-4 px; hidden points find another edge
        assert np.quantile(off, 0.9) < 2e-3


def test_threads_pierce_the_drawing():
    drawn = np.concatenate(
        [c.points(np.linspace(0, 1, 2001)) for c in machine().drawn_curves().values()]
    )
    for eye, p in machine().threads():
        s = eye[0] / (eye[0] - p[0])
        pierced = eye + s * (p - eye)
        # 2000 points a curve: at most 3e-4 apart
        assert np.linalg.norm(drawn - pierced, axis=1).min() < 5e-4


def test_relief_covers_the_lute():
    """From the eye, the lute and its relief cover the same pixels, patch by patch."""
    eye = shot("duerer", 1)
    relief = make_lecture().lecture_drawings.RELIEF
    scene = shot("relief").scene
    parts = {name: shape for shape in scene.shapes() if (name := shape.id()) in machine().lute()}
    flat = {name: next(s for s in scene.shapes() if s.id() == f"relief_{name}") for name in parts}
    assert len(parts) == 5
    x, y = np.meshgrid(np.arange(100.5, 440, 4), np.arange(50.5, 240, 4))
    ray = eye.rays(np.column_stack([x.ravel(), y.ravel()]))
    for name, shape in parts.items():
        si, other = shape.ray_intersect(ray), flat[name].ray_intersect(ray)
        hit, again = np.array(si.is_valid()), np.array(other.is_valid())
        assert hit.sum() > 5, name
        # float32 decides at edges; the thin bridge has few pixels and much edge
        assert (hit != again).sum() <= 3, name
        on = hit & again
        p, q = (np.array(s.p, dtype=np.float64).T[on] for s in (si, other))
        image = np.c_[p, np.ones(len(p))] @ relief.T
        # the nearest hits correspond: the relief keeps the order along a ray; float32 at 3 units
        np.testing.assert_allclose(image[:, :3] / image[:, 3:], q, rtol=0, atol=2e-5)


# ---------------------------------------------------------------------- curves on a board


def test_drawn_schemes_end_on_their_curves():
    module = make_lecture().lecture_drawings
    for name, curve, t in module.DRAWINGS:
        levels = module.scheme(curve, t)
        assert [len(points) for points, _farin in levels] == [4, 3, 2, 1]
        end = levels[-1][0][0]
        np.testing.assert_allclose(end, module.standing(curve.evaluate(t)), rtol=0, atol=1e-13)
        # the last leg is the tangent, and every leg was drawn where it belongs
        a, b = levels[-2][0]
        np.testing.assert_allclose(np.cross(end - a, b - a), 0, atol=1e-13)
        for k, (points, _farin) in enumerate(levels[:-1]):
            values = np.loadtxt(SCENES / "models" / f"{name}_level{k}.txt")
            net = values[:, :3].reshape(len(points) - 1, 4, 3)
            # a straight B-spline of one segment begins at its second control point
            np.testing.assert_allclose(net[:, 1], points[:-1], rtol=0, atol=1e-6)
            np.testing.assert_allclose(net[:, 2], points[1:], rtol=0, atol=1e-6)


# ---------------------------------------------------------------------- one paraboloid


def members():
    return {m.name: m for m in make_lecture().paraboloids()}


def test_collineations_of_a_paraboloid_have_the_named_types():
    module = make_lecture()
    assert len(members()) == 9
    for name, member in members().items():
        patches, matrix = module.shown(member)
        assert patches == member.base.transform(matrix)
        for net, before in zip(patches.control_points, member.base.control_points):
            a, b = mb.fit_quadric(net), mb.fit_quadric(before)
            assert classify_quadric(b) in (
                "elliptic paraboloid",
                "hyperbolic paraboloid",
                "parabolic cylinder",
            )
            assert classify_quadric(a) == name
            moved = np.linalg.inv(matrix).T @ b @ np.linalg.inv(matrix)
            moved *= (moved * a).sum() / (moved * moved).sum()
            # rounding of a fit, times the condition of the collineation (some 1e2)
            np.testing.assert_allclose(moved, a, rtol=0, atol=1e-9 * np.abs(a).max())


def hits_of(s, ids, spacing):
    """Return points ``(N, 3)``, parameters and patches of the hits on each of these shapes."""
    w, h = s.camera.film_size
    x, y = np.meshgrid(np.arange(0.5, w, spacing), np.arange(0.5, h, spacing))
    seen, si = s.look(np.column_stack([x.ravel(), y.ravel()]))
    p, uv, n = (np.array(v, dtype=np.float64).T for v in (si.p, si.uv, si.n))
    prim = np.array(si.prim_index).astype(int)
    out = {}
    for name in ids:
        on = seen == s.ids.index(name)
        out[name] = (p[on], uv[on], prim[on], n[on])
    return out


def test_rays_meet_the_transformed_quadrics():
    s = shot("paraboloids")
    module = make_lecture()
    names = {m.name.replace(" ", "_"): m for m in members().values()}
    for name, (p, uv, prim, _n) in hits_of(s, names, 4).items():
        assert len(p) > 40, name
        _patches, matrix = module.shown(names[name])
        shape = s.scene.shapes()[s.ids.index(name)]
        world = shape.patches
        # hits are where the parameters say: float32 at a distance of ten
        np.testing.assert_allclose(world.points(prim, uv), p, rtol=0, atol=3e-5)
        # and come from the paraboloid with the same parameters
        to_world = np.array(shape.to_world.matrix, dtype=np.float64).reshape(4, 4)
        x = names[name].base.evaluate(prim, uv) @ (to_world @ matrix).T
        np.testing.assert_allclose(x[:, :3] / x[:, 3:], p, rtol=0, atol=3e-5)
        a = mb.fit_quadric(world.control_points[0])
        value = np.einsum("ni,ij,nj->n", np.c_[p, np.ones(len(p))], a, np.c_[p, np.ones(len(p))])
        gradient = 2 * np.linalg.norm((np.c_[p, np.ones(len(p))] @ a)[:, :3], axis=1)
        # distance from the quadric to first order; the cone's gradient vanishes in its apex only
        assert (np.abs(value) / gradient).max() < 3e-5, name


# ---------------------------------------------------------------------- weights and infinity


def test_rays_meet_the_weighted_patches():
    s = shot("weights")
    ids = [f"weight_{k}" for k in range(len(make_lecture().WEIGHTS))]
    for name, (p, uv, prim, _n) in hits_of(s, ids, 3).items():
        assert len(p) > 25, name
        patches = s.scene.shapes()[s.ids.index(name)].patches
        # float32 at a distance of 27
        np.testing.assert_allclose(patches.points(prim, uv), p, rtol=0, atol=1e-4, err_msg=name)
        assert (uv >= -1e-5).all() and (uv.sum(axis=1) <= 1 + 1e-5).all()


def edge(weight, t):
    """Return homogeneous points of the edge u + v = 1 with this weight in its middle."""
    net = make_lecture().weighted_net(weight)
    t = np.asarray(t, dtype=np.float64)
    return mb.BezierTriangles(net).evaluate(0, np.column_stack([1 - t, t]))


def test_what_weights_do_to_the_edge():
    t = np.linspace(0, 1, 101)
    a, b = edge(1.0, [0.0, 1.0])[:, :3]
    # zero: the control point has no say, the edge is the chord
    chord = affine(edge(0.0, t))
    np.testing.assert_allclose(np.cross(chord - a, b - a), 0, atol=1e-14)
    # negative: the other arc of the conic of the positive weight, which x(t) -> -w also means
    # the parameter t / (2 t - 1)
    inner = np.delete(t, 50)
    other = edge(0.45, inner / (2 * inner - 1))
    np.testing.assert_allclose(affine(other), affine(edge(-0.45, inner)), rtol=0, atol=1e-12)
    # large: towards the control point, as 1 / w
    top = affine(edge(6.0, [0.5]))[0]
    assert abs(1.5 - top[2]) < 1.5 / 7 + 1e-12
    # below -1 the edge runs through infinity twice, at w = -1 once, above never
    for weight, crossings in ((-1.2, 2), (-0.45, 0), (0.25, 0)):
        signs = np.sign(edge(weight, t)[:, 3])
        assert np.count_nonzero(np.diff(signs)) == crossings
    assert is_ideal(edge(-1.0, [0.5])).all()


# ---------------------------------------------------------------------- developable


def test_ribbon_is_developable_where_rays_meet_it():
    s = shot("developable")
    p, uv, prim, n = hits_of(s, ["ribbon"], 4)["ribbon"]
    assert len(p) > 200
    patches = s.scene.shapes()[s.ids.index("ribbon")].patches
    np.testing.assert_allclose(patches.points(prim, uv), p, rtol=0, atol=3e-5)  # float32
    # rounding of second derivatives, against curvatures of order 1 (mean curvature)
    assert np.abs(gaussian_curvature(patches.differential(prim, uv))).max() < 1e-9
    # along a ruling the tangent plane is the same: that of the control planes at this t
    t = np.where(prim == 0, uv[:, 0], 1 - uv[:, 0])
    planes = make_lecture().ribbon().tangent_plane(t)
    planes = planes[:, :] / np.linalg.norm(planes[:, :3], axis=1, keepdims=True)
    distance = np.abs((planes[:, :3] * p).sum(axis=1) + planes[:, 3])
    assert distance.max() < 3e-5
    assert (np.abs((planes[:, :3] * n).sum(axis=1)) > 1 - 1e-5).all()


def test_rulings_touch_the_curve_of_regression():
    module = make_lecture()
    curve, surface = module.REGRESSION, module.ribbon()
    t = np.linspace(0, 1, 21)
    # the curve of regression that the planes give is the cubic they came from
    x, y = surface.regression_curve().points(t), curve.points(t)
    np.testing.assert_allclose(x, y, rtol=0, atol=1e-10)
    h = 1e-5
    tangent = (curve.points(t + h) - curve.points(t - h)) / (2 * h)
    rulings = surface.ruling(t)[:, :3]
    cross = np.cross(tangent, rulings)
    scale = np.linalg.norm(tangent, axis=1) * np.linalg.norm(rulings, axis=1)
    # central difference: h^2 and rounding / h
    assert (np.linalg.norm(cross, axis=1) / scale).max() < 1e-8
    for p, q in module.ribbon_rulings():
        for plane in (module.RIBBON_PLANES[1],):
            assert abs(np.dot(plane, [*q, 1])) < 1e-12
        assert np.linalg.norm(p - q) > 0.3


# ---------------------------------------------------------------------- invariance


def test_picture_is_invariant_under_a_collineation_of_scene_and_rays():
    """General collineation: the same pixels see the same patches at the same parameters."""
    s = shot("figure2")
    shapes = [shape for shape in s.scene.shapes() if hasattr(shape, "patches")]
    rng = np.random.default_rng(3)
    h = np.eye(4) + 0.1 * rng.normal(size=(4, 4))
    h[3] = [0.03, 0.02, -0.025, 1.0]  # the plane that goes to infinity misses scene and eye
    w, hgt = s.camera.film_size
    x, y = np.meshgrid(np.arange(0.5, w, 3), np.arange(0.5, hgt, 3))
    ray = s.rays(np.column_stack([x.ravel(), y.ravel()]))
    o, d = (np.array(v, dtype=np.float64).T for v in (ray.o, ray.d))

    def seen(patches, o, d):
        scene = mi.load_dict(
            {"type": "scene"}
            | {
                f"s{k}": {"type": "beziertriangle", "control_points": tensor(p)}
                for k, p in enumerate(patches)
            }
        )
        si = mb.ray_intersect(
            scene, mi.Ray3f(mi.Point3f(*np.float32(o).T), mi.Vector3f(*np.float32(d).T))
        )
        number = np.full(len(o), -1)
        for shape in scene.shapes():
            on = np.array(mi.ShapePtr(si.shape) == mi.ShapePtr(shape)) & np.array(si.is_valid())
            number[on] = int(shape.id()[1:])
        return number, np.array(si.uv).T

    before, uv = seen([p.patches for p in shapes], o, d)
    a = np.c_[o, np.ones(len(o))] @ h.T
    b = np.c_[d, np.zeros(len(o))] @ h.T
    # derivative of the image of o + t d at t = 0: the ray keeps its sense where the weight is > 0
    assert (a[:, 3] > 0).all()
    direction = b[:, :3] * a[:, 3:] - a[:, :3] * b[:, 3:]
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    after, uv_after = seen([p.patches.transform(h) for p in shapes], a[:, :3] / a[:, 3:], direction)
    assert (before >= 0).sum() > 3000
    same = before == after
    # a ray through an edge may go either way in float32: 1e-6 of ten units, of 11 000 rays
    assert (~same).sum() <= 5
    on = same & (before >= 0)
    error = np.abs(uv - uv_after)[on].max(axis=1)
    # the parameters too; they are ill-determined at the collapsed ends of the lunes
    assert np.quantile(error, 0.995) < 2e-4


def test_render_is_invariant_under_a_relief_and_a_motion_of_the_camera():
    """Mitsuba's sensor on the original, and moved with the relief of the scene: one image."""
    s = shot("figure2")
    shapes = [shape for shape in s.scene.shapes() if hasattr(shape, "patches")]
    eye = s.camera.center
    # a plane behind the objects is fixed, everything else is drawn towards it
    relief = homology(eye, [0, 1, 0, -3.0], 0.4)
    motion = np.array(mi.ScalarTransform4f().translate([1, 2, 3]).rotate([0.6, 0, 0.8], 40).matrix)

    def image(patches, to_world):
        scene = {
            "type": "scene",
            "integrator": {"type": "bezierpath", "max_depth": 1},
            "sensor": {
                "type": "perspective", "fov": s.camera.x_fov, "fov_axis": "x",
                "to_world": mi.ScalarTransform4f(to_world),
                "film": {"type": "hdrfilm", "width": 160, "height": 90, "rfilter": {"type": "box"}},
            },
        }  # fmt: skip
        for k, p in enumerate(patches):
            light = {"type": "rgb", "value": [1 + k % 4, 1 + k // 4 % 4, 1 + k // 16]}
            # seen from behind a patch is black, in both pictures
            scene[f"s{k}"] = {
                "type": "beziertriangle",
                "control_points": tensor(p),
                "emitter": {"type": "area", "radiance": light},
            }
        return np.array(mi.render(mi.load_dict(scene), spp=4, seed=1))

    world = [shape.patches for shape in shapes]
    first = image(world, s.camera.to_world)
    moved = motion @ relief
    second = image([p.transform(moved) for p in world], motion @ s.camera.to_world)
    assert (first.sum(axis=2) > 0).mean() > 0.12  # the balls are there
    # float32 decides a sample on an edge: 57 600 samples, some 3 % of them within a pixel of one
    assert (np.abs(first - second).max(axis=2) > 1e-3).mean() < 1e-3
