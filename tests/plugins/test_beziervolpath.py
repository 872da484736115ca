"""Media: renders that agree with Mitsuba's `volpath` up to noise, and answers known exactly."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from backend_cases import VARIANT
from mitsuba_cases import ray_of
from render_cases import (
    BATCHES,
    SHARE,
    ball,
    camera,
    floor,
    lamp,
    moments,
    share_that_agrees,
    sky,
    three_balls,
)

from mitsuba_bezier.cli._scene import load
from mitsuba_bezier.plugins.integrators.media import Media, transmittance
from mitsuba_bezier.plugins.scene import SceneRays


@pytest.fixture(scope="module", autouse=True)
def variant() -> None:
    mi.set_variant(VARIANT)


def volpath(**parameters: Any) -> Any:
    return mi.load_dict({"type": "volpath", **parameters})


def beziervolpath(**parameters: Any) -> Any:
    return mi.load_dict({"type": "beziervolpath", **parameters})


def fog(sigma: Any = 2.0, albedo: Any = (0.9, 0.7, 0.5), **more: Any) -> dict:
    """Return a homogeneous medium; a triple is a colour (of components up to 1)."""
    values = {"sigma_t": sigma, "albedo": albedo}
    rgb = {
        k: {"type": "rgb", "value": list(v)} if isinstance(v, tuple) else v
        for k, v in values.items()
    }
    return {"type": "homogeneous", "phase": {"type": "hg", "g": 0.4}, **rgb, **more}


def cloud(center: tuple = (0, 0, 0), albedo: Any = 0.8) -> dict:
    """Return a heterogeneous medium in a cube of edge 2: random cells, some of them empty."""
    grid = np.random.default_rng(0).random((6, 6, 6, 1), dtype=np.float32)
    volume = {
        "type": "gridvolume",
        "grid": mi.VolumeGrid(5 * np.maximum(grid - 0.2, 0)),
        "to_world": mi.ScalarTransform4f().translate(np.array(center) - 1.0).scale(2),
    }
    return {"type": "heterogeneous", "sigma_t": volume, "albedo": albedo}


# ---------------------------------------------------------------- against `volpath`

WIDTH, HEIGHT = 72, 30
BALLS = ["fog in glass", "coloured fog", "cloud"]


def three_media(kind: str) -> Any:
    """Fog in a glass ball, fog and a cloud in index-matched balls."""
    coloured = fog((1.0, 0.5, 0.25), scale=2.0)
    return mi.load_dict(
        {
            "type": "scene",
            "camera": camera(WIDTH, HEIGHT),
            "floor": floor(),
            "sky": sky(),
            "lamp": lamp(),
            "glass": ball(kind, [-2.4, 0, 0], 1, bsdf={"type": "dielectric"}, interior=fog()),
            "fog": ball(kind, [0, 0, 0], 1, bsdf={"type": "null"}, interior=coloured),
            "cloud": ball(kind, [2.4, 0, 0], 1, bsdf={"type": "null"}, interior=cloud((2.4, 0, 0))),
        }
    )


SPP = 16


@pytest.fixture(scope="module")
def renders(variant) -> dict[str, tuple]:
    return {
        "volpath": moments(three_media("native"), volpath(), SPP, 0),
        "native": moments(three_media("native"), beziervolpath(), SPP, 1000),
        "tetrahedral": moments(three_media("tetrahedral"), beziervolpath(), SPP, 2000),
    }


def check(a: tuple, b: tuple, spp: int, columns: slice = slice(None)) -> None:
    """Hold that two renders differ by noise alone, in each pixel and in the mean."""
    share = share_that_agrees(a, b, spp, columns)
    assert share >= SHARE, f"{share:.4%}"
    # five standard deviations of the mean over the image
    (ma, va), (mb_, vb) = ((m[:, columns], v[:, columns]) for m, v in (a, b))
    noise = np.sqrt((va + vb).sum() / (spp * BATCHES)) / ma.size
    assert mb_.mean() == pytest.approx(ma.mean(), abs=5 * noise)


@pytest.mark.parametrize("kind", ["native", "tetrahedral"])
@pytest.mark.parametrize("name", BALLS)
def test_agrees_with_volpath(renders, kind, name):
    third = WIDTH // 3
    columns = slice(BALLS.index(name) * third, (BALLS.index(name) + 1) * third)
    check(renders["volpath"], renders[kind], SPP, columns)


def test_the_z_test_sees_a_missing_medium(renders):
    mean, variance = renders["tetrahedral"]
    for name in range(3):
        columns = slice(name * WIDTH // 3, (name + 1) * WIDTH // 3)
        # 2 % of brightness; and the noise of fog is no more than `volpath`'s
        assert share_that_agrees(renders["volpath"], (mean * 1.02, variance), SPP, columns) < SHARE
        assert variance[:, columns].mean() < 1.3 * renders["volpath"][1][:, columns].mean()


def test_without_media_it_is_volpath():
    a = moments(three_balls("native"), volpath(), 8, 0)
    b = moments(three_balls("octants"), beziervolpath(), 8, 3000)
    check(a, b, 8)


def lamp_in_fog(kind: str) -> Any:
    """A small scene with a shining ball in sight and a ball of fog in front of a mirror."""
    emitter = {"type": "area", "radiance": {"type": "rgb", "value": [3, 2, 1]}}
    mirror = {"type": "roughconductor", "alpha": 0.15, "material": "Cu"}
    return mi.load_dict(
        {
            "type": "scene",
            "camera": camera(48, 20),
            "floor": floor(),
            "bulb": ball(kind, [-1.8, 0.3, 0], 0.6, emitter=emitter),
            "mirror": ball("native", [2.2, 0, -1], 0.8, bsdf=mirror),
            "fog": ball(kind, [0.5, 0, 0], 1, bsdf={"type": "null"}, interior=fog(1.0)),
        }
    )


@pytest.mark.parametrize(
    "parameters",
    [{"hide_emitters": True}, {"max_depth": 1}, {"max_depth": 3, "rr_depth": 1}],
    ids=str,
)
def test_parameters_mean_what_they_mean_to_volpath(parameters):
    a = moments(lamp_in_fog("native"), volpath(**parameters), 16, 0)
    b = moments(lamp_in_fog("tetrahedral"), beziervolpath(**parameters), 16, 5000)
    check(a, b, 16)


def test_nothing_at_depth_zero():
    assert np.all(
        np.array(mi.render(lamp_in_fog("native"), integrator=beziervolpath(max_depth=0))) == 0
    )


@pytest.mark.parametrize("hide", [False, True])
@pytest.mark.parametrize("name", ["path", "volpath"])
def test_alpha_is_mitsubas(name, hide):
    # an environment in sight is opaque
    film = {"type": "hdrfilm", "width": 12, "height": 8, "pixel_format": "rgba"}
    parts = {
        "camera": {**camera(), "film": {**film, "rfilter": {"type": "box"}}},
        "sky": {"type": "constant"},
        "ball": ball("native", [0, 0, 0], 1.5, bsdf={"type": "diffuse"}),
    }
    scene = mi.load_dict({"type": "scene", **parts})
    theirs, ours = (
        np.array(
            mi.render(scene, integrator=mi.load_dict({"type": t, "hide_emitters": hide}), spp=16)
        )
        for t in (name, f"bezier{name}")
    )
    np.testing.assert_array_equal(ours[..., 3], theirs[..., 3])
    assert (theirs[..., 3].min() == 0) == hide


# ---------------------------------------------------------------- exact answers


@pytest.mark.parametrize("bsdf", ["null", "dielectric"])
@pytest.mark.parametrize("medium", ["fog", "cloud"])
def test_white_furnace(bsdf, medium):
    # light of radiance 1 from everywhere, and nothing absorbs: 1 is seen everywhere
    inside = fog(2.0, 1.0) if medium == "fog" else cloud(albedo=1.0)
    # the cloud's boundary is within its grid
    shape = ball("octants", [0, 0, 0], 0.95, bsdf={"type": bsdf}, interior=inside)
    scene = mi.load_dict(
        {"type": "scene", "camera": camera(16, 16), "sky": {"type": "constant"}, "ball": shape}
    )
    mean, variance = moments(scene, beziervolpath(rr_depth=1000), 64, 0)
    noise = np.sqrt(variance.sum() / (64 * BATCHES)) / mean.size
    # 1e-5: some hundred roundings on a path; five standard deviations
    assert mean.mean() == pytest.approx(1, abs=5 * noise + 1e-5)
    assert noise < 2e-3


def shadows(scene: Any, o: Any, d: Any, length: float, medium: Any = None) -> np.ndarray:
    """Return the transmittance ``(N, 3)`` of rays of this length."""
    rays = SceneRays(scene)
    ray = ray_of(o, d, length)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(0, dr.width(ray))
    pointer = dr.zeros(mi.MediumPtr) if medium is None else mi.MediumPtr(medium)
    tr = transmittance(rays, Media(scene, medium), ray, pointer, sampler, mi.Bool(True))
    return np.array(tr).T


def test_shadow_rays_through_nested_fog():
    # a hollow ball of fog with a denser core: Beer and Lambert, without noise
    null = {"bsdf": {"type": "null"}}
    scene = mi.load_dict(
        {
            "type": "scene",
            "shell": ball("octants", [0, 0, 0], 1, **null, interior=fog((0.9, 0.5, 0.2))),
            # oriented outwards: its outside is the shell's fog
            "hollow": ball("tetrahedral", [0, 0, 0], 0.7, **null, exterior=fog((0.9, 0.5, 0.2))),
            "core": ball("native", [0, 0, 0], 0.4, **null, interior=fog(1.5)),
        }
    )
    x = np.random.default_rng(1).uniform(-1.1, 1.1, 4000)
    o = np.stack([x, 0.05 * x, np.full_like(x, -3)], axis=1)
    got = shadows(scene, o, [0, 0, 1], 10.0)
    r2 = (o[:, :2] ** 2).sum(axis=1)
    chord = [2 * np.sqrt(np.maximum(r * r - r2, 0)) for r in (1, 0.7, 0.4)]
    expected = np.exp(-np.outer(chord[0] - chord[1], (0.9, 0.5, 0.2)) - 1.5 * chord[2][:, None])
    # At each boundary Mitsuba sets rays off by about 1e-4, which lengthens a chord by that over the
    # cosine: here 7e-4 at most, at six boundaries.
    clear = (np.abs(np.sqrt(r2)[:, None] - (1, 0.7, 0.4)) > 0.01).all(axis=1)
    assert clear.mean() > 0.9
    assert np.abs(got - expected)[clear].max() < 2e-3
    assert np.abs(got - expected)[clear].mean() < 2e-4


def test_shadow_rays_stop_at_their_end_and_at_what_is_opaque():
    scene = mi.load_dict(
        {
            "type": "scene",
            "fog": ball("octants", [0, 0, 0], 1, bsdf={"type": "null"}, interior=fog(1.0)),
            "wall": ball("octants", [0, 0, 5], 1, bsdf={"type": "diffuse"}),
            "pane": ball("octants", [0, 0, -5], 1, bsdf={"type": "dielectric"}),
        }
    )
    o = [[0, 0, -2.0]]
    assert shadows(scene, o, [0, 0, 1], 0.9)[0, 0] == 1  # in front of the fog
    # in the midst of it; 1e-3: the set-off at the boundary
    assert shadows(scene, o, [0, 0, 1], 2.0)[0, 0] == pytest.approx(np.exp(-1), abs=1e-3)
    assert shadows(scene, o, [0, 0, 1], 4.0)[0, 0] == pytest.approx(np.exp(-2), abs=1e-3)
    assert shadows(scene, o, [0, 0, 1], 9.0)[0, 0] == 0
    assert shadows(scene, o, [0, 0, -1], 9.0)[0, 0] == 0  # glass is not index-matched


def test_shadow_rays_through_a_cloud_are_right_on_average():
    # the cells of one column, each a third of an edge long
    medium = cloud()
    scene = mi.load_dict(
        {
            "type": "scene",
            "ball": ball("octants", [0, 0, 0], 2, bsdf={"type": "null"}, interior=medium),
        }
    )
    grid = 5 * np.maximum(np.random.default_rng(0).random((6, 6, 6), dtype=np.float32) - 0.2, 0)
    column = grid[:, 3, 3]  # z is slowest; the ray runs in the middle of cells 3, 3
    # linear between the middles of cells, constant towards the rim
    depth = np.interp(np.linspace(-1, 1, 20001), (np.arange(6) + 0.5) / 3 - 1, column).mean() * 2
    got = shadows(scene, np.tile([1 / 6, 1 / 6, -3.0], (200_000, 1)), [0, 0, 1], 9.0)[:, 0]
    # 200 000 estimates; five standard deviations
    noise = got.std() / np.sqrt(len(got))
    assert got.mean() == pytest.approx(np.exp(-depth), abs=5 * noise)
    assert 0 < noise < 2e-3


def test_a_sensor_in_fog():
    # a shining wall seen through fog that only absorbs, and through a bubble without fog
    wall = {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().look_at([0, 0, -4], [0, 0, 0], [0, 1, 0]).scale(9),
        "emitter": {"type": "area", "radiance": 1.0},
    }
    medium = mi.load_dict(fog(0.2, 0.0))
    sensor = {
        **camera(24, 8),
        "to_world": mi.ScalarTransform4f().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0]),
    }
    bubble = ball("tetrahedral", [0, 0, 0], 1.0, bsdf={"type": "null"}, exterior=medium)
    scene = mi.load_dict(
        {"type": "scene", "camera": {**sensor, "medium": medium}, "wall": wall, "bubble": bubble}
    )
    mean, variance = moments(scene, beziervolpath(), 512, 0)
    error = np.sqrt(variance / (512 * BATCHES))
    x = (np.arange(24) + 0.5 - 12) / 12 * np.tan(np.radians(25))
    y = (np.arange(8) + 0.5 - 4) / 12 * np.tan(np.radians(25))
    lengthening = np.sqrt(1 + x[None] ** 2 + y[:, None] ** 2)
    # distance of the line from the centre, 4 away
    miss = 4 * np.sqrt(1 - 1 / lengthening**2)
    path = 8 * lengthening - 2 * np.sqrt(np.maximum(1 - miss**2, 0))
    clear = np.abs(miss - 1) > 0.15  # pixels that the bubble's outline does not cross
    z = (mean[..., 0] - np.exp(-0.2 * path))[clear] / error[..., 0][clear]
    assert clear.sum() > 150
    # five standard deviations; half a pixel's curvature of the path is less than one
    assert np.abs(z).max() < 5
    assert abs(z.mean()) < 5 / np.sqrt(clear.sum())


# ---------------------------------------------------------------- parameters and command line


def test_defaults():
    integrator = beziervolpath()
    assert integrator.max_depth == 0xFFFFFFFF and integrator.rr_depth == 5
    assert integrator.hide_emitters is False
    for word in ("BezierVolPath", "rr_depth = 5", "hide_emitters = False"):
        assert word in str(integrator)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"max_depth": -2}, "max_depth: expected an integer >= 0, or -1 for no limit, got -2"),
        ({"rr_depth": 0}, "rr_depth: expected an integer > 0, got 0"),
        ({"max_dept": 3}, "unknown parameter 'max_dept'; did you mean 'max_depth'"),
    ],
)
def test_bad_parameters(parameters, message):
    with pytest.raises(RuntimeError, match=message):
        beziervolpath(**parameters)


def test_the_command_line_replaces_volpath(tmp_path):
    file = tmp_path / "scene.xml"
    file.write_text(
        '<scene version="3.0.0"><integrator type="volpath"><integer name="max_depth" value="7"/>'
        '</integrator><sensor type="perspective"/><shape type="sphere"/></scene>'
    )
    loaded = load(file, "llvm_ad_rgb")
    assert loaded.integrator_name == "beziervolpath"
    assert loaded.integrator.max_depth == 7
    assert "rendering with beziervolpath" in loaded.notes[0]
