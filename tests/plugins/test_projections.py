"""Texture coordinates of Mitsuba's own shapes on patches, against these shapes."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from backend_cases import VARIANT
from mitsuba_cases import ball_rays, bezier, numbers, ray_of, tensor
from render_cases import SHARE, bezierpath, camera, moments, path, share_that_agrees, sky

import mitsuba_bezier as mb
from mitsuba_bezier.geometry.trims import Trims, square_map
from mitsuba_bezier.io import save

SPP = 32


@pytest.fixture(scope="module", autouse=True)
def variant() -> None:
    mi.set_variant(VARIANT)


def square() -> mb.BezierTriangles:
    """Return the square from -1 to 1, which looks upwards."""
    corners = np.array([[-1, -1, 0, 1], [1, -1, 0, 1], [1, 1, 0, 1], [-1, 1, 0, 1.0]])
    return mb.BezierTriangles(corners[[[0, 1, 2], [0, 2, 3]]])


#: Mitsuba's shape, the projection, and patches.
PAIRS = {
    "octants": ("sphere", "spherical", lambda: mb.sphere()),
    "tetrahedral": ("sphere", "spherical", lambda: mb.sphere(cover="tetrahedral")),
    "cylinder": ("cylinder", "cylindrical", lambda: mb.cylinder()),
    "rectangle": ("rectangle", "planar", square),
    "disk": ("disk", "polar", lambda: mb.disk()),
}
FIELDS = ("uv", "dp_du", "dp_dv", "dn_du", "dn_dv")


def flags() -> Any:
    return mi.RayFlags.All | mi.RayFlags.dNSdUV | mi.RayFlags.dNGdUV


def both(kind: str, o: np.ndarray, d: np.ndarray, **more: Any) -> tuple[Any, Any, np.ndarray]:
    """Return interactions with Mitsuba's shape and with patches, and which rays hit both."""
    native, uv, patches = PAIRS[kind]
    scene = mi.load_dict({"type": "scene", "shape": {"type": native, **more}})
    theirs = scene.ray_intersect(ray_of(o, d), flags(), True)
    ours = mi.load_dict(bezier(patches(), uv=uv, **more)).ray_intersect(ray_of(o, d), flags())
    hit = np.array(theirs.is_valid()), np.array(ours.is_valid())
    assert (hit[0] != hit[1]).mean() < 1e-3
    dr.eval(theirs, ours)
    return theirs, ours, hit[0] & hit[1]


def frame(si: Any) -> np.ndarray:
    return np.concatenate([numbers(si.sh_frame.s), numbers(si.sh_frame.t)], axis=1)


def around(uv: np.ndarray, column: int | None) -> np.ndarray:
    """Return uv as numbers that do not jump at the seam, where they stay between 0 and 1."""
    if column is None:
        return uv
    angle = 2 * np.pi * uv[:, column]
    other = uv[:, 1 - column]
    return np.stack([np.cos(angle), np.sin(angle), other], axis=1)


def placement(kind: str) -> Any:
    place = mi.ScalarTransform4f().translate([3, -2, 1]).rotate([0.6, 0, 0.8], 70)
    # Mitsuba's sphere and cylinder keep their form
    return place.scale(0.3 if kind in ("octants", "tetrahedral", "cylinder") else [0.3, 0.5, 0.7])


@pytest.mark.parametrize("moved", [False, True], ids=["at home", "moved"])
@pytest.mark.parametrize("kind", PAIRS)
def test_they_are_those_of_the_native_shape(kind, moved):
    place = placement(kind) if moved else mi.ScalarTransform4f()
    matrix = np.array(place.matrix, dtype=float)
    o, d = ball_rays(20000)
    o, d = o @ matrix[:3, :3].T + matrix[:3, 3], d @ matrix[:3, :3].T
    theirs, ours, hit = both(kind, o, d / np.linalg.norm(d, axis=1, keepdims=True), to_world=place)
    n, wi = numbers(ours.n), numbers(ours.to_world(ours.wi))
    # where rays graze, either shape's t is off by more
    hit &= np.abs(np.einsum("ni,ni->n", n, wi)) > 0.1
    assert hit.sum() > 2000
    local = (numbers(ours.p) - matrix[:3, 3]) @ np.linalg.inv(matrix[:3, :3]).T
    rho = np.linalg.norm(local[:, :2], axis=1) if kind != "rectangle" else np.ones(len(local))
    # Roundings of points, in units of the shape: 2^-24 of numbers up to 5 where it is moved, or
    # 3 on the way along the ray, by 1 / 0.3 where it is small, a few of them at a slant of 0.1.
    # An angle around the axis is off by that over the distance from it.
    slack = 2.0**-24 * (5 / 0.3 if moved else 3) * 16 * (1 + 1 / np.maximum(rho, 1e-6))
    column = {"rectangle": None, "disk": 1}.get(kind, 0)
    for name in FIELDS:
        a, b = numbers(getattr(theirs, name)), numbers(getattr(ours, name))
        if name == "uv":
            assert a[hit].min() >= 0
            assert a[hit].max() <= 1 + 1e-6
            a, b = around(a, column), around(b, column)
        off, size = np.abs(a - b)[hit].max(axis=1), max(np.abs(a[hit]).max(), 1)
        if name[:2] == "dn" and kind == "tetrahedral":
            off -= 4 * 5e-3**2  # beside collapsed edges: of a point 5e-3 of the patch away
        assert (off < slack[hit] * size).all(), name
    assert (np.abs(frame(theirs) - frame(ours))[hit].max(axis=1) < slack[hit]).all()


