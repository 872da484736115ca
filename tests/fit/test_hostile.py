"""Searches with input that cannot be, checkpoints of others, full disks and Ctrl-C."""

from __future__ import annotations

import errno
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import mitsuba_bezier as mb
from mitsuba_bezier import fit
from mitsuba_bezier.fit import checkpoint as checkpoints
from mitsuba_bezier.fit.problem import Problem
from mitsuba_bezier.fit.search import which_integrator

KEY = "b.control_points"


@pytest.fixture(autouse=True)
def variant() -> None:
    mi.set_variant("llvm_ad_rgb")


def square(params: Any, _seed: int) -> Any:
    return dr.sum(dr.square(params["own"].array - 1))


def search(item: Any = None, objective: Any = square, **options: Any) -> fit.Fit:
    """Search two numbers that belong to no scene."""
    item = fit.Values([3.0, 4.0]) if item is None else item
    settings = {"steps": 4, "rate": 0.1, "progress": False} | options
    return fit.minimize(None, {"own": item}, objective=objective, **settings)


def scene_of(side: int = 8, patches: bool = True) -> Any:
    """Return a ball under a sky; one of Mitsuba's own is rendered by quick kernels."""
    camera = mi.ScalarTransform4f().look_at([0, 0, 4.5], [0, 0, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": side, "height": side, "rfilter": {"type": "box"}}
    grey = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.5] * 3}}
    return mi.load_dict(
        {
            "type": "scene",
            "cam": {"type": "perspective", "to_world": camera, "film": film},
            "sky": {"type": "constant"},
            "b": mb.shape(mb.sphere(), bsdf=grey) if patches else {"type": "sphere", "bsdf": grey},
        }
    )


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"steps": True}, "steps"),
        ({"steps": 2.5}, "steps"),
        ({"rate": np.inf}, "rate"),
        ({"rate": "fast"}, "rate"),
        ({"smoothing": None}, "smoothing"),
        ({"seed": None}, "seed"),
        ({"seed": 0.5}, "seed"),
        ({"views": 1.5}, "views"),
        ({"refine": {3: "fold"}}, "refine: expected steps with"),
        ({"refine": {-1: "split"}}, "refine"),
        ({"callback": 3}, "callback: expected a function"),
        ({"objective": 3}, "objective: expected a function"),
        ({"objective": lambda p, s: None}, "loss: expected one number of Dr.Jit, got NoneType"),
        ({"objective": lambda p, s: p["own"].array}, "loss: expected one number .* got 2 numbers"),
        ({"terms": [(1.0, "own")]}, "terms"),
        ({"terms": [(np.nan, "own", dr.sum)]}, "terms: expected finite weights"),
        ({"terms": [(1.0, "own", lambda v: v)]}, "terms: expected one number"),
        ({"checkpoint": "no/such/folder/a.fit"}, "checkpoint: expected a folder that exists"),
    ],
)
def test_bad_arguments_are_told_before_the_first_step(options: dict[str, Any], says: str) -> None:
    with pytest.raises(mb.BezierError, match=says):
        search(**options)


def test_unknowns_that_are_none_are_refused() -> None:
    scene = scene_of()
    image = np.zeros((8, 8, 3), dtype=np.float32)
    colour = "b.bsdf.reflectance.value"
    for unknowns, says in (
        ([], "unknowns: expected a dict"),
        ({}, "at least one parameter"),
        ({colour: fit.Values([0.5, 0.5])}, "3 numbers for a Color3f, got shape"),
        ({"cam.near_clip": fit.Values(0.1)}, "parameters that have derivatives .*b.control_points"),
    ):
        with pytest.raises(mb.BezierError, match=says):
            fit.minimize(scene, unknowns, [image], integrator="bezierpath", progress=False)  # type: ignore[arg-type]


def test_targets_and_losses_that_are_none_are_refused() -> None:
    scene = scene_of(patches=False)
    image = np.zeros((8, 8, 3), dtype=np.float32)
    unknowns = {"b.bsdf.reflectance.value": fit.Values([0.5] * 3)}
    for targets, options, says in (
        (image, {}, r"targets: expected a list of images, or a dict, got shape \(8, 8, 3\)"),
        (["photo.png"], {}, r"targets\[0\]"),
        ({0.5: image}, {}, "sensors 0 to 0"),
        ([np.zeros((8, 8, 5))], {}, r"targets\[0\]: expected shape \(8, 8, 3\)"),
        ([image], {"loss": 3}, "loss"),
        ([image], {"loss": lambda a, b: a - b}, "loss: expected one number .* got 192 numbers"),
        ([image], {"integrator": "bezierpaht"}, "integrator: expected one of"),
        ([image], {"integrator": scene}, "integrator"),
    ):
        with pytest.raises(mb.BezierError, match=says):
            fit.minimize(
                scene, unknowns, targets, integrator=options.pop("integrator", "direct"),
                steps=1, spp=1, progress=False, **options,
            )  # fmt: skip


