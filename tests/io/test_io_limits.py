"""Every suffix through every door, and what readers may take: time, memory, kinds of files."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from format_cases import FILES, FLAT, written

import mitsuba_bezier as mb
from mitsuba_bezier import io
from mitsuba_bezier.cli.main import main
from mitsuba_bezier.errors import FileFormatError
from mitsuba_bezier.io import isolated, limits


def command(*words: object, **options) -> subprocess.CompletedProcess[str]:
    """Run ``mitsuba-bezier`` in a process of its own."""
    code = "import sys; from mitsuba_bezier.cli.main import main; sys.exit(main())"
    return subprocess.run(
        [sys.executable, "-c", code, *map(str, words)],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
        **options,
    )


def test_every_suffix_has_a_file_here():
    assert sorted(FILES) == io.known_suffixes()[0]


@pytest.mark.parametrize("suffix", sorted(FILES))
def test_every_suffix_through_every_door(tmp_path, suffix):
    """Python, ``info`` and ``convert`` in processes of their own: the same patches."""
    path = written(tmp_path, suffix)
    patches = mb.load(path)
    expected = FILES[suffix][1]
    if expected is not None:
        # 1e-6: what numerical areas promise
        expected = FLAT if expected == "flat" else expected
        assert float(np.sum(patches.area())) == pytest.approx(expected, rel=1e-6)
    done = command("info", path)
    assert (done.returncode, done.stderr) == (0, "")
    for group in io.read(path, trims=True).groups:
        assert f"patches     {len(group)} of degree {group.degree}" in done.stdout
    out = tmp_path / "out.vtu"
    done = command("convert", path, out, "--elevate")
    assert done.returncode == 0, done.stderr
    # .vtu holds every number exactly; a quotient and a product may round the last bit
    again = mb.load(out)
    np.testing.assert_allclose(again.control_points, patches.control_points, rtol=1e-14, atol=1e-14)


# ---------------------------------------------------------------------------- time and memory

#: Makes the reader of CAD files, in the process of its own, do something else.
BROKEN = """
from mitsuba_bezier.io.cad import opencascade as cad
def read_here(path, trims):
    {}