@pytest.mark.parametrize(("off", "scale"), [(0, 1), (1e3, 1), (0, 1e-3), (1e4, 1e3), (1e4, 1)])
@pytest.mark.parametrize("kind", ["octants", "tetrahedral"])
def test_they_are_exact_far_away(kind, off, scale):
    # against float64: Mitsuba's own sphere is off by what float32 makes of the distance
    place = mi.ScalarTransform4f().translate([off, -off, 0.3 * off]).rotate([0.6, 0, 0.8], 70)
    m = np.array(place.scale(scale).matrix, dtype=float)
    o, d = ball_rays(4000)
    o, d = np.float32(o @ m[:3, :3].T + m[:3, 3]), np.float32(d @ m[:3, :3].T / scale)
    shape = mi.load_dict(
        bezier(PAIRS[kind][2](), uv="spherical", to_world=mi.ScalarTransform4f(m.tolist()))
    )
    si = shape.ray_intersect(ray_of(o, d))
    # the ray and the map are those that were rounded
    m = shape.object_to_world
    back = np.linalg.inv(m[:3, :3]).T
    q, e = (o.astype(float) - m[:3, 3]) @ back, d.astype(float) @ back
    a, b, c = (e * e).sum(axis=1), (q * e).sum(axis=1), (q * q).sum(axis=1) - 1
    root = b * b - a * c
    q += ((-b - np.sqrt(np.maximum(root, 0))) / a)[:, None] * e
    rho = np.hypot(q[:, 0], q[:, 1])
    expected = np.stack(
        [np.arctan2(q[:, 1], q[:, 0]) / (2 * np.pi) % 1, np.arctan2(rho, q[:, 2]) / np.pi], axis=1
    )
    hit = np.array(si.is_valid()) & (root > 0.01 * a)
    assert hit.sum() > 3000
    wrong = np.abs(around(numbers(si.uv), 0) - around(expected, 0)).max(axis=1)
    # roundings of net and uv; an angle of 2 pi around the axis by the distance from it
    assert (wrong * rho.clip(1e-3))[hit].max() < 16 * 2.0**-24


@pytest.mark.parametrize("kind", PAIRS)
def test_turned_normals(kind):
    o, d = ball_rays(2000)
    theirs, ours, hit = both(kind, o, d, flip_normals=True)
    hit &= np.abs(numbers(dr.dot(ours.n, mi.Vector3f(d.T)))) > 0.1
    hit &= np.hypot(*numbers(ours.p).T[:2]) > 0.1
    for name in (*FIELDS[1:], "n"):
        a, b = numbers(getattr(theirs, name)), numbers(getattr(ours, name))
        assert np.abs(a - b)[hit].max() < 1e-4, name  # as above, by partials of 2 pi
    assert np.abs(frame(theirs) - frame(ours))[hit].max() < 2e-5


@pytest.mark.parametrize("rotated", [False, True])
@pytest.mark.parametrize("kind", ["octants", "tetrahedral", "disk"])
def test_on_the_axis_and_near_it(kind, rotated):
    at = np.concatenate([[0], np.geomspace(1e-7, 1e-2, 11)])
    angle, up = np.arange(12.0), np.array([0, 0, 3.0])
    target = np.stack([at * np.cos(angle), at * np.sin(angle), np.zeros(12)], axis=1)
    o = np.concatenate([target + up, target - up])
    d = np.repeat([[0, 0, -1.0], [0, 0, 1.0]], 12, axis=0)
    place = mi.ScalarTransform4f()
    if rotated:  # by a quarter: all numbers stay as they are
        turn = np.array([[0, 0, 1.0], [1, 0, 0], [0, 1, 0]])
        o, d = o @ turn.T, d @ turn.T
        place = mi.ScalarTransform4f(np.block([[turn, np.zeros((3, 1))], [0, 0, 0, 1]]).tolist())
    theirs, ours, hit = both(kind, o, d, to_world=place)
    assert hit.all()
    s, t, n = (numbers(x) for x in (ours.sh_frame.s, ours.sh_frame.t, ours.n))
    for a, b in ((s, s), (t, t)):
        assert np.allclose(np.einsum("ni,ni->n", a, b), 1, atol=1e-6)
    for a, b in ((s, t), (s, n), (t, n)):
        assert np.allclose(np.einsum("ni,ni->n", a, b), 0, atol=1e-6)
    # the point is off by 2^-24 of the radius or so, its angle by that over the distance
    slack = 8 * 2.0**-24 * (1 + 1 / np.maximum(np.tile(at, 2), 1e-7))
    if kind != "tetrahedral":  # whose poles are in the middle of patches: 1e-8 beside the axis
        slack[[0, 12]] = 8 * 2.0**-24
    for name in FIELDS:
        a, b = numbers(getattr(theirs, name)), numbers(getattr(ours, name))
        if name == "uv":
            column = 1 if kind == "disk" else 0
            a, b = around(a, column), around(b, column)
        assert np.isfinite(b).all(), name
        assert (np.abs(a - b).max(axis=1) < 7 * slack).all(), name
    assert (np.abs(frame(theirs) - frame(ours)).max(axis=1) < slack).all()


