"""Denoised pictures: better ones, marked, and refused where something is measured."""

from __future__ import annotations

import os
import sys

import numpy as np
import pytest
from backend_cases import VARIANT

import mitsuba_bezier as mb

# isort: split
import mitsuba as mi
from cli_cases import scene

from mitsuba_bezier.cli import main
from mitsuba_bezier.verification.images import read_image
from mitsuba_bezier.verification.metrics import measure

CORNER = """
  <shape type="cube"><bsdf type="twosided"><bsdf type="diffuse">
    <rgb name="reflectance" value="0.8,0.3,0.2"/></bsdf></bsdf>
    <transform name="to_world"><scale value="8"/></transform></shape>
  <shape type="sphere"><ref id="gray"/></shape>
  <shape type="sphere"><point name="center" x="2" y="3" z="2"/>
    <emitter type="area"><rgb name="radiance" value="20"/></emitter></shape>"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    text = (
        scene(shapes=CORNER).replace('value="32"', 'value="96"').replace('value="24"', 'value="64"')
    )
    text = text.replace('<emitter type="constant"/>', "").replace('"box"', '"gaussian"')
    (tmp_path / "a.xml").write_text(text)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(*words: str) -> int:
    try:
        return main.main([*words])
    except SystemExit as end:
        return int(end.code or 0)


def rgb(path: str) -> np.ndarray:
    return read_image(path).stack("RGB")


def test_without_the_denoiser_it_is_told_before_the_render(folder, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "mitsuba_oidn", None)
    assert run("render", "a.xml", "--spp", "4", "--denoise") == 2
    err = capsys.readouterr().err.splitlines()[-1]
    assert "pip install 'mitsuba-bezier[denoise]'" in err
    assert os.listdir() == ["a.xml"]


def test_a_denoised_picture(folder, capsys):
    pytest.importorskip("mitsuba_oidn")
    assert run("render", "a.xml", "--spp", "1000", "-q", "--seed", "9", "-o", "truth.exr") == 0
    assert run("render", "a.xml", "--spp", "16", "--denoise", "-o", "a.exr") == 0
    err = capsys.readouterr().err
    assert "the filter box in place of gaussian" in err
    assert "wrote a.exr and a.denoised.exr and a.png" in err
    noisy, clean = read_image("a.exr"), read_image("a.denoised.exr")
    assert noisy.attributes["rfilter"] == clean.attributes["rfilter"] == "box"
    assert "denoised" not in noisy.attributes
    assert clean.attributes["denoised"].startswith("Open Image Denoise 2.")
    assert clean.attributes["spp"] == noisy.attributes["spp"] == 16
    before, after = (measure(rgb("truth.exr"), rgb(f"a{s}.exr")) for s in ("", ".denoised"))
    assert after.relative_mse < before.relative_mse / 5
    # the noisy picture is that of a render without the flag, but for the filter
    text = (folder / "a.xml").read_text().replace('"gaussian"', '"box"')
    (folder / "box.xml").write_text(text)
    assert run("render", "box.xml", "--spp", "16", "-q") == 0
    np.testing.assert_array_equal(rgb("a.exr"), rgb("box.exr"))
    # the preview shows the clean one
    shown = read_image("a.png").stack("RGB")
    linear = np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)
    assert np.abs(linear - np.clip(rgb("a.denoised.exr"), 0, 1)).max() < 0.01

    # nothing that measures takes it
    assert run("compare", "a.denoised.exr", "truth.exr") == 2
    assert run("compare", "truth.exr", "a.denoised.exr") == 2
    assert run("merge", "a.denoised.exr", "-o", "m.exr") == 2
    assert capsys.readouterr().out.count("one that was denoised") == 2
    assert not os.path.exists("m.exr")


@pytest.mark.parametrize("channels", [None, 1, 3, 4])
def test_in_python(channels):
    pytest.importorskip("mitsuba_oidn")
    mi.set_variant(VARIANT)
    rng = np.random.default_rng(1)
    size = (64, 64) if channels is None else (64, 64, channels)
    image = (0.5 + 0.2 * rng.standard_normal(size)).astype(np.float32)
    guides = np.zeros((64, 64, 6))
    guides[..., :3], guides[..., 5] = 0.5, 1.0
    for aovs in (None, guides, {"albedo": guides[..., :3], "normal": guides[..., 3:]}):
        clean = mb.denoise(image, aovs)
        assert clean.shape == image.shape and clean.dtype == np.float32
        colour = clean if channels is None else clean[..., :3]
        assert colour.std() < 0.02 and abs(colour.mean() - 0.5) < 0.02
        if channels == 4:
            np.testing.assert_array_equal(clean[..., 3], image[..., 3])
    assert np.array_equal(mb.denoise(mi.TensorXf(image), guides), mb.denoise(image, guides))


def test_noise_of_albedo_and_normals_is_no_texture():
    pytest.importorskip("mitsuba_oidn")
    mi.set_variant(VARIANT)
    rng = np.random.default_rng(1)
    image = (0.5 + 0.2 * rng.standard_normal((64, 64, 3))).astype(np.float32)
    guides = np.zeros((64, 64, 6))
    guides[..., :3] = 0.3 + 0.05 * rng.standard_normal((64, 64, 1))
    guides[..., 3:] = [0, 0, 1] + 0.05 * rng.standard_normal((64, 64, 3))
    kept, gone = (mb.denoise(image, guides, noisy_aovs=noisy).std() for noisy in (False, True))
    # a tenth of the image's noise is left, and three times that if guides are taken for clean
    assert gone < 0.03 and gone < 0.5 * kept


@pytest.mark.parametrize(("kind", "noisy"), [("perspective", False), ("thinlens", True)])
def test_guides_of_an_aperture_are_noisy(folder, monkeypatch, kind, noisy):
    pytest.importorskip("mitsuba_oidn")
    lens = '<float name="aperture_radius" value="0.3"/><float name="focus_distance" value="4"/>'
    text = (folder / "a.xml").read_text().replace(
        '<sensor type="perspective">', f'<sensor type="{kind}">' + (lens if noisy else "")
    )  # fmt: skip
    (folder / "b.xml").write_text(text)
    told = []

    def denoised(image, aovs, *, noisy_aovs):
        told.append(noisy_aovs)
        return image

    monkeypatch.setattr("mitsuba_bezier.cli._passes.denoise", denoised)
    assert run("render", "b.xml", "--spp", "1", "--denoise", "-q") == 0
    assert told == [noisy]


@pytest.mark.parametrize(
    ("image", "aovs", "message"),
    [
        (np.zeros((4, 4, 2)), None, "image: expected shape"),
        (np.zeros(4), None, "image: expected shape"),
        (np.zeros((4, 4, 3)), np.zeros((4, 4, 3)), "aovs: expected shape (H, W, 6)"),
        (
            np.zeros((4, 4, 3)),
            {"albedo": np.zeros((4, 5, 3))},
            "aovs: albedo: expected shape (4, 4",
        ),
        (np.zeros((4, 4, 3)), {"normals": np.zeros((4, 4, 3))}, "aovs: expected the keys albedo"),
        (np.zeros((4, 4, 3)), {"normal": np.zeros((4, 4, 3))}, "aovs: expected albedo"),
    ],
)
def test_what_cannot_be_denoised(image, aovs, message):
    pytest.importorskip("mitsuba_oidn")
    with pytest.raises(mb.BezierError) as found:
        mb.denoise(image, aovs)
    assert message in str(found.value)


def test_a_broken_pixel_stays_alone():
    pytest.importorskip("mitsuba_oidn")
    image = np.full((32, 32, 3), 0.5, np.float32)
    image[5, 6] = np.nan
    clean = mb.denoise(image)
    assert np.isnan(clean[5, 6]).all() and np.count_nonzero(np.isnan(clean)) == 3
