"""Renders that are interrupted: what is there is kept, and goes on to the bits of the whole."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from cli_cases import render, scene

import mitsuba_bezier as mb
from mitsuba_bezier.cli import main
from mitsuba_bezier.rendering import keeper, passes
from mitsuba_bezier.verification.images import Image, read_image, write_exr

WORDS = ("ball.xml", "--spp", "22", "--spp-per-pass", "4", "--seed", "5", "--save-every", "0")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Return an empty folder with a scene file, which is the current one."""
    (tmp_path / "ball.xml").write_text(scene())
    monkeypatch.chdir(tmp_path)
    return tmp_path


def interrupt(monkeypatch, after: int, *words: str, error: BaseException | None = None) -> int:
    """Render, and press Ctrl-C in the pass after so many."""
    count = 0
    real = passes.render_pass

    def counted(*args):
        nonlocal count
        count += 1
        if count > after:
            raise error or KeyboardInterrupt
        return real(*args)

    with monkeypatch.context() as patch:
        patch.setattr(passes, "render_pass", counted)
        return render(*words)


def same(a: str, b: str) -> None:
    """Hold that two pictures are equal to the bit, and tell the same of their samples."""
    one, two = read_image(a), read_image(b)
    assert one.channels.keys() == two.channels.keys()
    for name, pixels in one.channels.items():
        np.testing.assert_array_equal(pixels, two.channels[name])
    for key in ("spp", "seeds", "passes", "stopped_by", "scene"):
        assert one.attributes[key] == two.attributes[key], key


@pytest.fixture
def whole(folder):
    assert render(*WORDS, "-q", "-o", "whole.exr") == 0
    return "whole.exr"


@pytest.mark.parametrize("after", [1, 3, 5])
def test_the_same_command_goes_on(folder, whole, monkeypatch, capsys, after):
    assert interrupt(monkeypatch, after, *WORDS, "-o", "a.exr") == 130
    err = capsys.readouterr().err
    assert f"kept {4 * after} of 22 spp in a.exr; the same command goes on" in err
    picture = read_image("a.exr").attributes
    assert picture["spp"] == 4 * after and picture["stopped_by"] == "not yet"
    assert picture["spp_asked"] == 22
    assert sorted(os.listdir()) == [
        *("a.exr", "a.png", "a.sums.exr", "ball.xml", "whole.exr", "whole.png")
    ]
    assert render(*WORDS, "-o", "a.exr") == 0
    assert f"going on from {4 * after} spp in a.sums.exr" in capsys.readouterr().err
    same("a.exr", whole)
    assert Path("a.png").read_bytes() == Path("whole.png").read_bytes()
    assert not os.path.exists("a.sums.exr")


def test_all_is_rendered_but_not_written(folder, whole, monkeypatch):
    assert interrupt(monkeypatch, 3, *WORDS, "-q", "-o", "a.exr", "--resume") == 130
    assert render(*WORDS, "-q", "-o", "a.exr", "--resume") == 0
    same("a.exr", whole)
    os.unlink("a.exr")
    # the last pass of 2 is another one if more are asked for, so that it is not kept
    assert read_image("a.sums.exr").attributes["spp"] == 20
    assert interrupt(monkeypatch, 1, *WORDS, "-q", "-o", "a.exr", "--resume") == 0
    same("a.exr", whole)


def test_a_finished_render_goes_on_to_more(folder, whole, monkeypatch):
    assert render("ball.xml", "-q", *WORDS[3:], "--spp", "10", "--resume", "-o", "a.exr") == 0
    assert read_image("a.exr").attributes["spp"] == 10
    assert interrupt(monkeypatch, 4, *WORDS, "-q", "--resume", "-o", "a.exr") == 0
    same("a.exr", whole)


@pytest.mark.parametrize("error", [MemoryError(), RuntimeError("no device")])
def test_an_error_loses_nothing_either(folder, whole, monkeypatch, capsys, error):
    try:
        assert interrupt(monkeypatch, 3, *WORDS, "-o", "a.exr", error=error) == 2
    except RuntimeError:
        pass  # not a user's error: it is not dressed up
    assert "kept 12 of 22 spp in a.exr" in capsys.readouterr().err
    assert render(*WORDS, "-q", "-o", "a.exr") == 0
    same("a.exr", whole)


