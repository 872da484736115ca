"""``mitsuba-bezier doctor``: what it finds, advises and returns."""

from __future__ import annotations

import json
import sys
from importlib import metadata

import pytest

from mitsuba_bezier import _llvm, _runtime
from mitsuba_bezier.cli import doctor, main

COMMAND = "import sys; from mitsuba_bezier.cli.main import main; sys.exit(main(sys.argv[1:]))"


@pytest.fixture
def quick(monkeypatch):
    """Let one trial stand for all: the others differ in name only."""
    results = {}

    def once(variant, timeout):
        if "llvm" not in results:
            results["llvm"] = doctor_try(variant, timeout)
        return results["llvm"]

    doctor_try = doctor._try
    monkeypatch.setattr(doctor, "_try", once)


def test_json_of_a_working_machine(python):
    done = python(COMMAND, None, "doctor", "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["variants"]["llvm_ad_rgb"] == "works"
    assert not any(name.startswith("scalar_") for name in found["variants"])
    assert found["versions"]["mitsuba"] == metadata.version("mitsuba")
    assert found["llvm"]["path"] == _llvm.find().path
    assert found["llvm"]["chosen_by"].startswith("mitsuba_bezier, from")
    assert not [item for item in found["advice"] if "LLVM" in item["problem"]]


def test_table(quick, capsys):
    assert main.main(["doctor"]) == 0
    out = capsys.readouterr().out
    for text in (metadata.version("drjit"), _llvm.find().path, "llvm_ad_rgb", "works", "libatomic"):
        assert text in out


def test_a_missing_package(monkeypatch, quick):
    version = doctor._version
    monkeypatch.setattr(
        doctor, "_version", lambda name: None if name == "OpenEXR" else version(name)
    )
    found = doctor.examine()
    assert found["versions"]["OpenEXR"] is None
    assert {"problem": "the package OpenEXR is missing", "command": "pip install OpenEXR"} in found[
        "advice"
    ]


def test_an_old_llvm(monkeypatch, capsys):
    monkeypatch.setattr(_runtime, "llvm_version", lambda: (15, 0, 7))
    monkeypatch.setattr(_runtime, "_starts", lambda name: False)
    monkeypatch.setattr(doctor, "_gpu", lambda: None)
    assert main.main(["doctor", "--json"]) == 1  # no JIT variant works
    found = json.loads(capsys.readouterr().out)
    assert found["llvm"]["version"] == "15.0.7"
    assert found["variants"]["llvm_ad_rgb"] == "needs LLVM 17 or newer"
    assert found["variants"]["cuda_ad_rgb"] == "needs an NVIDIA GPU and its driver"
    problems = [item["problem"] for item in found["advice"]]
    assert any(text.startswith("LLVM: expected version 17 or newer") for text in problems)


@pytest.mark.skipif(sys.platform != "linux", reason="about Linux's dynamic loader")
def test_without_libatomic(python, tmp_path):
    (tmp_path / "libatomic.so.1").touch()
    done = python(COMMAND, {"LD_LIBRARY_PATH": str(tmp_path)}, "doctor", "--json")
    assert done.returncode == 1, done.stderr
    found = json.loads(done.stdout)
    assert found["libatomic"] is None and found["variants"] == {}
    assert [item["command"] for item in found["advice"]] == [_llvm.install_command("libatomic")]


def test_a_trial_that_fails_aborts_or_hangs(monkeypatch):
    for code, seconds, expected in [
        ("import sys; sys.exit('a reason')", 600, "a reason"),
        ("import os; os.abort()", 600, "aborted by SIGABRT"),
        ("raise SystemExit(3)", 600, "exit code 3"),
        ("import time; time.sleep(600)", 2, "did not start within 2 s"),
    ]:
        monkeypatch.setattr(doctor, "_TRIAL", code)
        assert doctor._try("llvm_ad_rgb", seconds) == expected


def test_a_trial_chooses_its_llvm_by_itself(monkeypatch):
    # our own choice, inherited, would look like one of the user's in the child's messages
    monkeypatch.setattr(
        doctor, "_TRIAL", "import os, sys; sys.exit(str(os.environ.get(sys.argv[1])))"
    )
    name = "DRJIT_LIBLLVM_PATH"
    monkeypatch.setenv(name, _llvm.find().path)
    monkeypatch.setattr(_runtime, "_ours", _llvm.find())
    assert doctor._try(name, 600.0) == "None"
    monkeypatch.setenv(name, "/usr/lib/libLLVM-of-the-user.so")
    assert doctor._try(name, 600.0) == "/usr/lib/libLLVM-of-the-user.so"


def test_a_scalar_variant_does_not_pass_the_trial():
    assert "cannot run a Dr.Jit kernel" in doctor._try("scalar_rgb", 600.0)


def test_the_card_without_a_driver(monkeypatch, quick):
    monkeypatch.setattr(doctor, "_gpu", lambda: None)
    monkeypatch.setattr(doctor, "_has_nvidia_card", lambda: True)
    found = doctor.examine()
    assert _llvm.install_command("nvidia") in [item["command"] for item in found["advice"]]
