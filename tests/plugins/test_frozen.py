"""Functions frozen by `dr.freeze`: replayed with the structure of now, or recorded anew."""

from __future__ import annotations

import gc
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from backend_cases import VARIANT
from mitsuba_cases import bezier, ray_of

import mitsuba_bezier as mb
from mitsuba_bezier.errors import BezierError
from mitsuba_bezier.kernels.arrays import upload
from mitsuba_bezier.kernels.closed_form import members
from mitsuba_bezier.plugins.frozen import contents


@pytest.fixture(scope="module", autouse=True)
def variant() -> None:
    mi.set_variant(VARIANT)


@pytest.fixture(autouse=True)
def no_garbage() -> None:
    """Free the scenes of other tests now: Mitsuba cannot while a function is recorded."""
    gc.collect()


def scene_of(shapes: dict[str, Any], integrator: str = "bezierpath", **more: Any) -> Any:
    camera = mi.ScalarTransform4f().look_at([0, -3, 2], [0, 0, 0], [0, 0, 1])
    film = {"type": "hdrfilm", "width": 24, "height": 24, "rfilter": {"type": "box"}}
    sampler = {"type": "independent", "sample_count": 4}
    sensor = {"type": "perspective", "to_world": camera, "film": film, "sampler": sampler}
    scene = {"type": "scene", "integrator": {"type": integrator, **more}, "sensor": sensor}
    if not any("emitter" in shape for shape in shapes.values()):
        scene["sky"] = {"type": "constant"}
    return mi.load_dict({**scene, **shapes})


def torus(**more: Any) -> dict[str, Any]:
    return bezier(mb.torus(), **more)


def maps() -> Any:
    maps = np.repeat(np.eye(3, 4, dtype=np.float32)[None], 3, axis=0)
    maps[:, 0, 3], maps[:, :, :3] = [-1, 0, 1], 0.4 * np.eye(3)
    return mi.TensorXf(maps)


CASES = {
    "graphs": lambda: scene_of({"a": torus()}),
    "closed forms": lambda: scene_of({"a": bezier()}),
    "with others": lambda: scene_of(
        {"a": bezier(mb.sphere(cover="tetrahedral")), "b": torus(), "c": {"type": "rectangle"}}
    ),
    "a light": lambda: scene_of({"a": bezier(emitter={"type": "area"}), "b": torus()}),
    "instances": lambda: scene_of({"a": bezier(instances=maps())}),
    "aovs": lambda: scene_of({"a": torus()}, "bezieraov", aovs="n:sh_normal"),
    "volumes": lambda: scene_of({"a": torus()}, "beziervolpath"),
}


def picture(scene: Any, seed: Any) -> Any:
    return mi.render(scene, seed=seed)


def assert_replayed(frozen: Any, scene: Any, seeds: range) -> None:
    for seed in seeds:
        expected = np.array(picture(scene, seed))
        np.testing.assert_array_equal(np.array(frozen(scene, mi.UInt32(seed))), expected)


def smaller(scene: Any) -> None:
    """Change the control points of a shape."""
    params = mi.traverse(scene)
    key = next(k for k in params.keys() if k.endswith("control_points"))  # noqa: SIM118
    params[key] = params[key] * mi.TensorXf([0.7, 0.7, 0.7, 1.0], shape=(1, 1, 4))
    params.update()


def reasons(error: BaseException | None) -> str:
    """Return the messages of an error and of what caused it."""
    return "" if error is None else f"{error}\n{reasons(error.__cause__ or error.__context__)}"


@pytest.mark.parametrize("make", CASES.values(), ids=CASES.keys())
def test_frozen_renders(make):
    scene = make()
    picture(scene, 0)
    frozen = dr.freeze(picture)
    assert_replayed(frozen, scene, range(8))
    # the first ones are not alike: Mitsuba's own arrays become opaque meanwhile
    assert frozen.n_recordings <= 4
    before = np.array(picture(scene, 1))
    smaller(scene)
    picture(scene, 0)
    assert_replayed(frozen, scene, range(3))
    assert not np.array_equal(np.array(picture(scene, 1)), before)


def test_no_frozen_function_uses_what_is_out_of_date():
    scene = scene_of({"a": torus()})
    frozen = dr.freeze(picture)
    with pytest.raises(RuntimeError) as first:
        frozen(scene, mi.UInt32(0))
    assert "expected a first ray query, and one after each change" in reasons(first.value)
    for _ in range(3):  # until changes alone do not have it recorded anew
        picture(scene, 0)
        assert_replayed(frozen, scene, range(3))
        smaller(scene)
    with pytest.raises(RuntimeError) as second:
        frozen(scene, mi.UInt32(0))
    assert "expected a first ray query, and one after each change" in reasons(second.value)


