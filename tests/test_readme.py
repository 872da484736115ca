"""The two commands that README.md begins with, which CI and new users run as they stand."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
BLOCKS = re.findall(r"^```sh\n(.*?)^```$", (ROOT / "README.md").read_text("utf-8"), re.M | re.S)


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
