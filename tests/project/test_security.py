"""What untrusted files can and cannot do: a test for each sentence of docs/security.md."""

from __future__ import annotations

import hashlib
import json
import os
import pickle
import re
import struct
import subprocess
import sys
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import mitsuba_bezier as mb
from mitsuba_bezier import _children, _files, _llvm
from mitsuba_bezier.cli import _plugins, _streams, doctor, main
from mitsuba_bezier.errors import FileFormatError
from mitsuba_bezier.io import isolated, limits
from mitsuba_bezier.plugins import PLUGINS
from mitsuba_bezier.verification import image_size
from mitsuba_bezier.verification.images import read_image, write_exr
from mitsuba_bezier.verification.thresholds import Thresholds

ROOT = Path(__file__).parents[2]
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
    *("numpy", "mitsuba", "drjit", "OpenEXR", "rich", "shapely", "meshio"),
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
    assert doctor._try("llvm_ad_rgb", 600.0) == "works"
    assert not trap.exists(), trap.read_text()


@NOT_RUN
def test_only_one_module_starts_a_python():
    # all others ask it, so that none forgets the current folder; but bisect runs the tests of a
    # checkout there, which are code that one asks for
    package = Path(mb.__file__).parent
    users = [path.name for path in package.rglob("*.py") if "sys.executable" in path.read_text()]
    assert sorted(users) == ["_children.py", "bisect.py"]


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
    mb.save(mb.sphere(), "ball.vtu")
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


# ---------------------------------------------------------------- models


class Evil:
    """Unpickled, it leaves a file."""

    def __reduce__(self):
        return (os.mkdir, ("RAN",))


DATA = sentence(
    "A model is data: no part of it is run, and a `.npy` file of pickled objects is refused."
)


@DATA
@pytest.mark.parametrize("kind", ["array of objects", "pickle"])
def test_pickles(tmp_path, monkeypatch, kind):
    import mitsuba as mi

    if mi.variant() is None:
        mi.set_variant("llvm_ad_rgb")
    monkeypatch.chdir(tmp_path)
    if kind == "pickle":
        Path("maps.npy").write_bytes(pickle.dumps(Evil()))
    else:
        np.save("maps.npy", np.array([Evil()], dtype=object), allow_pickle=True)
    net = mi.TensorXf(mb.sphere().control_points)
    with pytest.raises(RuntimeError, match=r"instances_filename: expected a \.npy file"):
        mi.load_dict(
            {"type": "beziertriangle", "control_points": net, "instances_filename": "maps.npy"}
        )
    assert not Path("RAN").exists()


@DATA
def test_nothing_in_the_package_runs_data():
    words = r"\b(eval|exec|pickle|marshal|shelve|yaml|zipfile|tarfile|shutil\.unpack_archive)\b"
    for path in Path(mb.__file__).parent.rglob("*.py"):
        for line in path.read_text("utf-8").splitlines():
            # a suffix, whose files are read as plain rows, and words about it
            code = re.sub(r"[.]yaml\b|``.yaml``|`yaml.dump`", "", line.partition("#")[0])
            found = re.search(words, code)
            # dr.eval and methods of that name compute; NumPy is told not to unpickle
            assert not found or re.search(
                r"[.]eval\b|\"eval\"|def eval\(|_eval\b|allow_pickle=False", code
            ), line
        assert "allow_pickle=True" not in path.read_text("utf-8")


ENTITIES = sentence(
    "A `.vtu` file with a document type, whose entities could name other files or grow without "
    "bound, is refused; a scene's are not expanded."
)


@ENTITIES
@pytest.mark.parametrize("entity", ['SYSTEM "secret"', '"&b;&b;&b;"'])
def test_entities_of_models(tmp_path, entity):
    (tmp_path / "secret").write_text("0")
    path = tmp_path / "a.vtu"
    mb.save(mb.sphere(), path)
    head, _, rest = path.read_bytes().partition(b"\n")
    path.write_bytes(head + f"<!DOCTYPE VTKFile [<!ENTITY a {entity}>]>".encode() + rest)
    with pytest.raises(FileFormatError, match="expected a VTK XML file, got a DOCTYPE"):
        mb.load(path)


@ENTITIES
def test_entities_of_scenes(tmp_path, capsys):
    (tmp_path / "secret").write_text("sphere")
    path = tmp_path / "s.xml"
    doctype = '<!DOCTYPE scene [<!ENTITY a SYSTEM "secret"><!ENTITY b "sphere">]>'
    for name in "ab":
        path.write_text(f'{doctype}<scene version="3.0.0"><shape type="&{name};"/></scene>')
        assert main.main(["render", str(path)]) == 2
        assert f"&{name};" in capsys.readouterr().err


