"""What the command line refuses before it works, and streams, names and locales that it bears."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from cli_cases import scene

import mitsuba_bezier as mb
from mitsuba_bezier import _files
from mitsuba_bezier.cli import _passes, main
from mitsuba_bezier.cli._streams import printable
from mitsuba_bezier.verification import png
from mitsuba_bezier.verification.images import read_image, write_exr

ROOT = Path(mb.__file__).parents[1]
PROGRAM = [sys.executable, "-m", "mitsuba_bezier.cli.main"]
posix = pytest.mark.skipif(sys.platform == "win32", reason="names and streams of POSIX")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Return a folder with a scene, an image and a model, which is the current one."""
    (tmp_path / "ball.xml").write_text(scene())
    write_exr(tmp_path / "a.exr", {"R": np.zeros((4, 5))}, {"spp": 1, "seed": 1})
    mb.save(mb.sphere(), tmp_path / "a.vtu")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(*words: str) -> int:
    try:
        return main.main(list(words))
    except SystemExit as end:
        return int(end.code or 0)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["render", "."], "SCENE: expected an existing scene file (.xml), got '.'"),
        (["render", ""], "SCENE: expected an existing scene file (.xml), got ''"),
        (["render", "/"], "SCENE: expected an existing scene file (.xml), got /"),
        (["render", ".."], "SCENE: expected an existing scene file"),
        (["render", "\udcff.xml"], "SCENE: expected a name in UTF-8, got '\\udcff.xml'"),
        (["render", "ball.xml", "-o", ""], "--output: expected the name of a file, got an empty"),
        (["render", "ball.xml", "-o", "."], "--output: expected a name that ends in .exr"),
        (["render", "ball.xml", "-o", "\udcff.exr"], "--output: expected a name in UTF-8"),
        (["render", "ball.xml", "-o", f"{'x' * 252}.exr"], "File name too long"),
        (["render", "ball.xml", "-o", "/dev/null"], "--output: expected a name that ends in .exr"),
        (["render", "ball.xml", "-o", "pipe.exr"], "expected the name of a file, got the device"),
        (["render", "ball.xml", "-o", "ball.xml"], "--output: expected a name that ends in .exr"),
        (["render", "ball.exr"], "--output: expected another file than those that are read"),
        (["render", "wood.xml"], "--output: expected another file than those that are read, got w"),
        (["render", "ball.xml", "-o", "sub/tex.exr"], "--output: expected another file"),
        (["render", "ball.xml", "-t", "1000000"], "-t/--threads: expected an integer from 1 to"),
        (["render", "ball.xml", "-a", "\udcff"], "-a/--append: expected names in UTF-8"),
        (["render", "ball.xml", "-D", "a=\udcff"], "-D/--define: expected KEY=VALUE"),
        (["render", "ball.xml", "-m", "\udcff"], "variant: expected one of"),
        (["render", "ball.xml", "--exposure", "nan"], "--exposure: expected a number from -64"),
        (["render", "ball.xml", "--exposure", "1e9"], "--exposure: expected a number from -64"),
        (["merge", "a.exr", "-o", ""], "--output: expected the name of a file"),
        (["merge", "a.exr", "-o", "\udcff.exr"], "--output: expected a name in UTF-8"),
        (["merge", "a.exr", "-o", f"{'x' * 252}.exr"], "File name too long"),
        (["compare", "", "a.exr"], "A: expected an image or a folder, got an empty name"),
        (["compare", "a.exr", ""], "B: expected an image or a folder, got an empty name"),
        (["compare", "a.exr", "a.exr", "--html", ""], "--html: expected the name of a file"),
        (["compare", "a.exr", "a.exr", "--html", "a.exr"], "--html: expected a name that ends in"),
        (["compare", "a.exr", "a.exr", "--json", ""], "--json: expected the name of a file"),
        (["compare", "a.exr", "a.exr", "--json", "a.exr"], "--json: expected a name that is none"),
        (["compare", "a.exr", "a.exr", "--json", "."], "--json: expected the name of a file"),
        (["compare", "a.exr", "a.exr", "--json", "/dev/null"], "--json: expected the name of a"),
        (["compare", "a.exr", "a.exr", "--json", "ball.xml/x"], "--json: expected a folder that"),
        (
            ["compare", "a.exr", "a.exr", "--thresholds", "t.toml", "--json", "t.toml"],
            "--json: expected another file than those that are read, got t.toml",
        ),
        (
            ["compare", "a.exr", "a.exr", "--json", "x.html", "--html", "x.html"],
            "--json: expected another file than --html, got x.html",
        ),
        (["compare", "a.exr", "a.exr", "--exposure", "inf"], "--exposure: expected a number from"),
        (["verify", "torus", "--html", ""], "--html: expected the name of a file"),
        (["verify", "torus", "--json", "."], "--json: expected the name of a file"),
        (["verify", "torus", "--html", "x.exr"], "--html: expected a name that ends in .html"),
        (["convert", "a.vtu", ""], "path: expected a file that can be written"),
        (["convert", "a.vtu", "a.vtu"], "OUT: expected another file than those that are read"),
        (["convert", "a.vtu", f"{'x' * 252}.vtu"], "File name too long"),
        (["convert", "", "b.vtu"], "path: expected a file that can be read"),
        (["convert", ".", "b.vtu"], "path: expected a file that can be read"),
        (["info", ""], "path: expected a file that can be read"),
        (["info", "\udcff.vtu"], "\\udcff.vtu"),
        (["doctor", "--timeout", "nan"], "--timeout: expected a number above 0"),
        (["\udcff"], "invalid choice"),
    ],
)
@posix
def test_one_line_before_any_work(folder, words, message, monkeypatch, capsys):
    # whatever is refused, the files stay
    (folder / "ball.exr").write_text(scene())
    os.mkfifo("pipe.exr")
    (folder / "sub").mkdir()
    (folder / "sub/tex.png").write_bytes(png.encode(np.zeros((2, 2, 3), np.uint8)))
    (folder / "wood.png").write_bytes(png.encode(np.zeros((2, 2, 3), np.uint8)))
    (folder / "t.toml").write_text("")
    (folder / "\udcff.xml").write_text(scene())
    picture = """<shape type="sphere"><bsdf type="diffuse"><texture type="bitmap"
      name="reflectance"><string name="filename" value="{}"/></texture></bsdf></shape>"""
    (folder / "wood.xml").write_text(scene(shapes=picture.format("wood.png")))
    if "sub/tex.exr" in words:
        (folder / "ball.xml").write_text(scene(shapes=picture.format("sub/tex.png")))

    def contents():
        return {p: p.read_bytes() for p in folder.rglob("*") if p.is_file() and not p.is_fifo()}

    def too_late(*_args):
        raise AssertionError("rendering began")

    before = contents()
    monkeypatch.setattr(_passes, "render", too_late)
    assert run(*words) == 2
    lines = capsys.readouterr().err.splitlines()
    assert lines[-1].startswith("mitsuba-bezier: error: ") and message in lines[-1]
    assert all("error" not in line for line in lines[:-1])
    assert contents() == before


