"""Films of models: frames that differ, are kept, and make a file that players read."""

from __future__ import annotations

import os

import numpy as np
import pytest
from cli_cases import render

import mitsuba_bezier as mb
from mitsuba_bezier.errors import BezierError
from mitsuba_bezier.models.camera import read_up, read_view, view_frame
from mitsuba_bezier.models.frames import animated, read_animation, turntable
from mitsuba_bezier.models.scene import Look, models_of

SMALL = ("--size", "40x30", "--spp", "4", "-q")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    mb.save(mb.torus((0, 0, 1), 2, tube=0.7), tmp_path / "ring.vtu")
    mb.save(mb.sphere((4, 0, 1)), tmp_path / "ball.vtu")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_turntable_of_every_format(folder):
    imageio = pytest.importorskip("imageio.v3")
    words = ("ring.vtu", "ball.vtu", "--turntable", "2", "--view", "20,60", *SMALL)
    assert render(*words, "-o", "turn.gif") == 0
    kept = sorted(os.listdir("turn.frames"))
    assert kept == [f"0000{k}.{end}" for k in range(2) for end in ("exr", "png")]
    for suffix in (".gif", ".webp", ".mp4"):
        if suffix == ".mp4":
            pytest.importorskip("imageio_ffmpeg")
        # the frames are those of the same folder
        assert render(*words, "-o", f"turn{suffix}") == 0
        if suffix == ".mp4":
            frames = imageio.imread("turn.mp4", index=None, plugin="FFMPEG")
        else:
            from PIL import Image, ImageSequence

            with Image.open(f"turn{suffix}") as film:
                frames = np.stack(
                    [np.array(f.convert("RGB")) for f in ImageSequence.Iterator(film)]
                )
        assert frames.shape[:3] == (2, 30, 40), suffix
        assert all(np.ptp(f[..., :3]) > 60 for f in frames)
        assert np.abs(frames[0].astype(float) - frames[1]).max() > 60


def test_frames_that_are_there_are_not_rendered_again(folder, capsys):
    pytest.importorskip("imageio")
    words = ("ball.vtu", "--turntable", "2", *SMALL[:-1], "-o", "turn.gif")
    assert render(*words) == 0
    for name in os.listdir("turn.frames"):  # some file systems count whole seconds
        os.utime(f"turn.frames/{name}", (1e9, 1e9))
    before = {
        name: os.stat(f"turn.frames/{name}").st_mtime_ns for name in os.listdir("turn.frames")
    }
    os.remove("turn.frames/00001.exr")
    capsys.readouterr()
    assert render(*words) == 0
    err = capsys.readouterr().err
    assert "frame 2 of 2" in err and "frame 1 of 2" not in err and "1 of them from before" in err
    after = {name: os.stat(f"turn.frames/{name}").st_mtime_ns for name in os.listdir("turn.frames")}
    assert {name for name in after if after[name] != before[name]} == {"00001.exr", "00001.png"}
    # another film in the same place: nothing of it is of use
    assert render(*words, "--view", "top") == 0
    assert "from before" not in capsys.readouterr().err


def test_steps_and_a_weight_that_runs(folder):
    pytest.importorskip("imageio")
    assert render("ball.vtu", "ring.vtu", "--sequence", *SMALL, "-o", "steps.gif") == 0
    assert len(os.listdir("steps.frames")) == 4
    words = ("ball.vtu", "--animate", "weight:0,4,1,-1", "--frames", "2", *SMALL)
    assert render(*words, "-o", "w.gif") == 0
    assert len(os.listdir("w.frames")) == 4


def test_a_turn_keeps_its_distance_and_sees_everything():
    models = models_of(mb.sphere((5, 0, 0)))
    frames = turntable(models, Look(view="10,30", up="y"), 4)
    views = [read_view(frame.look.view) for frame in frames]
    assert np.allclose(views, [[10, 30], [100, 30], [-170, 30], [-80, 30]])
    spans = []
    for view, frame in zip(views, frames):
        rows = view_frame(*view, read_up("y")).rows
        spans.append(np.ptp(frame.framing.points @ rows.T, axis=0))
    # 24 turns, and quarters among them: the same points
    assert np.allclose(spans, spans[0])


def test_a_cut_stays_where_it_is_in_a_turn():
    frames = turntable(models_of(mb.sphere()), Look(section="x=0"), 3)
    assert len({frame.look.section for frame in frames}) == 1
    assert frames[0].look.section.endswith("<0.0") or frames[0].look.section.endswith("<-0.0")


def test_weights_run_evenly_and_points_stay():
    net = mb.sphere()
    made = animated(models_of(net), Look(), read_animation("weight:2,3,1,-1"), 5)
    rows = [frame.models[0].groups[0].control_points[2, 3] for frame in made]
    assert np.allclose([row[3] for row in rows], [1, 0.5, 0, -0.5, -1])
    place = net.control_points[2, 3, :3] / net.control_points[2, 3, 3]
    assert np.allclose(rows[0][:3], place) and np.allclose(rows[4][:3], -place)
    for words in ("weight:8,0,1,2", "weight:0,15,1,2"):
        with pytest.raises(BezierError, match="a patch below 8 and a point below 15"):
            animated(models_of(net), Look(), read_animation(words), 2)
    for words in ("mass:0,0,1,2", "weight:0,0,1", "weight:a,0,1,2", "weight:0,-1,1,2"):
        with pytest.raises(BezierError, match="weight:PATCH,POINT,FROM,TO"):
            read_animation(words)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--turntable", "0"], "from 1 to"),
        (["--turntable", "3", "--sequence"], "one of --turntable"),
        (["--turntable", "3", "-o", "a.exr"], ".gif, .mp4, .webp"),
        (["--frames", "3"], "--frames"),
        (["--fps", "3"], "--fps"),
        (["--turntable", "3", "--fps", "0"], "frames a second"),
        (["--animate", "weight"], "weight:PATCH,POINT,FROM,TO"),
    ],
)
def test_what_cannot_be_is_one_line(folder, capsys, words, message):
    if "-o" not in words and "--animate" in words:
        pytest.importorskip("imageio")
    assert render("ball.vtu", *words) == 2
    err = capsys.readouterr().err.strip().splitlines()
    assert message in err[-1]
    assert not [name for name in os.listdir() if name.endswith((".gif", ".exr"))]
