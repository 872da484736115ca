"""The conformance set: its cases, its file, and the runner that scores answers."""

from __future__ import annotations

import json
from fractions import Fraction

import numpy as np
import pytest

from mitsuba_bezier.cli import main as cli
from mitsuba_bezier.geometry.triangles import BezierTriangles
from mitsuba_bezier.oracles.conformance import entry, read_set, write_set
from mitsuba_bezier.oracles.conformance_cases import FAMILIES, QUADRICS, Case, cases
from mitsuba_bezier.oracles.conformance_score import UNITS, answer, score
from mitsuba_bezier.oracles.reference import intersect_all


@pytest.fixture(scope="module")
def exact(tmp_path_factory):
    """Return the path of a small set with every family."""
    path = tmp_path_factory.mktemp("set") / "set.jsonl"
    write_set(path, cases(seed=3, degrees=(1, 2, 3), patches=2, rays=6))
    return path


def reference(net, origins, directions):
    """Return what `reference` finds, in the form of an intersector."""
    with np.errstate(divide="ignore", invalid="ignore"):
        found = intersect_all(BezierTriangles(net), origins, directions)
    finite = np.isfinite(found.t)
    return [found.t[finite & (found.ray == k)].tolist() for k in range(len(origins))]


def rays_of(path):
    return [(entry, ray) for entry in read_set(path) for ray in entry["rays"]]


def test_equal_seeds_give_equal_cases_and_others_do_not():
    one, two, other = (list(cases(seed, (2,), 1, 3)) for seed in (0, 0, 1))
    assert {case.family for case in one} == set(FAMILIES)
    for a, b in zip(one, two):
        assert (a.net == b.net).all() and (a.origins == b.origins).all()
    assert any((a.net != b.net).any() for a, b in zip(one, other))


def test_a_family_has_the_same_cases_alone():
    every = [case for case in cases(0, (3,), 2, 3) if case.family == "cusp"]
    alone = list(cases(0, (3,), 2, 3, ("cusp",)))
    assert len(alone) == 2
    assert all((a.net == b.net).all() for a, b in zip(every, alone))


def test_every_family_has_what_it_is_named_for(exact):
    found: dict[str, list[dict]] = {}
    for row, ray in rays_of(exact):
        found.setdefault(row["family"], []).extend(ray["roots"])
    assert set(found) == set(FAMILIES)
    for family in ("grazing", "cusp"):
        assert sum(root["multiplicity"] > 1 for root in found[family]) >= 4
    assert any(root["t"] is None for root in found["infinite"])
    on_edge = [root for root in found["edge"] if min(root["u"], root["v"]) == 0]
    assert on_edge or any(root["u"] + root["v"] == 1 for root in found["edge"])
    assert all(root["multiplicity"] == 1 and root["margin"] > 0 for root in found["random"])
    for row in read_set(exact):
        if row["family"] == "base point":
            net = BezierTriangles(np.array(row["net"]))
            eighths = np.array([(i, j) for i in range(9) for j in range(9 - i)]) / 8
            x = net.evaluate(np.zeros(len(eighths), dtype=int), eighths)
            assert np.abs(x).max(axis=1).min() == 0


def test_roots_on_quadrics_satisfy_the_equation_to_all_digits(exact, tmp_path):
    write_set(tmp_path / "quartics", cases(3, (4,), 1, 6, ("quadric",)))
    count = 0
    for row, ray in rays_of(exact) + rays_of(tmp_path / "quartics"):
        for root in ray["roots"] if row["family"] == "quadric" else []:
            t = Fraction(root["digits"])
            x = [Fraction(o) + t * Fraction(d) for o, d in zip(ray["origin"], ray["direction"])]
            x.append(Fraction(1))
            values = [
                sum(int(a[i, j]) * x[i] * x[j] for i in range(4) for j in range(4))
                for a, _point in QUADRICS
            ]
            # 30 digits of t, of terms of this size, three of which may be lost
            size = float(sum(y * y for y in x))
            assert min(abs(float(value)) for value in values) < 1e-26 * size
            count += 1
    assert count >= 10


def test_digits_are_more_than_a_float_has(exact):
    roots = [root for _entry, ray in rays_of(exact) for root in ray["roots"] if "digits" in root]
    assert len(roots) > 100
    for root in roots:
        assert float(root["digits"]) == root["t"]
        assert abs(Fraction(root["digits"]) - Fraction(root["t"])) <= abs(root["t"]) * 2.0**-53


def test_both_arithmetics_have_the_same_firm_roots(exact, tmp_path):
    write_set(tmp_path / "float", cases(3, (1, 2, 3), 2, 6), "float64")
    count = 0
    floats = {json.dumps([r["origin"], r["direction"]]): r for _e, r in rays_of(tmp_path / "float")}
    for _entry, ray in rays_of(exact):
        other = floats[json.dumps([ray["origin"], ray["direction"]])]
        one, two = (
            [(r["t"], r["condition"]) for r in x["roots"] if r["margin"] > 1e-9 and r["condition"]]
            for x in (ray, other)
        )
        assert len(one) == len(two)
        for (t, condition), (s, _c) in zip(sorted(one), sorted(two)):
            assert abs(t - s) < 100 * 2.0**-53 * condition
            count += 1
    assert count > 100


