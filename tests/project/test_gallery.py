"""The pictures of `renders/` are those of its script, small, and all there."""

from __future__ import annotations

import importlib.util
import shlex
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from mitsuba_bezier.verification.images import read_image

RENDERS = Path(__file__).resolve().parents[2] / "renders"


def script() -> ModuleType:
    spec = importlib.util.spec_from_file_location("gallery", RENDERS / "gallery.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["gallery"] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


GALLERY = script()


def test_pages_are_those_of_the_script():
    assert (RENDERS / "index.html").read_text(encoding="utf-8") == GALLERY.index()
    assert (RENDERS / "README.md").read_text(encoding="utf-8") == GALLERY.readme()


def test_every_scene_has_a_picture():
    scenes = {file.stem for file in (RENDERS.parent / "scenes").glob("*.xml")}
    assert scenes == {picture.scene for picture in GALLERY.PICTURES}


@pytest.mark.parametrize("picture", GALLERY.PICTURES, ids=lambda p: p.name)
def test_picture_and_reference_are_there(picture):
    png = read_image(RENDERS / f"{picture.name}.png")
    assert png.size == (picture.height, picture.width)
    path = RENDERS / f"{picture.name}.exr"
    exr = read_image(path)
    assert max(exr.size) == 256
    assert exr.attributes["command"] == "mitsuba-bezier " + shlex.join(picture.reference())
    assert set(exr.channels) == {"R", "G", "B"}
    values = np.stack(list(exr.channels.values()))
    assert np.isfinite(values).all() and values.max() > 0.1
    # half floats, compressed: below two bytes a channel, and the header
    assert path.stat().st_size < 6 * exr.size[0] * exr.size[1] + 4096


def test_no_file_is_large():
    large = {file.name for file in RENDERS.rglob("*") if file.stat().st_size > 1_000_000}
    assert large == set()
