"""Ray queries of a shape and of a scene, against the analytic sphere and the float64 net."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from backend_cases import VARIANT
from mitsuba_cases import analytic_sphere, ball_rays, bezier, camera_rays, numbers, ray_of

import mitsuba_bezier as mb

COVERS = ["octants", "tetrahedral"]


@pytest.fixture(scope="module", autouse=True)
def variant() -> None:
    mi.set_variant(VARIANT)


@pytest.fixture(scope="module")
def spheres(variant) -> dict[str, Any]:
    return {cover: mi.load_dict(bezier(mb.sphere(cover=cover))) for cover in COVERS}


@pytest.fixture(scope="module", params=COVERS)
def sphere(request, spheres) -> Any:
    return spheres[request.param]


# ---------------------------------------------------------------- against the analytic sphere

#: Rays this near the silhouette (relative) may go either way: float32 control points alone move
#: the surface by up to 6e-8 of the net's hull, a few times the radius.
BAND = 2e-6


def check_hits(shape: Any, o: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Compare closest and any hit with the analytic unit sphere; return the patches met."""
    ray = ray_of(o, d)
    pi = shape.ray_intersect_preliminary(ray)
    t, patch = numbers(pi.t), numbers(pi.prim_index)
    truth, distance = analytic_sphere(o, d)
    hit = np.isfinite(t)
    sure = np.abs(distance - 1) > BAND
    wrong = sure & (hit != np.isfinite(truth))
    assert not wrong.any(), f"{wrong.sum()} wrong, first {o[wrong][0]}, {d[wrong][0]}"
    both = hit & np.isfinite(truth)
    error = np.abs(t[both] - truth[both])
    cosine = np.sqrt(1 - distance[both] ** 2)
    # Seen along the normal: one rounding of t (up to 3.5) and one of the control points. What
    # that is along the ray grows towards the silhouette, where control points in float32 move
    # the true hit itself by as much.
    assert (error * cosine).max() < 4e-7
    assert error[cosine > 0.02].max() < 2e-5
    assert np.quantile(error, 1 - 1e-5) < 2e-5  # all but ten in a million, whatever the slant
    assert (numbers(shape.ray_test(ray)) == hit).all()
    assert (numbers(pi.is_valid()) == hit).all()
    return np.unique(patch[hit])


EYES = [(0.3, -0.4, 3.0), (-2.9, 0.5, -0.7), (1.1, 2.6, -1.2), (0.2, -2.3, -2.1)]


def test_four_million_primary_rays(sphere):
    met = [check_hits(sphere, *camera_rays(eye, 1000, seed=k)) for k, eye in enumerate(EYES)]
    # seen from all sides, no patch is left out
    assert len(np.unique(np.concatenate(met))) == sphere.primitive_count()


def test_a_million_rays_from_everywhere(sphere):
    check_hits(sphere, *ball_rays(1_000_000, seed=1))


def test_rays_that_were_missed(sphere):
    # up to 5e-5 inside the silhouette, where the march once forgot an error of the slope
    o = [
        [-1.3476462, 1.0660553, -1.8158678],
        [-1.1926343, 1.7599273, 1.3154008],
        [0.9617986, -0.12256945, -2.3043263],
        [0.3270289, 1.2454143, 2.1428943],
        [0.40136307, -1.7528274, -1.7368084],
    ]
    d = [
        [0.7308247, -0.5594912, 0.39097932],
        [0.6576001, -0.36281598, -0.66024745],
        [-0.70502913, 0.1561983, 0.691763],
        [-0.40773493, -0.67537606, -0.61450744],
        [-0.26880422, 0.89637595, 0.3524974],
    ]
    assert np.isfinite(numbers(sphere.ray_intersect_preliminary(ray_of(o, d)).t)).all()


def test_rays_from_inside(sphere):
    o, d = ball_rays(100_000, seed=2, start=0.95)
    truth, _ = analytic_sphere(o, d)
    pi = sphere.ray_intersect_preliminary(ray_of(o, d))
    t = numbers(pi.t)
    assert np.isfinite(t).all()  # no ray escapes
    # a chord from radius 0.95 meets the sphere at an angle of 18 degrees or more
    assert np.abs(t - truth).max() < 2e-6
    assert (numbers(sphere.ray_test(ray_of(o, d)))).all()


