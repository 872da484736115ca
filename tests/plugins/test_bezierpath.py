"""The integrator: parameters, and renders that agree with Mitsuba's `path` up to noise."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from backend_cases import VARIANT
from render_cases import (
    BALLS,
    BATCHES,
    SHARE,
    SPP,
    WIDTH,
    ball,
    bezierpath,
    bsdfs,
    camera,
    floor,
    lamp,
    moments,
    path,
    share_that_agrees,
    three_balls,
)


@pytest.fixture(scope="module", autouse=True)
def variant() -> None:
    mi.set_variant(VARIANT)


# ---------------------------------------------------------------- Z-tests


@pytest.fixture(scope="module")
def renders(variant) -> dict[str, tuple]:
    """The three balls, rendered by Mitsuba and as both covers."""
    return {
        "native": moments(three_balls("native"), path(), SPP, 0),
        "octants": moments(three_balls("octants"), bezierpath(), SPP, 1000),
        "tetrahedral": moments(three_balls("tetrahedral"), bezierpath(), SPP, 2000),
    }


@pytest.mark.parametrize("cover", ["octants", "tetrahedral"])
@pytest.mark.parametrize("name", BALLS)
def test_agrees_with_mitsubas_sphere(renders, cover, name):
    third = WIDTH // 3
    columns = slice(BALLS.index(name) * third, (BALLS.index(name) + 1) * third)
    assert renders["native"][0][:, columns].mean() > 0.1  # there is light
    share = share_that_agrees(renders["native"], renders[cover], SPP, columns)
    assert share >= SHARE, f"{share:.4%}"


def test_the_z_test_sees_a_small_difference(renders):
    # half a percent of brightness, or a shift by a quarter of a pixel
    mean, variance = renders["octants"]
    assert share_that_agrees(renders["native"], (mean * 1.005, variance), SPP) < SHARE
    moved = 0.75 * mean + 0.25 * np.roll(mean, 1, axis=1)
    for third in range(3):
        columns = slice(third * WIDTH // 3, (third + 1) * WIDTH // 3)
        assert share_that_agrees(renders["native"], (moved, variance), SPP, columns) < SHARE


def lit_by_a_ball(kind: str) -> Any:
    """A floor and a wall of other shapes under a ball that is a lamp; nothing else shines."""
    lamp_ball = ball(
        kind,
        [0, 0.3, 0],
        0.8,
        emitter={"type": "area", "radiance": {"type": "rgb", "value": [3, 2, 1]}},
    )
    mirror = {"type": "sphere", "center": [2.2, -0.3, 0], "radius": 0.7, "bsdf": bsdfs()[BALLS[1]]}
    return mi.load_dict(
        {
            "type": "scene",
            "camera": camera(48, 20),
            "floor": floor(),
            "lamp": lamp_ball,
            "mirror": mirror,
        }
    )


def two_lamps(kind: str) -> Any:
    """A Bézier shape that shines beside a lamp of Mitsuba's, and one that does not."""
    emitter = {"type": "area", "radiance": {"type": "rgb", "value": [1, 2, 3]}}
    return mi.load_dict(
        {
            "type": "scene",
            "camera": camera(48, 20),
            "floor": floor(),
            "lamp": lamp(),
            "bulb": ball(kind, [-1.5, 0.3, 0], 0.6, emitter=emitter),
            "ball": ball(kind, [1.2, -0.2, 0], 0.8, bsdf=bsdfs()[BALLS[0]]),
        }
    )


@pytest.mark.parametrize(
    ("scene", "parameters"),
    [
        (lit_by_a_ball, {"hide_emitters": True}),
        (two_lamps, {"max_depth": 2}),
        (two_lamps, {"max_depth": 3, "rr_depth": 1}),
    ],
)
def test_lamps_with_a_bezier_surface(scene, parameters):
    # small lamps have heavy tails: more samples bring them nearer to normal
    spp = 2 * SPP
    native = moments(scene("native"), path(**parameters), spp, 0)
    ours = moments(scene("tetrahedral"), bezierpath(**parameters), spp, 5000)
    share = share_that_agrees(native, ours, spp)
    assert share >= SHARE, f"{share:.4%}"
    # five standard deviations of the mean over the image
    noise = np.sqrt((native[1] + ours[1]).sum() / (spp * BATCHES)) / native[0].size
    assert ours[0].mean() == pytest.approx(native[0].mean(), abs=5 * noise)