def test_a_change_of_one_unit_moves_a_root_by_its_condition():
    rng = np.random.default_rng(0)
    unit = 1e-6
    for case in cases(5, (2, 3), 2, 4, ("random", "infinite")):
        roots = [reference(case.net, case.origins, case.directions)]
        moved = case.net * (1 + unit * rng.uniform(-1, 1, case.net.shape))
        roots.append(reference(moved, case.origins, case.directions))
        for ray, (one, two) in zip(entry(case)["rays"], zip(*roots)):
            for root in ray["roots"]:
                if root["condition"] and root["margin"] > 100 * unit:
                    a = min(one, key=lambda t: abs(t - root["t"]))
                    b = min(two, key=lambda t: abs(t - a))
                    # first order: a tenth more for what follows, at a hundredth of the margin
                    assert abs(b - a) <= 1.1 * unit * root["condition"]


def test_the_reference_passes(exact, tmp_path):
    answer(tmp_path / "a", exact, reference, "reference", "double", first=False)
    head, scores = score(exact, tmp_path / "a")
    assert head["name"] == "reference"
    assert sum(s.missed + s.extra + s.refused for s in scores.values()) == 0
    assert sum(s.firm for s in scores.values()) > 150
    # the reference loses some roundings in its coefficients
    assert max(max(s.errors, default=0) for s in scores.values()) < 30


@pytest.mark.parametrize(
    ("change", "first", "missed", "extra"),
    [
        (lambda t: t[1:], False, 1, 0),  # one root lost
        (lambda t: [*t, 50.0], False, 0, 1),  # one too many
        (lambda t: [x * (1 + 1e-5) for x in t], False, 0, 0),  # inexact
        (lambda t: t[:1], True, 0, 0),
        (lambda t: t[1:2], True, 1, 0),  # the second in place of the first
        (lambda t: [], True, 1, 0),
        (lambda t: [t[0] / 2], True, 1, 1),  # where nothing is
    ],
)
def test_what_is_counted(change, first, missed, extra, tmp_path):
    # x = u, y = v, z = (u - 1/2)^2: met twice from the side
    net = np.zeros((6, 4))
    net[:, 0], net[:, 1], net[:, 3] = [1, 0.5, 0.5, 0, 0, 0], [0, 0.5, 0, 1, 0.5, 0], 1
    net[:, 2] = [0.25, -0.25, -0.25, 0.25, 0.25, 0.25]
    case = Case("random", net, np.array([[-1.0, 0.125, 0.0625]]), np.array([[1.0, 0, 0]]))
    write_set(tmp_path / "set", [case])
    (line,) = read_set(tmp_path / "set")
    t = [root["t"] for root in line["rays"][0]["roots"]]
    assert t == [1.25, 1.75]
    answer(tmp_path / "a", tmp_path / "set", lambda *_: [change(t)], "x", "single", first)
    ((name, s),) = score(tmp_path / "set", tmp_path / "a")[1].items()
    assert (name, s.firm, s.missed, s.extra) == ("random 2", 1 if first else 2, missed, extra)
    if change(t)[:1] == [1.25 * (1 + 1e-5)]:
        condition = line["rays"][0]["roots"][0]["condition"]
        assert s.errors[0] == pytest.approx(1.25e-5 / condition / UNITS["single"])


def test_refused_patches_and_wrong_files(exact, tmp_path):
    answer(tmp_path / "a", exact, lambda *_: None, "nothing", "double", first=False)
    scores = score(exact, tmp_path / "a")[1]
    assert all(s.refused == s.rays and s.firm == 0 for s in scores.values())
    (tmp_path / "b").write_text("\n".join((tmp_path / "a").read_text().splitlines()[:-1]))
    with pytest.raises(ValueError, match=r"expected \d+ lines, precision single or double"):
        score(exact, tmp_path / "b")
    with pytest.raises(ValueError, match="expected bezier-triangle-answers, version 1"):
        score(exact, exact)
    (tmp_path / "c").write_text("{")
    for name in ("c", "missing"):
        with pytest.raises(ValueError, match="expected JSON lines"):
            list(read_set(tmp_path / name))


def test_the_command_makes_and_scores(tmp_path, capsys):
    where = tmp_path / "set.jsonl"
    words = ["--degrees", "2", "--patches", "1", "--family", "random"]
    assert cli.main(["conformance", "make", str(where), *words]) == 0
    answer(tmp_path / "a", where, reference, "reference", "double", first=False)
    answer(tmp_path / "b", where, lambda n, o, d: [[]] * len(o), "blind", "double", first=True)
    assert cli.main(["conformance", "score", str(where), str(tmp_path / "a")]) == 0
    assert "reference: double precision, all hits" in capsys.readouterr().out
    assert cli.main(["conformance", "score", str(where), str(tmp_path / "b"), "--degree"]) == 1
    assert "| random 2 | 6 | 0 |" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--degrees", "0"], "expected degrees from 1 to 8"),
        (["--degrees", "2,x"], "expected degrees from 1 to 8"),
        (["--patches", "-1"], "expected an integer from 0 up"),
        (["--family", "easy"], "--family: expected random or grazing or"),
    ],
)
def test_wrong_usage_of_the_command(words, message, tmp_path, capsys):
    try:
        code = cli.main(["conformance", "make", str(tmp_path / "x"), *words])
    except SystemExit as end:
        code = int(end.code or 0)
    assert code == 2 and message in capsys.readouterr().err
    assert not (tmp_path / "x").exists()
