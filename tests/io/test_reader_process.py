"""The process that reads a file for another has what that needs, and no more."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from mitsuba_bezier import _children

_LOOK = "import sys, mitsuba_bezier; print('mitsuba' in sys.modules, 'drjit' in sys.modules)"


@pytest.mark.parametrize(("parent", "loaded"), [(0, "False False"), (1, "True True")])
def test_a_process_that_only_reads_loads_no_mitsuba(parent: int, loaded: str) -> None:
    # the variable counts for children of the process that it names, not for theirs
    env = {**os.environ, _children.READER: str(os.getpid() + parent)}
    command = _children.python_command(_LOOK)
    said = subprocess.run(command, env=env, capture_output=True, text=True, check=True)
    assert said.stdout.strip() == loaded


def test_this_process_is_no_reader() -> None:
    assert not _children.reads()
    assert "mitsuba" in sys.modules