def test_rays_at_edges_and_corners_do_not_slip_through(sphere):
    # points of the common edges and corners of patches, and of edges of their midpoint splits
    patches = sphere.patches
    rng = np.random.default_rng(3)
    net = patches.split().split()
    count = 50_000
    uv = np.zeros((count, 2))
    side = rng.integers(0, 3, count)
    s = rng.choice([0.0, 0.5, 1.0, 0.25], count) + 0.0
    s = np.where(rng.random(count) < 0.5, s, rng.random(count))
    uv[side == 0] = np.stack([s, 1 - s], axis=1)[side == 0]
    uv[side == 1, 0] = s[side == 1]
    uv[side == 2, 1] = s[side == 2]
    target = net.points(rng.integers(0, len(net), count), uv)
    start = 0.7 * rng.uniform(-1, 1, (count, 3)) / np.sqrt(3)
    for o in (start, 2.5 * target + 0.4 * start):  # from inside and from outside
        t = numbers(sphere.ray_intersect_preliminary(ray_of(o, target - o)).t)
        assert np.isfinite(t).all()
        # 1e-4: the nearest hit is the one aimed at, not one behind it
        assert np.abs(t - 1).max() < 1e-4


def test_any_length_of_direction(sphere):
    o, d = ball_rays(20_000, seed=4)
    base = numbers(sphere.ray_intersect_preliminary(ray_of(o, d)).t)
    for scale in (1e-6, 1e-2, 1e3, 1e6):
        t = numbers(sphere.ray_intersect_preliminary(ray_of(o, d * np.float32(scale))).t)
        both = np.isfinite(t) & np.isfinite(base)
        assert (np.isfinite(t) != np.isfinite(base)).sum() <= 2  # roundings at the silhouette
        # roundings of the direction's three components, felt at slants down to 1/100
        assert np.median(np.abs(t[both] * scale - base[both])) < 1e-6


@pytest.mark.parametrize("cover", COVERS)
@pytest.mark.parametrize(("scale", "offset"), [(1, 0), (1e3, 1), (1e-3, 0), (1e3, 1e4)])
def test_spawned_rays_do_not_meet_their_own_surface(cover, scale, offset):
    # (scales and offsets of Mitsuba's own test of ray offsets)
    shape = mi.load_dict(
        bezier(
            mb.sphere(cover=cover),
            to_world=mi.ScalarTransform4f().translate([offset, 0, 0]).scale(scale),
        )
    )
    o, d = ball_rays(2**14, seed=12, target=0.95)
    si = shape.ray_intersect(ray_of(o * scale + np.array([offset, 0, 0]), d))
    assert numbers(si.is_valid()).all()
    rng = np.random.default_rng(13)
    sample = mi.Point2f(*rng.random((2, 2**14)).astype(np.float32))
    out = si.to_world(mi.warp.square_to_uniform_hemisphere(sample))
    assert not numbers(shape.ray_test(si.spawn_ray(out))).any()
    # into the ball: the other side is met, at the length of the chord
    t = numbers(shape.ray_intersect_preliminary(si.spawn_ray(-out)).t)
    cosine = np.einsum("ni,ni->n", numbers(si.n), numbers(out))
    steep = cosine > 0.02
    assert np.isfinite(t[steep]).all()
    # Mitsuba moves the origin by 1500 roundings of 6e-8, times 1 + the largest coordinate
    slack = 1e-4 * (1 + offset + scale)
    assert np.abs(t - 2 * scale * cosine)[steep].max() < slack / 0.02


# ---------------------------------------------------------------- rays that are no rays


BAD_RAYS = {
    "NaN origin": ([np.nan, 0, 3], [0, 0, -1]),
    "infinite origin": ([0, np.inf, 3], [0, 0, -1]),
    "NaN direction": ([0, 0, 3], [0, np.nan, -1]),
    "infinite direction": ([0, 0, 3], [0, 0, -np.inf]),
    "no direction": ([0, 0, 3], [0, 0, 0]),
    "all NaN": ([np.nan] * 3, [np.nan] * 3),
}


