"""The two commands that README.md begins with, and its example in Python, as they stand."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "README.md").read_text("utf-8")
BLOCKS = re.findall(r"^```sh\n(.*?)^```$", TEXT, re.M | re.S)


@pytest.mark.parametrize("number", [0, 1])
def test_the_first_two_blocks_have_one_line(number):
    assert BLOCKS[number].count("\n") == 1


def test_the_first_installs_and_renders_a_scene_that_is_there():
    install, render = (shlex.split(part) for part in BLOCKS[0].split("&&"))
    assert install == ["pip", "install", "."]
    assert render[:3] == ["mitsuba-bezier", "render", "scenes/quadrics.xml"]
    assert (ROOT / render[2]).is_file()


def test_the_second_installs_and_tests():
    steps = [shlex.split(part) for part in BLOCKS[1].split("&&")]
    assert steps[0] == ["pip", "install", ".[test]"]
    assert steps[-1][:3] == ["python", "-m", "pytest"]


def pixels(path: Path) -> np.ndarray:
    """Return the numbers of a picture, from 0 to 1."""
    import mitsuba as mi

    return np.array(mi.Bitmap(str(path)))[..., :3] / 255.0


def test_the_example_makes_the_picture_that_is_shown(tmp_path, monkeypatch):
    (code,) = re.findall(r"^```python\n(.*?)^```$", TEXT, re.M | re.S)
    assert 12 <= sum(bool(line.strip()) for line in code.splitlines()) <= 24
    # smaller, and one pass
    small = code.replace('"width": 1600, "height": 800', '"width": 100, "height": 50')
    small = small.replace("range(12)) / 12", "range(1)) / 1")
    assert small.count("100") == 1 and "range(1)" in small
    monkeypatch.chdir(tmp_path)
    exec(compile(small, "README.md", "exec"), {"__name__": "readme"})
    (name,) = (path.name for path in tmp_path.iterdir())
    image = pixels(tmp_path / name)
    assert image.shape == (50, 100, 3)
    # a constant picture has 0; this one has 0.17, 0.12 and 0.10
    assert image.std(axis=(0, 1)).min() > 0.05 and 0.2 < image.mean() < 0.8
    shown = pixels(ROOT / "renders" / name)
    assert f"](renders/{name})" in TEXT and shown.shape[1] == 2 * shown.shape[0]
    # the mean of pixels is taken after the curve of sRGB here, and 32 samples are noisy
    step = shown.shape[0] // 50
    mean = shown[: 50 * step, : 100 * step].reshape(50, step, 100, step, 3).mean(axis=(1, 3))
    assert np.abs(mean - image).mean() < 0.03