def test_changes_that_need_other_kernels():
    # a closed form is lost, and comes again; then there are leaves at infinity beside others
    scene = scene_of({"a": bezier()})
    params = mi.traverse(scene)
    octants = np.array(params["a.control_points"])
    dented, infinite = octants.copy(), octants.copy()
    dented[:, 7, :3] *= 1.1
    infinite[0, 14, 3] = -0.2
    frozen = dr.freeze(picture)
    seen = []
    for net in (octants, dented, octants, infinite, dented):
        params["a.control_points"] = mi.TensorXf(net)
        params.update()
        picture(scene, 0)
        assert_replayed(frozen, scene, range(3))
        seen.append(np.array(picture(scene, 0)))
    assert not np.array_equal(seen[0], seen[1]) and not np.array_equal(seen[0], seen[3])


def test_no_garbage_is_collected_meanwhile(monkeypatch):
    scene = scene_of({"a": bezier()})
    picture(scene, 0)
    enabled = []
    values = members._values
    monkeypatch.setattr(members, "_values", lambda *x: enabled.append(gc.isenabled()) or values(*x))
    frozen = dr.freeze(picture)
    frozen(scene, mi.UInt32(0))
    assert enabled and not any(enabled) and gc.isenabled()
    picture(scene, 0)
    assert enabled[-1]


def test_what_is_told_of_structures():
    plain, dented = mb.sphere(), mb.sphere().control_points.copy()
    dented[:, 7, :3] *= 1.1
    nets = (plain, plain.transform(np.diag([0.7, 0.7, 0.7, 1.0])), dented, mb.torus())
    data = [mi.load_dict(bezier(net))._alone() for net in nets]
    found = [contents(d) for d in data]
    # another size of the same is the same code, and so are quartics without a closed form
    assert found[0]["code"] == found[1]["code"] != found[2]["code"] == found[3]["code"]
    for d, what in zip(data, found):
        indices = [a.index for a in what["arrays"]]
        assert len(set(indices)) == len(indices) > 10
        assert d.structure.nodes.records.index in indices and d.tables.nets.index in indices


def test_updates_are_replayed():
    scene = scene_of({"a": torus()})
    frozen = dr.freeze(picture)
    for _ in range(8):
        picture(scene, 0)
        frozen(scene, mi.UInt32(0))
        smaller(scene)
    # numbers are data, not code; Dr.Jit records anew where sizes come to coincide
    assert frozen.n_recordings <= 5


def test_a_shape_of_several_structures():
    scene = scene_of({"a": torus(), "b": bezier(mb.sphere(cover="tetrahedral"))})
    picture(scene, 0)
    frozen = dr.freeze(picture)
    assert_replayed(frozen, scene, range(2))
    for shape in scene.shapes():
        shape.ray_test(ray_of([[0, -3, 0]], [[0, 1, 0]]))
    assert_replayed(frozen, scene, range(2, 4))


def test_frozen_derivatives():
    scene = scene_of({"a": torus()})
    params = mi.traverse(scene)
    key = next(k for k in params.keys() if k.endswith("control_points"))  # noqa: SIM118

    def gradient(scene, params, seed):
        image = mi.render(scene, params, seed=seed, spp=4)
        dr.backward(dr.mean(dr.square(image), axis=None))
        return dr.grad(params[key])

    frozen = dr.freeze(gradient)
    seen = []
    for step in range(3):
        dr.enable_grad(params[key])
        params.update()
        expected = np.array(gradient(scene, params, mi.UInt32(step)))
        dr.set_grad(params[key], 0.0)
        found = np.array(frozen(scene, params, mi.UInt32(step)))
        # sums in float32, in another order
        np.testing.assert_allclose(found, expected, atol=1e-5 * np.abs(expected).max())
        seen.append(found)
        params[key] = dr.detach(params[key]) * mi.TensorXf([0.9, 1, 1, 1], shape=(1, 1, 4))
    assert np.abs(seen[0]).max() > 0 and not np.allclose(seen[0], seen[1])


def test_uploads_in_a_frozen_function_are_refused():
    # Dr.Jit would end the process
    frozen = dr.freeze(lambda x: x + upload(mi.Float, np.ones(3)))
    with pytest.raises(RuntimeError) as caught:
        frozen(mi.Float([1.0, 2.0, 3.0]))
    assert "ran once before it was frozen" in reasons(caught.value)
    assert issubclass(BezierError, Exception)