@sentence(
    "Libraries that a damaged model could crash read it in a process of its own, with limits of "
    "processor time and memory; its end is one error."
)
@pytest.mark.parametrize(
    ("code", "message"),
    [
        ("os.abort()", "its process died of SIGABRT"),
        ("os.kill(os.getpid(), 9)", "its process died of SIGKILL"),
        ("while True: pass", "in 0.5 s of processor time"),
        ("bytearray(1 << 30)", "in 0.5 GiB of memory"),
    ],
)
@pytest.mark.skipif(sys.platform == "win32", reason="signals and limits of POSIX")
def test_readers_that_crash(tmp_path, monkeypatch, code, message):
    start = isolated.python_command
    monkeypatch.setattr(
        isolated,
        "python_command",
        lambda c, *w: start(
            "import os, mitsuba_bezier.io.cad.rhino as r\n"
            f"def read_here(path, trims):\n    {code}\n"
            f"r.read_here = read_here\nr.import_library = lambda: None\n{c}",
            *w,
        ),
    )
    path = tmp_path / "a.3dm"
    path.write_bytes(b"3D Geometry File Format ")
    with limits.chosen(seconds=0.5, memory=0.5), pytest.raises(FileFormatError, match=message):
        mb.load(path)


@sentence("A model that is a pipe, a device or a socket is refused, not waited for.")
@pytest.mark.skipif(sys.platform == "win32", reason="pipes of POSIX")
@pytest.mark.parametrize("suffix", ["vtu", "obj", "step", "inp"])
def test_pipes(tmp_path, suffix):
    os.mkfifo(tmp_path / f"a.{suffix}")
    with pytest.raises(FileFormatError, match="which is a named pipe"):
        mb.load(tmp_path / f"a.{suffix}")
    (tmp_path / f"b.{suffix}").symlink_to("/dev/zero")
    with pytest.raises(FileFormatError, match="which is a device"):
        mb.load(tmp_path / f"b.{suffix}")


@sentence(
    "Only a `.pvtu` file names others, its pieces, which are refused unless they are in its folder "
    "or below."
)
@pytest.mark.parametrize("where", ["../piece.vtu", "/{}/piece.vtu", "sub/../../piece.vtu"])
def test_pieces_of_other_folders(tmp_path, where):
    mb.save(mb.sphere(), tmp_path / "piece.vtu")
    (tmp_path / "inner" / "sub").mkdir(parents=True)
    path = tmp_path / "inner" / "a.pvtu"
    text = (
        '<VTKFile type="PUnstructuredGrid" version="1.0"><PUnstructuredGrid>'
        '<Piece Source="{}"/></PUnstructuredGrid></VTKFile>'
    )
    path.write_text(text.format(where.format(tmp_path)))
    with pytest.raises(FileFormatError, match="a Source in the folder of the file, or below"):
        mb.load(path)
    mb.save(mb.sphere(), tmp_path / "inner" / "sub" / "piece.vtu")
    path.write_text(text.format("sub/piece.vtu"))
    assert len(mb.load(path)) == 8


@sentence("A model is read from one file: what it includes or refers to is not read.")
@pytest.mark.filterwarnings("ignore::mitsuba_bezier.io.FormatWarning")
@pytest.mark.skipif(sys.platform == "win32", reason="pipes of POSIX")
@pytest.mark.parametrize("suffix", ["inp", "bdf", "obj"])
def test_includes(tmp_path, suffix):
    own = {
        "inp": "*NODE\n1, 0, 0, 0\n2, 1, 0, 0\n3, 0, 1, 0\n*ELEMENT, TYPE=S3\n1, 1, 2, 3\n",
        "bdf": "BEGIN BULK\nGRID,1,,0.,0.,0.\nGRID,2,,1.,0.,0.\nGRID,3,,0.,1.,0.\n"
        "CTRIA3,1,1,1,2,3\n",
        "obj": "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\ncstype bezier\ndeg 1 1\n"
        "surf 0 1 0 1 1 2 3 4\nparm u 0 1\nparm v 0 1\nend\n",
    }[suffix]
    if suffix != "obj":
        pytest.importorskip("meshio")
    include = {
        "inp": "*INCLUDE, INPUT={}\n",
        "bdf": "INCLUDE '{}'\n",
        "obj": "mtllib {0}\ncall {0}\n",
    }
    other = tmp_path / f"other.{suffix}"
    other.write_text(own)
    path = tmp_path / f"a.{suffix}"
    path.write_text(own)
    alone = mb.load(path)
    path.write_text(own + include.get(suffix, "mtllib {0}\ncall {0}\n").format(other))
    assert mb.load(path) == alone
    other.unlink()
    os.mkfifo(other)  # who opens it waits for ever
    assert mb.load(path) == alone


