"""The shape `asphere` in Mitsuba: hits, parameters, sampling, derivatives, errors."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from asphere_cases import ASPHERES, asphere_parameters, rays_at
from backend_cases import VARIANT

import mitsuba_bezier
from mitsuba_bezier.errors import BezierError
from mitsuba_bezier.geometry.aspheres import EvenAsphere


@pytest.fixture(autouse=True)
def _variant():
    mi.set_variant(VARIANT)


LENS = {
    "type": "asphere",
    "radius": 50.0,
    "conic": -1.2,
    "coefficients": [0, 1e-5, -3e-8, 1e-10],
    "aperture": 12.5,
}


def ray_of(o: np.ndarray, d: np.ndarray):
    return mi.Ray3f(mi.Point3f(np.float32(o).T), mi.Vector3f(np.float32(d).T))


def rows(value) -> np.ndarray:
    return np.array(value).T.astype(float)


@pytest.mark.parametrize("name", ["lens", "ring", "wavy", "r^40"])
def test_points_normals_and_partials_are_those_of_the_sag(name):
    surface = ASPHERES[name]
    shape = mi.load_dict(asphere_parameters(surface))
    o, d, kind = rays_at(surface, 3000, 1)
    si = shape.ray_intersect(ray_of(o, d), mi.RayFlags.All | mi.RayFlags.dNGdUV)
    ok = np.array(si.is_valid()) & (kind != 4)
    assert ok.mean() > 0.4
    p, n, uv = rows(si.p)[ok], rows(si.n)[ok], rows(si.uv)[ok]
    size = surface.aperture
    s = np.sum(p[:, :2] ** 2, axis=1)
    f, slope, second = surface.derivatives(np.minimum(s, size**2 * (1 + 1e-5)))
    steep = np.hypot(1, 2 * slope * np.sqrt(s))
    # a rounding of each coordinate in float32, and of uv
    assert (np.abs(p[:, 2] - f) / steep).max() < 2e-7 * max(size, np.abs(f).max())
    assert np.abs(uv - (0.5 + p[:, :2] / (2 * size))).max() < 2e-7
    truth = np.append(-2 * slope[:, None] * p[:, :2], np.ones((len(p), 1)), axis=1)
    # rounding p in float32 turns the normal by a rounding times the curvature
    bent = 1 + size * (np.abs(second) * 4 * s + 2 * np.abs(slope)) / steep
    off = np.linalg.norm(n - truth / np.linalg.norm(truth, axis=1, keepdims=True), axis=1)
    assert (off / bent).max() < 3e-7
    one = np.ones(len(p)), np.zeros(len(p))
    du = 2 * size * np.stack([one[0], one[1], 2 * slope * p[:, 0]], axis=1)
    dv = 2 * size * np.stack([one[1], one[0], 2 * slope * p[:, 1]], axis=1)
    for got, want in ((si.dp_du, du), (si.dp_dv, dv)):
        error = np.linalg.norm(rows(got)[ok] - want, axis=1) / (2 * size * bent * steep)
        assert error.max() < 3e-7
    # the normal's partials by differences of its own formula, along x and y
    step = 1e-5 * size
    for got, axis in ((si.dn_du, 0), (si.dn_dv, 1)):
        ends = []
        for sign in (-1, 1):
            q = p[:, :2].copy()
            q[:, axis] += sign * step
            b = surface.derivatives(np.minimum(np.sum(q**2, axis=1), size**2 * (1 + 9e-5)))[1]
            m = np.append(-2 * b[:, None] * q, np.ones((len(p), 1)), axis=1)
            ends.append(m / np.linalg.norm(m, axis=1, keepdims=True))
        inner = s < (size * (1 - 2e-5)) ** 2
        want = (ends[1] - ends[0]) / (2 * step) * 2 * size
        error = np.linalg.norm(rows(got)[ok] - want, axis=1) / (1 + np.linalg.norm(want, axis=1))
        assert error[inner].max() < 1e-4


def test_where_it_is_turned_squeezed_and_mirrored():
    surface = ASPHERES["lens"]
    rng = np.random.default_rng(3)
    for mirrored in (1, -1):
        matrix = np.eye(4)
        matrix[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0] @ np.diag([1, 2, 0.3 * mirrored])
        matrix[:3, 3] = 30, -40, 50
        shape = mi.load_dict({**asphere_parameters(surface), "to_world": matrix})
        o, d, kind = rays_at(surface, 2000, 2)
        wo, wd = o @ matrix[:3, :3].T + matrix[:3, 3], d @ matrix[:3, :3].T
        si = shape.ray_intersect(ray_of(wo, wd))
        ok = np.array(si.is_valid()) & (kind != 4)
        exact = shape.object_to_world
        inverse = np.linalg.inv(exact[:3, :3])
        p = (rows(si.p)[ok] - exact[:3, 3]) @ inverse.T
        s = np.sum(p[:, :2] ** 2, axis=1)
        f, slope, _second = surface.derivatives(np.minimum(s, surface.aperture**2 * (1 + 1e-5)))
        # 5e-6 is a rounding of 80 in float32; the map takes it to some three times as much
        assert np.abs(p[:, 2] - f).max() < 2e-5
        n = np.append(-2 * slope[:, None] * p[:, :2], np.ones((len(p), 1)), axis=1) @ inverse
        n *= np.sign(np.linalg.det(exact[:3, :3]))
        n /= np.linalg.norm(n, axis=1, keepdims=True)
        # a mirror image keeps its outside out: towards the image of positive z
        side = np.sign(np.sum(n * exact[:3, 2], axis=1, keepdims=True))
        assert np.abs(rows(si.n)[ok] - n * side).max() < 3e-6
        box = shape.bbox()
        low, high = np.array(box.min), np.array(box.max)
        assert (rows(si.p)[ok] >= low).all()
        assert (rows(si.p)[ok] <= high).all()


def test_normals_are_towards_positive_z_unless_flipped():
    ray = mi.Ray3f(mi.Point3f(1, 2, 30), mi.Vector3f(0, 0, -1))
    for flip in (False, True):
        n = mi.load_dict({**LENS, "flip_normals": flip}).ray_intersect(ray).n
        assert (n.z[0] < 0) == flip


def test_samples_have_their_density_and_the_area():
    surface = ASPHERES["ring"]
    shape = mi.load_dict(
        {**asphere_parameters(surface), "to_world": mi.ScalarTransform4f().scale([1, 2, 1])}
    )
    count = 200_000
    x = np.random.default_rng(0).random((2, count)).astype(np.float32)
    ps = shape.sample_position(0.0, mi.Point2f(x))
    pdf, p = np.array(ps.pdf).astype(float), rows(ps.p)
    ok = pdf > 0
    r = np.hypot(p[ok, 0], p[ok, 1] / 2)
    assert r.min() > surface.inner * (1 - 1e-6)
    assert r.max() < surface.aperture * (1 + 1e-6)
    area = shape.surface_area()[0]
    # the mean of 1 / pdf, within four standard deviations
    weight = np.where(ok, 1 / np.where(ok, pdf, 1), 0)
    assert abs(weight.mean() - area) < 4 * weight.std() / np.sqrt(count)
    assert ok.mean() > 0.75  # the cells on the rims of a thin ring are many
    # the inner half by area, by weights, against the area of a smaller ring
    inside = EvenAsphere(
        surface.curvature, 1.5, surface.conic, surface.coefficients, surface.inner
    ).area(np.diag([1, 2, 1.0]))
    part = np.where(ok & (np.hypot(p[:, 0], p[:, 1] / 2) < 1.5), weight, 0)
    assert abs(part.mean() - inside) < 4 * part.std() / np.sqrt(count)
    again = np.array(shape.pdf_position(ps))
    assert np.abs(again[ok] / pdf[ok] - 1).max() < 1e-5


def test_points_by_their_texture_coordinates():
    surface = ASPHERES["ring"]
    shape = mi.load_dict(asphere_parameters(surface))
    uv = np.random.default_rng(1).random((500, 2)).astype(np.float32)
    si = shape.eval_parameterization(mi.Point2f(uv.T))
    place = (2 * uv.astype(float) - 1) * surface.aperture
    r = np.linalg.norm(place, axis=1)
    assert (np.array(si.is_valid()) == ((r <= surface.aperture) & (r >= surface.inner))).all()
    ok = np.array(si.is_valid())
    truth = np.append(place[ok], surface.sag(r[ok] ** 2)[:, None], axis=1)
    assert np.abs(rows(si.p)[ok] - truth).max() < 2e-6
    assert np.abs(rows(si.uv)[ok] - uv[ok]).max() < 3e-7


@pytest.mark.parametrize("name", ["curvature", "conic", "coefficients", "to_world"])
def test_derivatives_of_hits_are_those_of_the_formula(name):
    shape = mi.load_dict(LENS)
    surface = shape.asphere
    rng = np.random.default_rng(4)
    target = np.append(rng.uniform(-6, 6, (200, 2)), np.zeros((200, 1)), axis=1)
    o = target + np.array([3.0, -2.0, 40.0])
    o, d = o.astype(np.float32), (target - o).astype(np.float32)
    value = mi.traverse(shape)[name]
    if name == "to_world":
        shift = mi.Float(0.0)
        dr.enable_grad(shift)
        params = mi.traverse(shape)
        params[name] = mi.Transform4f().translate(mi.Vector3f(0, 0, shift))
        params.update()
        value = shift
    else:
        dr.enable_grad(value)
    # a weight for each ray, so that no error cancels
    weight = rng.random(200)
    t = shape.ray_intersect(ray_of(o, d)).t
    dr.backward(dr.sum(t * mi.Float(np.float32(weight))))
    got = np.array(dr.grad(value)).ravel().astype(float)
    # dt = df / (d_z - f' ds), by the implicit function theorem, in float64
    o, d, t = o.astype(float), d.astype(float), np.array(t).astype(float)
    p = o + t[:, None] * d
    s = np.sum(p[:, :2] ** 2, axis=1)
    rate = d[:, 2] - surface.derivatives(s)[1] * 2 * np.sum(p[:, :2] * d[:, :2], axis=1)
    c, k = surface.curvature, surface.conic
    root = np.sqrt(1 - (1 + k) * c * c * s)
    change = {
        "curvature": [s / (1 + root) + c * s * (1 + k) * c * s / (root * (1 + root) ** 2)],
        "conic": [c**3 * s**2 / (2 * root * (1 + root) ** 2)],
        "coefficients": [s**i for i in range(1, 5)],
        "to_world": [np.ones_like(s)],
    }[name]
    want = np.array([np.sum(weight * x / rate) for x in change])
    assert got == pytest.approx(want, rel=2e-5)


def test_updates_and_what_is_refused_by_them():
    shape = mi.load_dict(LENS)
    params = mi.traverse(shape)
    ray = mi.Ray3f(mi.Point3f(6, 0, 40), mi.Vector3f(0, 0, -1))
    first = shape.ray_intersect(ray).t[0]
    # what float32 shows is not taken over: all digits stay
    params["curvature"] = mi.Float(params["curvature"])
    params.update()
    assert shape.asphere.coefficients == (0, 1e-5, -3e-8, 1e-10)
    assert shape.asphere.curvature == 1 / 50
    params["coefficients"] = mi.TensorXf([1e-3, 0.0], shape=(2,))
    params.update()
    expected = 40 - EvenAsphere(1 / 50, 12.5, -1.2, (1e-3, 0)).sag(36.0)
    assert shape.ray_intersect(ray).t[0] == pytest.approx(expected, rel=1e-7)
    params["conic"] = 100.0
    with pytest.raises(BezierError, match="aperture: expected a radius at which"):
        params.update()
    assert shape.conic[0] == pytest.approx(-1.2)
    assert shape.ray_intersect(ray).t[0] == pytest.approx(expected, rel=1e-7)
    assert abs(first - expected) > 1e-3


def test_a_scene_of_all_kinds_and_an_emitter():
    def film():
        return {"type": "hdrfilm", "width": 24, "height": 24, "rfilter": {"type": "box"}}

    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 3},
        "lamp": {
            **LENS,
            "aperture": 5.0,
            "to_world": mi.ScalarTransform4f().translate([0, 0, 30]).rotate([1, 0, 0], 180),
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 3.0}},
        },
        "floor": {"type": "rectangle", "to_world": mi.ScalarTransform4f().scale(20.0)},
        "ball": {
            "type": "beziertriangle",
            "control_points": mitsuba_bezier.sphere(),
            "to_world": mi.ScalarTransform4f().translate([6, 0, 3]).scale(2.0),
        },
        "ring": {
            "type": "beziertriangle",
            "control_points": mitsuba_bezier.torus(tube=0.3),
            "to_world": mi.ScalarTransform4f().translate([-6, 0, 3]).scale(2.0),
        },
        "sensor": {
            "type": "perspective",
            "to_world": mi.ScalarTransform4f().look_at([0, -40, 25], [0, 0, 5], [0, 0, 1]),
            "film": film(),
        },
    }
    image = np.array(mi.render(mi.load_dict(scene), spp=64)).mean()
    # the lamp as a fine mesh, to be seen by Mitsuba's own means
    surface = EvenAsphere(1 / 50, 5, -1.2, (0, 1e-5, -3e-8, 1e-10))
    lamp = scene["lamp"]
    r, a = np.meshgrid(np.linspace(0, 5, 33), np.arange(96) / 96 * 2 * np.pi, indexing="ij")
    points = np.stack([r * np.cos(a), r * np.sin(a), surface.sag(r**2)], axis=-1).reshape(-1, 3)
    at = np.arange(33 * 96).reshape(33, 96)
    quads = np.stack([at[:-1], at[1:], np.roll(at[1:], -1, 1), np.roll(at[:-1], -1, 1)], axis=-1)
    faces = np.concatenate([quads[..., [0, 1, 2]], quads[..., [0, 2, 3]]]).reshape(-1, 3)
    mesh = mi.Mesh("lamp", len(points), len(faces), props=_emitting(lamp))
    params = mi.traverse(mesh)
    matrix = np.array(lamp["to_world"].matrix)
    params["vertex_positions"] = mi.Float(
        (points @ matrix[:3, :3].T + matrix[:3, 3]).astype(np.float32).ravel()
    )
    params["faces"] = mi.UInt32(faces.astype(np.uint32).ravel())
    params.update()
    other = np.array(mi.render(mi.load_dict({**scene, "lamp": mesh}), spp=64, seed=7)).mean()
    # 576 pixels of 64 samples each: noise of some 0.5 %
    assert image == pytest.approx(other, rel=0.02)


def _emitting(lamp):
    props = mi.Properties()
    props["mesh_emitter"] = mi.load_dict(lamp["emitter"])
    return props


def test_instances():
    surface = ASPHERES["lens"]
    maps = np.tile(np.eye(4), (3, 1, 1))
    maps[1, :3, 3] = 40, 0, 0
    maps[2, :3, :3] *= 0.5
    maps[2, :3, 3] = 0, 40, 0
    shape = mi.load_dict({**asphere_parameters(surface), "instances": maps})
    o = np.array([[1, 2, 50], [41, 2, 50], [0.5, 41, 50], [20, 20, 50.0]])
    si = shape.ray_intersect(ray_of(o, np.tile([0, 0, -1.0], (4, 1))))
    assert np.array(si.is_valid()).tolist() == [True, True, True, False]
    sag = surface.sag(5.0)
    assert rows(si.p)[:2, 2] == pytest.approx([sag, sag], abs=1e-6)
    assert rows(si.p)[2, 2] == pytest.approx(0.5 * surface.sag(1 + 4.0), abs=1e-6)
    assert shape.surface_area()[0] == pytest.approx(2.25 * surface.area(), rel=1e-6)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"aperture": -1.0}, "aperture: expected a positive radius, got -1.0"),
        ({"radius": 1.0, "aperture": 2.0}, "at most 0.9999, got 2, where it is 4"),
        ({"radius": 0.0}, "radius: expected a number other than 0"),
        ({"radius": 1.0, "curvature": 2.0}, "at most one of radius and curvature, got both"),
        ({"coefficients": "1 two"}, "coefficients: expected numbers, got '1 two'"),
        ({"coefficients": "1 nan"}, "coefficients: expected finite numbers"),
        ({"inner_radius": 1.0}, "inner_radius: expected a radius from 0 to below 1"),
        ({"aperture": "wide"}, "aperture: expected a number, got 'wide'"),
        ({"radiuss": 1.0}, "unknown parameter 'radiuss'; did you mean 'radius'?"),
        ({"filename": "a.obj"}, "expected no net"),
    ],
)
def test_bad_parameters_are_one_line(parameters, message):
    with pytest.raises(RuntimeError) as error:
        mi.load_dict({"type": "asphere", **parameters})
    assert message in str(error.value)
    assert str(error.value).count("\n") == 0


def test_frozen_functions_follow_an_update():
    shape = mi.load_dict(LENS)
    scene = mi.load_dict({"type": "scene", "lens": shape})

    @dr.freeze
    def distance(scene, o):
        return scene.ray_intersect(mi.Ray3f(o, mi.Vector3f(0, 0, -1))).t

    o = mi.Point3f([0.0, 3.0, 6.0], 0.0, 40.0)
    scene.ray_intersect(mi.Ray3f(o, mi.Vector3f(0, 0, -1)))  # the structure, before it is frozen
    for terms in ((0, 1e-5), (1e-3, -1e-6)):
        params = mi.traverse(scene)
        params["lens.coefficients"] = mi.TensorXf(np.float32(terms))
        params.update()
        scene.ray_intersect(mi.Ray3f(o, mi.Vector3f(0, 0, -1)))
        want = 40 - EvenAsphere(1 / 50, 12.5, -1.2, terms).sag(np.array([0.0, 9.0, 36.0]))
        for _again in range(2):
            assert np.array(distance(scene, o)) == pytest.approx(want, rel=1e-7)