def test_a_variant_without_derivatives_is_named() -> None:
    mi.set_variant("scalar_rgb")
    with pytest.raises(mb.BezierError, match="variant: expected one with derivatives"):
        search()


def test_what_has_a_derivative_is_named_with_a_parameter_that_has_none() -> None:
    for key, named in (
        ("camera.thicknesses", "direct"),
        ("fog.interior_medium.sigma_t.value", "beziervolpath"),
        ("b.control_points", "bezier_direct_projective"),
    ):
        assert named in which_integrator(key)
    still = {"own": fit.Values([2.0]), "x.thicknesses": fit.Values([1.0])}
    with pytest.raises(mb.BezierError, match=r"x\.thicknesses: expected .* Mitsuba's direct"):
        fit.minimize(None, still, objective=square, progress=False)


@pytest.mark.parametrize("method", ["adam", "l-bfgs"])
def test_a_checkpoint_of_another_problem_is_refused(tmp_path: Path, method: str) -> None:
    name = tmp_path / "a.fit"
    search(checkpoint=name, method=method)
    before = name.read_bytes()
    with pytest.raises(mb.BezierError, match=r"checkpoint.*start of its unknowns"):
        search(fit.Values([3.0, 4.5]), checkpoint=name, method=method)
    with pytest.raises(mb.BezierError, match="checkpoint"):
        search(fit.Values([3.0, 4.0, 5.0]), checkpoint=name, method=method)
    assert name.read_bytes() == before
    assert len(search(checkpoint=name, steps=6).losses) == 6 if method == "adam" else True


def test_a_checkpoint_of_other_photographs_is_refused(tmp_path: Path) -> None:
    name = tmp_path / "a.fit"
    unknowns = {"b.bsdf.reflectance.value": fit.Values([0.5] * 3)}
    rng = np.random.default_rng(0)
    image = rng.random((8, 8, 3)).astype(np.float32)

    def run(target: Any) -> fit.Fit:
        return fit.minimize(
            scene_of(patches=False), unknowns, [target], integrator="direct", steps=1, spp=1,
            checkpoint=name, progress=False,
        )  # fmt: skip

    run(image)
    assert len(run(image * 1.001).losses) == 1  # rendered anew
    with pytest.raises(mb.BezierError, match=r"checkpoint.*its targets"):
        run(image[::-1])


@pytest.mark.parametrize("hurt", ["x", "pending", "first", "about", "nan", "shape"])
def test_a_damaged_checkpoint_is_told(tmp_path: Path, hurt: str) -> None:
    name = tmp_path / "a.fit"
    search(checkpoint=name)
    about, arrays = checkpoints.read(name)
    if hurt == "about":
        del about["refined"]
    elif hurt == "nan":
        arrays["x"][0] = np.nan
    elif hurt == "shape":
        arrays["second"] = np.zeros(1)
    else:
        del arrays[hurt]
    checkpoints.write(name, about, arrays)
    with pytest.raises(mb.BezierError, match="checkpoint"):
        search(checkpoint=name)


@pytest.mark.parametrize("method", ["adam", "l-bfgs"])
def test_a_full_disk_is_no_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, method: str
) -> None:
    name = tmp_path / "a.fit"
    search(checkpoint=name, method=method, steps=1)
    before = name.read_bytes()

    def full(*_: Any) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("mitsuba_bezier._files._write_new", full)
        with pytest.warns(UserWarning, match="goes on without writing"):
            found = search(checkpoint=name, method=method, steps=3, every=1e-9)
    assert len(found.losses) >= 2 and np.isfinite(found.values["own"]).all()
    assert name.read_bytes() == before and list(tmp_path.iterdir()) == [name]


@pytest.mark.parametrize("method", ["adam", "l-bfgs"])
def test_ctrl_c_leaves_the_scene_and_the_checkpoint_at_the_last_good_state(
    tmp_path: Path, method: str
) -> None:
    name = tmp_path / "a.fit"
    scene = scene_of()
    calls = 0

    def stopped(params: Any, _seed: int) -> Any:
        nonlocal calls
        calls += 1
        if calls == 4:
            raise KeyboardInterrupt
        return dr.sum(dr.square(params[KEY].array - 1))

    with pytest.raises(KeyboardInterrupt):
        fit.minimize(
            scene, {KEY: fit.Sphere()}, objective=stopped, method=method, steps=9,
            checkpoint=name, progress=False,
        )  # fmt: skip
    value = mi.traverse(scene)[KEY]
    assert not dr.grad_enabled(value)
    _about, arrays = checkpoints.read(name)
    problem = Problem(scene, {KEY: fit.Sphere()}, stopped, (), 0.0)
    expected = problem.arrays(arrays["x"])[KEY]["center"]
    # the sphere's middle, from two points of it that are opposite
    net = np.array(value).reshape(-1, 4)
    points = net[:, :3] / net[:, 3:]
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    assert np.allclose(middle, expected, atol=1e-5)
    assert np.abs(expected).max() > 0