ESCAPES = sentence(
    "Control characters in names and text of a file are printed as escapes, so a terminal does not "
    "obey them."
)
BELL = "\x1b]0;title\x07"


@ESCAPES
def test_printable():
    assert _streams.printable("Bézier 7 × 3, a b") == "Bézier 7 × 3, a b"
    odd = "\x1b[2J\r\n\t\x9b\u202e\udcff"
    assert _streams.printable(odd) == r"\x1b[2J\r\n\t\x9b\u202e\udcff"


@ESCAPES
@pytest.mark.parametrize("command", ["info", "convert", "render", "compare"])
def test_what_is_printed(tmp_path, capfd, command):
    model = tmp_path / f"{BELL}.obj"
    surface = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\ncstype bezier\ndeg 1 1\n"
    surface += "surf 0 1 0 1 1 2 3 4\nparm u 0 1\nparm v 0 1\nend\n"
    model.write_text(f"{BELL} 3\n{surface}")
    scene = tmp_path / f"{BELL}.xml"
    scene.write_text('<scene version="3.0.0"><shape type="&#x9b;"/></scene>')
    images = [tmp_path / f"{name}{BELL}.exr" for name in "ab"]
    for at, image in enumerate(images):
        write_exr(image, {f"R{BELL}": np.full((2, 2), at, np.float32)})
    words = {
        "info": [str(model)],
        "convert": [str(model), str(tmp_path / "out.vtu")],
        "render": [str(scene)],
        "compare": [str(images[0]), str(images[1])],
    }[command]
    main.main([command, *words])
    out, err = capfd.readouterr()
    assert len(out + err) > 20
    assert not {"\x1b", "\x07", "\x9b"} & set(out + err)


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
    mb.save(mb.sphere(), tmp_path / "scene/ball.vtu")
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
    names = (*own, *PLUGINS)
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
    (folder / "s.png").rename(outside / "t.png")
    texture = f"""<bsdf type="diffuse"><texture type="bitmap" name="reflectance">
        <string name="filename" value="{outside}/t.png"/></texture></bsdf>
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


# ---------------------------------------------------------------- images, settings, reports

BOMBS = sentence(
    "An image of more than 67 million numbers is refused if its file has less than a byte for a "
    "hundred of them."
)


@BOMBS
def test_a_png_that_unpacks_to_more(tmp_path):
    def chunk(kind: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    path = tmp_path / "a.png"
    # the header is enough: what follows is not unpacked
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", 40_000, 40_000, 8, 2, 0, 0, 0))
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + header + chunk(b"IEND", b""))
    with pytest.raises(FileFormatError, match="got 4800000000"):
        read_image(path)


@BOMBS
def test_an_exr_that_unpacks_to_more(tmp_path, monkeypatch):
    path = tmp_path / "a.exr"
    write_exr(path, {name: np.zeros((400, 300), np.float32) for name in "RGB"})
    assert read_image(path).size == (400, 300)
    monkeypatch.setattr(image_size, "ALWAYS", 300_000)
    assert path.stat().st_size < 3600
    with pytest.raises(FileFormatError, match=r"at most 3\d+ numbers in a file of .*got 360000"):
        read_image(path)


@BOMBS
def test_what_a_file_may_hold():
    assert image_size.ALWAYS == 1 << 26  # 67 108 864
    image_size.check_size("x", 67_000_000, 1)
    image_size.check_size("x", 100_000_000, 1_000_000)
    with pytest.raises(FileFormatError):
        image_size.check_size("x", 100_000_000, 999_999)


@sentence("A TOML file of limits sets the limits of images, and no other key is accepted.")
@pytest.mark.parametrize(
    "text",
    ["include = 'b.toml'", "[default]\ncommand = 'rm'", "[images.a]\npath = '/'", "[run]\nx = 1"],
)
def test_settings(tmp_path, text):
    path = tmp_path / "a.toml"
    path.write_text("[default]\nrmse = 0.25\n")
    assert Thresholds.load(path).limits("x").rmse == 0.25
    path.write_text(text)
    with pytest.raises(mb.BezierError):
        Thresholds.load(path)


@sentence(
    "A report shows names and header texts of images as text, and loads nothing from elsewhere."
)
def test_reports(tmp_path):
    script = "<script>alert(1)</script>"
    for folder, value in (("a", 0.0), ("b", 1.0)):
        (tmp_path / folder).mkdir()
        write_exr(
            tmp_path / folder / "<img src=x onerror=alert(1)>.exr",
            {f"{script}.R": np.full((4, 4), value, np.float32)},
            {"command": script, "spp": 1},
        )
    words = [str(tmp_path / "a"), str(tmp_path / "b"), "--html", str(tmp_path / "r.html")]
    assert main.main(["compare", *words]) in (0, 1)
    page = (tmp_path / "r.html").read_text("utf-8")
    assert script not in page and "<img src=x" not in page
    # pictures lie in the page itself; links lead nowhere else
    assert not re.search(r"""(src|href)\s*=\s*["']?(https?:|//|file:|javascript:)""", page)
    assert "url(http" not in page and "@import" not in page