@pytest.mark.parametrize("name", BAD_RAYS)
def test_unusable_rays_miss(sphere, name):
    # between two good rays: one lane must not disturb another
    o = np.array([[0, 0, 3], BAD_RAYS[name][0], [0.1, 0, 3]])
    d = np.array([[0, 0, -1.0], BAD_RAYS[name][1], [0, 0, -1]])
    ray = ray_of(o, d)
    si = sphere.ray_intersect(ray)
    assert list(si.is_valid()) == [True, False, True]
    assert numbers(sphere.ray_intersect_preliminary(ray).t)[1] == np.inf
    assert list(sphere.ray_test(ray)) == [True, False, True]
    scene = mi.load_dict({"type": "scene", "s": sphere})
    assert list(mb.ray_test(scene, ray)) == [True, False, True]


@pytest.mark.parametrize("maxt", [np.nan, 0.0, -1.0])
def test_empty_segments_miss(sphere, maxt):
    ray = ray_of([[0, 0, 3.0]], [[0, 0, -1.0]], maxt)
    assert not sphere.ray_intersect(ray).is_valid()[0] and not sphere.ray_test(ray)[0]


def test_axis_parallel_rays(sphere):
    grid = np.linspace(-0.9, 0.9, 40) + 0.0
    x, y = (a.ravel() for a in np.meshgrid(grid, grid))
    for axis in range(3):
        for sign in (1.0, -1.0):
            for zero in (0.0, -0.0):
                o = np.stack([x, y], axis=1)
                o = np.insert(o, axis, -3 * sign, axis=1).astype(np.float32)
                d = np.full_like(o, zero)
                d[:, axis] = sign
                t = numbers(sphere.ray_intersect_preliminary(ray_of(o, d)).t)
                truth, distance = analytic_sphere(o, d)
                sure = np.abs(distance - 1) > 1e-5
                assert (np.isfinite(t) == np.isfinite(truth))[sure].all()


def test_maxt(sphere):
    o, d = ball_rays(50_000, seed=5, target=0.9)
    truth, _ = analytic_sphere(o, d)
    assert np.isfinite(truth).all()
    for factor, expected in ((1 - 1e-4, False), (1 + 1e-4, True)):
        ray = ray_of(o, d)
        ray.maxt = mi.Float((truth * factor).astype(np.float32))
        assert (numbers(sphere.ray_test(ray)) == expected).all()
        t = numbers(sphere.ray_intersect_preliminary(ray).t)
        assert (np.isfinite(t) == expected).all()
        assert (t[np.isfinite(t)] < numbers(ray.maxt)[np.isfinite(t)]).all()


def test_lanes_that_are_not_active(sphere):
    o, d = ball_rays(1000, seed=6, target=0.9)
    active = np.arange(1000) % 3 == 0
    ray = ray_of(o, d)
    mask = mi.Bool(active)
    assert (numbers(sphere.ray_intersect_preliminary(ray, mask).is_valid()) == active).all()
    assert (numbers(sphere.ray_test(ray, mask)) == active).all()
    assert (numbers(sphere.ray_intersect(ray, active=mask).is_valid()) == active).all()
    scene = mi.load_dict({"type": "scene", "s": sphere})
    assert (numbers(mb.ray_intersect(scene, ray, active=mask).is_valid()) == active).all()


# ---------------------------------------------------------------- interactions