@pytest.mark.parametrize("kind", ["octants", "tetrahedral", "cylinder", "disk"])
def test_the_seam(kind):
    y = np.float32(np.concatenate([-np.geomspace(1e-5, 1e-2, 10), np.geomspace(1e-5, 1e-2, 10)]))
    zeros = np.zeros_like(y)
    if kind == "disk":
        o, d = np.stack([zeros + 0.7, y, zeros + 2], axis=1), [0, 0, -1.0]
    else:
        o, d = np.stack([zeros + 3, y, zeros + 0.3], axis=1), [-1.0, 0, 0]
    theirs, ours, hit = both(kind, o, np.broadcast_to(d, o.shape))
    assert hit.all()
    column = 1 if kind == "disk" else 0
    u = numbers(ours.uv)[:, column]
    assert np.abs(u - numbers(theirs.uv)[:, column]).max() < 4 * 2.0**-24
    # just below the x axis comes the end, just above it the beginning
    assert ((u > 0.99) == (y < 0)).all()
    assert ((u < 0.01) == (y > 0)).all()
    # and on it, too
    o[:, 1], o[:, 0 if kind == "disk" else 2] = 0, np.linspace(0.05, 0.95, len(o))
    theirs, ours, hit = both(kind, o, np.broadcast_to(d, o.shape))
    assert hit.all()
    assert not numbers(theirs.uv)[:, column].any()
    assert not numbers(ours.uv)[:, column].any()


def test_where_a_surface_has_no_partials():
    wall = square().transform(mi_matrix(mi.ScalarTransform4f().rotate([1, 0, 0], 90)))
    cases = [(wall, "planar"), (wall, "polar"), (square(), "cylindrical"), (mb.cone(), "spherical")]
    o, d = ball_rays(4000)
    for patches, uv in cases:
        si = mi.load_dict(bezier(patches, uv=uv)).ray_intersect(ray_of(o, d), flags())
        hit = np.array(si.is_valid())
        assert hit.sum() > 500
        for name in FIELDS:
            assert np.isfinite(numbers(getattr(si, name))).all(), (uv, name)
        s, t = (numbers(x)[hit] for x in (si.sh_frame.s, si.sh_frame.t))
        assert np.allclose(np.cross(s, t), numbers(si.n)[hit], atol=1e-5)


def mi_matrix(transform: Any) -> np.ndarray:
    return np.array(transform.matrix, dtype=float)


@pytest.mark.parametrize("uv", ["spherical", "cylindrical", "planar", "polar"])
def test_partials_on_any_surface(uv):
    # dp_du and dp_dv are what uv changes by 1 along: seen by rays beside each other
    patches = mb.torus().transform(mi_matrix(mi.ScalarTransform4f().translate([0.1, 0.2, 0.3])))
    place = mi.ScalarTransform4f().rotate([0, 0.6, 0.8], 40).scale([1, 0.8, -1.3])
    shape = mi.load_dict(bezier(patches, uv=uv, to_world=place))
    rng = np.random.default_rng(0)
    o, d = ball_rays(4000, start=4)
    si = shape.ray_intersect(ray_of(o, d))
    n, p = numbers(si.n), numbers(si.p).astype(float)
    cosine = np.abs(np.einsum("ni,ni->n", n, d))
    step = 1e-3
    side = rng.normal(size=p.shape)
    side -= n * np.einsum("ni,ni->n", side, n)[:, None]
    side *= step / np.linalg.norm(side, axis=1, keepdims=True)
    near = [shape.ray_intersect(ray_of(p + s * side - 0.1 * d, d)) for s in (1, -1)]
    dp = numbers(near[0].p).astype(float) - numbers(near[1].p)
    duv = numbers(near[0].uv).astype(float) - numbers(near[1].uv)
    du, dv = numbers(si.dp_du).astype(float), numbers(si.dp_dv).astype(float)
    along = duv[:, :1] * du + duv[:, 1:] * dv
    stretch = np.linalg.norm(du, axis=1) + np.linalg.norm(dv, axis=1)
    across = np.linalg.norm(np.cross(du, dv), axis=1)
    good = np.array(si.is_valid() & near[0].is_valid() & near[1].is_valid())
    # away from silhouettes, seams, and where uv hardly tell the tangent plane
    good &= (cosine > 0.3) & (np.abs(duv).max(axis=1) < 0.1) & (stretch < 30) & (across > 1)
    good &= np.linalg.norm(dp, axis=1) < 4 * step
    assert good.sum() > 300
    off = np.linalg.norm(along - dp, axis=1)[good]
    # float32 uv: 2^-24 by a stretch of 30 is 1e-3 of the way; the rest is curvature
    assert np.quantile(off, 0.99) < 0.01 * 2 * step
    assert np.abs(np.einsum("ni,ni->n", n, du)[good] / stretch[good]).max() < 1e-5


