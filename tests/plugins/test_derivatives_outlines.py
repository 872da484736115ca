"""Derivatives of outlines of instances and trims, and of those in mirrors and behind glass."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from backend_cases import VARIANT
from derivative_cases import BENT, central_by, film, front_camera, inner, weights
from mitsuba_cases import bezier, tensor

import mitsuba_bezier as mb
from mitsuba_bezier.geometry.trim_outlines import trim_segments
from mitsuba_bezier.geometry.trims import Trims, closed_region, square_map
from mitsuba_bezier.io.trim_arrays import trims_to_numbers
from mitsuba_bezier.plugins.trim_curves import TrimCurves

BALL = mb.sphere(cover="octants").control_points
SIDE = 8


@pytest.fixture(scope="module", autouse=True)
def variant() -> None:
    mi.set_variant(VARIANT)


def in_view(surface: dict[str, Any]) -> Any:
    """A surface before a bright backdrop: its outlines are in the image."""
    return mi.load_dict(
        {
            "type": "scene",
            "camera": front_camera(SIDE),
            "surface": {**surface, "bsdf": {"type": "twosided", "one": {"type": "diffuse"}}},
            "point": {"type": "point", "position": [1, 3, 4.0], "intensity": 20.0},
            "back": {
                "type": "rectangle",
                "to_world": mi.ScalarTransform4f().translate([0, 0, -3]).scale(6),
                "bsdf": {"type": "diffuse", "reflectance": 0.0},
                "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [0.2, 0.5, 1]}},
            },
        }
    )


def with_shadow(surface: dict[str, Any]) -> Any:
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
            "surface": {**surface, "to_world": mi.ScalarTransform4f().translate([0, 0, 4])},
            "lamp": {
                "type": "rectangle",
                "to_world": mi.ScalarTransform4f().look_at([0.5, 0, 8], [0, 0, 0], [0, 1, 0]),
                "emitter": {"type": "area", "radiance": 10.0},
            },
            "floor": {"type": "rectangle", "to_world": mi.ScalarTransform4f().scale(10)},
        }
    )


def attached(params: Any, keys: list[str]) -> None:
    for key in keys:
        dr.enable_grad(params[key])
    params.update()


def derivatives(integrator: Any, scene: Any, keys: list[str], w: Any, spp: int) -> list[np.ndarray]:
    """Return the derivatives of the loss by parameters, in reverse mode."""
    params = mi.traverse(scene)
    attached(params, keys)
    integrator.render_backward(scene, None, mi.TensorXf(w), seed=1, spp=spp)
    return [np.array(dr.grad(params[key])).reshape(params[key].shape) for key in keys]


# ---------------------------------------------------------------- instances

#: Two instances, the second one sheared.
MAPS = np.array([[[0.6, 0, 0, -0.9], [0, 0.6, 0, 0.3], [0, 0, 0.6, 0]],
                 [[0.6, 0.0, 0, 0.8], [0.3, 0.6, 0, -0.2], [0, 0, -0.6, 0.5]]])  # fmt: skip
LARGER = np.where(np.arange(4) < 3, MAPS, 0)
BOTH = ["surface.control_points", "surface.instances"]


def instances(net: np.ndarray) -> dict[str, Any]:
    return bezier(net, instances=tensor(MAPS))


@pytest.mark.parametrize("net", [BALL, BENT], ids=["ball", "patch"])
@pytest.mark.parametrize("place", ["in view", "shadow"])
def test_outlines_of_instances(net, place):
    seen = place == "in view"
    scene = (in_view if seen else with_shadow)(instances(net))
    side = SIDE if seen else 4
    w = weights(side)
    if seen:  # a loss that tells left from right
        w *= np.linspace(0, 2, side, dtype=np.float32)[:, None]
    which = {"sppi": 0} if seen else {"sppc": 4, "sppp": 0}
    full = mi.load_dict({"type": "bezier_direct_projective", **which})
    spp = 4096 if seen else 16384
    by_net, by_maps = derivatives(full, scene, BOTH, w, spp)
    # a net that grows is a surface that grows before its maps
    grown = np.array(net)
    grown[..., 3] = 0
    # 2 % are noise, of pixels that an outline crosses and of lines that touch the surface
    for got, key, change in (
        ((by_maps * LARGER).sum(), BOTH[1], LARGER),
        ((by_net * grown).sum(), BOTH[0], grown),
    ):
        want = central_by(scene, key, change, w, 8100 if seen else 4096, 0.04, depth=2)
        assert got == pytest.approx(want, rel=0.1), key
    # one of them moves
    if seen:
        moved = np.zeros_like(MAPS)
        moved[1, :, 3] = 1, -0.7, 0.4
        want = central_by(scene, BOTH[1], moved, w, 8100, 0.03, depth=2)
        assert (by_maps * moved).sum() == pytest.approx(want, rel=0.1)


def test_forward_is_reverse_for_instances():
    scene = in_view(instances(BENT))
    full = mi.load_dict({"type": "bezier_prb_projective", "max_depth": 2, "sppi": 16})
    w = weights(SIDE)
    (got,) = derivatives(full, scene, BOTH[1:], w, 64)
    change = np.random.default_rng(0).normal(size=MAPS.shape)
    params = mi.traverse(scene)
    attached(params, BOTH[1:])
    dr.set_grad(params[BOTH[1]], tensor(change))
    image = full.render_forward(scene, None, seed=1, spp=64)
    # the same samples: only the order of sums differs
    assert inner(image, w) == pytest.approx(float((got * change).sum()), rel=1e-3)


def test_instances_are_a_parameter():
    shape = mi.load_dict(instances(BALL))
    params = mi.traverse(shape)
    ray = mi.Ray3f(mi.Point3f(3, 0.3, 9), mi.Vector3f(0, 0, -1))
    assert not shape.ray_test(ray)[0]
    moved = MAPS.copy()
    moved[0, 0, 3] = 3
    params["instances"] = tensor(moved)
    params.update()
    assert shape.ray_test(ray)[0] and shape.bbox().max.x == pytest.approx(3.6, abs=1e-5)
    params["instances"] = tensor(np.zeros_like(MAPS))
    with pytest.raises(mb.BezierError, match="instances: expected finite, regular, affine maps"):
        params.update()
    assert shape.ray_test(ray)[0]
    assert np.array(params["instances"])[0, 0, 3] == 3


def test_silhouette_samples_of_instances():
    shape = mi.load_dict(instances(BENT))
    eye = mi.ScalarPoint3f(0, 0, 5)
    index, length = shape.precompute_silhouette(eye)
    ss = shape.sample_precomputed_silhouette(eye, index, mi.Float(0.5))
    assert set(np.unique(np.array(ss.scene_index))) == {1, 2} and (np.array(length) > 0).all()
    # all kinds: numbers of the unit cube come back, up to roundings and to what has no inverse
    sample = mi.Point3f(np.random.default_rng(0).random((3, 2000)))
    flags = mi.DiscontinuityFlags.AllTypes
    ss = shape.sample_silhouette(sample, flags)
    again = shape.sample_silhouette(shape.invert_silhouette_sample(ss), flags)
    good = np.array(ss.is_valid())
    for name in ("p", "d"):
        off = np.linalg.norm(np.array(getattr(ss, name)) - np.array(getattr(again, name)), axis=0)
        assert good.sum() > 1500 and np.quantile(off[good], 0.99) < 1e-3, name
    assert (np.array(ss.scene_index) == np.array(again.scene_index))[good].mean() > 0.99
    with pytest.raises(mb.BezierError, match="no instances where an interaction is to tell one"):
        shape.differential_motion(dr.zeros(mi.SurfaceInteraction3f))


# ---------------------------------------------------------------- mirrors and glass

NET = "surface.control_points"
SPARSE = {"sppi": 0, "sppp": 0}


def ball(centre: Any, radius: float) -> np.ndarray:
    return BALL @ np.block([[radius * np.eye(3), np.array(centre)[:, None]], [0, 0, 0, 1]]).T


def glowing(net: np.ndarray) -> dict[str, Any]:
    """A surface of one radiance: only its outline tells where it is."""
    light = {"type": "area", "radiance": {"type": "rgb", "value": [0.9, 0.3, 0.2]}}
    return bezier(net, bsdf={"type": "diffuse", "reflectance": 0.0}, emitter=light)


def seen_by(fov: float, **shapes: Any) -> Any:
    """Shapes before a sky that is the same everywhere."""
    look = mi.ScalarTransform4f().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0])
    sky = {"type": "constant", "radiance": {"type": "rgb", "value": [0.05, 0.1, 0.3]}}
    camera = {"type": "perspective", "fov": fov, "to_world": look, **film(SIDE)}
    return mi.load_dict({"type": "scene", "camera": camera, "sky": sky, **shapes})


#: Seen by reflection in the middle of the view.
AT = (4, 0.1, 0.2)
TURNED = np.array([[0, 0, 1, 4], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1.0]])
MIRROR = {"type": "conductor", "material": "none"}
GLASS = {"type": "dielectric", "int_ior": 1.5}
HOLLOW = ball((-2.1, 0, -2.1), 3)


def plane_mirror() -> dict[str, Any]:
    turned = mi.ScalarTransform4f().look_at([0, 0, 0], [1, 0, 1], [0, 1, 0]).scale(4)
    return {"type": "rectangle", "to_world": turned, "bsdf": MIRROR}


SCENES = {
    "ball in a plane mirror": lambda: (
        seen_by(30, surface=glowing(ball(AT, 1)), mirror=plane_mirror()), AT),
    "patch in a plane mirror": lambda: (
        seen_by(30, surface=glowing(BENT @ TURNED.T), mirror=plane_mirror()), (4, 0, 0)),
    "trims in a plane mirror": lambda: (
        seen_by(30, mirror=plane_mirror(),
                surface={**cut(net_at=TURNED), **{k: v for k, v in glowing(BALL).items() if k in
                                                  ("bsdf", "emitter")}}), (4, 0, 0)),
    "ball in a ball": lambda: (
        seen_by(20, surface=glowing(ball(AT, 1)), mirror=bezier(HOLLOW, bsdf=MIRROR)), AT),
    "ball in a ball that grows": lambda: (
        seen_by(20, other=glowing(ball(AT, 1)), surface=bezier(HOLLOW, bsdf=MIRROR)),
        (-2.1, 0, -2.1)),
    "ball through glass": lambda: (
        seen_by(22, surface=glowing(ball((0.2, 0.1, -3), 0.6)),
                glass=bezier(ball((0, 0, 0), 1), bsdf=GLASS)), (0.2, 0.1, -3)),
    "ball through glass that grows": lambda: (
        seen_by(16, other=glowing(ball((0.2, 0.1, -3), 0.6)),
                surface=bezier(ball((0, 0, 0), 1), bsdf=GLASS)), (0, 0, 0)),
}  # fmt: skip


@pytest.mark.parametrize("make", SCENES.values(), ids=SCENES)
def test_outlines_in_mirrors_and_through_glass(make):
    scene, centre = make()
    depth = 5
    w = weights(SIDE) * np.linspace(0, 2, SIDE, dtype=np.float32)[:, None]
    full = mi.load_dict({"type": "bezier_prb_projective", "max_depth": depth, **SPARSE})
    (got,) = derivatives(full, scene, [NET], w, 1024)
    net = np.array(mi.traverse(scene)[NET])
    # it grows about its middle
    change = net - net[..., 3:] * np.array([*centre, 1.0])
    # 3 % are noise, of pixels that an outline crosses
    want = central_by(scene, NET, change, w, 8100, 0.02, depth)
    assert (got * change).sum() == pytest.approx(want, rel=0.1)
    # without them there is nothing, or half of it
    rest = mi.load_dict({"type": "bezier_prb_projective", "max_depth": depth, **SPARSE, "spps": 0})
    (none,) = derivatives(rest, scene, [NET], w, 64)
    assert abs((none * change).sum() - want) > 0.5 * abs(want)


def test_forward_is_reverse_in_mirrors():
    scene, _centre = SCENES["patch in a plane mirror"]()
    full = mi.load_dict({"type": "bezier_prb_projective", "max_depth": 3, **SPARSE, "sppc": 0})
    w = weights(SIDE)
    (got,) = derivatives(full, scene, [NET], w, 64)
    change = np.random.default_rng(0).normal(size=got.shape)
    params = mi.traverse(scene)
    attached(params, [NET])
    dr.set_grad(params[NET], tensor(change))
    image = full.render_forward(scene, None, seed=1, spp=64)
    assert np.abs(np.array(image)).max() > 0
    # the same samples: only the order of sums differs
    assert inner(image, w) == pytest.approx(float((got * change).sum()), rel=1e-4)


# ---------------------------------------------------------------- trims


def square_and_circle(radius: float) -> list[np.ndarray]:
    """Return the border of a square, through which a round hole is cut."""
    corners = [(0, 0), (1, 0), (1, 1), (0, 1), (0, 0)]
    lines = [np.array([[*a, 1], [*b, 1]], float) for a, b in pairwise(corners)]
    arcs = []
    half = np.sqrt(0.5)
    for k in range(4):
        c, s = (1, 0, -1, 0)[k], (0, 1, 0, -1)[k]
        net = np.array([[1, 0, 1], [half, half, half], [0, 1, 1]])
        turned = net @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]])
        arcs.append(turned @ np.array([[radius, 0, 0], [0, radius, 0], [0.45, 0.55, 1]]))
    return lines + closed_region(arcs, 1e-9)


def cut(bend: float = 0.0, hole: float = 0.3, net_at: Any = None) -> dict[str, Any]:
    """A square of two patches, bent or flat, with a hole across both."""
    grid = np.zeros((3, 3, 4))
    x = np.array([-1, 0, 1.0])
    grid[..., 0], grid[..., 1], grid[..., 3] = x[:, None], x[None, :], 1
    grid[1, 1, 2] = bend
    patches = mb.tensor_to_triangles(grid)
    if net_at is not None:
        patches = patches.transform(net_at)
    maps = [square_map(), square_map(second=True)]
    trims = Trims([square_and_circle(hole)], [0, 0], maps, [[[0, 0], [1, 1]]] * 2)
    return bezier(patches, trims=tensor(trims_to_numbers(trims)))


TRIMMED = ["surface.control_points", "surface.trim_points"]


@pytest.mark.parametrize("place", ["in view", "shadow"])
def test_outlines_of_trimmed_shapes(place):
    seen = place == "in view"
    scene = (in_view if seen else with_shadow)(cut(1.0))
    w = weights(SIDE if seen else 4)
    which = {"sppi": 0} if seen else {"sppc": 4, "sppp": 0}
    full = mi.load_dict({"type": "bezier_direct_projective", **which})
    by_net, by_points = derivatives(full, scene, TRIMMED, w, 4096 if seen else 16384)
    params = mi.traverse(scene)
    net, points = (np.array(params[key]).reshape(params[key].shape) for key in TRIMMED)
    grown = net * [1, 1, 1, 0]
    # the hole alone grows; its points come after the four corners of the square
    larger = points - points[:, 2:] * [0.45, 0.55, 1]
    larger[:4] = 0
    for got, key, change in ((by_net, TRIMMED[0], grown), (by_points, TRIMMED[1], larger)):
        # 2 % are noise
        want = central_by(scene, key, change, w, 8100, 0.04, depth=2)
        assert (got * change).sum() == pytest.approx(want, rel=0.1), key
    if seen:  # without its hole it has another derivative
        path = mi.load_dict({"type": "bezier_direct_projective", "sppi": 0, "sppp": 0})
        (rest,) = derivatives(path, scene, TRIMMED[:1], w, 64)
        want = central_by(scene, TRIMMED[0], grown, w, 8100, 0.04, depth=2)
        assert abs((rest * grown).sum() - want) > 0.5 * abs(want)


def test_trims_are_a_parameter():
    shape = mi.load_dict(cut())
    params = mi.traverse(shape)
    assert params["trim_points"].shape == (12, 3)  # corners and ends once
    ray = mi.Ray3f(mi.Point3f(0.6, 0.1, 3), mi.Vector3f(0, 0, -1))
    assert shape.ray_test(ray)[0]
    points = np.array(params["trim_points"])
    points[4:, :2] += 0.3 * (points - points[:, 2:] * [0.45, 0.55, 1])[4:, :2]
    before = np.array(params["trim_points"])
    params["trim_points"] = tensor(points)
    params.update()
    assert not shape.ray_test(ray)[0]
    params["trim_points"] = tensor(before)
    params.update()
    assert shape.ray_test(ray)[0]
    params["trim_points"] = tensor(-points)
    with pytest.raises(mb.BezierError, match=r"trim_points.*positive weight"):
        params.update()
    assert np.array_equal(np.array(params["trim_points"]), before.astype(np.float32))


def test_borders_of_trimmed_shapes():
    shape = mi.load_dict(cut())
    found = trim_segments(shape.patches, shape.trims)
    a, b = (shape.patches.points(found.patch, x) for x in (found.a, found.b))
    # the hole of radius 0.6 in space; the border of the square is left to the open edges
    assert np.linalg.norm(b - a, axis=1).sum() == pytest.approx(1.2 * np.pi, rel=1e-3)
    # trims in float32
    assert np.abs(np.linalg.norm(a[:, :2] - [-0.1, 0.1], axis=1) - 0.6).max() < 1e-6
    assert (found.weight == 1).all()
    # a lid in the hole, of a larger net: its border and that of the hole are one
    turn = np.diag([1.5, 1.5, 1, 1])
    turn[:2, 3] = 0.05, -0.05
    lid = Trims([square_and_circle(0.2)[4:]], [0, 0], shape.trims.square, shape.trims.place)
    both = mb.BezierTriangles.join([shape.patches, shape.patches.transform(turn)])
    twice = trim_segments(both, Trims.join([shape.trims, lid]))
    assert len(twice) == 2 * len(found) and (twice.weight == 0.5).all()


def test_points_of_trimming_curves():
    """Curves on arcs, in a part of their plane: host and device place them as `Trims` does."""
    rng = np.random.default_rng(4)
    patches = mb.BezierTriangles(np.repeat(BENT, 2, axis=0))
    place = [[[2.0, -1.0], [3.0, 0.5]]] * 2
    region = [c @ [[3.0, 0, 0], [0, 0.5, 0], [2, -1, 1]] for c in square_and_circle(0.3)[4:]]
    trims = Trims(
        [region], [0, 0], [square_map(), square_map(True, True)], place, [[0, 1.5], [2, 0]]
    )
    found = trim_segments(patches, trims)
    assert set(found.patch) == {0, 1}
    flat = [c for r in trims.regions for c in r]
    for uv, t in ((found.a, found.t[:, 0]), (found.b, found.t[:, 1])):
        want = np.array(
            [
                bernstein_point(flat[k], x)  # of the curve itself
                for k, x in zip(found.curve, t)
            ]
        )
        assert np.abs(trims.parameters(found.patch, uv) - want).max() < 1e-9
    shape = mi.load_dict(bezier(patches, trims=tensor(trims_to_numbers(trims))))
    curves = TrimCurves()
    cuts = curves.add(shape, 0, found)
    curves = curves.uploaded(shape._alone())
    s = rng.random(len(cuts.rows)).astype(np.float32)
    for at in (np.zeros_like(s), s, np.ones_like(s)):
        got = curves.point(mi.UInt32(cuts.rows), mi.Float(at), mi.Bool(True))
        uv = np.array(got.uv).T
        if at is s:  # the tangent, by differences in float32
            near = [
                np.array(curves.point(mi.UInt32(cuts.rows), mi.Float(s + e), mi.Bool(True)).uv).T
                for e in (-1e-2, 1e-2)
            ]
            slope = (near[1] - near[0]) / 2e-2
            assert np.abs(slope - np.array(got.tangent).T).max() < 1e-4
        else:
            assert np.abs(uv - (cuts.b if at[0] else cuts.a)).max() < 1e-6


def bernstein_point(net: np.ndarray, t: float) -> np.ndarray:
    while len(net) > 1:
        net = (1 - t) * net[:-1] + t * net[1:]
    return net[0, :2] / net[0, 2]


def test_trimming_curves_in_a_mirror():
    """A round hole that grows and moves in an instance of its surface, seen in a mirror alone."""
    shape = {
        **cut(0.4),
        "bsdf": {"type": "diffuse", "reflectance": 0.7},
        "instances": tensor(TURNED[None, :3]),
    }
    scene = seen_by(30, mirror=plane_mirror(), surface=shape)
    params = mi.traverse(scene)
    points = np.array(params[TRIMMED[1]])
    # of the hole alone: the border of the square stays
    hole = np.hypot(*(points[:, :2] / points[:, 2:] - (0.45, 0.55)).T) < 0.44
    change = np.zeros_like(points)
    middle = np.array([0.4, 0.6, 1.0])
    change[hole] = points[hole] - points[hole, 2:] * middle
    w = weights(SIDE) * np.linspace(0, 2, SIDE, dtype=np.float32)[:, None]
    full = mi.load_dict({"type": "bezier_prb_projective", "max_depth": 3, **SPARSE})
    (got,) = derivatives(full, scene, TRIMMED[1:], w, 1024)
    # 3 % are noise, of pixels that the curve crosses
    want = central_by(scene, TRIMMED[1], change, w, 8100, 0.02, 3)
    assert (got * change).sum() == pytest.approx(want, rel=0.1)


def test_pieces_of_trimming_curves_are_found_once_for_all_nets():
    first = mi.load_dict(cut(1.0))
    patches, trims = first.patches, first.trims
    calls = []
    own = type(trims).inside
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(type(trims), "inside", lambda *a: calls.append(1) or own(*a))
        one = trim_segments(patches, trims)
        assert len(calls) == 3
        moved = patches.transform(np.diag([1.0, 2.0, 0.5, 1.0]))
        two = trim_segments(moved, trims)
        assert len(calls) == 3
    # and as if they had been found for this net alone
    again = trim_segments(moved, trims[:])
    for name in ("patch", "curve", "t", "a", "b", "side", "weight"):
        assert np.array_equal(getattr(two, name), getattr(again, name)), name
        assert np.array_equal(getattr(one, name), getattr(two, name)), name
    # a patch that leaves another one opens edges
    apart = patches[:1]
    alone = trim_segments(apart, trims[:1])
    assert len(alone) and (alone.patch == 0).all()