@pytest.mark.parametrize("parameters", [{"max_depth": 2}, {"rr_depth": 2}])
def test_depths_on_bezier_shapes(parameters):
    native = moments(three_balls("native"), path(**parameters), SPP // 4, 0)
    ours = moments(three_balls("octants"), bezierpath(**parameters), SPP // 4, 7000)
    share = share_that_agrees(native, ours, SPP // 4)
    assert share >= SHARE, f"{share:.4%}"


@pytest.mark.parametrize("name", ["llvm_ad_spectral", "llvm_ad_mono_polarized"])
def test_other_variants(name):
    mi.set_variant(name)
    try:
        native = moments(three_balls("native"), path(max_depth=4), SPP // 4, 0)
        ours = moments(three_balls("tetrahedral"), bezierpath(max_depth=4), SPP // 4, 7000)
        share = share_that_agrees(native, ours, SPP // 4)
    finally:
        mi.set_variant(VARIANT)
    assert native[0].mean() > 0.1
    assert share >= SHARE, f"{share:.4%}"


# ---------------------------------------------------------------- scenes of Mitsuba's own shapes


@pytest.mark.parametrize(
    "parameters",
    [
        {},
        {"max_depth": -1, "rr_depth": 5, "hide_emitters": False},
        {"max_depth": 0},
        {"max_depth": 1},
        {"max_depth": 2},
        {"max_depth": 3},
        {"rr_depth": 1},
        {"max_depth": 12, "rr_depth": 3},
        {"hide_emitters": True},
        {"hide_emitters": True, "max_depth": 2},
    ],
    ids=str,
)
def test_without_bezier_shapes_it_is_path(parameters):
    # the same random numbers in the same order: the same image up to the order of roundings
    scene = three_balls("native")
    a = np.array(mi.render(scene, integrator=path(**parameters), spp=8, seed=3))
    b = np.array(mi.render(scene, integrator=bezierpath(**parameters), spp=8, seed=3))
    assert a.shape == b.shape
    assert (a.max() > 0.5) == (parameters.get("max_depth") != 0)
    # a rounding may send a path through glass another way; no more than a few pixels do
    differs = np.abs(a - b).max(axis=-1) > 1e-5 * (1 + a.max(axis=-1))
    assert differs.mean() < 2e-3, f"{differs.sum()} pixels"


# ---------------------------------------------------------------- parameters


def test_defaults():
    integrator = bezierpath()
    assert integrator.max_depth == 0xFFFFFFFF and integrator.rr_depth == 5
    assert integrator.hide_emitters is False
    assert bezierpath(max_depth=-1).max_depth == 0xFFFFFFFF
    assert bezierpath(max_depth=7).max_depth == 7
    for word in ("BezierPath", "max_depth", "rr_depth = 5", "hide_emitters = False"):
        assert word in str(integrator)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"max_depth": -2}, "max_depth: expected an integer >= 0, or -1 for no limit, got -2"),
        ({"max_depth": "x"}, "max_depth: expected an integer >= 0, or -1 for no limit, got 'x'"),
        ({"max_depth": 2.5}, "max_depth: expected an integer >= 0, or -1 for no limit, got 2.5"),
        ({"max_depth": True}, "max_depth: expected an integer >= 0, .*, got True"),
        ({"rr_depth": 0}, "rr_depth: expected an integer > 0, got 0"),
        ({"rr_depth": -1}, "rr_depth: expected an integer > 0, got -1"),
        ({"hide_emitters": 3}, '"hide_emitters" has the wrong type .expected boolean'),
        ({"max_dept": 3}, "unknown parameter 'max_dept'; did you mean 'max_depth'"),
        ({"samples": 3}, "unknown parameter 'samples'; its parameters are max_depth, "),
    ],
)
def test_bad_parameters(parameters, message):
    with pytest.raises(RuntimeError, match=message):
        bezierpath(**parameters)


def test_weights_of_densities_whose_squares_overflow() -> None:
    # in the plane of a light its density comes near 1e20; such paths made NaN pixels
    from mitsuba_bezier.plugins.integrators.path_tracing import mis_weight

    a, b = mi.Float([1e20, 1.0, 1e20, 3.0, 0.0]), mi.Float([1.0, 1e20, 1e20, 4.0, 1.0])
    # 1e-6: a few roundings of float32
    np.testing.assert_allclose(mis_weight(a, b), [1, 0, 0.5, 9 / 25, 0], atol=1e-6)