# ---------------------------------------------------------------- beside other features


def test_shapes_without_it_pay_nothing_and_stay_the_same():
    o, d = ball_rays(4000)
    corners = np.random.default_rng(0).random((8, 3, 2))
    for more in ({}, {"texcoords": tensor(corners)}):
        alone = mi.load_dict(bezier(**more))
        assert alone._alone().tables.projections is None
        scene = mi.load_dict(
            {
                "type": "scene",
                "a": bezier(uv="spherical", to_world=mi.ScalarTransform4f().translate([5, 0, 0])),
                "b": bezier(**more),
            }
        )
        a, b = alone.ray_intersect(ray_of(o, d), flags()), mb.ray_intersect(scene, ray_of(o, d))
        hit = np.array(a.is_valid() & (a.t == b.t))
        assert hit.sum() > 3000
        for name in ("uv", "dp_du", "dp_dv"):
            assert (numbers(getattr(a, name)) == numbers(getattr(b, name)))[hit].all()


def test_several_projections_in_a_scene():
    place = {k: mi.ScalarTransform4f().translate([3 * i, 0, 0]) for i, k in enumerate(PAIRS)}
    natives = {k: {"type": PAIRS[k][0], "to_world": place[k]} for k in PAIRS}
    patches = {k: bezier(PAIRS[k][2](), uv=PAIRS[k][1], to_world=place[k]) for k in PAIRS}
    o, d = ball_rays(2000)
    o = np.concatenate([o + np.array([3 * i, 0, 0]) for i in range(len(PAIRS))])
    d = np.tile(d, (len(PAIRS), 1))
    native = mi.load_dict({"type": "scene", **natives})
    ours = mi.load_dict({"type": "scene", **patches})
    a, b = native.ray_intersect(ray_of(o, d)), mb.ray_intersect(ours, ray_of(o, d))
    near = np.array(a.is_valid() & b.is_valid() & (dr.abs(a.t - b.t) < 1e-4))
    assert near.sum() > 5000
    off = np.abs(numbers(a.uv) - numbers(b.uv)).max(axis=1)
    # hits near the axis or where rays graze are those of the other tests
    assert np.quantile(np.minimum(off, 1 - off)[near], 0.99) < 1e-4


def test_instances_have_the_texture_of_the_first():
    maps = np.array(
        [
            mi_matrix(mi.ScalarTransform4f().translate([4, 0, 0]).rotate([0, 0, 1], 33)),
            mi_matrix(mi.ScalarTransform4f().translate([0, 5, 100]).scale([2, 1, -1])),
        ]
    )
    home = mi.ScalarTransform4f().rotate([0, 0.6, 0.8], 20).scale(0.7)
    copied = mi.load_dict(bezier(uv="spherical", to_world=home, instances=tensor(maps)))
    o, d = ball_rays(4000)
    for m in maps:
        place = mi.ScalarTransform4f((m @ mi_matrix(home)).tolist())
        single = mi.load_dict(bezier(uv="spherical", to_world=place))
        ray = ray_of(o @ m[:3, :3].T + m[:3, 3], d @ m[:3, :3].T)
        a, b = single.ray_intersect(ray, flags()), copied.ray_intersect(ray, flags())
        hit = np.array(a.is_valid() & b.is_valid())
        hit &= np.abs(numbers(dr.dot(a.n, dr.normalize(ray.d)))) > 0.1
        # t is off by 2^-24 of 100
        off = np.abs(around(numbers(a.uv), 0) - around(numbers(b.uv), 0)).max(axis=1)
        assert np.quantile(off[hit], 0.98) < 2e-4
        for name in ("dp_du", "dp_dv", "dn_du", "dn_dv"):
            off = np.abs(numbers(getattr(a, name)) - numbers(getattr(b, name))).max(axis=1)
            assert np.quantile(off[hit], 0.98) < 3e-3, name


def test_updates_of_to_world():
    shape = mi.load_dict(bezier(uv="spherical"))
    o, d = ball_rays(1000)
    params = mi.traverse(shape)
    before = shape.ray_intersect(ray_of(o, d))
    dr.eval(before)
    place = mi.ScalarTransform4f().translate([1, 2, 3]).rotate([0.6, 0, 0.8], 25).scale(2)
    params["to_world"] = mi.Transform4f(place)
    params.update()
    matrix = mi_matrix(place)
    ray = ray_of(o @ matrix[:3, :3].T + matrix[:3, 3], d @ matrix[:3, :3].T)
    after = shape.ray_intersect(ray)
    hit = np.array(before.is_valid() & after.is_valid())
    assert hit.sum() > 700
    off = np.abs(around(numbers(before.uv), 0) - around(numbers(after.uv), 0)).max(axis=1)
    assert np.quantile(off[hit], 0.98) < 1e-5
    moved = numbers(before.dp_du) @ matrix[:3, :3].T
    assert np.quantile(np.abs(moved - numbers(after.dp_du))[hit], 0.98) < 1e-4