cad.read_here = read_here
cad.import_library = lambda: None
"""
#: Makes a process start such readers.
START_BROKEN = """
from mitsuba_bezier.io import isolated
command = isolated.python_command
isolated.python_command = lambda code, *words: command({!r} + code, *words)
"""


@pytest.fixture
def broken(tmp_path, monkeypatch):
    """Return a function that makes the reader of .step files do something else."""

    def make(code: str) -> Path:
        start, broken = isolated.python_command, BROKEN.format(code)
        monkeypatch.setattr(isolated, "python_command", lambda c, *w: start(broken + c, *w))
        path = tmp_path / "a.step"
        path.write_bytes(b"ISO-10303-21;")
        return path

    return make


def test_time_is_that_of_the_processor(broken, monkeypatch):
    """A reader that waits is not late; one that computes is, and the message says what to do."""
    path = broken("while True: pass")
    monkeypatch.setenv("MITSUBA_BEZIER_READ_SECONDS", "0.5")
    words = r"in 0.5 s of processor time \(--read-seconds or MITSUBA_BEZIER_READ_SECONDS"
    with pytest.raises(FileFormatError, match=words):
        io.load(path)


def test_waiting_takes_no_time(broken):
    path = broken("import time; time.sleep(4); raise RuntimeError('at its end')")
    with limits.chosen(seconds=0.5), pytest.raises(FileFormatError, match="at its end"):
        io.load(path)


def test_memory_has_a_limit_that_the_message_names(broken):
    path = broken("x = bytearray(300 << 20); raise RuntimeError('at its end')")
    with pytest.raises(FileFormatError, match="at its end"):
        io.load(path)
    words = r"in 0.25 GiB of memory \(--read-memory or MITSUBA_BEZIER_READ_MEMORY sets"
    with limits.chosen(memory=0.25), pytest.raises(FileFormatError, match=words):
        io.load(path)


def test_limits_grow_with_the_file():
    assert limits.seconds_limit(10**6) == pytest.approx(110)
    assert limits.memory_limit(1 << 20) == 768 << 20
    with limits.chosen(3, 2):
        assert (limits.seconds_limit(10**9), limits.memory_limit(10**9)) == (3, 2 << 30)
    assert limits.seconds_limit(0) == 10


@pytest.mark.parametrize("value", ["0", "-1", "much", "nan", "inf", "1e400"])
def test_bad_limits_are_told(tmp_path, monkeypatch, value):
    monkeypatch.setenv("MITSUBA_BEZIER_READ_SECONDS", value)
    path = tmp_path / "a.step"
    path.write_bytes(b"ISO-10303-21;")
    with pytest.raises(FileFormatError, match="MITSUBA_BEZIER_READ_SECONDS: expected a number"):
        io.load(path)
    done = command("info", path, "--read-memory", value)
    assert done.returncode == 2
    assert "--read-memory: expected a number above 0" in done.stderr


def test_flags_reach_the_reader(broken, monkeypatch, capsys):
    """A flag wins against the variable."""
    path = broken("while True: pass")
    monkeypatch.setenv("MITSUBA_BEZIER_READ_SECONDS", "1000")
    assert main(["info", str(path), "--read-seconds", "0.5"]) == 2
    text = capsys.readouterr().err
    assert text.startswith("mitsuba-bezier: error: ") and text.count("\n") == 1
    assert "in 0.5 s of processor time" in text


def test_an_idle_reader_is_given_up(broken, monkeypatch):
    monkeypatch.setattr(isolated, "IDLE_LIMIT", 1.5)
    path = broken("import time; time.sleep(100)")
    with pytest.raises(FileFormatError, match="not idle for"):
        io.load(path)


def alive(process: int) -> bool:
    """Whether a process runs; one that is dead may not be looked for yet by who inherits it."""
    try:
        stat = Path(f"/proc/{process}/stat").read_text()
    except OSError:  # between two looks
        return False
    return stat.rpartition(")")[2].split()[0] not in ("Z", "X")


@pytest.mark.skipif(sys.platform != "linux", reason="looks for processes in /proc")
@pytest.mark.parametrize("how", ["SIGKILL", "SIGTERM", "SIGINT"])
def test_a_reader_ends_with_its_parent(how, tmp_path):
    """Even where the library never comes back to Python: it holds the lock of the interpreter."""
    pid_file = tmp_path / "pid"
    path = tmp_path / "a.step"
    path.write_bytes(b"ISO-10303-21;")
    stuck = (
        f"import os, ctypes; open({str(pid_file)!r}, 'w').write(str(os.getpid())); "
        "ctypes.PyDLL(None).sleep(1000)"
    )
    code = START_BROKEN.format(BROKEN.format(stuck))
    code += "import sys; from mitsuba_bezier import io; io.read(sys.argv[1])"
    words = [sys.executable, "-c", code, str(path)]
    parent = subprocess.Popen(words, stderr=subprocess.DEVNULL)
    try:
        deadline = time.monotonic() + 300
        while not (pid_file.exists() and pid_file.read_text()) and time.monotonic() < deadline:
            time.sleep(0.05)
        child = int(pid_file.read_text())
        parent.send_signal(getattr(signal, how))
        parent.wait(300)
        # by itself the reader would sleep for three times as long
        while alive(child):
            assert time.monotonic() < deadline
            time.sleep(0.05)
    finally:
        parent.kill()


# ---------------------------------------------------------------------------- what is no file


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
@pytest.mark.parametrize("suffix", sorted(FILES))
def test_only_regular_files_are_read(tmp_path, suffix):
    """A pipe that nobody writes to would hang, a device never end."""
    pipe, folder, server = (tmp_path / f"{n}{suffix}" for n in ("pipe", "folder", "socket"))
    os.mkfifo(pipe)
    folder.mkdir()
    device = tmp_path / f"zero{suffix}"
    device.symlink_to("/dev/zero")
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(server))
        for path, kind in ((pipe, "a named pipe"), (folder, "a folder"), (device, "a device")):
            with pytest.raises(FileFormatError, match=f"which is {kind}"):
                io.read(path)
        with pytest.raises(FileFormatError, match="expected a file that can be read"):
            io.read(server)
