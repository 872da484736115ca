"""Derivatives of `beziervolpath` by media, materials and lights, against central differences."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from backend_cases import VARIANT
from derivative_cases import film, forward, inner, reverse, weights
from mitsuba_cases import bezier, sphere_net, tensor

SIDE = 4


@pytest.fixture(scope="module", autouse=True)
def variant() -> None:
    mi.set_variant(VARIANT)


def scene_of(kind: str) -> Any:
    """A ball of fog or of cloud before a wall, under a lamp and a sky."""
    place = mi.ScalarTransform4f()
    fog = {
        "type": "homogeneous",
        "albedo": {"type": "rgb", "value": [0.8, 0.5, 0.3]},
        "sigma_t": {"type": "rgb", "value": [0.9, 0.7, 0.5]},
        "phase": {"type": "hg", "g": 0.3},
    }
    grid = np.random.default_rng(0).uniform(0.3, 2, (3, 4, 5, 1)).astype(np.float32)
    cloud = {
        "type": "heterogeneous",
        "albedo": 0.8,
        "sigma_t": {
            "type": "gridvolume",
            "grid": mi.VolumeGrid(grid),
            "to_world": place.translate([-1, -1, -1]).scale(2),
        },
    }
    return mi.load_dict(
        {
            "type": "scene",
            "camera": {
                "type": "perspective",
                "fov": 30,
                "to_world": place.look_at([0, 0.5, 5], [0, 0, 0], [0, 1, 0]),
                **film(SIDE),
            },
            "ball": {
                **bezier(),
                "control_points": sphere_net("tetrahedral"),
                "bsdf": {"type": "null"},
                "interior": fog if kind == "fog" else cloud,
            },
            "wall": {"type": "rectangle", "to_world": place.translate([0, 0, -1.5]).scale(4)},
            "lamp": {
                "type": "rectangle",
                "to_world": place.look_at([2, 3, 2], [0, 0, 0], [0, 1, 0]),
                "emitter": {"type": "area", "radiance": 5.0},
            },
            "sky": {"type": "constant", "radiance": 0.3},
        }
    )


@pytest.mark.parametrize(
    ("kind", "key", "step"),
    [
        ("fog", "ball.interior_medium.sigma_t", 0.2),
        ("fog", "ball.interior_medium.albedo", 0.1),
        ("fog", "lamp.emitter.radiance", 1.0),
        ("cloud", "ball.interior_medium.sigma_t", 0.2),
    ],
)
def test_media(kind, key, step):
    scene = scene_of(kind)
    params = mi.traverse(scene)
    key = next(k for k in params.keys() if k.startswith(key))  # noqa: SIM118
    first = type(params[key])(params[key])
    integrator = mi.load_dict({"type": "beziervolpath", "max_depth": 6, "rr_depth": 20})
    w = weights(SIDE)

    def rendered(e: Any, seed: int = 1) -> Any:
        params[key] = first + e
        params.update()
        return mi.render(
            scene, params, integrator=integrator, spp=8192, seed=seed, seed_grad=seed + 10
        )

    got = reverse(rendered, w)
    # the same paths
    assert forward(rendered, w) == pytest.approx(got, rel=1e-3)
    out = [inner(rendered(mi.Float(x)), w) for x in (step, -step)]
    # 131072 paths: 2 % of noise, and the third derivative by the density
    assert got == pytest.approx((out[0] - out[1]) / (2 * step), rel=0.08)


# ---------------------------------------------------------------- boundaries that move


def by_net(scene: Any) -> Any:
    params = mi.traverse(scene)
    net = np.array(params["ball.control_points"])
    grown = net * np.array([1, 1, 1, 0])

    def move(e: Any) -> None:
        params["ball.control_points"] = tensor(net) + e * tensor(grown)
        params.update()

    return move


def by_place(scene: Any) -> Any:
    params = mi.traverse(scene)

    def move(e: Any) -> None:
        params["ball.to_world"] = mi.Transform4f().scale(mi.Vector3f(1 + e))
        params.update()

    return move


def rendered_by(scene: Any, move: Any, spp: int) -> Any:
    integrator = mi.load_dict({"type": "beziervolpath", "max_depth": 6, "rr_depth": 20})

    def rendered(e: Any) -> Any:
        move(e)
        params = mi.traverse(scene)
        return mi.render(scene, params, integrator=integrator, spp=spp, seed=1, seed_grad=11)

    return rendered


@pytest.mark.parametrize("ours", [True, False], ids=["patches", "sphere"])
def test_boundary_of_what_absorbs(ours):
    """The way through a ball is known: 2 sqrt(r^2 - d^2) where a ray passes at distance d."""
    sigma, fov, side = 0.9, 20.0, SIDE
    fog = {"type": "homogeneous", "albedo": 0.0, "sigma_t": sigma}
    patches = {"type": "beziertriangle", "control_points": sphere_net("tetrahedral")}
    own = patches if ours else {"type": "sphere"}
    look = mi.ScalarTransform4f().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0])
    scene = mi.load_dict(
        {
            "type": "scene",
            "camera": {"type": "perspective", "fov": fov, "to_world": look, **film(side)},
            "ball": {**own, "bsdf": {"type": "null"}, "interior": fog},
            "sky": {"type": "constant"},
        }
    )
    rendered = rendered_by(scene, (by_net if ours else by_place)(scene), 4096)
    w = np.full((side, side, 3), 1 / (3 * side**2), dtype=np.float32)
    got = reverse(rendered, w)
    if ours:  # forward, Mitsuba's sphere has no derivative by its scale, in `prb` neither
        assert forward(rendered, w) == pytest.approx(got, rel=1e-3)
    # all of the film, whose middle is seen at a distance of up to 5 tan
    n = 2000
    x = (np.arange(n) + 0.5) / n * 2 - 1
    tangent = np.tan(np.radians(fov / 2)) * np.hypot(x[:, None], x)
    square = 25 * tangent**2 / (1 + tangent**2)
    half = np.sqrt(np.maximum(1 - square, 0))
    slope = -2 * sigma * np.exp(-2 * sigma * half) / np.where(half > 0, half, np.inf)
    # the standard error is 1 %
    assert got == pytest.approx(float(slope.mean()), rel=0.06)


@pytest.mark.parametrize("kind", ["fog", "cloud"])
def test_boundary_of_what_scatters(kind):
    scene = scene_of(kind)
    rendered = rendered_by(scene, by_net(scene), 4096)
    w = weights(SIDE)
    got = reverse(rendered, w)
    assert forward(rendered, w) == pytest.approx(got, rel=2e-3)
    out = [inner(rendered(mi.Float(x)), w) for x in (0.04, -0.04)]
    # what it would be if nothing was scattered in at the boundary is far off
    scale = {"fog": 0.077, "cloud": 0.1}[kind]
    assert got == pytest.approx((out[0] - out[1]) / 0.08, abs=0.15 * scale)


def test_what_moves_is_refused():
    scene = scene_of("fog")
    params = mi.traverse(scene)
    # a boundary may move, a wall not
    dr.enable_grad(params["ball.control_points"], params["wall.to_world"])
    params.update()
    integrator = mi.load_dict({"type": "beziervolpath"})
    with pytest.raises(
        Exception, match=r"beziervolpath: expected .*null BSDF.*bezierpath.* wall.to_world$"
    ):
        integrator.render_backward(scene, params, mi.TensorXf(weights(SIDE)), spp=1)
