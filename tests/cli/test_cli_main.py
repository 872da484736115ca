"""The program's frame: help, versions, errors in one line, exit codes."""

from __future__ import annotations

import re
import subprocess
import sys
from importlib import import_module

import pytest

from mitsuba_bezier import __version__
from mitsuba_bezier.cli import main as cli
from mitsuba_bezier.errors import GeometryError


def run(*words: str) -> int:
    try:
        return cli.main(list(words))
    except SystemExit as end:  # argparse ends this way
        return int(end.code or 0)


def test_help_names_every_command(capsys):
    assert run("--help") == 0
    out = capsys.readouterr().out
    for name in cli.COMMANDS:
        assert re.search(rf"^    {name}\s", out, re.M)


@pytest.mark.parametrize("name", cli.COMMANDS)
def test_each_command_is_a_module_with_the_two_functions(name, capsys):
    module = import_module(f"mitsuba_bezier.cli.{name}")
    assert callable(module.add_parser) and callable(module.run)
    assert run(name, "--help") == 0
    assert f"usage: mitsuba-bezier {name}" in capsys.readouterr().out


def test_version(capsys):
    assert run("--version") == 0
    assert capsys.readouterr().out == f"mitsuba-bezier {__version__}\n"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "the following arguments are required: COMMAND"),
        (["rendr"], "invalid choice: 'rendr'"),
        (["render"], "the following arguments are required: SCENE"),
        (["render", "a.xml", "--spp", "0"], "argument --spp: expected an integer from 1 to"),
        (["render", "a.xml", "--spp", "many"], "argument --spp: expected an integer from 1 to"),
        (["render", "a.xml", "--seed", "-1"], "argument --seed: expected an integer from 0 to"),
        (["render", "a.xml", "-D", "spp"], "argument -D/--define: expected KEY=VALUE, got 'spp'"),
        (["render", "a.xml", "--sp", "4"], "ambiguous option: --sp"),
        (["render", "a.xml", "--nothing"], "unrecognized arguments: --nothing"),
    ],
)
def test_wrong_usage_is_one_line(words, message, capsys):
    assert run(*words) == 2
    err = capsys.readouterr().err
    assert err.startswith("mitsuba-bezier: error: ") and message in err
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    "error", [GeometryError("a: expected\nb, got c"), FileNotFoundError(2, "No such file", "x")]
)
def test_errors_are_one_line_and_a_traceback_on_demand(error, monkeypatch, capsys):
    def fail(_args):
        raise error

    monkeypatch.setattr(import_module("mitsuba_bezier.cli.doctor"), "run", fail)
    assert run("doctor") == 2
    err = capsys.readouterr().err
    assert err.startswith("mitsuba-bezier: error: ") and err.count("\n") == 1
    for words in (("--debug", "doctor"), ("doctor", "--debug")):
        with pytest.raises(type(error)):
            cli.main(words)


def test_our_own_mistakes_are_not_dressed_up(monkeypatch):
    def fail(_args):
        raise TypeError("a defect")

    monkeypatch.setattr(import_module("mitsuba_bezier.cli.doctor"), "run", fail)
    with pytest.raises(TypeError):
        cli.main(["doctor"])


def test_ctrl_c(monkeypatch, capsys):
    def interrupt(_args):
        raise KeyboardInterrupt

    monkeypatch.setattr(import_module("mitsuba_bezier.cli.doctor"), "run", interrupt)
    assert run("doctor") == 130
    assert capsys.readouterr().err == "mitsuba-bezier: interrupted\n"


def test_as_a_program():
    done = subprocess.run(
        [sys.executable, "-m", "mitsuba_bezier.cli.main", "render", "nowhere.xml"],
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert done.returncode == 2
    assert done.stderr == (
        "mitsuba-bezier: error: SCENE: expected an existing scene file (.xml), got nowhere.xml\n"
    )


@pytest.mark.parametrize(
    "error", [MemoryError(), RuntimeError("jit_malloc(): out of memory! Could not allocate")]
)
def test_too_little_memory_is_one_line(monkeypatch, capsys, error):
    def fail(_args):
        raise error

    monkeypatch.setattr(import_module("mitsuba_bezier.cli.doctor"), "run", fail)
    assert run("doctor") == 2
    err = capsys.readouterr().err
    assert err == "mitsuba-bezier: error: this takes more memory than there is\n"


def test_a_library_that_is_missing_is_one_line(monkeypatch, capsys):
    def fail(_args):
        raise error

    monkeypatch.setattr(import_module("mitsuba_bezier.cli.doctor"), "run", fail)
    error = ImportError("OpenEXR.so: failed to map segment from shared object", name="OpenEXR")
    assert run("doctor") == 2
    assert capsys.readouterr().err == f"mitsuba-bezier: error: {error}\n"
    error = ImportError("no such name", name="mitsuba_bezier.io")
    with pytest.raises(ImportError):
        run("doctor")