def test_parts_go_on_too(folder, whole, monkeypatch):
    for part in (1, 2):
        words = (*WORDS, "-q", "--part", f"{part}/2", "-o", f"{part}.exr")
        assert interrupt(monkeypatch, 1, *words) == 130
        assert main.main(["merge", f"{part}.exr", "-o", "m.exr", "--allow", "missing"]) == 2
        assert render(*words) == 0
    assert main.main(["merge", "1.exr", "2.exr", "-q", "-o", "merged.exr"]) == 0
    for name, pixels in read_image(whole).channels.items():
        np.testing.assert_array_equal(pixels, read_image("merged.exr").channels[name])


def test_a_part_that_is_not_finished_is_refused(folder, monkeypatch, capsys):
    assert interrupt(monkeypatch, 1, *WORDS, "-q", "--part", "1/2", "-o", "1.exr") == 130
    assert render(*WORDS, "-q", "--part", "2/2", "-o", "2.exr") == 0
    capsys.readouterr()
    assert main.main(["merge", "1.exr", "2.exr", "-o", "merged.exr"]) == 2
    assert "1.exr: part 1/2: expected all of its 12 spp" in capsys.readouterr().err
    words = ["merge", "1.exr", "2.exr", "-q", "-o", "merged.exr", "--allow", "unfinished"]
    assert main.main(words) == 0
    assert read_image("merged.exr").attributes["spp"] == 14


# ---------------------------------------------------------------- what cannot be continued


def other_scene(folder):
    (folder / "ball.xml").write_text(scene().replace('value="3"', 'value="4"'))


def damaged(folder):
    data = bytearray((folder / "a.sums.exr").read_bytes())
    data[-100] ^= 1
    (folder / "a.sums.exr").write_bytes(data)


