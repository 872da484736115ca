"""Renders on several processes and machines, and the scripts for them."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from cli_cases import BEZIER, scene

import mitsuba_bezier as mb
from mitsuba_bezier.cli import main
from mitsuba_bezier.errors import BezierError
from mitsuba_bezier.rendering.bundle import Bundle, make_bundle
from mitsuba_bezier.verification.images import read_image, write_exr


@pytest.fixture
def folder(tmp_path, monkeypatch):
    (tmp_path / "models").mkdir()
    mb.save(mb.sphere(), tmp_path / "models" / "ball.vtu")
    (tmp_path / "ball.xml").write_text(scene(shapes=BEZIER.format("models/ball.vtu")))
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(autouse=True)
def patience(monkeypatch):
    """Give a busy machine time to answer."""
    from mitsuba_bezier.cli import _many

    monkeypatch.setattr(_many, "ANSWER", 300)
    monkeypatch.setattr(_many, "FIRST_WORKER", 600)
    monkeypatch.setattr(_many, "SILENCE", "600 s")


def run(*words: str | Path) -> int:
    try:
        return main.main([*map(str, words)])
    except SystemExit as end:
        return int(end.code or 0)


def equal(a: str, b: str) -> None:
    one, two = read_image(a), read_image(b)
    for name, pixels in one.channels.items():
        np.testing.assert_array_equal(pixels, two.channels[name])
    for key in ("spp", "passes", "scene"):
        assert one.attributes[key] == two.attributes[key]


# ---------------------------------------------------------------- bundles


def test_a_bundle_keeps_names_and_contents(folder, tmp_path):
    files = [folder / "ball.xml", folder / "models/ball.vtu"]
    bundle = make_bundle(files, ["ball.xml"], [])
    root = bundle.unpack(tmp_path / "there")
    for file in files:
        assert (root / file.relative_to(folder)).read_bytes() == file.read_bytes()
    # what lies there damaged is written anew
    (root / "ball.xml").write_text("other")
    assert bundle.unpack(tmp_path / "there") == root
    assert (root / "ball.xml").read_bytes() == files[0].read_bytes()
    other = Bundle({**bundle.files, "ball.xml": b"other"}, bundle.inputs, (), bundle.digest)
    with pytest.raises(BezierError, match="bundle: expected files of hash"):
        other.unpack(tmp_path / "there")


def test_a_bundle_of_files_in_several_places(folder, tmp_path):
    (folder / "a/b").mkdir(parents=True)
    (folder / "a/b/c.xml").write_text("c")
    files = [folder / "a/b/c.xml", folder / "a/b/../../models/ball.vtu"]
    bundle = make_bundle(files, [folder / "a/b/c.xml"], [folder / "models"])
    assert sorted(bundle.files) == ["a/b/c.xml", "models/ball.vtu"]
    assert bundle.inputs == ("a/b/c.xml",) and bundle.folders == ("models",)


# ---------------------------------------------------------------- dask


def test_without_dask_it_is_told_before_the_render(folder, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert run("render", "ball.xml", "--workers", "2") == 2
    assert "pip install 'mitsuba-bezier[dask]'" in capsys.readouterr().err
    assert not os.path.exists("ball.exr")


def test_a_scheduler_that_is_not_there(folder, monkeypatch, capsys):
    pytest.importorskip("distributed")
    from mitsuba_bezier.cli import _many

    monkeypatch.setattr(_many, "ANSWER", 1)
    assert run("render", "ball.xml", "--scheduler", "tcp://127.0.0.1:9") == 2
    err = capsys.readouterr().err.splitlines()[-1]
    assert "--scheduler: expected the address of a dask scheduler that answers" in err
    assert not os.path.exists("ball.exr")


@pytest.mark.parametrize("address", ["", " "])
def test_an_empty_address_is_none(folder, address, capsys):
    assert run("render", "ball.xml", "--scheduler", address) == 2
    assert "--scheduler: expected the address of a dask scheduler" in capsys.readouterr().err
    assert not os.path.exists("ball.exr")


def test_whether_workers_can_be_reached():
    from mitsuba_bezier.cli import _many

    class Client:
        def __init__(self, *addresses):
            self.addresses = addresses

        def scheduler_info(self, n_workers):
            assert n_workers == -1
            return {"workers": dict.fromkeys(self.addresses)}

    with socket.create_server(("127.0.0.1", 0)) as server:
        here = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        assert _many.reachable(Client(here, here))
        assert not _many.reachable(Client(here, "tcp://127.0.0.1:9"))
        assert not _many.reachable(Client("inproc://10.0.0.1/2/3"))


def test_two_workers_give_the_bits_of_one(folder, capsys):
    pytest.importorskip("distributed")
    words = ("ball.xml", "--spp", "22", "--spp-per-pass", "4", "--seed", "5")
    assert run("render", *words, "-q", "-o", "whole.exr") == 0
    assert run("render", *words, "--workers", "2", "-o", "many.exr") == 0
    assert "passes by worker: tcp://" in capsys.readouterr().err
    equal("whole.exr", "many.exr")
    assert read_image("whole.exr").attributes["seeds"] == read_image("many.exr").attributes["seeds"]
    assert not os.path.exists("many.sums.exr")


def test_workers_of_other_versions_are_named(folder, monkeypatch, capsys):
    distributed = pytest.importorskip("distributed")
    from mitsuba_bezier.cli import _many, _worker

    with distributed.Client(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None
    ) as client:
        address = client.scheduler.address
        ours = _many.machine()
        monkeypatch.setattr(_many, "machine", lambda: {**ours, "version_llvm": "1.2.3"})
        assert run("render", "ball.xml", "--scheduler", address) == 2
        found = capsys.readouterr().err.splitlines()[-1]
        assert "llvm: expected 1.2.3, got" in found and "worker inproc://" in found
        monkeypatch.setattr(_many, "machine", lambda: ours)

        def full(_bundle, _folder):
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(_worker, "receive", full)
        assert run("render", "ball.xml", "--scheduler", address) == 2
        found = capsys.readouterr().err.splitlines()[-1]
        assert "room for the scene's files" in found and "No space left" in found
        assert "at worker inproc://" in found


MODELS = ("models/ball.vtu", "models/egg.vtu", "--light", "sky.exr", "--size", "40x30")


def surround(value: float) -> None:
    """Write a picture of surroundings."""
    half = np.full((8, 16), np.float32(value))
    half[:, 8:] *= 2
    write_exr("sky.exr", {c: half for c in "RGB"}, {})


@contextmanager
def elsewhere():
    """Give two workers that run in another folder."""
    distributed = pytest.importorskip("distributed")
    home = os.getcwd()
    os.mkdir("there")
    os.chdir("there")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, memory_limit=0
    ) as cluster:
        os.chdir(home)
        yield cluster


def models(folder) -> None:
    mb.save(mb.ellipsoid((0, 0, 1), (1, 1, 2)), folder / "models/egg.vtu")
    surround(0.5)


def test_models_and_their_surroundings_travel(folder, capsys):
    models(folder)
    words = (*MODELS, "--spp", "12", "--spp-per-pass", "4", "-q", "--resume")
    assert run("render", *words, "-o", "whole.exr") == 0
    with elsewhere() as cluster:
        where = ("--scheduler", cluster.scheduler_address, "--scene", "made.xml")
        assert run("render", *words, *where, "-o", "many.exr") == 0
    equal("whole.exr", "many.exr")
    assert os.path.exists("made.xml") and not os.path.exists("there/made.xml")
    # the contents of the surroundings count, not their name
    surround(1.0)
    assert run("render", *words, "-o", "many.exr") == 2
    assert "many.sums.exr: scene: expected" in capsys.readouterr().err


def test_frames_are_rendered_by_workers_of_which_one_is_killed(folder, capsys):
    pytest.importorskip("imageio")
    models(folder)
    words = ("render", *MODELS, "--turntable", "3", "--spp", "12", "--spp-per-pass", "4")
    assert run(*words, "-q", "-o", "whole.gif") == 0
    with elsewhere() as cluster:
        killed = next(iter(cluster.workers.values())).process.pid

        def kill() -> None:
            while not os.path.exists("many.frames/00001.exr"):
                time.sleep(0.02)
            os.kill(killed, signal.SIGKILL)

        thread = threading.Thread(target=kill, daemon=True)
        thread.start()
        where = ("--scheduler", cluster.scheduler_address)
        assert run(*words, *where, "-o", "many.gif", "--save-every", "0") == 0
        thread.join(300)
        assert not thread.is_alive() and "frame 3 of 3" in capsys.readouterr().err
    for number in range(3):
        equal(f"whole.frames/{number:05d}.exr", f"many.frames/{number:05d}.exr")
    assert Path("whole.gif").read_bytes() == Path("many.gif").read_bytes()
    assert run(*words, "--workers", "2", "-o", "many.gif") == 0
    assert "3 of them from before" in capsys.readouterr().err


FAULTS = """
import resource
import numpy as np
from mitsuba_bezier.cli import _worker
from mitsuba_bezier.rendering.bundle import Bundle, _digest