def test_frozen():
    shape = mi.load_dict(bezier(uv="spherical"))
    scene = mi.load_dict({"type": "scene", "shape": shape})
    mb.ray_intersect(scene, ray_of(*ball_rays(10)))

    @dr.freeze
    def uv(scene: Any, ray: Any) -> Any:
        si = mb.ray_intersect(scene, ray)
        return si.uv, si.dp_du

    for seed in range(3):
        ray = ray_of(*ball_rays(500, seed=seed))
        si = mb.ray_intersect(scene, ray)
        found = uv(scene, ray)
        assert (numbers(found[0]) == numbers(si.uv)).all()
        assert (numbers(found[1]) == numbers(si.dp_du)).all()


def test_patches_to_infinity():
    plane = mi.load_dict(bezier(mb.plane(), uv="planar"))
    o, d = ball_rays(2000)
    d[:, 2] *= np.geomspace(1e-4, 1, len(d)).astype(np.float32)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    si = plane.ray_intersect(ray_of(o, d))
    hit = np.array(si.is_valid())
    t = -o[:, 2].astype(float) / d[:, 2]
    expected = (o[:, :2] + t[:, None] * d[:, :2] + 1) / 2
    assert hit.sum() > 900
    assert t[hit].max() > 1e3
    # a few roundings of numbers of that size
    off = np.abs(numbers(si.uv) - expected).max(axis=1)[hit]
    assert (off < 8 * 2.0**-24 * (t[hit] + 1)).all()
    assert np.abs(numbers(si.dp_du)[hit] - [2, 0, 0]).max() < 1e-6
    assert np.abs(numbers(si.dp_dv)[hit] - [0, 2, 0]).max() < 1e-6


def test_trimmed_patches(tmp_path):
    half = [[[0, 0, 1], [0.5, 0, 1]], [[0.5, 0, 1], [0.5, 1, 1]], [[0.5, 1, 1], [0, 1, 1]]]
    region = [np.array(x, dtype=float) for x in [*half, [[0, 1, 1], [0, 0, 1]]]]
    corners = np.array([[1, -1, 0, 1], [-1, 1, 0, 1], [-1, -1, 0, 1.0]])
    trims = Trims([region], [0], [square_map()], [[[0, 0], [1, 1]]])
    save(mb.BezierTriangles(corners[None]), tmp_path / "part.vtu", trims=trims)
    shape = mi.load_dict(
        {"type": "beziertriangle", "filename": str(tmp_path / "part.vtu"), "uv": "polar"}
    )
    rng = np.random.default_rng(0)
    x, y = rng.uniform(-1, 1, (2, 500))
    o = np.float32(np.stack([x, y, x * 0 + 2], axis=1))
    si = shape.ray_intersect(ray_of(o, [0, 0, -1.0]))
    hit = np.array(si.is_valid())
    assert (hit == ((x < 0) & (x + y < 0))).mean() > 0.99
    expected = np.stack([np.hypot(x, y), np.arctan2(y, x) / (2 * np.pi) % 1], axis=1)
    off = around(numbers(si.uv), 1) - around(expected, 1)
    assert np.abs(off[hit] * np.hypot(x, y)[hit, None]).max() < 1e-6


def test_a_scene_file(tmp_path):
    save(square(), tmp_path / "square.vtu")
    scene = mi.load_string(
        f"""<scene version="3.0.0"><shape type="beziertriangle">
        <string name="filename" value="{tmp_path / "square.vtu"}"/>
        <string name="uv" value="planar"/></shape></scene>"""
    )
    si = mb.ray_intersect(scene, ray_of([[0.5, 0.2, 3]], [0, 0, -1.0]))
    assert np.allclose(numbers(si.uv), [[0.75, 0.6]], atol=1e-6)
    ball = mi.load_dict(mb.shape(mb.sphere(), uv="spherical"))
    assert ball.projection == "spherical"


# ---------------------------------------------------------------- derivatives


