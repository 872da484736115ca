"""Rays leave a surface as far off as the error of the point asks: no near surface is passed by."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from backend_cases import VARIANT
from mitsuba_cases import ball_rays, bezier, numbers, ray_of

import mitsuba_bezier as mb
from mitsuba_bezier.oracles import analytic
from mitsuba_bezier.plugins.integrators.emitters import EmitterSampling
from mitsuba_bezier.plugins.offsets import own_error, spawn_ray, spawn_ray_to
from mitsuba_bezier.plugins.scene import SceneRays

COUNT = 2**14
#: Offset along (1, -1, 1) and size: those at which the coordinates leave room for a shell.
PLACES = [(0, 1), (0, 1e-3), (0, 1e3), (1e4, 1e3)]
GAP = 4e-5


@pytest.fixture(autouse=True, scope="module")
def variant() -> None:
    mi.set_variant(VARIANT)


def place(offset: float, size: float) -> Any:
    to = mi.ScalarTransform4f().translate([offset, -offset, offset])
    return to.scale([float(size)] * 3)


def owners(scene: Any, names: str) -> list[Any]:
    """Return the shapes of a scene by their names, as numbers that hits can be compared with."""
    by_id = {shape.id(): shape for shape in scene.shapes()}
    return [dr.reinterpret_array(mi.UInt32, mi.ShapePtr(by_id[name])) for name in names]


def passes(scene: Any, ray: Any, order: str) -> np.ndarray:
    """Follow rays straight through; return which do not meet these shapes in this order."""
    wrong = np.zeros(dr.width(ray.o), dtype=bool)
    last = ray
    for shape in owners(scene, order):  # as integrators of others do
        si = scene.ray_intersect(last)
        wrong |= numbers(dr.reinterpret_array(mi.UInt32, si.shape) != shape)
        last = si.spawn_ray(last.d)
    wrong |= numbers(scene.ray_test(last))
    rays = SceneRays(scene)
    for shape in owners(scene, order):
        hit = rays.preliminary(ray)
        # by a shadow ray, too, which must end there
        wrong |= ~numbers(rays.test(ray))
        si, p_err = rays.meet(hit, ray)
        wrong |= numbers(dr.reinterpret_array(mi.UInt32, si.shape) != shape)
        ray = spawn_ray(si, p_err, ray.d)
    return wrong | numbers(rays.test(ray))


@pytest.mark.parametrize("cover", ["octants", "tetrahedral", "lunes"])
@pytest.mark.parametrize(("offset", "size"), PLACES)
def test_shells(cover, offset, size):
    net, to = mb.sphere(cover=cover), place(offset, size)
    scene = mi.load_dict(
        {
            "type": "scene",
            "a": bezier(net, to_world=to),
            "b": bezier(net, to_world=to.scale([1 + GAP] * 3)),
        }
    )
    o, d = ball_rays(COUNT, seed=1, target=0.95)
    ray = ray_of(o * size + offset * np.array([1, -1, 1]), d)
    assert passes(scene, ray, "baab").sum() == 0


@pytest.mark.parametrize("kind", ["instances", "texcoords", "uv", "mixed", "flipped"])
def test_shells_of_every_kind(kind):
    ball = mb.sphere(cover="octants")
    outer = mi.ScalarTransform4f().scale([1 + GAP] * 3)
    more: dict[str, Any] = {}
    if kind == "instances":
        maps = np.tile(np.eye(4), (2, 1, 1))
        maps[1, :3, 3] = 1e4, 0, 0  # where these rays do not come
        more = {"instances": mi.TensorXf(maps.astype(np.float32).ravel(), shape=maps.shape)}
    elif kind == "texcoords":  # coordinates that tell nothing of the patch's size
        corners = np.array([[1e4, 0], [0, 1e4], [0, 0]], dtype=np.float32)
        corners = np.tile(corners, (len(ball), 1, 1))
        more = {"texcoords": mi.TensorXf(corners.ravel(), shape=corners.shape)}
    elif kind == "uv":
        more = {"uv": "spherical"}
    elif kind == "flipped":
        more = {"flip_normals": True}
    scene = {
        "type": "scene",
        "a": bezier(ball, **more),
        "b": bezier(ball, to_world=outer, **more),
    }
    if kind == "mixed":
        scene["other"] = {"type": "sphere", "center": [1e4, 0, 0]}
    o, d = ball_rays(COUNT, seed=1, target=0.95)
    assert passes(mi.load_dict(scene), ray_of(o, d), "baab").sum() == 0


@pytest.mark.parametrize(("offset", "size"), PLACES)
def test_cornea(offset, size):
    # a meniscus: spheres of radius 1 and 0.9 that are 4e-5 apart on the axis, and more beside it
    ball, to = mb.sphere(), place(offset, size)
    inner = to.translate([0, 0, 0.1 - GAP]).scale([0.9] * 3)
    scene = mi.load_dict(
        {"type": "scene", "a": bezier(ball, to_world=to), "b": bezier(ball, to_world=inner)}
    )
    rng = np.random.default_rng(2)
    target = np.column_stack([rng.uniform(-0.1, 0.1, (COUNT, 2)), np.full(COUNT, 0.998)])
    start = target + 0.5 * np.column_stack([rng.uniform(-0.6, 0.6, (COUNT, 2)), np.ones(COUNT)])
    d = (target - start) / np.linalg.norm(target - start, axis=1, keepdims=True)
    center = offset * np.array([1, -1, 1])
    o, d = np.float32(start * size + center), np.float32(d)
    # in float64, where the float32 rays meet the two
    truth = [
        analytic.sphere(center + size * np.array([0, 0, z]), size * r, o, d).first()
        for z, r in ((0, 1), (0.1 - GAP, 0.9))
    ]
    thin = truth[1] - truth[0]
    assert thin.min() > 0
    rays = SceneRays(scene)
    ray = ray_of(o, d)
    first, second = owners(scene, "ab")
    si, p_err = rays.meet(rays.preliminary(ray), ray)
    assert numbers(dr.reinterpret_array(mi.UInt32, si.shape) == first).all()
    ray = spawn_ray(si, p_err, ray.d)
    met = rays.intersect(ray)
    assert numbers(dr.reinterpret_array(mi.UInt32, met.shape) == second).all()
    # the way between them: what the origin moved, and roundings of the place, are missing
    assert np.abs(numbers(met.t) - thin).max() < 4e-6 * size + 4e-7 * offset


@pytest.mark.parametrize(("offset", "size"), PLACES)
def test_film(offset, size):
    # quartic patches without a closed form, one a little above the other
    rng = np.random.default_rng(3)
    flat = mb.BezierTriangles([[[1, 0, 0, 1], [0, 1, 0, 1], [0, 0, 0, 1]]]).elevate(4)
    net = np.array(flat.control_points)
    net[..., 2] = 0.2 * rng.random(net.shape[1])
    to = place(offset, size)
    film = mb.BezierTriangles(net)
    scene = mi.load_dict(
        {
            "type": "scene",
            "a": bezier(film, to_world=to),
            "b": bezier(film, to_world=to.translate([0, 0, GAP])),
        }
    )
    st = rng.random((COUNT, 2))
    st = np.where(st.sum(axis=1, keepdims=True) > 1, 1 - st, st) * 0.9 + 0.03
    target = np.column_stack([st, np.full(COUNT, 0.1)])
    start = target + np.column_stack([rng.uniform(-0.02, 0.02, (COUNT, 2)), np.full(COUNT, 0.4)])
    d = target - start
    center = offset * np.array([1, -1, 1])
    hits = mb.ray_test(scene, ray_of(start * size + center, d))
    inside = np.array(hits)
    assert inside.mean() > 0.5
    above = ray_of((start * size + center)[inside], d[inside])
    assert passes(scene, above, "ba").sum() == 0
    below = start + 2 * d
    below = ray_of((below * size + center)[inside], -d[inside])
    assert passes(scene, below, "ab").sum() == 0


def around(rng: np.random.Generator, n: np.ndarray) -> np.ndarray:
    """Return directions on the side of normals, a third of them grazing."""
    d = rng.normal(size=n.shape)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    height = np.abs(np.einsum("ni,ni->n", d, n))
    across = d - np.einsum("ni,ni->n", d, n)[:, None] * n
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    height = np.where(np.arange(len(d)) % 3 == 0, 10 ** rng.uniform(-5, 0, len(d)), height)
    return np.float32(height[:, None] * n + np.sqrt(1 - height**2)[:, None] * across)


BODIES = {
    "octants": lambda: mb.sphere(cover="octants"),
    "tetrahedral": mb.sphere,
    "lunes": lambda: mb.sphere(cover="lunes"),
    "cone": mb.cone,
    "cylinder": mb.cylinder,
    "torus": mb.torus,
    "needle": lambda: np.array(mb.sphere().control_points) * [1000, 1, 1, 1],
    "plate": lambda: np.array(mb.sphere().control_points) * [1000, 1000, 1, 1],
}


@pytest.mark.parametrize("body", BODIES)
@pytest.mark.parametrize(
    ("offset", "size"), [(0, 1), (1e3, 1), (0, 1e-3), (1e4, 1e3), (0, 1e3), (1e4, 1)]
)
def test_no_ray_meets_again_what_it_leaves(body, offset, size):
    scene = mi.load_dict(
        {"type": "scene", "body": bezier(BODIES[body](), to_world=place(offset, size))}
    )
    center = offset * np.array([1, -1, 1])
    o, d = ball_rays(COUNT, seed=4, target=0.95)
    ray = ray_of(o * size + center, d)
    rays = SceneRays(scene)
    si, p_err = rays.meet(rays.preliminary(ray), ray)
    met, n = numbers(si.is_valid()), numbers(si.n).astype(float)
    if body == "torus":  # its inner side is not convex
        place_of = (numbers(si.p) - center) / size
        met &= np.hypot(place_of[:, 0], place_of[:, 1]) > 1
    assert met.mean() > 0.1
    out = np.float32(around(np.random.default_rng(5), n))
    ray = spawn_ray(si, p_err, mi.Vector3f(*out.T.copy()))
    t = numbers(rays.preliminary(ray).pi.t)
    if body == "torus":  # and from above it rays may come to the other half
        t = np.where(t < 1e-2 * size, t, np.inf)
    assert not (met & np.isfinite(t)).any()


def test_far_points_of_a_plane_are_left_by_no_more_than_mitsubas_offset():
    turn = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]
    net = np.array(mb.plane().control_points)
    net[..., :3] = net[..., :3] @ turn.T
    scene = mi.load_dict({"type": "scene", "plane": bezier(net)})
    rng = np.random.default_rng(6)
    across = np.column_stack([10 ** rng.uniform(0, 5, (COUNT, 2)), np.zeros(COUNT)]) @ turn.T
    ray = ray_of(turn[:, 2] * 10.0, across - turn[:, 2] * 10.0)
    rays = SceneRays(scene)
    si, p_err = rays.meet(rays.preliminary(ray), ray)
    met = numbers(si.is_valid())
    assert met.all()
    assert (numbers(p_err) <= numbers(own_error(si.p))).all()
    for side in (1, -1):
        # steeply: the net's patches, rounded to float32, make a plane only to 1e-7 of its slope
        d = side * numbers(si.n) + rng.uniform(-0.5, 0.5, (COUNT, 3))
        d = mi.Vector3f(*np.float32(d).T.copy())
        assert not numbers(rays.test(spawn_ray(si, p_err, d))).any()


def test_planes_through_zero_are_left():
    # where all coordinates along the normal are zero, so are their roundings
    triangle = [[[1, 0, 0, 1], [0, 1, 0, 1], [0, 0, 0, 1]]]
    bent = np.array(mb.BezierTriangles(triangle).elevate(3).control_points)
    bent[0, 4, 2] = 2e-7  # as flat as what is still met as a plane
    o = np.column_stack([np.random.default_rng(6).random((COUNT, 2)) * 0.5, np.ones(COUNT)])
    for net in (mb.BezierTriangles(triangle), mb.BezierTriangles(bent)):
        scene = mi.load_dict({"type": "scene", "a": bezier(net)})
        rays = SceneRays(scene)
        for side in (1.0, -1.0):
            ray = ray_of(o * side, [[0.1, 0.2, -side]])
            if side < 0:
                ray = ray_of(o * [1, 1, -1], [[0.1, 0.2, 1]])
            hit = rays.preliminary(ray)
            si, p_err = rays.meet(hit, ray)
            for d in (ray.d, -ray.d):
                again = rays.test(spawn_ray(si, p_err, d))
                assert not numbers(again & si.is_valid()).any()


def test_mitsubas_own_shapes_keep_their_offset():
    scene = mi.load_dict(
        {
            "type": "scene",
            "ball": {"type": "sphere", "center": [3, 0.2, 0.1]},
            "ours": bezier(to_world=mi.ScalarTransform4f().translate([40, 0, 0])),
        }
    )
    o, d = ball_rays(1000, seed=7, target=0.9)
    ray = ray_of(o + np.array([3, 0.2, 0.1]), d)
    rays = SceneRays(scene)
    si, p_err = rays.meet(rays.preliminary(ray), ray)
    assert numbers(p_err == own_error(si.p)).all()
    away = mi.Vector3f(*np.roll(d, 1, axis=0).T.copy())
    ours, theirs = spawn_ray(si, p_err, away), si.spawn_ray(away)
    assert (numbers(ours.o) == numbers(theirs.o)).all()
    assert (numbers(ours.d) == numbers(theirs.d)).all()
    with mb.native(False):
        plain = si.spawn_ray(away)
    assert (numbers(plain.o) == numbers(theirs.o)).all()
    target = mi.Point3f(0, 5, 0)
    ours, theirs = spawn_ray_to(si, p_err, target).ray, si.spawn_ray_to(target)
    assert np.abs(numbers(ours.o) - numbers(theirs.o)).max() == 0
    # d = way / length, where Mitsuba may multiply
    assert np.abs(numbers(ours.d) - numbers(theirs.d)).max() < 2.5e-7
    assert np.abs(numbers(ours.maxt) / numbers(theirs.maxt) - 1).max() < 2.5e-7


RECTANGLE = mb.BezierTriangles(
    [[[1, -1, 0, 1], [1, 1, 0, 1], [-1, -1, 0, 1]], [[-1, 1, 0, 1], [-1, -1, 0, 1], [1, 1, 0, 1]]]
)


@pytest.mark.parametrize("lamp", ["beziertriangle", "rectangle"])
@pytest.mark.parametrize("blocker", [-GAP, GAP])
@pytest.mark.parametrize("size", [1.0, 1e-3, 1e3])
def test_shadow_rays_end_at_the_lamp(lamp, blocker, size):
    # a lamp seen from a floor, and a screen just before or just behind it
    up = mi.ScalarTransform4f().scale([size] * 3).translate([0, 0, 1])
    flip = mi.ScalarTransform4f().rotate([1, 0, 0], 180).scale([0.5] * 3)
    light = {"type": "area", "radiance": 1.0}
    shape: dict[str, Any] = {"type": "rectangle"} if lamp == "rectangle" else bezier(RECTANGLE)
    scene = mi.load_dict(
        {
            "type": "scene",
            "floor": bezier(RECTANGLE, to_world=mi.ScalarTransform4f().scale([size] * 3)),
            "lamp": {**shape, "to_world": up @ flip, "emitter": light},
            "screen": bezier(RECTANGLE, to_world=up.translate([0, 0, blocker])),
        }
    )
    o = np.random.default_rng(8).uniform(-0.9, 0.9, (COUNT, 3)) * [1, 1, 0] + [0, 0, 0.5]
    ray = ray_of(o * size, [[0, 0, -1]])
    rays = SceneRays(scene)
    sampling = EmitterSampling(rays)
    si, p_err = rays.meet(rays.preliminary(ray), ray)
    sample = mi.Point2f(*np.random.default_rng(9).random((2, COUNT)).astype(np.float32))
    ds, _weight, end_err = sampling.sample(si, sample, mi.Bool(True))
    blocked = numbers(rays.is_blocked(spawn_ray_to(si, p_err, ds.p, ds.n, end_err)))
    assert (blocked == (blocker < 0)).all()
    # the same by the scene's own method
    _ds, weight = scene.sample_emitter_direction(si, sample, True)
    assert ((numbers(weight)[:, 0] > 0) == (blocker > 0)).all()


@pytest.mark.parametrize("lit", [False, True])
def test_shadows_of_a_shell(lit):
    # points of the inner of two shells, lit through the outer one, or from the centre
    scene = mi.load_dict(
        {
            "type": "scene",
            "a": bezier(),
            "b": bezier(to_world=mi.ScalarTransform4f().scale([1 + GAP] * 3)),
            "light": {"type": "point", "position": [0, 0, 5 if not lit else 0]},
        }
    )
    o, d = ball_rays(COUNT, seed=10, start=0.5, target=0.4)
    rays = SceneRays(scene)
    ray = ray_of(o, d)  # from inside
    si, p_err = rays.meet(rays.preliminary(ray), ray)
    ds, _weight, end_err = EmitterSampling(rays).sample(si, mi.Point2f(0.5), mi.Bool(True))
    up = numbers(si.n)[:, 2] > 0.3  # for the others the ball itself is between
    blocked = numbers(rays.is_blocked(spawn_ray_to(si, p_err, ds.p, ds.n, end_err)))
    assert (blocked[up] == (not lit)).all()


def furnace(shapes: dict[str, Any], integrator: dict[str, Any]) -> np.ndarray:
    """Return an image inside of a white environment."""
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": integrator,
            "sky": {"type": "constant"},
            "camera": {
                "type": "perspective",
                "to_world": mi.ScalarTransform4f().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0]),
                "fov": 25,
                "film": {"type": "hdrfilm", "width": 24, "height": 24, "rfilter": {"type": "box"}},
                "sampler": {"type": "independent", "sample_count": 64},
            },
            **shapes,
        }
    )
    return np.array(mi.render(scene, seed=1))


@pytest.mark.parametrize("kind", ["bezierpath", "beziervolpath"])
@pytest.mark.parametrize("shells", [1, 2])
def test_furnace(kind, shells):
    # glass neither takes nor gives light, so it cannot be seen; a shell that is passed by leaves
    # the square of its index
    def ball(inner: float, outer: float, radius: float) -> dict[str, Any]:
        glass = {"type": "dielectric", "int_ior": inner, "ext_ior": outer}
        return bezier(to_world=mi.ScalarTransform4f().scale([radius] * 3), bsdf=glass)

    shapes = {"outer": ball(1.5, 1.0, 1 + GAP)}
    if shells == 2:
        shapes["inner"] = ball(1.8, 1.5, 1.0)
    image = furnace(shapes, {"type": kind, "max_depth": 200, "rr_depth": 200})
    # paths that end in total reflection after 200 bounces are lost: none of these few
    assert np.abs(image - 1).max() < 1e-4