def check_interaction(shape: Any, si: Any, ray: Any) -> None:
    """Compare the fields with the float64 net of the shape, evaluated at their own (u, v)."""
    valid = numbers(si.is_valid())
    assert valid.all()
    patch = numbers(si.prim_index)
    uv = numbers(si.uv)
    p, n = numbers(si.p), numbers(si.n)
    o, d, t = numbers(ray.o), numbers(ray.d), numbers(si.t)

    assert uv.min() > -1e-5 and uv.sum(axis=1).max() < 1 + 1e-5
    net = shape.patches
    truth = net.differential(patch, uv)
    size = np.abs(net.points(np.arange(len(net)), np.full((len(net), 2), 1 / 3))).max()
    # the net itself is stored in float32 and evaluated there: a few roundings
    assert np.abs(p - truth.p).max() < 1e-6 * size
    # the point reported and the point on the ray: (u, v) are float32 too, and a slanted ray
    # turns an error across it into one along it
    along = np.linalg.norm(o + t[:, None] * d - p, axis=1)
    cosine = np.abs(np.einsum("ni,ni->n", n, d)) / np.linalg.norm(d, axis=1)
    assert (along * cosine).max() < 3e-6 * size

    # first partials: the differences of points half a percent apart, and the exact ones
    h = 5e-3
    for got, exact, step in (
        (numbers(si.dp_du), truth.dp_du, [h, 0]),
        (numbers(si.dp_dv), truth.dp_dv, [0, h]),
    ):
        scale = np.linalg.norm(exact, axis=1).max()
        assert np.abs(got - exact).max() < 2e-5 * scale  # ten roundings of the net's entries
        difference = (net.points(patch, uv + step) - net.points(patch, uv - step)) / (2 * h)
        # third derivatives of these nets are up to 200 times the first: h^2/6 of that
        assert np.abs(got - difference).max() < 5e-3 * scale

    # unit normals along the cross product, turned by the orientation
    assert np.abs(np.linalg.norm(n, axis=1) - 1).max() < 1e-6
    exact = net.normals(patch, uv) * shape.orientation
    assert np.einsum("ni,ni->n", n, exact).min() > 1 - 1e-5

    frame = si.sh_frame
    axes = [numbers(frame.s), numbers(frame.t), numbers(frame.n)]
    for i, a in enumerate(axes):
        for j, b in enumerate(axes):
            assert np.abs(np.einsum("ni,ni->n", a, b) - (i == j)).max() < 1e-5
    assert np.abs(axes[2] - n).max() < 1e-6
    world = numbers(si.to_world(si.wi))
    assert np.abs(world + d).max() < 1e-5 * np.abs(d).max()  # of the ray's own length
    assert (numbers(si.wi)[:, 2] * np.einsum("ni,ni->n", n, d) <= 0).all()
    assert numbers(si.shape == mi.ShapePtr(shape)).all()
    assert numbers(si.bsdf(mi.RayDifferential3f(ray)) == mi.BSDFPtr(shape.bsdf())).all()


TO_WORLD = np.array([[2.0, 0.3, 0, 0.4], [-0.2, 1.1, 0, 0], [0, 0.1, -0.7, 0.2], [0, 0, 0, 1]])


@pytest.mark.parametrize("cover", COVERS)
@pytest.mark.parametrize("moved", [False, True])
def test_interaction_fields(cover, moved):
    matrix = TO_WORLD if moved else np.eye(4)
    shape = mi.load_dict(
        bezier(
            mb.sphere(cover=cover),
            to_world=mi.ScalarTransform4f(matrix.tolist()),
            flip_normals=moved,
            bsdf={"type": "conductor"},
        )
    )
    o, d = ball_rays(20_000, seed=7, target=0.95)
    m = matrix[:3, :3]
    ray = ray_of(o @ m.T + matrix[:3, 3], d @ m.T)
    si = shape.ray_intersect(ray)
    check_interaction(shape, si, ray)
    outward = numbers(si.p) - matrix[:3, 3]
    outward = np.linalg.solve(m, outward.T).T @ np.linalg.inv(m)
    sign = np.einsum("ni,ni->n", numbers(si.n), outward)
    assert (sign * (-1 if moved else 1) > 0).all()
    pi = shape.ray_intersect_preliminary(ray)
    assert (numbers(pi.t) == numbers(si.t)).all()
    assert (numbers(pi.prim_index) == numbers(si.prim_index)).all()
    assert numbers(pi.shape == mi.ShapePtr(shape)).all()