@pytest.mark.parametrize(
    ("kind", "follow"), [(k, False) for k in PAIRS] + [("tetrahedral", True), ("disk", True)]
)
def test_derivatives_by_to_world(kind, follow):
    _native, uv, patches = PAIRS[kind]
    rng = np.random.default_rng(1)
    turn = np.zeros((4, 4))
    turn[:3] = 0.3 * rng.normal(size=(3, 4))
    o, d = ball_rays(400)
    more = mi.RayFlags.All | (mi.RayFlags.FollowShape if follow else mi.RayFlags.Empty)

    def shape_of(e: float) -> Any:
        place = mi.ScalarTransform4f((np.eye(4) + e * turn).tolist())
        return mi.load_dict(bezier(patches(), uv=uv, to_world=place))

    def found(shape: Any) -> Any:
        si = shape.ray_intersect(ray_of(o, d), more)
        return [si.uv.x, si.uv.y, *si.dp_du, *si.dp_dv], si

    shape = shape_of(0.0)
    params = mi.traverse(shape)
    e = mi.Float(0.0)
    dr.enable_grad(e)
    matrix = mi.Matrix4f(np.eye(4).tolist()) + mi.Matrix4f(turn.tolist()) * e
    params["to_world"] = mi.Transform4f(matrix)
    params.update()
    values, si = found(shape)
    dr.set_grad(e, 1.0)
    dr.enqueue(dr.ADMode.Forward, e)
    dr.traverse(dr.ADMode.Forward, dr.ADFlag.ClearNone)  # some values follow from others
    ours = np.stack([np.broadcast_to(np.array(dr.grad(x)), len(o)) for x in values])
    assert np.isfinite(ours).all()
    hit = np.array(si.is_valid())
    hit &= np.abs(numbers(dr.dot(si.n, mi.Vector3f(d.T)))) > 0.2
    hit &= np.linalg.norm(numbers(si.p)[:, :2], axis=1) > 0.2
    if follow:  # the texture goes with the shape
        assert np.abs(ours[:2])[:, hit].max() < 1e-4
        return
    h = 1e-3
    sides = [found(shape_of(s * h)) for s in (1, -1)]
    hit &= np.array(sides[0][1].is_valid() & sides[1][1].is_valid())
    a, b = (np.stack([np.array(x, dtype=float) for x in values]) for values, _si in sides)
    hit &= np.abs(a - b).max(axis=0) < 0.3  # not across the seam
    assert hit.sum() > 50
    off = np.abs((a - b) / (2 * h) - ours)[:, hit]
    # float32 by 2 h: 1e-7 of 6 over 2e-3, a few of them; the third derivative by h^2 is less
    assert np.quantile(off, 0.98) < 0.01


@pytest.mark.parametrize("kind", PAIRS)
def test_derivatives_by_the_ray(kind):
    native, uv, patches = PAIRS[kind]
    scenes = (
        mi.load_dict({"type": "scene", "shape": {"type": native}}),
        mi.load_dict({"type": "scene", "shape": bezier(patches(), uv=uv)}),
    )
    found = []
    for scene in scenes:
        ray = ray_of(*ball_rays(500))
        dr.enable_grad(ray.o)
        si = mb.ray_intersect(scene, ray)
        value = si.uv.x + 2 * si.uv.y
        hit = np.array(si.is_valid() & (dr.abs(dr.dot(si.n, ray.d)) > 0.2))
        hit &= (np.hypot(*numbers(si.p).T[:2]) > 0.2) | (kind == "rectangle")
        dr.backward(dr.select(si.is_valid(), value, 0))
        found.append((hit, numbers(dr.grad(ray.o))))
    (one, theirs), (other, ours) = found
    assert np.isfinite(ours).all()
    assert not ours[~np.array(si.is_valid())].any()
    assert (one & other).sum() > 100
    # float32 by slants and distances from the axis of 0.2
    assert np.abs(theirs - ours)[one & other].max() < 1e-3


def test_derivatives_by_the_net():
    shape = mi.load_dict(bezier(uv="spherical"))
    params = mi.traverse(shape)
    o, d = ball_rays(300)
    rng = np.random.default_rng(0)
    net = np.array(params["control_points"])
    change = 0.1 * rng.normal(size=net.shape) * [1, 1, 1, 0]

    def at(e: float) -> Any:
        moved = mi.load_dict(bezier(net + e * change, uv="spherical"))
        return moved.ray_intersect(ray_of(o, d))

    x = mi.Float(0.0)
    dr.enable_grad(x)
    params["control_points"] = mi.TensorXf(
        mi.Float(net.ravel()) + mi.Float(np.float32(change.ravel())) * x, shape=net.shape
    )
    params.update()
    si = shape.ray_intersect(ray_of(o, d))
    dr.forward(x)
    ours = numbers(dr.grad(si.uv))
    h = 1e-3
    a, b = at(h), at(-h)
    central = (numbers(a.uv).astype(float) - numbers(b.uv)) / (2 * h)
    hit = np.array(si.is_valid() & a.is_valid() & b.is_valid())
    hit &= np.abs(numbers(dr.dot(si.n, mi.Vector3f(d.T)))) > 0.3
    hit &= np.linalg.norm(numbers(si.p)[:, :2], axis=1) > 0.3
    hit &= np.abs(central).max(axis=1) < 10
    assert hit.sum() > 100
    assert np.quantile(np.abs(ours - central)[hit], 0.98) < 2e-3


