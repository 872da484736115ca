"""``mitsuba-bezier lens FILE --render SCENE``: a lens in place of the scene's camera."""

from __future__ import annotations

from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

from mitsuba_bezier.cli.main import main

LENS = Path(__file__).parents[2] / "scenes/lenses/double_gauss.csv"

SCENE = """<scene version="3.0.0">
<default name="spp" value="4"/>
<integrator type="path"><integer name="max_depth" value="2"/></integrator>
<sensor type="{kind}">
    <float name="fov" value="{fov}"/>
    {more}
    <transform name="to_world"><lookat origin="0, -3, 1" target="0, 0, 1" up="0, 0, 1"/></transform>
    <film type="hdrfilm"><integer name="width" value="48"/><integer name="height" value="32"/>
        <rfilter type="box"/></film>
    <sampler type="independent"><integer name="sample_count" value="$spp"/></sampler>
</sensor>
<emitter type="constant"/>
<shape type="sphere"><float name="radius" value="0.2"/><point name="center" x="0" y="0" z="1"/>
    <bsdf type="diffuse"><rgb name="reflectance" value="0.1, 0.1, 0.1"/></bsdf></shape>
<shape type="sphere"><float name="radius" value="0.1"/><point name="center" x="0.3" y="0" z="1.2"/>
    <bsdf type="diffuse"><rgb name="reflectance" value="0.1, 0.1, 0.1"/></bsdf></shape>
</scene>
"""


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "scene.xml"
    path.write_text(SCENE.format(kind="perspective", fov=20, more=""))
    return path


def picture(path):
    return np.array(mi.Bitmap(str(path)).convert(mi.Bitmap.PixelFormat.RGB)).mean(axis=2)


def test_the_lens_sees_what_the_camera_saw(scene, tmp_path, capsys):
    seen, plain = tmp_path / "a.exr", tmp_path / "b.exr"
    words = ["lens", str(LENS), "--render", str(scene), "-o", str(seen), "--spp", "64"]
    assert main([*words, "--f-number", "8"]) == 0
    told = capsys.readouterr().err
    # 200 mm times the tangent of 10 degrees; the front of the ball is 2.8 m from the camera, the
    # front vertex 58 mm before that
    assert "the film is 35.27 mm wide, as the camera sees" in told
    assert "in focus at 2.742, in the middle" in told
    assert main(["render", str(scene), "-o", str(plain), "--spp", "64", "-q"]) == 0
    a, b = picture(seen), picture(plain)
    assert a.shape == b.shape == (32, 48) and seen.with_suffix(".png").is_file()
    # dark balls before a white sky, in the same places, larger by the pull of focus, 3.7 %
    assert ((a < 0.5) == (b < 0.5)).mean() > 0.97
    assert (a < 0.5).sum() == pytest.approx(1.08 * (b < 0.5).sum(), rel=0.1)


def test_size_film_variant_and_defines_are_those_asked_for(scene, tmp_path, capsys):
    words = ["lens", str(LENS), "--render", str(scene), "--width", "24", "--film-width", "17.6"]
    assert main([*words, "-m", "llvm_ad_rgb", "-D", "spp=16", "--focus-distance", "2.8"]) == 0
    assert "16 spp" in capsys.readouterr().err
    found = picture(tmp_path / "scene-double_gauss.exr")  # beside the scene
    assert found.shape == (16, 24)
    # half the film: twice the ball, whose radius is 2 * 24 / 35.27 * 200 * 0.2 / 3 / 2 pixels
    assert (found[8] < 0.5).sum() == pytest.approx(2 * 24 / 17.6 * 100 * 0.2 / 2.9, abs=2)


def test_a_wide_camera_gets_what_the_lens_covers(tmp_path, capsys):
    path = tmp_path / "wide.xml"
    path.write_text(SCENE.format(kind="perspective", fov=80, more=""))
    assert main(["lens", str(LENS), "--render", str(path), "--spp", "1"]) == 0
    # 100 mm times the tangent of 14 degrees, less 1.04 % of distortion, and 0.35 % because the film
    # is 0.40 mm before the paraxial image, 114.6 mm from the pupil: half the diagonal of 3 to 2
    told = capsys.readouterr().err
    assert "the film is 40.92 mm wide, as far as the fields of the lens reach" in told


def test_another_lens_does_not_go_on_from_a_picture(scene, tmp_path, capsys):
    words = ["lens", str(LENS), "--render", str(scene), "-o", str(tmp_path / "a.exr"), "--spp", "2"]
    assert main([*words, "--f-number", "8"]) == 0
    header = dict(mi.Bitmap(str(tmp_path / "a.exr")).metadata())
    assert main([*words, "--f-number", "4"]) == 0
    other = dict(mi.Bitmap(str(tmp_path / "a.exr")).metadata())
    changed = {key for key in header if header[key] != other[key]}
    assert any("scene" in key for key in changed)


@pytest.mark.parametrize(
    "words, message",
    [
        (["--render", "nosuch.xml"], "SCENE: expected an existing scene file"),
        (["--spp", "4"], "--spp: expected --render SCENE beside it"),
        (["--blades", "5"], "--blades: expected --render SCENE beside it"),
        (["--render", "SCENE", "--f-number", "nan"], "--f-number: expected a positive number"),
        (["--render", "SCENE", "--f-number", "0.1"], "f_number: expected at least 0.5"),
        (["--render", "SCENE", "--film-width", "-3"], "--film-width: expected a positive number"),
        (["--render", "SCENE", "--focus-distance", "0.001"], "focus_distance: expected more than"),
        (["--render", "SCENE", "--blades", "2"], "blades: expected 0 or a whole number"),
        (["--render", "SCENE", "-s", "3"], "--sensor: expected a number below 1, got 3"),
        (["--render", "SCENE", "-o", "a.png"], "--output: expected a name that ends in .exr"),
        (["--render", "ball.obj"], "--render: expected a scene file"),
    ],
)
def test_what_cannot_be_is_one_line(scene, tmp_path, capsys, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "ball.obj").write_text("v 0 0 0\n")
    words = [str(scene) if word == "SCENE" else word for word in words]
    assert main(["lens", str(LENS), *words]) == 2
    told = capsys.readouterr().err.strip().splitlines()
    assert message in told[-1] and "Traceback" not in "".join(told)
    assert not list(tmp_path.glob("*.exr"))
