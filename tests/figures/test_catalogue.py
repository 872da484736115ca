"""The lecture's figures by name, and the command that draws them."""

from __future__ import annotations

import inspect
from itertools import cycle

import numpy as np
import pytest

pytest.importorskip("matplotlib", reason="figures need the extra 'figures'")

from mitsuba_bezier import figures
from mitsuba_bezier.cli.main import main
from mitsuba_bezier.errors import GeometryError
from mitsuba_bezier.figures.catalogue import CATALOGUE


@pytest.mark.parametrize(("name", "style"), list(zip(CATALOGUE, cycle(["screen", "print"]))))
def test_every_figure_is_drawn(name, style):
    d = figures.draw(name, style=style)
    a = d.pixels(400).astype(int)
    assert a.shape[1] == 400 and abs(a.shape[0] - 225) <= 2  # 16 : 9
    assert 0.003 < (a.min(axis=2) < 128).mean() < 0.6  # something, and not all of it, is dark
    if style == "print":
        assert np.ptp(a, axis=2).max() == 0
    make = CATALOGUE[name]
    assert make.__doc__ and make.__doc__.splitlines()[0].endswith(".")
    assert inspect.signature(make).parameters["style"].default == "screen"


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("decasteljau", {"t": 0.9}),
        ("weights", {"weight": -0.5}),
        ("conics_by_weight", {"weight": 3.0}),
        ("conics_by_weight", {"weight": 0.0}),
        ("conics_by_weight", {"weight": -1.0}),
        ("kepler", {"eccentricity": 1.0}),
        ("kepler", {"eccentricity": 3.0}),
        ("foci", {"eccentricity": 0.0}),
        ("foci", {"eccentricity": 1.0}),
        ("foci", {"eccentricity": 1.6}),
        ("conic_sections", {"tilt": 0.0}),
        ("conic_sections", {"tilt": 45.0}),
        ("conic_sections", {"tilt": 70.0}),
        ("vanishing_point", {"pitch": 20.0}),
        ("vanishing_point", {"pitch": -60.0}),
        ("bernstein", {"n": 5}),
        ("rational_triangle", {"weight": -0.2}),
    ],
)
def test_what_moves_is_an_argument(name, arguments):
    before, after = figures.draw(name).pixels(320), figures.draw(name, **arguments).pixels(320)
    assert (before != after).mean() > 1e-3


def test_the_command_lists_and_draws(capsys, tmp_path):
    assert main(["figure"]) == 0
    listed = capsys.readouterr().out
    assert all(name in listed for name in figures.names())
    target = tmp_path / "scheme.png"
    command = ["figure", "decasteljau", "-o", str(target), "--set", "t=0.7", "--width", "320"]
    assert main(command) == 0
    assert "wrote" in capsys.readouterr().out
    assert target.read_bytes() == figures.draw("decasteljau", t=0.7).encoded(".png", 320)
    assert main(["figure", "-q", "three_tangents", "ceva", "-o", str(tmp_path / "all")]) == 0
    assert capsys.readouterr().out == ""
    assert sorted(p.name for p in (tmp_path / "all").iterdir()) == [
        "ceva.svg",
        "three_tangents.svg",
    ]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["nothing"], "name: expected one of"),
        (["decasteljau", "--set", "t"], "--set: expected KEY=NUMBER"),
        (["decasteljau", "--set", "t=much"], "--set: expected KEY=NUMBER"),
        (["decasteljau", "--set", "q=1"], "argument of decasteljau"),
        (["decasteljau", "--set", "t=nan"], "t: expected finite numbers"),
        (["photograph", "--set", "x=nan"], "x: expected finite numbers"),
        (
            ["pole_and_polar", "--set", "x=0", "--set", "y=0"],
            "x, y: expected a point outside of the",
        ),
        (["sphere_point", "--set", "height=1"], "height: expected a point of the sphere"),
        (["bernstein", "--set", "n=1e9"], "n: expected an integer from 1 to 8"),
        (["bernstein_triangle", "--set", "n=0"], "n: expected an integer >= 1"),
        (["developable", "--set", "rulings=2.5"], "rulings: expected an integer >= 2"),
        (["decasteljau", "-o", "a.doc"], "-o: expected a suffix"),
        (["decasteljau", "--width", "1"], "width: expected 16"),
        (["decasteljau", "--style", "gold"], "style: expected one of"),
    ],
)
def test_mistakes_take_one_line(words, says, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["figure", *words]) == 2
    err = capsys.readouterr().err
    assert says in err and err.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_what_moves_is_a_number():
    with pytest.raises(GeometryError, match="t: expected"):
        figures.draw("decasteljau", t="half")
    with pytest.raises(GeometryError, match="weight: expected one number"):
        figures.draw("conics_by_weight", weight=[1, 2])


def test_in_a_film_numbers_have_two_decimals():
    from mitsuba_bezier.figures.catalogue._arguments import shown

    assert [shown(x) for x in (0.4, 1 / 3, -1e-9, -0.414213, 1e16)] == [
        "0.4", "0.33", "0", "-0.41", "\\infty",
    ]  # fmt: skip