def test_derivatives_of_renders():
    # a ball that turns around its axis moves nothing but its texture
    def scene_of(kind: str) -> Any:
        shape: dict[str, Any] = {"type": "sphere"}
        if kind != "native":
            shape = bezier(PAIRS[kind][2](), uv="spherical")
        shape["bsdf"] = {"type": "diffuse", "reflectance": picture(3, 1)}
        light = {"type": "constant"}
        return mi.load_dict({"type": "scene", "c": camera(24, 20), "ball": shape, "light": light})

    prb = mi.load_dict({"type": "prb", "max_depth": 2})
    weights = mi.Float(np.random.default_rng(0).random(24 * 20 * 3).astype(np.float32))
    found = {}
    for kind in ("native", "octants", "tetrahedral"):
        scene = scene_of(kind)
        params = mi.traverse(scene)
        for forward in (True, False):
            angle = mi.Float(0.0)
            dr.enable_grad(angle)
            turn = mi.Transform4f().rotate([0, 0, 1], angle).scale(2)
            params["ball.to_world"] = turn
            params.update()
            image = mi.render(scene, params, integrator=prb, spp=16)
            if forward:
                dr.forward(angle, dr.ADFlag.ClearEdges)
                found[kind] = [np.array(dr.grad(image))]
            else:
                dr.backward(dr.sum(image.array * weights))
                found[kind].append(np.array(dr.grad(angle)))
    size = np.abs(found["native"][0]).mean()
    assert size > 1e-4
    for kind in ("octants", "tetrahedral"):
        forward, backward = (a - b for a, b in zip(found[kind], found["native"]))
        # the same rays and samples: roundings, and pixels where a path goes another way
        assert np.abs(forward).mean() < 0.01 * size
        assert np.abs(backward).max() < 0.01 * np.abs(found["native"][1]).max()


@pytest.mark.parametrize("by", ["uv", "texcoords"])
def test_differential_motion(by):
    corners = tensor(np.random.default_rng(0).random((8, 3, 2)))
    shape = mi.load_dict(bezier(**({"uv": "spherical"} if by == "uv" else {by: corners})))
    params = mi.traverse(shape)
    x = mi.Float(0.0)
    dr.enable_grad(x)
    params["to_world"] = mi.Transform4f().translate([x, 2 * x, 0])
    params.update()
    si = shape.ray_intersect(ray_of(*ball_rays(200)), mi.RayFlags.All | mi.RayFlags.DetachShape)
    p = shape.differential_motion(si, si.is_valid())
    hit = np.array(si.is_valid())
    assert np.abs(numbers(p) - numbers(si.p))[hit].max() < 1e-6
    dr.forward(x)
    assert np.abs(numbers(dr.grad(p))[hit] - [1, 2, 0]).max() < 1e-5


# ---------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (
            {"uv": "sperical"},
            'uv: expected one of "spherical", "cylindrical", "planar", '
            "\"polar\", got 'sperical'; did you mean 'spherical'?",
        ),
        ({"uv": "Planar"}, "did you mean 'planar'?"),
        ({"uv": "sphere"}, "did you mean 'spherical'?"),
        ({"uv": "disk"}, "did you mean 'polar'?"),
        ({"uv": "rectangle"}, "did you mean 'planar'?"),
        ({"uv": "cylinder"}, "did you mean 'cylindrical'?"),
        ({"uv": "qqq"}, "got 'qqq'"),
        ({"uv": ""}, "got ''"),
        ({"uv": 3.0}, "got 3.0"),
        ({"uv": True}, "got True"),
        ({"uv": "planar", "texcoords": np.zeros((8, 3, 2))}, "at most one of uv and texcoords"),
        ({"uv": "planar", "vertex_a": np.zeros((8, 3))}, "vertex_a: expected a shape without uv"),
        ({"UV": "planar"}, "unknown parameter 'UV'; did you mean 'uv'?"),
    ],
)
def test_bad_input(more, message):
    values = {k: tensor(v) if isinstance(v, np.ndarray) else v for k, v in more.items()}
    with pytest.raises(RuntimeError) as error:
        mi.load_dict(bezier(**values))
    assert message in str(error.value)


def test_attributes():
    colours = np.random.default_rng(0).random((8, 3))
    shape = mi.load_dict(bezier(uv="spherical", face_colour=tensor(colours)))
    si = shape.ray_intersect(ray_of(*ball_rays(200)))
    hit = np.array(si.is_valid())
    found = numbers(shape.eval_attribute_3("face_colour", si))[hit]
    assert np.allclose(found, colours[np.array(si.prim_index)[hit]], atol=1e-6)
    with pytest.raises(mb.BezierError, match="vertex_b: expected a shape without uv"):
        shape.add_attribute("vertex_b", 1, [0.0] * 24)
    with pytest.raises(mb.BezierError, match="without texcoords and uv"):
        shape.eval_parameterization(mi.Point2f(0.2, 0.2))


