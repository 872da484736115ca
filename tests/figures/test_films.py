"""Films: frames are kept, and what is there is not drawn again."""

from __future__ import annotations

import sys

import numpy as np
import pytest

pytest.importorskip("matplotlib", reason="figures need the extra 'figures'")

from mitsuba_bezier.cli.main import main
from mitsuba_bezier.errors import BezierError, RuntimeSetupError
from mitsuba_bezier.figures import films, names


@pytest.mark.parametrize("name", films.FILMS)
def test_every_film_has_frames(name, tmp_path):
    assert films.FILMS[name].figure in names()
    paths = [path for path, _new in films.film_frames(name, tmp_path, frames=3, width=160)]
    assert len(set(paths)) >= 2
    sizes = {path.stat().st_size for path in paths}
    assert len(sizes) > 1  # something moves
    values = films.FILMS[name].values(np.linspace(0, 1, 50))
    assert np.isfinite(values).all()


def test_the_weight_goes_once_around():
    w = films.FILMS["weight"].values(np.arange(400) / 400)
    angle = np.unwrap(2 * np.arctan(w)) / 2
    assert abs(angle[0] - np.pi / 4) < 1e-6 and abs(angle[-1] + 3 * np.pi / 4) < 0.01
    assert (np.diff(angle) < 0).all()


def test_a_film_goes_on_where_it_was_broken_off(tmp_path):
    keep = tmp_path / "frames"
    first = list(films.film_frames("decasteljau", keep, frames=4, width=64))
    assert sum(new for _path, new in first) == len({path for path, _new in first})
    gone = first[1][0]
    gone.write_bytes(b"half a frame")
    again = list(films.film_frames("decasteljau", keep, frames=4, width=64))
    assert [path for path, new in again if new] == [gone]
    # other arguments are other frames
    assert all(new for _p, new in films.film_frames("decasteljau", keep, frames=2, width=66))


@pytest.mark.parametrize("suffix", films.SUFFIXES)
def test_films_are_written(suffix, tmp_path, capsys):
    if suffix == ".mp4":
        pytest.importorskip("imageio_ffmpeg", reason="MP4 needs the extra 'figures'")
    path = tmp_path / f"film{suffix}"
    words = ["film", "decasteljau", "-o", str(path), "--frames", "4", "--width", "101"]
    assert main(words) == 0
    assert "wrote" in capsys.readouterr().out
    assert len(list((tmp_path / "film_frames").iterdir())) == 3  # to and fro: one comes twice
    data = path.read_bytes()
    if suffix == ".gif":
        from PIL import Image

        with Image.open(path) as film:
            assert film.n_frames == 4 and film.size[0] == 100
        assert main([*words, "-q"]) == 0
        assert path.read_bytes() == data  # the same frames, the same film
    else:
        assert b"ftyp" in data[:16]


def test_the_command_lists_films(capsys):
    assert main(["film"]) == 0
    out = capsys.readouterr().out
    assert all(name in out for name in films.FILMS)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["nothing"], "name: expected one of decasteljau"),
        (["decasteljau", "-o", "a.avi"], "-o: expected a suffix .gif, .mp4"),
        (["decasteljau", "--frames", "1"], "frames: expected an integer >= 2"),
        (["decasteljau", "--width", "2"], "width: expected an integer >= 16"),
        (["decasteljau", "--fps", "0"], "fps: expected an integer >= 1"),
        (["decasteljau", "--frames", "2", "--style", "gold"], "style: expected one of"),
    ],
)
def test_mistakes_take_one_line(words, says, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["film", *words]) == 2
    err = capsys.readouterr().err
    assert says in err and err.count("\n") == 1
    assert not list(tmp_path.glob("*.gif"))


def test_without_ffmpeg_there_is_one_clear_error(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(RuntimeSetupError, match="mitsuba-bezier\\[figures\\]"):
        films.save_film("decasteljau", tmp_path / "a.mp4", frames=2, width=64)
    assert not list(tmp_path.iterdir())
    with pytest.raises(BezierError, match="suffix"):
        films.save_film("decasteljau", tmp_path / "a.mov")