_worker.receive(Bundle({}, (), (), _digest({}, (), ())), %r)
for count in range(20):
    if count == 2:  # by then the memory is there
        before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    np.ones(1 << 17)
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="of glibc's memory")
def test_a_worker_keeps_the_memory_of_its_pictures(tmp_path):
    # as dask starts its workers: each of 18 arrays of 1 MB would be 256 pages taken anew, 4608;
    # what else the process does takes a few
    environment = {**os.environ, "MALLOC_TRIM_THRESHOLD_": "65536"}
    words = [sys.executable, "-c", FAULTS % str(tmp_path)]
    done = subprocess.run(words, env=environment, check=True, capture_output=True, text=True)
    assert int(done.stdout) < 2000


# ---------------------------------------------------------------- scripts


@pytest.mark.skipif(shutil.which("make") is None, reason="no make")
def test_a_makefile_renders_the_bits_of_the_whole(folder, capsys):
    words = ("ball.xml", "--parts", "3", "--spp", "24", "--seed", "2", "-o", "out.exr")
    assert run("plan", *words, "--make", "--slurm", "array.slurm") == 0
    printed = capsys.readouterr()
    assert "wrote out.mk" in printed.err and "wrote array.slurm" in printed.err
    assert run("render", "ball.xml", "--spp", "24", "--spp-per-pass", "2", "--seed", "2", "-q") == 0
    programs = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = {**os.environ, "PATH": programs}
    subprocess.run(["make", "-f", "out.mk"], env=environment, check=True, capture_output=True)
    equal("out.exr", "ball.exr")
    # the job array finds its parts done, and merges them
    os.unlink("out.exr")
    array = {**environment, "SLURM_ARRAY_TASK_ID": "2"}
    subprocess.run(["sh", "array.slurm"], env=array, check=True, capture_output=True)
    equal("out.exr", "ball.exr")
    subprocess.run(["sh", "-n"], input=printed.out, text=True, check=True)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--parts", "0"), "--parts: expected a number from 1"),
        (("--parts", "17"), "--parts: expected no more than the 16 samples"),
        (("--parts", "2", "--render", "--part 1/2"), "--render: expected options that all"),
        (("--parts", "2", "-o", "a b.exr", "--make"), "--make: expected names without blanks"),
        (("--parts", "2", "--make", "ball.xml"), "--make: expected another file"),
    ],
)
def test_plans_that_cannot_be_made(folder, words, message, capsys):
    before = sorted(os.listdir())
    assert run("plan", "ball.xml", *words) == 2
    assert message in capsys.readouterr().err
    assert sorted(os.listdir()) == before
