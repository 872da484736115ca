"""Signals at chosen moments, from the first import to the last step of writing a file."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import mitsuba_bezier as mb
from mitsuba_bezier.verification.images import read_image, write_exr

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")

ROOT = Path(mb.__file__).parents[1]

# the program, with a hook that sends it a signal at a step of Python's that it will take
PROGRAM = """
import os, sys
sys.path.insert(0, {root!r})
event, word, number = {event!r}, {word!r}, {number}
def hook(name, args):
    found = str(args[0]) if args else ""
    if name == event and (word in found if len(word) > 1 else word == found) and not done:
        done.append(1)
        os.kill(os.getpid(), number)
done = []
sys.addaudithook(hook)
sys.argv[0] = "mitsuba-bezier"
from mitsuba_bezier.cli.main import main
sys.exit(main())
"""
MOMENTS = {
    "first import": ("import", "errors"),
    "NumPy": ("import", "numpy.linalg"),
    "Dr.Jit": ("import", "drjit"),
    "Mitsuba": ("import", "mitsuba_ext"),
    "OpenEXR": ("import", "OpenEXR"),
    "a new file": ("open", ".tmp"),
    "its renaming": ("os.rename", ".tmp"),
}


def start(folder: Path, event: str, word: str, number: int, *words: str) -> subprocess.Popen:
    temporary = folder / "temporary"
    temporary.mkdir(exist_ok=True)
    code = PROGRAM.format(root=str(ROOT), event=event, word=word, number=int(number))
    return subprocess.Popen(
        [sys.executable, "-c", code, *words],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, "TMPDIR": str(temporary)},
        text=True,
        start_new_session=True,
    )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for k, name in enumerate(("a", "b")):
        pixels = {"R": np.full((4, 5), k, np.float32)}
        write_exr(tmp_path / f"{name}.exr", pixels, {"spp": 1, "seed": k})
    (tmp_path / "out.exr").write_bytes(b"old")
    return tmp_path


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
@pytest.mark.parametrize("moment", MOMENTS)
def test_a_signal_ends_the_command_in_one_line(folder, moment, name):
    number = getattr(signal, name)
    before = sorted(os.listdir(folder))
    process = start(folder, *MOMENTS[moment], number, "merge", "a.exr", "b.exr", "-o", "out.exr")
    _out, err = process.communicate(timeout=300)
    assert process.returncode == 128 + number, err
    words = {"SIGINT": "interrupted", "SIGTERM": "terminated", "SIGHUP": "terminal closed"}
    assert err.startswith(f"mitsuba-bezier: {words[name]}") and err.count("\n") == 1
    assert "written" not in err or "no file was written" in err
    assert (folder / "out.exr").read_bytes() == b"old"
    assert sorted(os.listdir(folder)) == sorted([*before, "temporary"])
    assert os.listdir(folder / "temporary") == []


def test_a_signal_after_the_file_is_there(folder):
    """The folder is brought to the disk last: the new file is whole by then."""
    words = ("merge", "a.exr", "b.exr", "-o", "out.exr")
    process = start(folder, "open", ".", signal.SIGTERM, *words)
    _out, err = process.communicate(timeout=300)
    assert process.returncode == 143 and err == "mitsuba-bezier: terminated\n"
    assert read_image(folder / "out.exr").attributes["spp"] == 2
    assert not [name for name in os.listdir(folder) if name.endswith(".tmp")]


def test_a_folder_for_a_child_and_the_child_end_too(folder):
    """As of `info`, which reads a STEP file in a second Python."""
    code = """
import os, signal, subprocess, sys, threading
sys.path.insert(0, {root!r})
sys.argv[0] = "mitsuba-bezier"
from mitsuba_bezier import _signals
_signals.begin()
from mitsuba_bezier import _files
with _files.temporary_folder() as folder:
    code = "import time; print(flush=True); time.sleep(600)"
    child = subprocess.Popen([sys.executable, "-c", code])
    print(os.path.isdir(folder), flush=True)
    child.wait()
"""
    temporary = folder / "temporary"
    temporary.mkdir()
    process = subprocess.Popen(
        [sys.executable, "-c", code.format(root=str(ROOT))],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, "TMPDIR": str(temporary)},
        text=True,
        start_new_session=True,
    )
    lines = {process.stdout.readline(), process.stdout.readline()} - {"\n"}
    assert lines.pop() == "True\n" and len(os.listdir(temporary)) == 1
    process.send_signal(signal.SIGTERM)
    _out, err = process.communicate(timeout=300)  # it ends when the child has, too
    assert process.returncode == 143 and err.count("\n") == 1
    assert os.listdir(temporary) == []


def test_who_imports_the_package_keeps_the_signals():
    code = f"""
import signal, sys
sys.path.insert(0, {str(ROOT)!r})
before = [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)]
import mitsuba_bezier
from mitsuba_bezier.cli.main import main
main(["info", "nowhere.vtu"])
assert before == [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)]
"""
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)
