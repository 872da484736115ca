"""``mitsuba-bezier render MODEL``: every format that can be read, from file to picture."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from cli_cases import render
from format_cases import FILES, written

import mitsuba_bezier as mb

SMALL = ("--size", "48x36", "--spp", "16")


def picture(path: Path | str) -> np.ndarray:
    import mitsuba as mi

    return np.array(mi.Bitmap(str(path))) / 255.0


def shown(image: np.ndarray) -> np.ndarray:
    """Return a mask of pixels that are not white."""
    return image[..., :3].min(axis=-1) < 0.9


@pytest.mark.parametrize("suffix", sorted(FILES))
def test_every_format_becomes_a_picture_that_is_not_empty(suffix, tmp_path, capsys):
    if suffix == ".3dm":
        pytest.importorskip("rhino3dm")
    if suffix in (".brep", ".iges", ".igs", ".step", ".stp"):
        pytest.importorskip("OCP")
    if suffix in (".bdf", ".inp", ".mesh", ".nas"):
        pytest.importorskip("meshio")
    path = written(tmp_path, suffix)
    assert render(path, "--no-ground", *SMALL) == 0
    assert "128 spp" not in capsys.readouterr().err
    image = picture(tmp_path / "model.png")
    seen = shown(image)
    assert image.shape == (36, 48, 3) and np.isfinite(image).all()
    # framed: the model reaches near to two opposite sides, and is cut by none
    rows, columns = np.flatnonzero(seen.any(axis=1)), np.flatnonzero(seen.any(axis=0))
    assert rows[0] >= 1 and rows[-1] <= 34 and columns[0] >= 1 and columns[-1] <= 46
    assert rows[-1] - rows[0] >= 28 or columns[-1] - columns[0] >= 38
    # neither black nor white
    assert 0.05 < image[seen].mean() < 0.85


@pytest.fixture
def folder(tmp_path, monkeypatch):
    mb.save(mb.torus((0, 0, 1), 2, tube=0.7), tmp_path / "ring.vtu")
    mb.save(mb.sphere((0, 0, 1)), tmp_path / "ball.vtu")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_scene_that_is_written_gives_the_same_picture(folder, capsys):
    options = (*SMALL, "--material", "ball=matte:#ff0000", "--view", "30,20", "--light", "sky")
    assert render("ring.vtu", "ball.vtu", *options, "-o", "one.exr", "--scene", "s.xml") == 0
    assert "wrote s.xml and 3 files beside it" in capsys.readouterr().err
    assert render("s.xml", "-o", "two.exr", "-q") == 0
    one, two = (mb_image(name) for name in ("one.exr", "two.exr"))
    # the light is written in half or full floats: equal seeds give equal samples of it
    assert np.abs(one - two).max() < 2e-3 * one.max()
    red = (one[0] > 0.05) & (one[0] > 5 * one[2])
    assert red.any() and not red.all()


def mb_image(path: str) -> np.ndarray:
    from mitsuba_bezier.verification.images import read_image

    image = read_image(Path(path))
    return np.stack([np.asarray(image.channels[c], dtype=np.float64) for c in "RGB"])


def test_a_scene_only_is_written_without_rendering(folder):
    assert render("ball.vtu", "--scene", "s.xml") == 0
    assert sorted(os.listdir()) == [
        "ball.vtu",
        "ring.vtu",
        "s-light.exr",
        "s-part-ball.vtu",
        "s.xml",
    ]


def test_transparent_and_coloured_backgrounds(folder):
    assert render("ball.vtu", *SMALL, "-q", "--background", "transparent") == 0
    image = picture("ball.png")
    assert image.shape == (36, 48, 4)
    assert image[0, 0, 3] == 0 and image[18, 24, 3] == 1
    assert render("ball.vtu", *SMALL, "-q", "--background", "#336699", "--no-ground") == 0
    assert np.allclose(picture("ball.png")[0, 0] * 255, [0x33, 0x66, 0x99], atol=1)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["ball.vtu", "--view", "frnt"], "did you mean 'front'"),
        (["ball.vtu", "--only", "bal"], "did you mean 'ball'"),
        (["ball.vtu", "--hide", "ball"], "at least one part that is shown"),
        (["ball.vtu", "--size", "12"], "WIDTHxHEIGHT"),
        (["ball.vtu", "--material", "gold"], "PART=MATERIAL"),
        (["ball.vtu", "-D", "a=b"], "--define"),
        (["ball.vtu", "no.vtu"], "no.vtu"),
        (["ball.vtu", "--scene", "s.txt"], "ends in .xml"),
        (["flat.vtu"], "no area"),
        (["plane.vtu"], "reach infinity"),
        (["scene.xml", "--view", "iso"], "--view: expected a model"),
        (["scene.xml", "ball.vtu"], "one scene, or several models"),
    ],
)
def test_what_cannot_be_is_one_line(folder, capsys, words, message):
    mb.save(mb.plane(), "plane.vtu")
    mb.save(mb.BezierTriangles([[[0, 0, 0, 1.0], [1, 0, 0, 1], [3, 0, 0, 1]]]), "flat.vtu")
    Path("scene.xml").write_text("<scene version='3.0.0'/>")
    assert render(*words) == 2
    err = capsys.readouterr().err.strip().splitlines()
    assert message in err[-1] and err[-1].startswith("mitsuba-bezier: error: ")
    assert sum(line.startswith("mitsuba-bezier: error") for line in err) == 1
    assert not [name for name in os.listdir() if name.endswith((".exr", ".png"))]


def test_a_model_is_denoised(folder):
    pytest.importorskip("mitsuba_oidn")
    assert render("ring.vtu", "--denoise", *SMALL) == 0
    assert (folder / "ring.denoised.exr").is_file()