@pytest.mark.parametrize("double", [False, True])
@pytest.mark.parametrize("spread", [1e-2, 1e-4, 1e-6])
def test_around_collapsed_corners(double, spread):
    # Lunes have an edge that is collapsed into a corner, the centre of projection of another
    # patch; nothing of the inverse of either is left there.
    net = mb.sphere(cover="tetrahedral").control_points
    as_tensor = mi.TensorXf64 if double else mi.TensorXf
    values = net.astype(np.float64 if double else np.float32)
    shape = mi.load_dict(
        {"type": "beziertriangle", "control_points": as_tensor(values.ravel(), shape=net.shape)}
    )
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3)
    corners = np.repeat(corners, 5000, axis=0)
    rng = np.random.default_rng(8)
    target = corners + spread * rng.normal(size=corners.shape)
    o = 2 * corners + 0.3 * rng.normal(size=corners.shape)
    d = target - o
    ray = ray_of(o, d)
    si = shape.ray_intersect(ray)
    valid = numbers(si.is_valid())
    truth, distance = analytic_sphere(numbers(ray.o), numbers(ray.d))
    sure = np.abs(distance - 1) > BAND
    assert (valid == np.isfinite(truth))[sure].all()
    o, d, t = numbers(ray.o)[valid], numbers(ray.d)[valid], numbers(si.t)[valid]
    p, n = numbers(si.p)[valid], numbers(si.n)[valid]
    assert np.abs(np.linalg.norm(p, axis=1) - 1).max() < 1e-6
    # (u, v) is known to sqrt(1e-16 .. 1e-7) there, p not much worse than elsewhere
    assert np.linalg.norm(p - (o + t[:, None] * d), axis=1).max() < 2e-5
    # 1e-2 is eight degrees, at 1e-5 from the tip; a reversed normal has -1
    assert np.einsum("ni,ni->n", n, p).min() > 1 - 1e-2
    for value in (si.dp_du, si.dp_dv, si.wi, si.sh_frame.s):
        assert np.isfinite(numbers(value)).all()


# ---------------------------------------------------------------- scenes


def lined_up() -> Any:
    """A Bézier sphere between a rectangle in front (x > 0) and a sphere of Mitsuba behind."""
    move = mi.ScalarTransform4f().translate
    return mi.load_dict(
        {
            "type": "scene",
            "screen": {
                "type": "rectangle",
                "to_world": move([1, 0, 2]),
                "bsdf": {"type": "twosided", "bsdf": {"type": "diffuse"}},
            },
            "bezier": bezier(bsdf={"type": "conductor"}),
            "small": bezier(
                mb.sphere(cover="tetrahedral"),
                to_world=move([0, -2, 0]) @ mi.ScalarTransform4f().scale(0.5),
                bsdf={"type": "plastic"},
            ),
            "behind": {"type": "sphere", "center": [0, 0, -4], "radius": 3},
        }
    )


def one_of(scene: Any, word: str) -> Any:
    return next(s for s in scene.shapes() if s.id() == word)


def test_scenes_with_other_shapes():
    scene = lined_up()
    x = np.linspace(-4, 4, 161)
    o = np.stack([np.tile(x, 161), np.repeat(x, 161), np.full(161**2, 6.0)], axis=1)
    o[:, :2] += 0.0123
    d = np.array([[0, 0, -1.0]])
    ray = ray_of(o, d)
    si = mb.ray_intersect(scene, ray)
    o, d = np.broadcast_arrays(o.astype(np.float32), d.astype(np.float32))

    screen = np.where(
        (np.abs(o[:, 0] - 1) < 1) & (np.abs(o[:, 1]) < 1), 4.0, np.inf
    )  # in front of the ball
    answers = {
        "screen": screen,
        "bezier": analytic_sphere(o, d)[0],
        "small": analytic_sphere(o, d, (0, -2, 0), 0.5)[0],
        "behind": analytic_sphere(o, d, (0, 0, -4), 3)[0],
    }
    table = np.stack(list(answers.values()))
    truth, which = table.min(axis=0), table.argmin(axis=0)
    # rays within a thousandth of an outline are left out: the grid has none on purpose
    edge = np.zeros(len(o), dtype=bool)
    for center, radius in (((0, 0), 1), ((0, -2), 0.5), ((0, 0), 3)):
        edge |= np.abs(np.hypot(*(o[:, :2] - center).T) - radius) < 1e-3
    sure = ~edge
    assert sure.mean() > 0.98
    t = numbers(si.t)
    assert (np.isfinite(t) == np.isfinite(truth))[sure].all()
    hit = sure & np.isfinite(truth)
    # Mitsuba's own sphere of radius 3 is solved in float32, here at slants down to 1/40
    assert np.abs(t[hit] - truth[hit]).max() < 2e-4
    for number, name in enumerate(answers):
        mine = hit & (which == number)
        assert mine.sum() > 50, name
        shape = one_of(scene, name)
        assert numbers(si.shape == mi.ShapePtr(shape))[mine].all(), name
        assert numbers(si.bsdf(mi.RayDifferential3f(ray)) == mi.BSDFPtr(shape.bsdf()))[mine].all()
    assert (numbers(mb.ray_test(scene, ray)) == np.isfinite(t))[sure].all()
    n = numbers(si.n)
    ours = hit & ((which == 1) | (which == 2))
    center = np.where((which == 2)[:, None], [0, -2, 0], [0, 0, 0])
    out = (numbers(si.p) - center)[ours]
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    assert np.einsum("ni,ni->n", n[ours], out).min() > 1 - 1e-5
    assert (numbers(si.prim_index)[ours] < np.where(which == 1, 8, 10)[ours]).all()