# ---------------------------------------------------------------- files that are written


@sentence(
    "A link that waits under the name of an output is replaced; what it points to stays as it was."
)
@pytest.mark.skipif(sys.platform == "win32", reason="links of POSIX")
def test_planted_links(folder):
    victim = folder / "victim"
    victim.write_text("precious")
    (folder / "s.xml").write_text(scene())
    for name, words in (
        ("out.vtu", ["convert", str(folder / "ball.vtu"), str(folder / "out.vtu")]),
        ("s.exr", ["render", str(folder / "s.xml"), "--spp", "1", "-q"]),
    ):
        (folder / name).symlink_to(victim)
        assert main.main(words) == 0
        assert not (folder / name).is_symlink() and victim.read_text() == "precious"


@sentence(
    "A temporary file beside an output has a random name, and is never one that is there already."
)
@pytest.mark.skipif(sys.platform == "win32", reason="links of POSIX")
def test_temporary_names(tmp_path, monkeypatch):
    victim = tmp_path / "victim"
    victim.write_text("precious")
    opened: list[str] = []
    real = os.open

    def spy(path, flags, *args, **kwargs):
        if flags & os.O_CREAT:
            assert flags & os.O_EXCL
            opened.append(str(path))
        return real(path, flags, *args, **kwargs)

    monkeypatch.setattr(os, "open", spy)
    for _ in range(2):
        _files.write_file(tmp_path / "out.vtu", b"new")
    assert len(set(opened)) == len(opened) == 2
    # somebody guessed the name that comes next
    monkeypatch.setattr(_files.secrets, "token_hex", lambda _size: "guessed")
    (tmp_path / ".guessed.tmp").symlink_to(victim)
    with pytest.raises(FileFormatError):
        _files.write_file(tmp_path / "out.vtu", b"newer")
    assert opened[-1].endswith(".guessed.tmp") and victim.read_text() == "precious"
    assert (tmp_path / "out.vtu").read_bytes() == b"new"


@sentence(
    "A report can have `mitsuba-bezier accept` put images in the place of images below the folder "
    "of the project or the current one, or remove such, and nothing else."
)
@pytest.mark.parametrize("reference", ["../victim", "victim", "../victim.exr", "a/link.exr"])
@pytest.mark.parametrize("state", ["changed", "removed"])
def test_a_report_that_wants_more(tmp_path, monkeypatch, capsys, reference, state):
    work = tmp_path / "work"
    (work / "a").mkdir(parents=True)
    for victim in (tmp_path / "victim", tmp_path / "victim.exr", work / "victim"):
        victim.write_text("precious")
    (work / "a/link.exr").symlink_to("../victim")
    write_exr(work / "new.exr", {"Y": np.zeros((2, 2), np.float32)})
    record = {"title": "x", "state": state, "reference": reference, "candidate": "new.exr"}
    record["was"] = hashlib.sha256(b"precious").hexdigest()[:16]  # it knows the old contents
    (work / "r.json").write_text(json.dumps({"run": {}, "records": [record]}))
    monkeypatch.chdir(work)
    assert main.main(["accept", "r.json"]) == 2
    assert "x: expected" in (told := capsys.readouterr().err) or "expected a" in told
    for victim in (tmp_path / "victim", tmp_path / "victim.exr", work / "victim"):
        assert victim.read_text() == "precious"
    assert (work / "a/link.exr").is_symlink()