def test_a_full_disk_is_told_before_the_render(folder, monkeypatch, capsys):
    def too_late(*_args):
        raise AssertionError("rendering began")

    monkeypatch.setattr(_passes, "render", too_late)
    for free in (0, 32 * 24 * 6 // 8):
        monkeypatch.setattr(_files, "free_space", lambda _, free=free: free)
        assert run("render", "ball.xml", "-q") == 2
        assert f"bytes of free space, got {free} in ." in capsys.readouterr().err


@posix
def test_a_film_larger_than_the_memory_is_told_before_the_render(folder, monkeypatch, capsys):
    def too_late(*_args):
        raise AssertionError("rendering began")

    monkeypatch.setattr(_passes, "render", too_late)
    real = os.sysconf
    small = {"SC_PAGE_SIZE": 4096, "SC_PHYS_PAGES": 10}  # less than 64 bytes for 32 x 24 pixels
    monkeypatch.setattr(os, "sysconf", lambda name: small.get(name) or real(name))
    assert run("render", "ball.xml", "-q", "--spp", "1") == 2
    err = capsys.readouterr().err
    assert "film: expected a size whose 64 bytes a pixel fit the memory, 0 MiB, got 32 x 24" in err


def test_the_scene_of_a_render_is_told_by_its_contents(folder):
    def digest(*words):
        assert run("render", "ball.xml", "-q", "--spp", "1", *words) == 0
        return read_image("ball.exr").attributes["scene"]

    mb.save(mb.sphere(), "ball.vtu")
    shape = '<shape type="beziertriangle"><string name="filename" value="ball.vtu"/></shape>'
    text = scene(shapes=shape)
    (folder / "ball.xml").write_text(text)
    first = digest()
    assert digest("--seed", "3", "--exposure", "1") == first
    (folder / "ball.xml").write_bytes(text.replace("\n", "\r\n").encode())
    assert digest() == first
    assert digest("-D", "depth=2") != first
    mb.save(mb.sphere(radius=0.9), "ball.vtu")
    assert digest() != first
    mb.save(mb.sphere(), "ball.vtu")
    assert digest() == first
    (folder / "ball.xml").write_text(text.replace('value="32"', 'value="33"'))
    assert digest() != first
    (folder / "part.xml").write_text(f'<scene version="3.0.0">{shape}</scene>')
    (folder / "ball.xml").write_text(scene(shapes='<include filename="part.xml"/>'))
    included = digest()
    (folder / "part.xml").write_text(f'<scene version="3.0.0">{shape}<!-- --></scene>')
    assert digest() != included


def test_parts_of_other_scenes_and_plans_do_not_merge(folder, capsys):
    def part(number, *words, out=None):
        out = out or f"part{number}.exr"
        options = ("-q", "--spp", "4", "--spp-per-pass", "2", "--part", f"{number}/2")
        assert run("render", "ball.xml", *options, "-o", out, *words) == 0
        return out

    one, two = part(1), part(2)
    assert run("merge", one, two, "-o", "whole.exr", "-q") == 0
    for words, message in (
        (["-D", "depth=1"], "scene: expected "),
        (["-m", "llvm_ad_spectral"], "colours: expected rgb, as in part1.exr"),
        (["--seed", "1"], "none that is part 2/2 of seed 0, 4 spp in passes of 2"),
        (["--spp", "6"], "none that is part 2/2 of seed 0, 4 spp in passes of 2"),
        (["--spp-per-pass", "1"], "none that is part 2/2 of seed 0, 4 spp in passes of 2"),
    ):
        other = part(2, *words, out="other.exr")
        capsys.readouterr()
        assert run("merge", one, other, "-o", "mixed.exr", "-q") == 2
        assert message in capsys.readouterr().err
        assert not Path("mixed.exr").exists()


# ---------------------------------------------------------------- in a process of its own


def shell(command: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run a shell command, in which $M is the program."""
    program = " ".join(f"'{word}'" for word in PROGRAM)
    return subprocess.run(
        ["sh", "-c", command.replace("$M", program)],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT), **environment},
    )


@posix
@pytest.mark.parametrize(
    "streams", ["2>&1 | true", "-v 2>&1 | true", "2>&-", "<&- >&- 2>&-", "2>/dev/full"]
)
def test_a_render_is_written_whoever_reads_its_progress(folder, streams):
    done = shell(f"$M render ball.xml --spp 16 --spp-per-pass 2 {streams}")
    assert done.stderr == "" and read_image("ball.exr").attributes["spp"] == 16
    assert png.decode(Path("ball.png").read_bytes(), "ball.png").shape == (24, 32, 3)
    assert not [name for name in os.listdir() if name.endswith(".tmp")]


@posix
@pytest.mark.parametrize(
    ("command", "reason"),
    [
        ("$M compare a.exr a.exr >&-", "Bad file descriptor"),
        ("$M info a.vtu >/dev/full", "No space left on device"),
        ("$M --help >/dev/full", "No space left on device"),
        ("($M info a.vtu; echo $? >code) | true", "Broken pipe"),
        ("($M compare a.exr a.exr; echo $? >code) | true", "Broken pipe"),
    ],
)
def test_what_cannot_be_printed_is_an_error(folder, command, reason):
    if "/dev/full" in command and not os.path.exists("/dev/full"):
        pytest.skip("Linux has this device")
    done = shell(command)
    code = int(Path("code").read_text()) if "code" in command else done.returncode
    start = "mitsuba-bezier: error: standard output: expected a stream that can be written to, got "
    assert (code, done.stderr) == (2, f"{start}{reason}\n")


@posix
def test_a_folder_that_is_gone_or_has_no_name_in_utf8(folder):
    (folder / "gone").mkdir()
    done = shell("cd gone && rmdir ../gone && $M render ../ball.xml -q")
    expected = "current folder: expected one that exists, got one that was removed"
    assert (done.returncode, done.stderr) == (2, f"mitsuba-bezier: error: {expected}\n")
    (folder / "\udcff").mkdir()
    os.rename("ball.xml", "\udcff/ball.xml")
    done = shell("cd * 2>/dev/null; cd $(printf '\\377'); $M render ball.xml -q")
    assert done.returncode == 2 and "SCENE: expected a name in UTF-8" in done.stderr
    assert done.stderr.count("\n") == 1


@posix
def test_locales_and_time_zones(folder):
    ascii_only = {"LC_ALL": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0"}
    done = shell("$M --help && $M convert --help", **ascii_only)
    assert done.returncode == 0 and "B\\xe9zier" in done.stdout
    done = shell("$M compare a.exr a.exr --html a.html --json -", TZ="UTC+24", **ascii_only)
    assert done.returncode == 0 and '"made": "2' in Path("a.html").read_text(encoding="utf-8")


@posix
def test_names_with_line_ends_quotes_and_blanks(folder, capsys):
    name = " a\nb '\"$c"
    (folder / f"{name}.xml").write_text(scene())
    assert run("render", f"{name}.xml", "--spp", "1") == 0
    assert capsys.readouterr().err.splitlines()[-1].startswith("mitsuba-bezier: wrote  a\\nb '\"$c")
    assert read_image(f"{name}.exr").attributes["spp"] == 1
    assert run("compare", f"{name}.exr", f"{name}.exr", "--html", f"{name}.html") == 0
    assert Path(f"{name}.html").stat().st_size > 1000


@posix
def test_reports_of_files_whose_names_are_no_text(folder):
    os.rename("a.exr", "\udcff.exr")
    words = ("compare", "\udcff.exr", "\udcff.exr")
    assert run(*words, "--html", "\udcfe.html", "--json", "\udcfe.json") in (0, 2)
    assert "\\udcff.exr" in Path("\udcfe.json").read_text(encoding="utf-8")


def test_two_at_once_leave_one_whole_file(folder):
    """Whoever is last wins; nothing is mixed, and nothing is left over."""
    from concurrent.futures import ThreadPoolExecutor

    contents = [bytes([k]) * 100_000 for k in range(8)]
    with ThreadPoolExecutor(max_workers=4) as pool:
        list(pool.map(lambda data: _files.write_file("x", data), contents * 5))
    assert Path("x").read_bytes() in contents
    assert not [name for name in os.listdir() if name.endswith(".tmp")]


def test_what_is_printed_holds_no_control_characters():
    assert printable("a\x1b[31mé\n\udcff ✓") == "a\\x1b[31mé\\n\\udcff ✓"