def test_segments_in_a_scene():
    scene = lined_up()
    # from between the screen and the ball, up to just before and behind each of them, and in the
    # gap between the ball and the one behind it
    o = np.array([[0.3, 0.1, 1.5], [0.3, 0.1, 6], [-0.3, 0.1, 6], [-0.3, 0.1, 6], [-0.3, 0.1, -1]])
    o = np.concatenate([o, o[-1:]])
    d = np.array([[0, 0, -1.0], [0, 0, -1], [0, 0, -1], [0, 0, -1], [0, 0, 1], [0, 0, 1]])
    ray = ray_of(o, d)
    ray.maxt = mi.Float([10, 3.9, 5.0, 5.1, 0.04, 0.06])
    si = mb.ray_intersect(scene, ray)
    expected = [True, False, False, True, False, True]
    assert list(si.is_valid()) == expected and list(mb.ray_test(scene, ray)) == expected
    assert float(si.t[0]) == pytest.approx(1.5 - np.sqrt(0.9), abs=2e-6)


def test_scenes_without_bezier_shapes_are_mitsubas():
    scene = mi.load_dict({"type": "scene", "s": {"type": "sphere"}})
    o, d = ball_rays(1000, seed=9)
    ray = ray_of(o, d)
    ours, theirs = mb.ray_intersect(scene, ray), scene.ray_intersect(ray)
    for name in ("t", "p", "n", "uv", "dp_du", "wi"):
        assert np.array_equal(numbers(getattr(ours, name)), numbers(getattr(theirs, name))), name
    assert (numbers(mb.ray_test(scene, ray)) == numbers(scene.ray_test(ray))).all()


def test_scenes_that_share_shapes_are_told_apart(spheres):
    # a new scene may lie where a deleted one was
    ray = ray_of([[0.1, 0.2, 5]], [[0, 0, -1]])
    screen = {"type": "rectangle", "to_world": mi.ScalarTransform4f().translate([0, 0, 3])}
    for _ in range(8):
        for more, expected in (({}, 4.025320), ({"screen": screen}, 2.0)):
            scene = mi.load_dict({"type": "scene", "ball": spheres["tetrahedral"], **more})
            assert float(mb.ray_intersect(scene, ray).t[0]) == pytest.approx(expected, abs=2e-6)
            del scene


def test_scene_queries_follow_an_update():
    scene = mi.load_dict({"type": "scene", "ball": bezier(), "other": {"type": "rectangle"}})
    ray = ray_of([[0.2, 0.1, 5]], [[0, 0, -1]])
    before = float(mb.ray_intersect(scene, ray).t[0])
    params = mi.traverse(scene)
    params["ball.to_world"] = mi.Transform4f().translate([0, 0, 1])
    params.update()
    after = float(mb.ray_intersect(scene, ray).t[0])
    assert before - after == pytest.approx(1.0, abs=2e-6)


# ---------------------------------------------------------------- loops, other variants