def test_it_takes_the_place_of_what_a_file_has(tmp_path):
    corners = np.random.default_rng(0).random((8, 3, 2))
    save(mb.sphere(), tmp_path / "ball.vtu", attributes={"texcoords": corners})
    ours = mi.load_dict(
        {"type": "beziertriangle", "filename": str(tmp_path / "ball.vtu"), "uv": "spherical"}
    )
    ray = ray_of(*ball_rays(200))
    a, b = ours.ray_intersect(ray), mi.load_dict(bezier(uv="spherical")).ray_intersect(ray)
    hit = np.array(a.is_valid())
    assert np.abs(around(numbers(a.uv), 0) - around(numbers(b.uv), 0))[hit].max() < 1e-5


# ---------------------------------------------------------------- light


def test_sampled_points_have_them_too():
    place = mi.ScalarTransform4f().translate([3, -2, 1]).rotate([0.6, 0, 0.8], 70).scale(0.3)
    shape = mi.load_dict(bezier(uv="spherical", to_world=place))
    sample = mi.Point2f(np.random.default_rng(0).random((2, 2000)).astype(np.float32))
    ps = shape.sample_position(0.0, sample)
    q = (numbers(ps.p) - mi_matrix(place)[:3, 3]) @ np.linalg.inv(mi_matrix(place)[:3, :3]).T
    expected = np.stack(
        [np.arctan2(q[:, 1], q[:, 0]) / (2 * np.pi) % 1, np.arccos(q[:, 2].clip(-1, 1)) / np.pi],
        axis=1,
    )
    off = np.abs(around(numbers(ps.uv), 0) - around(expected, 0)).max(axis=1)
    # the angle around the axis is off by the rounding of the point over the distance from it
    assert (off * np.linalg.norm(q[:, :2], axis=1).clip(1e-3)).max() < 5e-6


# ---------------------------------------------------------------- Z-tests


def picture(channels: int, seed: int, low: float = 0.1) -> Any:
    shape = (8, 16) if channels == 1 else (8, 16, channels)
    values = low + (1 - low) * np.random.default_rng(seed).random(shape)
    return {"type": "bitmap", "bitmap": mi.Bitmap(values.astype(np.float32)), "raw": True}


def coated() -> dict:
    """A bitmap, bent by a bump map, bent by a normal map."""
    plain = {"type": "diffuse", "reflectance": picture(3, 1)}
    bump = {"type": "bumpmap", "arbitrary": picture(1, 2), "scale": 0.2, "bsdf": plain}
    turns = np.random.default_rng(3).random((8, 16, 3)) * [0.4, 0.4, 0.2] + [0.3, 0.3, 0.8]
    turns = {"type": "bitmap", "bitmap": mi.Bitmap(turns.astype(np.float32)), "raw": True}
    return {"type": "normalmap", "normalmap": turns, "bsdf": bump}


def textured_ball(kind: str) -> Any:
    # its axis towards the camera, a little aside: pole and seam are seen
    place = mi.ScalarTransform4f().translate([0, -0.1, 0]).rotate([1, 0, 0], -25).scale(2.4)
    if kind == "native":
        shape: dict[str, Any] = {"type": "sphere"}
    else:
        shape = bezier(PAIRS[kind][2](), uv="spherical")
    shape.update(to_world=place, bsdf=coated())
    return mi.load_dict({"type": "scene", "camera": camera(48, 40), "ball": shape, "sky": sky()})


@pytest.fixture(scope="module")
def native_ball(variant) -> tuple:
    return moments(textured_ball("native"), path(max_depth=3), SPP, 0)


@pytest.mark.parametrize("cover", ["octants", "tetrahedral"])
def test_a_ball_with_bitmap_bump_and_normal_map(native_ball, cover):
    ours = moments(textured_ball(cover), bezierpath(max_depth=3), SPP, 4000)
    share = share_that_agrees(native_ball, ours, SPP)
    assert share >= SHARE, f"{share:.4%}"


def test_the_picture_tells_them_apart(native_ball):
    scene = textured_ball("octants")
    turned = mi.ScalarTransform4f().rotate([1, 0, 0], -25).rotate([0, 0, 1], 4).scale(2.4)
    params = mi.traverse(scene)
    params["ball.to_world"] = mi.Transform4f(
        mi.ScalarTransform4f().translate([0, -0.1, 0]) @ turned
    )
    params.update()
    ours = moments(scene, bezierpath(max_depth=3), SPP, 4000)
    assert share_that_agrees(native_ball, ours, SPP) < SHARE


def test_variables_of_a_picture():
    text = "uv:uv, du:dp_du, dv:dp_dv, x:duv_dx"
    native = mi.render(
        textured_ball("native"), spp=16, integrator=mi.load_dict({"type": "aov", "aovs": text})
    )
    ours = mi.render(
        textured_ball("octants"),
        spp=16,
        integrator=mi.load_dict({"type": "bezieraov", "aovs": text}),
    )
    a, b = np.array(native), np.array(ours)
    assert a.shape == b.shape
    off = np.abs(a - b).max(axis=2)
    assert np.isfinite(b).all()
    seen = np.isfinite(a).all(axis=2)  # Mitsuba's duv_dx is NaN here and there
    assert seen.mean() > 0.9
    # but for pixels on the seam, at the pole and on the outline
    assert np.quantile(off[seen], 0.9) < 1e-3
