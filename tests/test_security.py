"""What untrusted files can and cannot do: a test for each sentence of docs/security.md."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import mitsuba_bezier as mb
from mitsuba_bezier import _children, _llvm
from mitsuba_bezier.cli import doctor
from mitsuba_bezier.errors import FileFormatError

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs/security.md"

tested: set[str] = set()


def sentence(text: str) -> Callable[[Callable], Callable]:
    """Name the sentence of the page that a test is about."""
    tested.add(text)
    return lambda test: test


def sentences() -> list[str]:
    """Return the items of the page's lists, each on one line."""
    items = re.findall(r"^\* (.*(?:\n  .*)*)", PAGE.read_text("utf-8"), re.M)
    return [" ".join(item.split()) for item in items]


def test_each_sentence_of_the_page_has_a_test_and_stands_there():
    assert sorted(sentences()) == sorted(tested)


# ---------------------------------------------------------------- folders

# what the package and its processes import, and what Python imports by itself when it starts
MODULES = (
    *("numpy", "mitsuba", "drjit", "OpenEXR", "rich", "meshio"),
    *("rhino3dm", "sitecustomize", "usercustomize", "typing", "subprocess", "ctypes"),
    *("platform", "json", "tempfile", "argparse", "dataclasses", "signal"),
    *("pathlib", "zlib", "lzma", "shutil", "secrets", "glob"),
)
PACKAGES = ("OCP", "encodings", "concurrent", "mitsuba_bezier")
PROGRAMS = ("ldconfig", "nvidia-smi", "uname", "gcc", "sh", "git", "python", "chromium")


@pytest.fixture
def trap(tmp_path, monkeypatch) -> Path:
    """Work in a folder full of code; whatever of it runs leaves the file ``RAN`` there."""
    ran = tmp_path / "RAN"
    code = f"open({str(ran)!r}, 'a').write(__name__ + ' ')\n"
    for name in MODULES:
        (tmp_path / f"{name}.py").write_text(code)
    for name in PACKAGES:
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text(code)
    for name in PROGRAMS:
        (tmp_path / name).write_text(f"#!/bin/sh\necho {name} >> {ran}\n")
        (tmp_path / name).chmod(0o755)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", f".:{os.environ['PATH']}:")
    return ran


NOT_RUN = sentence(
    "Python code in the current folder or beside a model is not run by `mitsuba-bezier`, nor by "
    "the processes that it starts."
)


@NOT_RUN
@pytest.mark.parametrize("suffix", ["step", "3dm", "inp"])
def test_readers_in_processes_of_their_own(trap, suffix):
    Path(f"model.{suffix}").write_text("no model")
    with pytest.raises(FileFormatError, match="expected"):
        mb.load(f"model.{suffix}")
    assert not trap.exists(), trap.read_text()


@NOT_RUN
def test_trials_of_variants(trap):
    assert doctor._try("llvm_ad_rgb", 120.0) == "works"
    assert not trap.exists(), trap.read_text()


@NOT_RUN
def test_only_one_module_starts_a_python():
    # all others ask it, so that none forgets the current folder
    package = Path(mb.__file__).parent
    users = [path.name for path in package.rglob("*.py") if "sys.executable" in path.read_text()]
    assert users == ["_children.py"]


@NOT_RUN
@pytest.mark.parametrize("first", ["", "."])
def test_a_second_python_imports_what_this_one_can(trap, monkeypatch, first, tmp_path):
    # the package from wherever this process has it, and folders named by the user
    (tmp_path / "named").mkdir()
    (tmp_path / "named/extra_module.py").write_text("value = 7")
    monkeypatch.setattr(sys, "path", [first, str(tmp_path), str(tmp_path / "named"), *sys.path])
    code = "import sys, extra_module, mitsuba_bezier as m; print(extra_module.value, m.__file__)"
    done = subprocess.run(
        _children.python_command(f"{code}; print(sys.argv[1:])", "a b", "ü"),
        capture_output=True,
        encoding="utf-8",
        env={**os.environ, "PYTHONIOENCODING": "utf-8", "PYTHONUTF8": "1"},
    )
    assert done.stdout.splitlines()[0] == f"7 {mb.__file__}", done.stderr
    assert not trap.exists(), trap.read_text()


@sentence(
    "`python -m mitsuba_bezier.cli.main` imports numpy, Mitsuba and all other packages from where "
    "they are installed, although Python itself looks into the current folder first."
)
@pytest.mark.parametrize("option", ["-m", "-Bm"])
def test_run_as_a_module(trap, option):
    for name in ("mitsuba_bezier", "encodings"):
        Path(name, "__init__.py").unlink()
        Path(name).rmdir()
    mb.sphere().save("ball.vtu")
    done = subprocess.run(
        [sys.executable, option, "mitsuba_bezier.cli.main", "info", "ball.vtu"],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(Path(mb.__file__).parents[1])},
    )
    assert done.returncode == 0, done.stderr
    assert "patches" in done.stdout
    assert not trap.exists(), trap.read_text()


PROGRAMS_NOT_RUN = sentence(
    'Programs in the current folder are not run, even where the PATH names it by "." or an empty '
    "entry."
)


@PROGRAMS_NOT_RUN
@pytest.mark.parametrize("path", [".", "", ":", ".:/nowhere:", "./:sub/..", "..:."])
def test_programs_are_looked_for_in_absolute_folders(trap, monkeypatch, path):
    monkeypatch.setenv("PATH", path)
    assert [_children.program(name) for name in PROGRAMS] == [None] * len(PROGRAMS)


@PROGRAMS_NOT_RUN
def test_programs_of_absolute_folders_are_found(tmp_path, monkeypatch):
    for name, mode in (("tool", 0o755), ("text", 0o644)):
        (tmp_path / name).write_text("#!/bin/sh\n")
        (tmp_path / name).chmod(mode)
    monkeypatch.setenv("PATH", f".:{tmp_path}")
    assert _children.program("tool") == str(tmp_path / "tool")
    assert _children.program("text") is None


@PROGRAMS_NOT_RUN
def test_the_search_for_llvm_and_gpus(trap, monkeypatch):
    monkeypatch.setenv("PATH", ".")
    _llvm.find()
    monkeypatch.setattr("drjit.has_backend", lambda _backend: True)
    assert "NVIDIA GPU" in str(doctor._gpu())
    assert not trap.exists(), trap.read_text()


@sentence(
    "Libraries in the current folder are not loaded, even where `DRJIT_LIBLLVM_PATH` is a bare "
    "name."
)
def test_a_bare_name_of_llvm(tmp_path, monkeypatch):
    folder = tmp_path / "x86_64-unknown-linux-gnu"
    folder.mkdir()
    for name in ("libunwind.so.1.0", "libc++abi.so.1.0", "libc++.so.1.0"):
        (folder / name).touch()
    monkeypatch.chdir(tmp_path)
    loaded: list[str] = []
    monkeypatch.setattr(_llvm.ctypes, "CDLL", loaded.append)
    _llvm.preload("libLLVM.so")
    _llvm.preload("./libLLVM.so")
    assert loaded == []
    _llvm.preload(str(tmp_path / "libLLVM.so"))
    assert len(loaded) == 3