def test_ctrl_c_while_a_net_is_refined_can_be_gone_on_from(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = tmp_path / "a.fit"
    options = {"refine": {2: "split"}, "checkpoint": name, "progress": False, "steps": 4}
    net = mb.sphere(cover="octants")[:1]

    def near(params: Any, _seed: int) -> Any:
        return dr.mean(dr.square(params["own"].array - 1))

    def run() -> fit.Fit:
        return fit.minimize(None, {"own": fit.Net(net)}, objective=near, **options)

    with monkeypatch.context() as patch:

        def interrupted(*_: Any) -> Any:
            raise KeyboardInterrupt

        patch.setattr("mitsuba_bezier.fit.problem.Problem.vector", interrupted)
        with pytest.raises(KeyboardInterrupt):
            run()
    found = run()
    assert len(found.losses) == 4 and found.values["own"].shape[0] == 4


def test_a_step_that_is_halved_is_told_once() -> None:
    class Fence(fit.Values):
        def value(self, unknowns: Any) -> Any:
            if float(unknowns["values"].array[0]) < 2.0:
                raise mb.NetError.expected("own", "at least 2", "less")
            return super().value(unknowns)

    with pytest.warns(UserWarning, match="halves steps .* own: expected at least 2") as told:
        found = search(Fence([3.0, 4.0]), rate=0.2, steps=8)
    assert sum("halves" in str(w.message) for w in told) == 1
    assert found.halved >= 1 and found.values["own"].ravel()[0] >= 2


class Own(fit.Parametrization):
    """A parametrization of a user, with mistakes."""

    def __init__(self, begin: Any, found: Any = None) -> None:
        self.begin, self.found = begin, found

    def start(self) -> Any:
        return self.begin

    def value(self, unknowns: Any) -> Any:
        return self.found


@pytest.mark.parametrize(
    ("item", "says"),
    [
        (Own([1.0]), r"unknowns\['own'\].start: expected a dict"),
        (Own({}), r"unknowns\['own'\].start: expected a dict"),
        (Own({"x": ["a"]}), r"unknowns\['own'\].start: expected arrays of numbers"),
        (Own({"x": [np.nan]}), r"unknowns\['own'\].start: expected finite numbers"),
        (Own({"x": [1.0]}), r"unknowns\['own'\].value: expected an array of Dr.Jit, got NoneType"),
        (
            Own({"x": [1.0]}, 3.0),
            r"unknowns\['own'\].value: expected an array of Dr.Jit, got float",
        ),
    ],
)
def test_mistakes_in_parametrizations_of_ones_own_are_told(item, says):
    with pytest.raises(mb.BezierError, match=says):
        search(item)


def test_a_parametrization_may_begin_with_lists():
    class Plain(fit.Parametrization):
        def start(self) -> Any:
            return {"x": [3, 4]}

        def value(self, unknowns: Any) -> Any:
            return unknowns["x"] + 0

    assert search(Plain(), method="l-bfgs").values["own"] == pytest.approx([1, 1], abs=1e-4)


@pytest.mark.parametrize(
    ("key", "near"),
    [("b.controlpoints", "b.control_points"), ("bal.control_points", "b.control_points")],
)
def test_names_that_may_be_meant_are_told(key, near):
    with pytest.raises(mb.BezierError, match=near):
        fit.minimize(scene_of(), {key: fit.Sphere()}, [np.zeros((8, 8, 3))])


def test_numbers_that_an_object_of_mitsuba_refuses_are_an_error_that_names_it():
    scene = mi.load_dict({"type": "scene", "b": {"type": "sphere", "bsdf": {"type": "diffuse"}}})
    key = "b.bsdf.reflectance.value"  # uniform: one number
    with pytest.raises(mb.BezierError, match=f"{key}: expected values that the scene takes"):
        fit.minimize(scene, {key: fit.Values([0.2] * 3)}, objective=lambda p, _seed: p[key])


def test_what_is_no_scene_and_no_name_of_a_file_is_told():
    with pytest.raises(mb.BezierError, match=r"scene: expected a scene of mi\.load_dict, got dict"):
        fit.minimize({"type": "scene"}, {KEY: fit.Sphere()}, [])
    with pytest.raises(mb.BezierError, match="checkpoint: expected the name of a file, got 3"):
        search(checkpoint=3)
