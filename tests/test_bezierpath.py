"""The integrator: parameters, and renders that agree with Mitsuba's `path` up to noise."""

from __future__ import annotations

from statistics import NormalDist
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from mitsuba_cases import bezier

import mitsuba_bezier as mb

VARIANT = "llvm_ad_rgb"


@pytest.fixture(scope="module", autouse=True)
def variant() -> None:
    mi.set_variant(VARIANT)


# ---------------------------------------------------------------- scenes

WIDTH, HEIGHT = 96, 40
BALLS = ["diffuse", "rough conductor", "dielectric"]


def bsdfs() -> dict[str, dict]:
    return {
        "diffuse": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.8, 0.5, 0.2]}},
        "rough conductor": {"type": "roughconductor", "alpha": 0.15, "material": "Cu"},
        "dielectric": {"type": "dielectric", "int_ior": 1.5},
    }


def ball(kind: str, center: list[float], radius: float, **more: Any) -> dict:
    """Return a sphere: Mitsuba's (``native``) or a cover."""
    if kind == "native":
        return {"type": "sphere", "center": center, "radius": radius, **more}
    place = mi.ScalarTransform4f().translate(center).scale(radius)
    return bezier(mb.sphere(cover=kind), to_world=place, **more)


def sky() -> Any:
    """Return a small environment map with a bright side."""
    rng = np.random.default_rng(0)
    values = 0.3 + 0.4 * rng.random((8, 16, 3), dtype=np.float32)
    values[2:4, 3:6] = [3.0, 2.5, 2.0]
    return {"type": "envmap", "bitmap": mi.Bitmap(values)}


def lamp() -> dict:
    return {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().look_at([0, 4, 2], [0, 0, 0], [0, 0, 1]).scale(0.7),
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [8, 8, 9]}},
    }


def floor() -> dict:
    board = {"type": "checkerboard", "to_uv": mi.ScalarTransform3f().scale([6, 6])}
    return {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().rotate([1, 0, 0], -90).translate([0, 0, -1]).scale(5),
        "bsdf": {"type": "diffuse", "reflectance": board},
    }


def camera(width: int = WIDTH, height: int = HEIGHT) -> dict:
    return {
        "type": "perspective",
        "fov": 50,
        "to_world": mi.ScalarTransform4f().look_at([0, 1.2, 8], [0, -0.1, 0], [0, 1, 0]),
        "film": {
            "type": "hdrfilm",
            "width": width,
            "height": height,
            "rfilter": {"type": "box"},
            "pixel_format": "rgb",
        },
        "sampler": {"type": "independent"},
    }


def three_balls(kind: str) -> Any:
    shapes = {
        f"ball{i}": ball(kind, [2.4 * (i - 1), 0, 0], 1.0, bsdf=bsdfs()[name])
        for i, name in enumerate(BALLS)
    }
    lights = {"sky": sky(), "lamp": lamp()}
    return mi.load_dict({"type": "scene", "camera": camera(), "floor": floor(), **lights, **shapes})


# ---------------------------------------------------------------- statistics

BATCHES = 16


def moments(scene: Any, integrator: Any, spp: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and variance of one sample, from independent renders of `spp` samples."""
    images = np.stack(
        [
            np.array(mi.render(scene, integrator=integrator, spp=spp, seed=seed + k))
            for k in range(BATCHES)
        ]
    ).astype(np.float64)
    assert np.isfinite(images).all()
    return images.mean(axis=0), images.var(axis=0, ddof=1) * spp


def share_that_agrees(a: tuple, b: tuple, spp: int, columns: slice = slice(None)) -> float:
    """Return the share of pixels that pass Mitsuba's per-pixel Z-test, averaged over channels.

    As in Mitsuba's ``test_renders.py``: variance at least 1e-4, level 0.01 with Šidák's
    correction; here both images have noise.
    """
    (mean_a, var_a), (mean_b, var_b) = ((m[:, columns], v[:, columns]) for m, v in (a, b))
    count = spp * BATCHES
    variance = np.maximum(var_a, 1e-4) + np.maximum(var_b, 1e-4)
    z = np.abs(mean_a - mean_b) * np.sqrt(count / variance)
    alpha = 1 - (1 - 0.01) ** (1 / (z.shape[0] * z.shape[1]))
    return float((z < NormalDist().inv_cdf(1 - alpha / 2)).mean())


#: Mitsuba's own share. With variances from 16 batches a pixel of two equal renders is beyond
#: the level in one of 20 000 cases (Student's distribution with 30 degrees of freedom).
SHARE = 0.9975


# ---------------------------------------------------------------- Z-tests

SPP = 32


def path(**parameters: Any) -> Any:
    return mi.load_dict({"type": "path", **parameters})


def bezierpath(**parameters: Any) -> Any:
    return mi.load_dict({"type": "bezierpath", **parameters})


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
    from mitsuba_bezier.plugins.path_tracing import mis_weight

    a, b = mi.Float([1e20, 1.0, 1e20, 3.0, 0.0]), mi.Float([1.0, 1e20, 1e20, 4.0, 1.0])
    # 1e-6: a few roundings of float32
    np.testing.assert_allclose(mis_weight(a, b), [1, 0, 0.5, 9 / 25, 0], atol=1e-6)
