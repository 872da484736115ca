"""What derivatives leave out is said once; parameters that have none are refused."""

from __future__ import annotations

import warnings
from typing import Any

import drjit as dr
import mitsuba as mi
import pytest
from backend_cases import VARIANT
from derivative_cases import BENT, film, weights
from mitsuba_cases import bezier

import mitsuba_bezier as mb
from mitsuba_bezier.plugins.integrators import left_out

SIDE = 2


@pytest.fixture(autouse=True)
def variant(monkeypatch: pytest.MonkeyPatch) -> None:
    mi.set_variant(VARIANT)
    monkeypatch.setattr(left_out, "_said", set())


def scene() -> Any:
    camera = {
        "type": "perspective",
        "to_world": mi.ScalarTransform4f().look_at([0.3, 0.4, 5], [0, 0, 0], [0, 1, 0]),
        **film(SIDE),
    }
    camera["film"]["rfilter"] = {"type": "gaussian"}
    return mi.load_dict(
        {
            "type": "scene",
            "camera": camera,
            "surface": bezier(BENT, bsdf={"type": "twosided", "one": {"type": "diffuse"}}),
            "back": {"type": "rectangle", "to_world": mi.ScalarTransform4f().scale(9)},
            "lamp": {"type": "point", "position": [1, 3, 4.0]},
        }
    )


def enable(scene: Any, key: str) -> None:
    params = mi.traverse(scene)
    value = params[key]
    if isinstance(value, mi.Transform4f):
        angle = mi.Float(0)
        dr.enable_grad(angle)
        params[key] = mi.Transform4f(value) @ mi.Transform4f().rotate([0, 0, 1], angle)
    else:
        dr.enable_grad(value)
        params[key] = value
    params.update()


def said(kind: str, *keys: str, times: int = 1) -> list[str]:
    """Return what is said of derivatives by parameters."""
    one = scene()
    for key in keys:
        enable(one, key)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for _ in range(times):
            integrator = mi.load_dict({"type": kind})
            integrator.render_backward(one, None, mi.TensorXf(weights(SIDE)), spp=1)
    return [str(w.message) for w in caught if issubclass(w.category, mb.DerivativeWarning)]


@pytest.mark.parametrize("kind", ["bezierpath", "bezierptracer"])
def test_outlines_are_named_once(kind):
    (text,) = said(kind, "surface.control_points", times=3)
    assert text.startswith(f"{kind}: derivatives by surface.control_points leave out outlines")
    assert "bezier_prb_projective has those by surface.control_points" in text
    assert said(kind, "surface.control_points") == []  # the next scene of a fit, too
    (text,) = said(kind, "surface.control_points", "back.to_world")
    assert "no integrator here has those by back.to_world" in text


def test_what_moves_matters():
    reflectance = "back.bsdf.reflectance.value"
    for kind in ("bezierpath", "bezierptracer", "beziervolpath", "bezier_prb_projective"):
        assert said(kind, reflectance) == []
    assert said("bezier_prb_projective", "surface.control_points") == []
    (text,) = said("bezier_prb_projective", "surface.control_points", "back.to_world", times=2)
    assert text.startswith("bezier_prb_projective: derivatives by back.to_world leave out")


@pytest.mark.parametrize(
    "kind", ["bezierpath", "bezierptracer", "beziervolpath", "bezier_prb_projective"]
)
@pytest.mark.parametrize("key", ["lamp.position", "camera.to_world"])
def test_places_of_lights_and_cameras_have_none(kind, key):
    with pytest.raises(Exception, match=rf"{kind}: expected parameters that.*bezierpath.*{key}"):
        said(kind, key)
