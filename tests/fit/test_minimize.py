"""Searches: that they find, go on where they were stopped, and refuse what cannot be."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import mitsuba_bezier as mb
from mitsuba_bezier import fit

KEY = "b.control_points"
WANTED = mb.sphere((0.3, -0.2, 0.1), 0.7).control_points


@pytest.fixture(autouse=True)
def variant() -> None:
    mi.set_variant("llvm_ad_rgb")


def scene_of(patches: Any = None, side: int = 12) -> Any:
    camera = mi.ScalarTransform4f().look_at([0.3, 0.4, 4.5], [0, 0, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": side, "height": side, "rfilter": {"type": "box"}}
    film |= {"pixel_format": "rgb", "sample_border": False}
    return mi.load_dict(
        {
            "type": "scene",
            "cam": {"type": "perspective", "fov": 40, "to_world": camera, "film": film},
            "light": {"type": "point", "position": [2, 3, 4], "intensity": 30.0},
            "b": mb.shape(mb.sphere() if patches is None else patches),
        }
    )


def distance(params: Any, _seed: int) -> Any:
    """Return the mean square distance of control points from those wanted."""
    return dr.mean(dr.square(params[KEY].array - mi.Float(WANTED.ravel())))


def search(item: Any = None, objective: Any = distance, **options: Any) -> fit.Fit:
    item = fit.Sphere() if item is None else item
    settings = {"steps": 12, "rate": 0.1, "progress": False} | options
    return fit.minimize(scene_of(), {KEY: item}, objective=objective, **settings)


def test_both_methods_find_the_least_loss() -> None:
    found = search(method="l-bfgs", steps=40)
    # the loss is float32: its least value is known to 6e-8 of terms of size one
    assert np.allclose(found.unknowns[KEY]["center"], [0.3, -0.2, 0.1], atol=2e-3)
    assert np.exp(found.unknowns[KEY]["logarithm"][0]) == pytest.approx(0.7, abs=2e-3)
    slow = search(steps=80)
    assert slow.losses[-1] < 1e-3 * slow.losses[0]
    assert len(slow.losses) == 80 and slow.reason == "steps"


def test_a_search_that_was_stopped_ends_where_an_uninterrupted_one_does(tmp_path: Path) -> None:
    options = {"refine": {5: "elevate", 8: "split"}, "smoothing": 2.0, "steps": 11}

    def near(params: Any, seed: int) -> Any:
        values = params[KEY].array
        return dr.mean(dr.square(values - dr.cos(dr.arange(mi.Float, dr.width(values)) + seed)))

    whole = search(fit.Net(mb.sphere()), near, **options)
    for stop in (0, 1, 4, 5, 6, 8, 10):
        name = tmp_path / f"{stop}.fit"
        calls = 0

        def interrupted(params: Any, seed: int, stop: int = stop) -> Any:
            nonlocal calls
            calls += 1
            if calls > stop:
                raise KeyboardInterrupt
            return near(params, seed)

        with pytest.raises(KeyboardInterrupt):
            search(fit.Net(mb.sphere()), interrupted, checkpoint=name, **options)
        again = search(fit.Net(mb.sphere()), near, checkpoint=name, **options)
        # threads add the gradients of what is gathered twice in an order of their own: float32
        # rounding, a few times over
        assert np.allclose(again.losses, whole.losses, rtol=1e-5)
        assert np.allclose(again.values[KEY], whole.values[KEY], rtol=0, atol=1e-4)
    assert whole.values[KEY].shape == (32, 21, 4)


def test_a_checkpoint_of_another_search_is_refused(tmp_path: Path) -> None:
    name = tmp_path / "a.fit"
    search(checkpoint=name, steps=2)
    before = name.read_bytes()
    for options in ({"seed": 7}, {"method": "l-bfgs"}, {"item": fit.Collineation(mb.sphere())}):
        with pytest.raises(mb.BezierError, match="checkpoint"):
            search(checkpoint=name, **options)
    assert name.read_bytes() == before
    name.write_bytes(before[:100])
    with pytest.raises(mb.FileFormatError, match="checkpoint"):
        search(checkpoint=name)
    assert len(name.read_bytes()) == 100


def test_a_step_to_an_invalid_net_is_halved() -> None:
    class Fence(fit.Sphere):
        def value(self, unknowns: Any) -> Any:
            if float(unknowns["center"].array[0]) > 0.2:
                raise mb.NetError.expected("center", "at most 0.2", "more")
            return super().value(unknowns)

    found = search(Fence(), rate=0.15)
    assert found.halved >= 1
    assert 0.1 < found.unknowns[KEY]["center"][0] <= 0.2
    found = search(Fence(), method="l-bfgs")
    assert found.halved >= 1 and found.unknowns[KEY]["center"][0] <= 0.2
    assert found.losses[-1] < 0.5 * found.losses[0]


@pytest.mark.parametrize("method", ["adam", "l-bfgs"])
def test_a_loss_that_is_not_finite_stops_and_keeps_the_state(method: str) -> None:
    calls = 0

    def breaks(params: Any, seed: int) -> Any:
        nonlocal calls
        calls += 1
        loss = distance(params, seed)
        return loss * (dr.nan if calls > 3 else 1)

    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        found = search(objective=breaks, method=method)
    assert np.isfinite(found.values[KEY]).all() and np.isfinite(found.losses).all()
    assert found.losses[-1] < found.losses[0] or method == "l-bfgs"
    if method == "adam":
        assert "not finite at step 3" in found.reason
        assert any("kept" in str(w.message) for w in told)
        assert len(found.losses) == 3


def test_an_image_is_fitted() -> None:
    exact = mi.load_dict({"type": "bezierpath", "max_depth": 2})
    wanted = mi.render(scene_of(mb.sphere((0.1, -0.1, 0), 0.9)), integrator=exact, spp=128)
    scene = scene_of()
    found = fit.minimize(
        scene, {KEY: fit.Sphere()}, [wanted], steps=6, spp=16, method="l-bfgs", progress=False
    )
    assert found.losses[-1] < 0.05 * found.losses[0]
    # a pixel of the picture is 0.25 wide; depth is known least
    assert np.abs(found.unknowns[KEY]["center"][:2] - [0.1, -0.1]).max() < 0.05
    net = np.array(mi.traverse(scene)[KEY])
    assert np.array_equal(net, np.float32(found.values[KEY]))


def test_colours_are_fitted_beside_a_place() -> None:
    def objective(params: Any, _seed: int) -> Any:
        colour = params["b.bsdf.reflectance.value"]
        m = params["b.to_world"].matrix
        return dr.sum(dr.square(colour - mi.Color3f(0.1, 0.2, 0.3))) + dr.mean(
            dr.square(m[0, 3] - 0.5)
        )

    scene = mi.load_dict(
        {
            "type": "scene",
            "b": mb.shape(
                mb.sphere(),
                bsdf={"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.5] * 3}},
            ),
        }
    )
    unknowns = {
        "b.bsdf.reflectance.value": fit.Values([0.5] * 3, low=0, high=1),
        "b.to_world": fit.Pose(),
    }
    found = fit.minimize(scene, unknowns, objective=objective, method="l-bfgs", progress=False)
    assert np.allclose(found.values["b.bsdf.reflectance.value"].ravel(), [0.1, 0.2, 0.3], atol=1e-3)
    assert found.unknowns["b.to_world"]["translation"][0] == pytest.approx(0.5, abs=1e-3)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"method": "newton"}, "method"),
        ({"steps": 0}, "steps"),
        ({"rate": 0}, "rate"),
        ({"smoothing": -1}, "smoothing"),
        ({"method": "l-bfgs", "refine": {3: "split"}}, "refine"),
        ({"refine": {0: "split"}}, "refine"),  # a sphere has no finer one
        ({"terms": [(1.0, "c.control_points", lambda v: 0)]}, "terms"),
        ({"objective": None}, "targets, objective"),
        ({"objective": lambda p, s: mi.Float(1)}, "derivative"),
    ],
)
def test_bad_arguments_are_one_clear_message(options: dict[str, Any], says: str) -> None:
    with pytest.raises(mb.BezierError, match=says):
        search(**options)


def test_no_scene_is_needed_where_nothing_is_rendered() -> None:
    found = fit.minimize(
        None,
        {"own": fit.Values([3.0, 4.0])},
        objective=lambda p, s: dr.sum(dr.square(p["own"].array - 1)),
        method="l-bfgs",
        progress=False,
    )
    assert np.allclose(found.values["own"], 1, atol=1e-5)
    with pytest.raises(mb.BezierError, match="scene"):
        fit.minimize(None, {"own": fit.Values([3.0])}, [np.zeros((2, 2, 3))])


def test_views_take_turns() -> None:
    scene = scene_of()
    black = np.zeros((12, 12, 3), dtype=np.float32)
    seen: list[float] = []

    def loss(image: Any, target: Any) -> Any:
        seen.append(float(target.array[0]))
        return dr.mean(dr.square(image - target), axis=None)

    fit.minimize(
        scene,
        {KEY: fit.Sphere()},
        {0: black},
        loss=loss,
        integrator="bezierpath",
        views=1,
        steps=2,
        spp=2,
        progress=False,
    )
    assert seen == [0.0, 0.0]
    with pytest.raises(mb.BezierError, match="views"):
        search(views=0)


def test_targets_are_checked() -> None:
    scene = scene_of()
    good = np.zeros((12, 12, 3), dtype=np.float32)
    for targets, says in (
        ([], "targets"),
        ([good[:5]], r"targets\[0\]"),
        ({1: good}, "sensor 1"),
        ([np.full_like(good, np.nan)], "NaN"),
    ):
        with pytest.raises(mb.BezierError, match=says):
            fit.minimize(scene, {KEY: fit.Sphere()}, targets)
    with pytest.raises(mb.BezierError, match=r"b\.control_points"):
        fit.minimize(scene, {"x.control_points": fit.Sphere()}, [good])
    with pytest.raises(mb.BezierError, match="Parametrization"):
        fit.minimize(scene, {KEY: 3}, [good])  # type: ignore[dict-item]
    with pytest.raises(mb.BezierError, match="unknowns"):
        fit.minimize(scene, {}, [good])
