"""Rays that can meet no emitter are not traced, and images and derivatives are the same."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import mitsuba_bezier as mb
from mitsuba_bezier.plugins.integrators import last_rays, path_replay, path_tracing

VARIANT = "llvm_ad_rgb"


@pytest.fixture(autouse=True)
def variant() -> None:
    mi.set_variant(VARIANT)


def _scene(bsdf, light):
    camera = mi.ScalarTransform4f().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": 6, "height": 6, "pixel_format": "rgba"}
    return mi.load_dict(
        {
            "type": "scene",
            "camera": {"type": "perspective", "to_world": camera, "film": film},
            "light": light,
            "ball": mb.shape(mb.sphere(), bsdf=bsdf),
            "wall": {
                "type": "rectangle",
                "to_world": mi.ScalarTransform4f().translate([0, 0.5, -1.5]),
            },
        }
    )


DIFFUSE = {"type": "diffuse"}
MASK = {"type": "mask", "opacity": 0.5, "nested": {"type": "diffuse"}}
POINT = {"type": "point", "position": [2, 3, 4], "intensity": 30.0}
SUN = {"type": "directional", "direction": [-1, -1, -1]}


def _found(integrator, bsdf, light):
    """Return image and gradient by the ball's net."""
    scene = _scene(bsdf, light)
    params = mi.traverse(scene)
    dr.enable_grad(params["ball.control_points"])
    params.update()
    image = mi.render(scene, params, integrator=mi.load_dict(integrator), spp=16, seed=3)
    dr.backward(dr.mean(dr.square(image), axis=None))
    return np.array(image), np.array(dr.grad(params["ball.control_points"]))


@pytest.mark.parametrize(
    ("depth", "bsdf", "light"), [(2, DIFFUSE, POINT), (2, MASK, POINT), (3, DIFFUSE, POINT)]
)
def test_paths_end_before_rays_that_carry_nothing(monkeypatch, depth, bsdf, light):
    integrator = {"type": "bezier_prb_projective", "max_depth": depth, "sppi": 0, "spps": 0}
    image, gradient = _found(integrator, bsdf, light)
    for module in (path_tracing, path_replay):
        monkeypatch.setattr(module, "emitters_can_be_met", lambda _scene: True)
    full_image, full_gradient = _found(integrator, bsdf, light)
    assert np.abs(full_gradient).max() > 1e-4
    assert 0 < full_image[..., 3].mean() < 1  # alpha, also behind surfaces that let light pass
    np.testing.assert_array_equal(image, full_image)
    # the same sums, added in another order
    np.testing.assert_allclose(gradient, full_gradient, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize(
    ("light", "met"),
    [(POINT, False), (SUN, False), ({"type": "constant"}, True), ({"type": "spot"}, False)],
)
def test_which_emitters_rays_can_meet(light, met):
    scene = _scene(DIFFUSE, light)
    assert last_rays.emitters_can_be_met(scene) is met
    assert last_rays.all_end_at_once(scene, 2, met) is not met
    assert not last_rays.all_end_at_once(scene, 3, met)
    assert not last_rays.all_end_at_once(_scene(MASK, light), 2, met)