def cut_off(folder):
    data = (folder / "a.sums.exr").read_bytes()
    (folder / "a.sums.exr").write_bytes(data[: len(data) // 2])


def no_sums(folder):
    write_exr(folder / "a.sums.exr", {"R": np.zeros((24, 32), np.float32)}, {"spp": 4})


def no_picture(folder):
    (folder / "a.sums.exr").write_text("this is no picture")


@pytest.mark.parametrize("resume", [(), ("--resume",)])
@pytest.mark.parametrize(
    ("change", "words", "message"),
    [
        (other_scene, (), "a.sums.exr: scene: expected"),
        (None, ("--seed", "6"), "a.sums.exr: seed: expected 6 (or --fresh to begin anew), got 5"),
        (None, ("--spp-per-pass", "3"), "a.sums.exr: plan: expected passes of 3 (or"),
        (None, ("-m", "llvm_ad_mono"), "a.sums.exr: variant: expected llvm_ad_mono (or"),
        (None, ("--part", "1/2"), "a.sums.exr: part: expected 1/2 (or"),
        (None, ("--spp", "7"), "--spp: expected at least the 12 that are in a.sums.exr (or"),
        (damaged, (), "a.sums.exr: expected the sums of whole passes (or --fresh to begin anew)"),
        (cut_off, (), "a.sums.exr: expected an intact EXR file"),
        (no_picture, (), "a.sums.exr: expected an intact EXR file"),
        (no_sums, (), "a.sums.exr: expected sums of a render (or"),
    ],
)
def test_another_render_is_refused_and_stays(
    folder, monkeypatch, capsys, change, words, message, resume
):
    assert interrupt(monkeypatch, 3, *WORDS, "-q", "-o", "a.exr") == 130
    if change:
        change(folder)
    before = {name: (folder / name).read_bytes() for name in os.listdir(folder)}
    assert render(*WORDS, *words, *resume, "-o", "a.exr") == 2
    err = capsys.readouterr().err.splitlines()[-1]
    assert message in err
    assert {name: (folder / name).read_bytes() for name in os.listdir(folder)} == before
    # what is to be begun anew is
    assert render(*WORDS, *words, "-q", "--fresh", "-o", "a.exr") == 0
    assert render(*WORDS, *words, "-q", "-o", "b.exr") == 0
    same("a.exr", "b.exr")


def test_resume_and_fresh_are_one_or_the_other(folder, capsys):
    assert render("ball.xml", "--resume", "--fresh") == 2
    assert "not allowed with argument" in capsys.readouterr().err


def test_nothing_to_go_on_from(folder, capsys, whole):
    assert render(*WORDS, "--resume", "-o", "a.exr") == 0
    assert "there is no a.sums.exr to go on from" in capsys.readouterr().err
    same("a.exr", whole)


def test_other_versions_are_told(folder, monkeypatch, capsys):
    assert interrupt(monkeypatch, 3, *WORDS, "-q", "-o", "a.exr") == 130
    image = read_image("a.sums.exr")
    attributes = {**image.attributes, "version_mitsuba": "3.0.0"}
    write_exr("a.sums.exr", image.channels, attributes, image.offset, image.full_size)
    assert render(*WORDS, "-o", "a.exr") == 0
    assert "the last bits may differ" in (err := capsys.readouterr().err)
    assert "version mitsuba 3.0.0, now 3" in err


def test_a_better_picture_of_the_same_render_stays_until_there_is_one(
    folder, whole, monkeypatch, capsys
):
    before = Path(whole).read_bytes()
    more = ("ball.xml", "--spp", "64", *WORDS[3:], "-o", whole)
    assert interrupt(monkeypatch, 3, *more) == 130
    assert Path(whole).read_bytes() == before
    assert "kept 12 of 64 spp in whole.sums.exr" in capsys.readouterr().err
    assert interrupt(monkeypatch, 3, *more) == 130
    assert read_image(whole).attributes["spp"] == 24


def test_a_finished_picture_stays_if_its_sums_were_not_yet_removed(folder, whole, monkeypatch):
    assert interrupt(monkeypatch, 2, *WORDS, "-q", "-o", "a.exr") == 130
    Path("a.exr").write_bytes(Path(whole).read_bytes())
    assert interrupt(monkeypatch, 1, *WORDS, "-q", "-o", "a.exr") == 130
    same("a.exr", whole)
    assert render(*WORDS, "-q", "-o", "a.exr") == 0
    same("a.exr", whole)


# ---------------------------------------------------------------- files and disks


def test_how_often_it_is_written(folder, monkeypatch):
    """The first pass at once, then no more than a hundredth of the time."""
    now, writes = 0.0, []
    monkeypatch.setattr(keeper.time, "perf_counter", lambda: now)

    def write(state):
        nonlocal now
        now += 0.1
        writes.append((now, state.n))
        return {}

    class State:
        def __init__(self, n):
            self.n = n

        def copy(self):
            return self

    kept = keeper.Keeper(lambda _: {}, write, lambda _: {}, print, str)
    for n in range(1000):
        now += 0.5
        kept.offer(State(n))
    assert writes[0][1] == 0
    steps = np.diff([time for time, _ in writes])
    assert np.all(steps >= 10.0) and np.all(steps <= 10.7)


def test_a_full_disk_does_not_stop_the_render(folder, whole, monkeypatch, capsys):
    from mitsuba_bezier import _files

    real, full = _files._write_new, []

    def write_new(temporary, data, old):
        if len(full) < 5:
            full.append(1)
            raise OSError(28, "No space left on device")
        return real(temporary, data, old)

    monkeypatch.setattr(_files, "_write_new", write_new)
    assert render(*WORDS, "-o", "a.exr") == 0
    err = capsys.readouterr().err
    assert err.count("the render goes on") == 1 and "No space left" in err
    same("a.exr", whole)


def test_sums_take_no_room_that_the_picture_needs(folder, whole, monkeypatch, capsys):
    monkeypatch.setattr(keeper, "free_space", lambda _: 10_000)
    assert interrupt(monkeypatch, 3, *WORDS, "-o", "a.exr") == 130
    assert "the disk has no room for a.sums.exr" in capsys.readouterr().err
    assert read_image("a.exr").attributes["spp"] == 12
    assert not os.path.exists("a.sums.exr")


def test_names_as_long_as_they_may_be(folder, monkeypatch):
    name = "é" * 125 + "x.exr"
    assert len(os.fsencode(name)) == 255
    assert interrupt(monkeypatch, 3, *WORDS, "-q", "-o", name) == 130
    assert render(*WORDS, "-q", "-o", name) == 0
    assert read_image(name).attributes["spp"] == 22
    assert len(os.listdir()) == 3


# ---------------------------------------------------------------- real signals


# the program, which counts its passes in a file, by its size
COUNTING = """
import sys
from mitsuba_bezier.rendering import passes
real = passes.render_pass
def counted(*words):
    done = real(*words)
    with open("passes", "ab", 0) as file:
        file.write(b".")
    return done
passes.render_pass = counted
from mitsuba_bezier.cli.main import main
sys.exit(main())
"""


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
@pytest.mark.parametrize(
    ("name", "code", "word"),
    [("SIGTERM", 143, "terminated"), ("SIGINT", 130, "interrupted"), ("SIGKILL", -9, "")],
)
def test_a_signal_keeps_what_is_there(folder, name, code, word):
    words = ["ball.xml", "--spp", "1000000", "--spp-per-pass", "64", "-o", "a.exr"]
    # by itself it writes after the first pass only
    process = subprocess.Popen(
        [sys.executable, "-c", COUNTING, "render", *words, "--save-every", "100000"],
        stderr=subprocess.PIPE,
        text=True,
        env=dict(os.environ, PYTHONPATH=str(Path(mb.__file__).parents[1])),
    )
    try:
        while process.poll() is None:
            if os.path.exists("a.png") and os.path.getsize("passes") > 3:
                break
            time.sleep(0.05)
        process.send_signal(getattr(signal, name))
        _, err = process.communicate(timeout=600)
    finally:
        process.kill()
    assert process.returncode == code
    spp = read_image("a.exr").attributes["spp"]
    assert spp >= 64 and spp % 64 == 0
    assert read_image("a.sums.exr").attributes["spp"] == spp
    if word:
        assert err.splitlines()[-1] == (
            f"mitsuba-bezier: {word}, kept {spp} of 1000000 spp in a.exr; the same command goes on"
        )
        # what was rendered since the last time was written by the signal
        assert spp > 64
    assert "Traceback" not in err
    # so many passes in one run are these bits
    assert render("ball.xml", "-q", "--spp", str(spp), *words[3:5], "-o", "b.exr") == 0
    for channel, pixels in read_image("a.exr").channels.items():
        np.testing.assert_array_equal(pixels, read_image("b.exr").channels[channel])


# ---------------------------------------------------------------- what was reached


def test_what_was_reached_is_told(folder, capsys):
    words = ("ball.xml", "--spp", "64", "--spp-per-pass", "8", "--json", "a.json")
    assert render(*words, "-o", "a.exr") == 0
    document = json.loads(Path("a.json").read_text())
    assert document["spp"] == document["spp_asked"] == 64 and document["stopped_by"] == "spp"
    assert document["spp_before"] == 0 and 0 < document["noise"] < 0.2
    assert isinstance(read_image("a.exr"), Image)
    assert f"noise {document['noise']:.2%}" in capsys.readouterr().err


# ---------------------------------------------------------------- frames


def frames(*more: str):
    from mitsuba_bezier.cli import _frames

    said: list[str] = []
    todo = []
    for seed in (1, 2, 3):
        words = ["render", *WORDS, "--seed", str(seed), *more]
        todo.append((main.parse(words), Path(f"f{seed}.exr")))
    assert _frames.render_frames(todo, "llvm_ad_rgb", said.append) == [path for _, path in todo]
    return "\n".join(said)


def test_frames_that_are_there_stay_and_the_others_go_on(folder, monkeypatch):
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    real, count = passes.render_pass, 0

    def counted(*arguments):
        nonlocal count
        count += 1
        if count == 9:  # 6 passes of the first frame, 2 of the second
            raise KeyboardInterrupt
        return real(*arguments)

    monkeypatch.setattr(passes, "render_pass", counted)
    with pytest.raises(KeyboardInterrupt):
        frames("-q")
    assert read_image("f2.exr").attributes["spp"] == 8 and not os.path.exists("f3.exr")
    said = frames("-q")
    assert "frame 1 of 3 is there" in said and "going on from 8 spp in f2.sums.exr" in said
    assert count == 9 + 4 + 6
    assert said.count("is there") == 1 and frames("-q").count("is there") == 3
    assert render(*WORDS, "--seed", "2", "-q", "-o", "whole.exr") == 0
    same("f2.exr", "whole.exr")
    assert "is there" not in frames("-q", "--fresh")
    assert _frames_of_none() == []


def _frames_of_none() -> list[Path]:
    from mitsuba_bezier.cli import _frames

    return _frames.render_frames([], "llvm_ad_rgb", print)


# ---------------------------------------------------------------- good enough


@pytest.mark.parametrize("noise", [0.03, 0.012])
def test_it_stops_at_the_noise_asked_for(folder, capsys, noise):
    words = ("ball.xml", "-q", "--until-noise", str(noise), "--json", "-", "-o", "a.exr")
    assert render(*words) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["stopped_by"] == "noise" and found["noise_asked"] == noise
    # the last pass added a quarter of the samples at the most
    assert 0.8 * noise < found["noise"] <= noise
    assert read_image("a.exr").attributes["noise"] == pytest.approx(found["noise"], rel=1e-6)
    # and goes on from there to less, as in one run
    assert render(*words[:2], "--until-noise", str(noise / 2), "-o", "a.exr") == 0
    assert render(*words[:2], "--until-noise", str(noise / 2), "-o", "b.exr") == 0
    same("a.exr", "b.exr")


def test_it_stops_where_a_perfect_picture_would_look_alike(folder, capsys, monkeypatch):
    pytest.importorskip("flip_evaluator")
    from mitsuba_bezier.verification.flip import flip_map

    words = ("ball.xml", "-q", "--until-flip", "0.03@90%", "--json", "-")
    assert render(*words, "-o", "a.exr") == 0
    found = json.loads(capsys.readouterr().out)
    assert found["stopped_by"] == "flip" and found["flip_asked"] == 0.03
    assert found["flip_share"] == 0.9 and 0.02 < found["flip_expected"] <= 0.03
    # as FLIP against many samples has it
    assert render("ball.xml", "-q", "--spp", "20000", "--seed", "9", "-o", "many.exr") == 0
    images = []
    for name in ("many.exr", "a.exr"):
        channels = read_image(name).channels
        images.append(np.stack([channels[c] for c in "RGB"], axis=-1).astype(np.float64))
    true = float(np.quantile(flip_map(*images, "linear"), 0.9))
    # a small picture, and one draw of its noise
    assert true == pytest.approx(found["flip_expected"], rel=0.2)
    # and goes on from there to less, as in one run
    assert render("ball.xml", "-q", "--until-flip", "0.02@90%", "-o", "a.exr") == 0
    assert render("ball.xml", "-q", "--until-flip", "0.02@90%", "-o", "b.exr") == 0
    same("a.exr", "b.exr")
    monkeypatch.setitem(sys.modules, "flip_evaluator", None)
    assert render(*words, "-o", "c.exr") == 2
    assert "pip install 'mitsuba-bezier[compare]'" in capsys.readouterr().err


@pytest.mark.parametrize("text", ["0", "1", "0.1@", "0.1@0", "0.1@100%", "x", "nan", "0.1@nan%"])
def test_flip_errors_that_are_none(folder, text, capsys):
    assert render("ball.xml", "--until-flip", text) == 2
    assert "expected a FLIP error" in capsys.readouterr().err


def test_the_samples_are_the_upper_limit(folder, capsys):
    assert render("ball.xml", "--until-noise", "1e-4", "--spp", "20", "-o", "a.exr") == 0
    assert "of 0.01% (stopped by spp)" in capsys.readouterr().err
    assert read_image("a.exr").attributes["spp"] == 20
    assert not os.path.exists("a.sums.exr")


def test_it_stops_in_time(folder, monkeypatch):
    from mitsuba_bezier.rendering import goal

    now = 0.0
    real = passes.render_pass

    def slow(*arguments):
        nonlocal now
        now += 2.0
        return real(*arguments)

    monkeypatch.setattr(goal.time, "perf_counter", lambda: now)
    monkeypatch.setattr(passes, "render_pass", slow)
    words = ("ball.xml", "-q", "--spp-per-pass", "4", "--time", "15s", "-o", "a.exr")
    assert render(*words) == 0
    picture = read_image("a.exr").attributes
    # of 2 s each; an eighth would end after 16
    assert picture["spp"] == 28 and picture["stopped_by"] == "time"
    assert "spp_asked" not in picture
    assert render(*words) == 0  # and as long again
    assert read_image("a.exr").attributes["spp"] == 56


@pytest.mark.parametrize(
    ("flag", "value", "message"),
    [
        ("--until-noise", "0", "expected a relative error"),
        ("--until-noise", "200%", "expected a relative error"),
        ("--until-noise", "nan", "expected a relative error"),
        ("--time", "0", "expected a time"),
        ("--time", "10 parsecs", "expected a time"),
        ("--time", "-5m", "expected"),
        ("--save-every", "-1", "expected seconds"),
    ],
)
def test_values_that_are_none(folder, capsys, flag, value, message):
    assert render("ball.xml", f"{flag}={value}") == 2
    assert message in capsys.readouterr().err


def test_times_of_all_kinds():
    from mitsuba_bezier.cli._flags import duration, noise_level

    times = {"90": 90, "90s": 90, "10m": 600, "1h30m": 5400, "1.5 h": 5400, "2d": 172800}
    assert {text: duration(text) for text in times} == times
    assert noise_level("2%") == noise_level("0.02") == 0.02


def test_parts_end_at_their_samples_only(folder, capsys):
    assert render(*WORDS, "--part", "1/2", "--time", "5s") == 2
    assert "--part: expected no --until-noise, --until-flip, --time" in capsys.readouterr().err
