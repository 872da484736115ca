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
from mitsuba_bezier.cli import _plugins, doctor, main
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


# ---------------------------------------------------------------- scenes

COMMAND = "import sys; from mitsuba_bezier.cli.main import main; sys.exit(main(sys.argv[1:]))"


def scene(more: str = "", first: str = "") -> str:
    """Return the XML of a small scene."""
    return f"""<scene version="3.0.0">{first}
      <sensor type="perspective">
        <transform name="to_world"><lookat origin="0,-5,0" target="0,0,0" up="0,0,1"/></transform>
        <film type="hdrfilm">
          <integer name="width" value="8"/><integer name="height" value="8"/>
        </film>
      </sensor>
      <emitter type="constant"/>
      <shape type="beziertriangle"><string name="filename" value="ball.vtu"/></shape>
      {more}
    </scene>"""


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    """Return a folder with a model, and work beside it."""
    (tmp_path / "scene").mkdir()
    (tmp_path / "here").mkdir()
    mb.sphere().save(tmp_path / "scene/ball.vtu")
    monkeypatch.chdir(tmp_path / "here")
    return tmp_path / "scene"


def plant(folder: Path, *names: str) -> None:
    """Write libraries that end in an error if somebody loads them."""
    (folder / "plugins").mkdir(parents=True, exist_ok=True)
    for name in names:
        for suffix in (".so", ".dylib", ".dll"):
            (folder / f"plugins/{name}{suffix}").write_text("no library")


NOT_IN_PLACE = sentence(
    "No library that lies there is loaded by `mitsuba-bezier` in place of a plugin of Mitsuba or "
    "of this package."
)


@NOT_IN_PLACE
@pytest.mark.parametrize("words", [("render", "s.xml", "--spp", "1"), ("verify", "ellipsoid")])
def test_libraries_under_known_names(folder, python, words):
    import mitsuba as mi

    own = _plugins._own(_plugins._root(mi))
    assert {"diffuse", "sphere", "hdrfilm", "gaussian"} < own
    names = (*own, *_plugins._REGISTERED)
    plant(folder, *names)
    plant(Path(), *names)
    plant(folder / "more", *names)
    (folder / "s.xml").write_text(scene(first='<path value="more"/>'))
    if words[0] == "render":
        words = ("render", str(folder / "s.xml"), *words[2:])
    else:
        words = (*words, "--resolution", "16")
    done = python(COMMAND, None, *words)
    assert done.returncode == 0, done.stderr


@NOT_IN_PLACE
def test_names_registered_from_python_are_all_known():
    from mitsuba_bezier import plugins

    for name in _plugins._REGISTERED:
        assert plugins._maker(name)
    source = Path(plugins.__file__).read_text("utf-8")
    assert set(re.findall(r"^        \"(\w+)\": make_", source, re.M)) == set(_plugins._REGISTERED)


REFUSED = sentence(
    "A scene that asks for another plugin, of which there is a library, is refused unless "
    "`--allow-plugins` is given."
)


@REFUSED
@pytest.mark.parametrize(
    ("place", "more", "first"),
    [
        ("scene", '<bsdf type="foreign"/>', ""),
        ("here", '<bsdf type="foreign"/>', ""),
        ("scene/more", '<bsdf type="foreign"/>', '<path value="more"/>'),
        ("scene", '<bsdf type="$kind"/>', '<default name="kind" value="foreign"/>'),
        ("scene", '<include filename="part.xml"/>', ""),
        ("scene", '<integrator type="foreign"/>', ""),
        ("scene", '<shape type="sphere"><emitter type="foreign"/></shape>', ""),
    ],
)
def test_libraries_under_other_names(folder, capsys, place, more, first):
    plant(folder.parent / place, "foreign")
    (folder / "part.xml").write_text('<scene version="3.0.0"><bsdf type="foreign"/></scene>')
    path = folder / "s.xml"
    path.write_text(scene(more, first))
    assert main.main(["render", str(path), "--spp", "1"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "plugins/foreign" in error
    assert "--allow-plugins" in error
    assert main.main(["render", str(path), "--spp", "1", "--allow-plugins"]) == 2
    if "integrator" not in more:  # that one is refused for another reason before
        error = capsys.readouterr().err
        assert "plugin" in error and "--allow-plugins" not in error  # it was tried


@sentence("A scene that names a plugin by a path is refused.")
@pytest.mark.parametrize("name", ["../plugins/diffuse", "/tmp/x", "a/b", "..\\x"])
def test_plugins_named_by_a_path(folder, capsys, name):
    path = folder / "s.xml"
    path.write_text(scene(f'<bsdf type="{name}"/>'))
    assert main.main(["render", str(path), "--spp", "1"]) == 2
    assert f"plugins named by words, got {path}: the path {name!r}" in capsys.readouterr().err


@sentence(
    "A scene can read every file that you can read: as a model, as a texture, as a part of itself."
)
def test_scenes_read_other_files(folder):
    outside = folder.parent / "outside"
    outside.mkdir()
    (folder / "ball.vtu").rename(outside / "ball.vtu")
    path = folder / "s.xml"
    path.write_text(scene().replace("ball.vtu", f"{outside}/ball.vtu"))
    assert main.main(["render", str(path), "--spp", "1", "-q"]) == 0
    (outside / "part.xml").write_text('<scene version="3.0.0"><bsdf type="diffuse"/></scene>')
    texture = f"""<bsdf type="diffuse"><texture type="bitmap" name="reflectance">
        <string name="filename" value="{folder}/s.png"/></texture></bsdf>
        <include filename="../outside/part.xml"/>"""
    path.write_text(scene(texture).replace("ball.vtu", "../outside/ball.vtu"))
    assert main.main(["render", str(path), "--spp", "1", "-q"]) == 0


@sentence(
    "A scene names no file to be written: `mitsuba-bezier render` writes its EXR and PNG only."
)
def test_scenes_write_nothing_else(folder):
    path = folder / "s.xml"
    path.write_text(scene())
    before = set(folder.parent.rglob("*"))
    assert main.main(["render", str(path), "--spp", "1", "-q"]) == 0
    assert set(folder.parent.rglob("*")) - before == {folder / "s.exr", folder / "s.png"}
