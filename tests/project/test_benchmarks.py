"""`benchmarks/speed.py` runs, and writes all its rows; what it measures is not judged here."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
COMMAND = ROOT / "benchmarks" / "speed.py"
PAGE = ROOT / "docs" / "performance.md"

TABLES = ["rays", "batch", "order", "reads", "compile", "render", "scale", "memory"]
SPHERES = ["sphere, tetrahedral", "sphere, octants", "sphere, general"]
SURFACES = [*SPHERES, "torus", "teapot"]
MESHES = ["mesh 65k", "mesh 1M", "mesh 16M"]


def run(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, str(COMMAND), *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=600,
        env={**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "250"},
    )


@pytest.fixture(scope="module")
def trial(tmp_path_factory) -> tuple[dict, str, Path, Path]:
    """A run of all tables: its data, what it printed, its file and its page."""
    folder = tmp_path_factory.mktemp("speed")
    file, page = folder / "speed.json", folder / "performance.md"
    page.write_text(PAGE.read_text(encoding="utf-8"), encoding="utf-8")
    done = run("--tiny", "--json", file, "--update-docs", "--page", page)
    assert done.returncode == 0, done.stderr
    return json.loads(file.read_text(encoding="utf-8")), done.stdout, file, page


def test_machine_and_versions(trial):
    data, printed, *_ = trial
    about = data["machine"]
    for key in ("variant", "mitsuba_bezier", "mitsuba", "drjit", "llvm", "processor", "cores"):
        assert about[key], key
        assert str(about[key]) in printed, key
    assert list(data["tables"]) == TABLES


def test_rays(trial):
    data, printed, *_ = trial
    table = data["tables"]["rays"]
    others = ["Mitsuba's sphere", *MESHES]
    pairs = [(s, o) for s in SPHERES for o in others]
    pairs += [("torus", "torus mesh 1M"), ("teapot", "teapot mesh 1M")]
    columns = [(r, q) for r in ("coherent", "random") for q in ("closest", "any")]
    ratios = {(r["surface"], r["against"], r["rays"], r["query"]): r for r in table["ratios"]}
    assert set(ratios) == {(*p, *c) for p in pairs for c in columns}
    # the requirements of the tables, at one place of each kind
    assert (
        ratios["sphere, tetrahedral", "Mitsuba's sphere", "coherent", "closest"]["required"] == 0.4
    )
    assert ratios["sphere, general", "Mitsuba's sphere", "random", "closest"]["required"] == 0.05
    assert ratios["sphere, general", "Mitsuba's sphere", "random", "any"]["required"] is None
    assert ratios["sphere, octants", "mesh 16M", "random", "any"]["required"] == 5.0
    assert ratios["teapot", "teapot mesh 1M", "coherent", "closest"]["required"] == 0.6
    speeds = {(r["surface"], r["rays"], r["query"]): r for r in table["speeds"]}
    names = [*SURFACES, *others, "torus mesh 1M", "teapot mesh 1M"]
    assert set(speeds) == {(n, *c) for n in names for c in columns}
    for rays in ("coherent", "random"):
        share = {n: speeds[n, rays, "any"]["hits"] for n in names}
        # the same surface is hit by the same rays, but for few at a mesh's coarse silhouette:
        # 64 triangles here for the 65k
        for name in [*SPHERES, *MESHES]:
            assert share[name] == pytest.approx(share["Mitsuba's sphere"], abs=0.08), name
        for name in ("torus", "teapot"):
            assert share[name] == pytest.approx(share[f"{name} mesh 1M"], abs=0.05), name
    ratio = ratios["torus", "torus mesh 1M", "random", "any"]["ratio"]
    ours, theirs = (speeds[n, "random", "any"] for n in ("torus", "torus mesh 1M"))
    assert ratio == pytest.approx(ours["rays_per_second"] / theirs["rays_per_second"])
    assert "torus mesh 1M" in printed


def test_order_of_rays(trial):
    rows = trial[0]["tables"]["order"]
    orders = ["scanlines", "tiles of 4 x 4", "tiles of 8 x 4", "Morton", "shuffled"]
    assert [(r["surface"], r["order"]) for r in rows] == [(s, o) for s in SURFACES for o in orders]


def test_rays_traced_at_once(trial):
    rows = trial[0]["tables"]["batch"]
    kinds = list(dict.fromkeys(r["rays"] for r in rows))
    assert [(r["rays"], r["surface"]) for r in rows] == [
        (k, s) for k in kinds for s in ("sphere, general", "torus", "teapot")
    ]
    apart = [r["apart"] for r in rows if r["surface"] == "torus"]
    assert apart == sorted(apart) and apart[-1] > 0.3  # the last are random
    assert not any(r["chosen"] for r in rows)  # too few in a trial run
    for r in rows:
        for query in ("closest", "any"):
            ratio = r[f"{query}, batch"] / r[f"{query}, each"]
            assert ratio == pytest.approx(r[query], rel=1e-9) and ratio > 0


def test_reads(trial):
    table = trial[0]["tables"]["reads"]
    reads = {(r["surface"], r["rays"]): r["reads"] for r in table["reads"]}
    assert set(reads) == {(s, r) for s in SURFACES for r in ("coherent", "random")}
    for (surface, _rays), kinds in reads.items():
        # a ray reads at least the root, if that is not a leaf, and fewer nodes than the tree has
        if surface in ("sphere, tetrahedral", "sphere, octants"):
            assert "nodes" not in kinds  # no tree is walked
        else:
            assert 1 <= kinds["nodes"]["records"] < 400, surface
    # a single quadric is not gathered, only its patches; the others read quadratics and nets
    assert reads["sphere, tetrahedral", "random"].keys() == {"members", "inverses"}
    assert reads["sphere, general", "random"].keys() >= {"nodes", "affine", "nets"}
    # about 0.9 of the random rays hit the sphere: each hit reads a net, few rays more than two
    assert 0.5 < reads["sphere, general", "random"]["nets"]["records"] < 3
    assert len(table["rates"]) == 6
    assert all(r["packets_per_second"] > 0 for r in table["rates"])


def test_compile(trial):
    rows = trial[0]["tables"]["compile"]
    names = [
        f"{s}, {q} hit"
        for s in ("sphere, tetrahedral", "sphere, general", "teapot")
        for q in ("closest", "any")
    ]
    names += ["Mitsuba's sphere, path", "Mitsuba's sphere, bezierpath"]
    names += [f"{s}, bezierpath" for s in SPHERES]
    assert [r["what"] for r in rows] == names
    # the cache was empty: what comes first was compiled, and only once
    assert rows[0]["compile"] > 0
    assert [r["compiled_again"] for r in rows] == [0] * len(rows)


def test_render(trial):
    rows = {r["scene"]: r for r in trial[0]["tables"]["render"]}
    ours = ["Mitsuba's sphere, bezierpath", *(f"{s}, bezierpath" for s in SPHERES)]
    assert list(rows) == ["Mitsuba's sphere, path", *ours, *(f"{m}, path" for m in MESHES)]
    for name, row in rows.items():
        assert row["kernels"] >= 1, name
        # a second render, and one after control points have changed, compile nothing
        assert row["compiled_again"] == row["compiled_after_update"] == 0, name
        # paths are not stored, which would take a hundred bytes each; the rest is rounding of
        # allocations, a few hundred bytes over 256 samples
        assert abs(row["bytes_per_sample"]) < 16, name
        # 512 paths: the means scatter by some 10 %
        assert 0.2 < row["mean"] < 1.2, name


def test_scale(trial):
    rows = trial[0]["tables"]["scale"]
    names = ["sphere, tetrahedral", "sphere, octants", "height field, 1", "height field, 20"]
    assert [r["surface"] for r in rows] == [*names, "balls, 1", "balls, 20"]
    assert [r["patches"] for r in rows] == [10, 8, 1, 20, 10, 20]
    for row in rows:
        assert set(row["parts"]) == {"leaves", "tree", "upload"}
        assert row["leaves"] >= row["patches"]
        assert 32 <= row["bytes_per_leaf"] < 2000  # at least a box
        assert row["update"]["all"]["wall"] > 0 and row["update"]["few"]["wall"] > 0
    assert rows[0]["net_bytes_per_leaf"] == 0  # closed forms have no net
    assert rows[2]["net_bytes_per_leaf"] >= 10 * 16  # ten control points of four floats


def test_memory(trial):
    rows = {r["scene"]: r for r in trial[0]["tables"]["memory"]}
    spheres = ["sphere, tetrahedral", "sphere, octants", "Mitsuba's sphere"]
    assert list(rows) == ["no scene", *spheres, "mesh 16M"]
    assert rows["mesh 16M"]["of_mesh"] == 1
    assert all(row["peak"] > 2**24 for row in rows.values())  # Python alone is larger


def test_page_and_earlier_run(trial, tmp_path):
    _data, printed, file, page = trial
    text = page.read_text(encoding="utf-8")
    for name in TABLES:
        (block,) = re.findall(f"<!-- {name} -->(.*?)<!-- end of {name} -->", text, re.DOTALL)
        assert block.count("\n|") >= 3, name
    # what is around the tables stays
    around = re.compile(r"(<!-- (\w+) -->).*?(<!-- end of \2 -->)", re.DOTALL)
    assert around.sub(r"\1\3", text) == around.sub(r"\1\3", PAGE.read_text(encoding="utf-8"))
    again = tmp_path / "performance.md"
    again.write_text(PAGE.read_text(encoding="utf-8"), encoding="utf-8")
    done = run("--from", file, "--update-docs", "--page", again)
    assert done.returncode == 0, done.stderr
    assert again.read_text(encoding="utf-8") == text
    assert done.stdout == printed


def test_mistakes_have_one_line(tmp_path):
    done = run("--tables", "rays,colour")
    assert done.returncode == 2 and "got 'colour'" in done.stderr
    done = run("--tiny", "--variant", "no_such_variant", "--tables", "scale")
    assert done.returncode == 1
    assert done.stderr.startswith("the variant no_such_variant does not start here: ")
    assert len(done.stderr.splitlines()) == 1