def test_queries_inside_a_recorded_loop(spheres):
    # a ray that is mirrored inside the sphere stays there: ten bounces in one kernel
    shape = spheres["octants"]
    o, d = ball_rays(1000, seed=10, start=0.3, target=0.9)
    ray = ray_of(o, d)
    shape.ray_test(ray)  # builds the structure

    def body(ray: Any, i: Any, ok: Any) -> tuple:
        si = shape.ray_intersect(ray)
        ok = ok & si.is_valid()
        ray = si.spawn_ray(si.to_world(mi.reflect(si.wi)))
        return ray, i + 1, ok

    state = (ray, dr.zeros(mi.UInt32, 1000), dr.full(mi.Bool, True, 1000))
    ray, _i, ok = dr.while_loop(state, cond=lambda r, i, ok: i < 10, body=body)
    assert numbers(ok).all()
    # Every chord has the same distance from the centre. Each origin is moved by 1e-4 along the
    # normal against self-intersection, which is felt in full in ten reflections.
    start = np.linalg.norm(np.cross(o, d / np.linalg.norm(d, axis=1, keepdims=True)), axis=1)
    end = np.linalg.norm(np.cross(numbers(ray.o), numbers(ray.d)), axis=1)
    assert np.abs(start - end).max() < 1e-3


def test_a_first_query_inside_a_recorded_loop_is_an_error():
    shape = mi.load_dict(bezier())
    ray = ray_of([[0, 0, 3.0]], [[0, 0, -1.0]])
    with pytest.raises(Exception) as caught:
        dr.while_loop(
            (mi.UInt32(0), mi.Bool(True)),
            cond=lambda i, ok: i < 10,
            body=lambda i, ok: (i + 1, ok & shape.ray_test(ray)),
        )
    cause: Any = caught.value
    while cause.__cause__ is not None:
        cause = cause.__cause__
    assert "outside of recorded loops" in str(cause)
    assert shape.ray_test(ray)[0]


@pytest.fixture
def other_variant(request) -> Iterator[str]:
    mi.set_variant(request.param)
    yield request.param
    mi.set_variant(VARIANT)


@pytest.mark.parametrize(
    "other_variant", ["llvm_ad_spectral", "llvm_ad_mono_polarized"], indirect=True
)
def test_other_variants(other_variant):
    scene = lined_up()
    shape = one_of(scene, "bezier")
    o, d = ball_rays(2000, seed=11, target=0.9)
    ray = ray_of(o, d)
    ray.time = 0.25
    if dr.size_v(mi.Spectrum) and "spectral" in other_variant:
        ray.wavelengths = dr.full(type(ray.wavelengths), 500.0, 2000)
    si = shape.ray_intersect(ray)
    check_interaction(shape, si, ray)
    assert (numbers(si.time) == 0.25).all()
    assert (numbers(si.wavelengths) == 500.0).all()
    si = mb.ray_intersect(scene, ray)
    assert numbers(si.is_valid()).all()
    assert (numbers(mb.ray_test(scene, ray))).all()


def test_evaluated_loops_are_the_users_own():
    # to look into loops one lets them be evaluated; ours would launch hundreds of kernels then
    torus = mi.load_dict(bezier(mb.torus()))
    ray = ray_of(*ball_rays(1000, seed=3))
    expected = numbers(torus.ray_intersect_preliminary(ray).t)
    flags = (dr.JitFlag.SymbolicLoops, dr.JitFlag.SymbolicConditionals, dr.JitFlag.KernelHistory)
    with (
        dr.scoped_set_flag(flags[0], False),
        dr.scoped_set_flag(flags[1], False),
        dr.scoped_set_flag(flags[2], True),
    ):
        dr.kernel_history_clear()
        t = torus.ray_intersect_preliminary(ray).t
        blocked = torus.ray_test(ray)
        dr.eval(t, blocked)
        kernels = [k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT]
        assert not dr.flag(flags[0]) and not dr.flag(flags[1])
    np.testing.assert_array_equal(numbers(t), expected)
    np.testing.assert_array_equal(numbers(blocked), np.isfinite(expected))
    assert len(kernels) < 10  # uploads among them
