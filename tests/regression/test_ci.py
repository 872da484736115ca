"""What CI sees of a run: summaries, annotations, shards, workers, history, bisection."""

from __future__ import annotations

import json
import os
import re
import subprocess

import numpy as np
import pytest
from pytest_cases import HEAD, SAME, Project

from mitsuba_bezier.cli.main import main
from mitsuba_bezier.regression.artifacts import Artifacts
from mitsuba_bezier.verification import calibration
from mitsuba_bezier.verification.images import Image
from mitsuba_bezier.verification.records import Record, without_folders
from mitsuba_bezier.verification.summary import github_lines, markdown

pytest_plugins = ["pytester"]


@pytest.fixture
def project(pytester, request):
    return Project(pytester, request)


TWO = SAME + SAME.replace("test_same", "test_other").replace("'ball'", "'other'")


def test_summary_annotations_history_and_shards(project, monkeypatch):
    project.write(TWO)
    project.run("--bezier-accept").assert_outcomes(skipped=2)
    project.write(TWO.replace("scene(), 'other'", "scene(6.0), 'other'"))
    monkeypatch.setenv("GITHUB_ACTIONS", "true")
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", str(project.path / "step.md"))
    monkeypatch.setenv("GITHUB_REF_NAME", "feature")
    for shard, name in ((1, "same"), (2, "other")):
        result = project.run(
            *("-k", f"test_{name}", "-o", f"bezier_artifact_dir=shard-{shard}"),
            *("--bezier-history", "runs"),
        )
        result.assert_outcomes(**{"passed" if shard == 1 else "failed": 1}, deselected=1)
    result.stdout.fnmatch_lines(
        ["::error file=test_ball.py,title=test_ball.py%3A%3Atest_other other::changed: Z-test *"]
    )
    first, second = (project.path / "step.md").read_text(encoding="utf-8").split("###")[1:]
    assert first.strip().startswith("✅ Renders: 1 unchanged") and "branch feature" in first
    assert "❌ Renders: 1 changed" in second and "| ❌ | other |" in second
    assert "`mitsuba-bezier accept shard-2/report.html`" in second
    monkeypatch.delenv("GITHUB_STEP_SUMMARY")

    # shards are one report, in which all can be accepted
    monkeypatch.chdir(project.path)
    assert main(["report", "shard-1", "shard-2/results.json", "-o", "all/report.html"]) == 1
    assert [e["change"] for e in project.entries("all/report.html")] == ["changed", "unchanged"]
    assert project.entries("all/report.html")[0]["panels"]
    assert main(["accept", "all/report.html"]) == 0
    result = project.run("-n", "2", "--bezier-history", "runs")
    result.assert_outcomes(passed=2)

    assert main(["history", "runs", "-o", "history.html"]) == 0
    assert len(list((project.path / "runs").iterdir())) == 3
    page = (project.path / "history.html").read_text(encoding="utf-8")
    assert page.count("<h2>") == 2 and "Z-test, share that fails" in page
    # one red run of one image, in the plots of RMSE, relative MSE, Z-test, and FLIP if it is there
    assert page.count('class="dot bad"') in (3, 4) and page.count('class="limit"') == 2


def test_a_checkout_that_is_read_only(project, monkeypatch, tmp_path_factory):
    project.write(SAME)
    project.run("--bezier-accept").assert_outcomes(skipped=1)
    project.write(SAME.replace("scene()", "scene(6.0)"))
    spare = tmp_path_factory.mktemp("temporary")
    monkeypatch.setenv("TMPDIR", str(spare))
    # no folder can be made below a file, whoever asks
    (project.path / "blocked").touch()
    result = project.run("-o", "bezier_artifact_dir=blocked/artifacts")
    result.assert_outcomes(failed=1)
    (page,) = spare.rglob("report.html")
    result.stdout.fnmatch_lines([f"report: {page}"])
    assert sorted(p.name for p in page.parent.rglob("*.exr")) == ["ball.candidate.exr", "ball.exr"]


def test_lists_of_files_lead_nowhere_else(tmp_path):
    folder, victim = tmp_path / "artifacts", tmp_path / "victim.txt"
    folder.mkdir()
    victim.touch()
    (tmp_path / "away").mkdir()
    (tmp_path / "away/file").touch()
    (folder / "link").symlink_to(tmp_path / "away")
    names = ["../victim.txt", str(victim), "link/file", "", "gone.exr", "a/b.exr"]
    (folder / "files.txt").write_text("\n".join(names))
    (folder / "a").mkdir()
    (folder / "a/b.exr").touch()
    Artifacts(folder).clean()
    assert victim.exists() and (tmp_path / "away/file").exists()
    assert sorted(p.name for p in folder.iterdir()) == ["link"]


NASTY = "a|b`c`<img src=x>\n::error::x [y](z) @team"


def test_nothing_breaks_out_of_summaries():
    record = Record(NASTY, f"{NASTY}::t", NASTY, "changed", notes=[NASTY], message=NASTY)
    text = markdown({"branch": NASTY, "commit": "1", "report": NASTY}, [record])
    (row,) = [line for line in text.splitlines() if line.startswith("| ❌")]
    assert len(re.findall(r"(?<!\\)\|", row)) == 5 and "<img" not in text.replace("`", "")[:500]
    assert "@team" not in row and "[y]" not in row
    lines = github_lines([record])
    assert len(lines) == 2 and all("\n" not in line for line in lines)


def test_no_absolute_path_is_left():
    text = "x: expected '/home/me/project/a b.exr', got /opt/x/y.exr; C:\\Users\\me\\z.exr"
    told = without_folders(text, ["/home/me/project"])
    assert told == "x: expected 'a b.exr', got y.exr; z.exr"
    assert without_folders("https://a.b/c/d and 1/2 and ./a/b and a/b") == (
        "https://a.b/c/d and 1/2 and ./a/b and a/b"
    )


def git(folder, *words):
    environment = {
        **os.environ,
        **{
            f"GIT_{who}_{what}": "x@y"
            for who in ("AUTHOR", "COMMITTER")
            for what in ("NAME", "EMAIL")
        },
    }
    subprocess.run(
        ["git", "-C", str(folder), *words], check=True, capture_output=True, env=environment
    )


def test_bisection_finds_the_commit_that_changed_an_image(project, monkeypatch, capsys):
    monkeypatch.chdir(project.path)
    git(project.path, "init", "-b", "main")
    tests = SAME.replace("scene()", "scene(RADIANCE)").replace(
        "'ball'", "'ball', reference_passes=16"
    )
    project.makepyfile(
        test_ball="from lamps import RADIANCE\n" + HEAD.format(variant="scalar_rgb") + tests
    )
    lamps = project.path / "lamps.py"
    lamps.write_text("RADIANCE = 1.0\n")
    project.run("--bezier-accept").assert_outcomes(skipped=1)
    for number, text in enumerate(["1.0", "1.0 # b", "nonsense", "6.0", "6.0 # e"]):
        lamps.write_text(f"RADIANCE = {text}\n")
        git(project.path, "add", "-A", ":!bezier-artifacts")
        git(project.path, "commit", "--allow-empty", "-m", f"change {number}")
    (project.path / "mine.txt").write_text("work in progress")
    assert main(["bisect", "HEAD~4", "HEAD", "test_ball.py::test_same"]) == 0
    out = capsys.readouterr().out
    assert re.search(r"first changed: \w{40} change 3\nor one of those before it .*: \w{10}\n", out)
    assert "untested" in out
    listed = subprocess.run(["git", "worktree", "list"], capture_output=True, text=True).stdout
    assert len(listed.splitlines()) == 1 and (project.path / "mine.txt").exists()
    for words, message in (
        (["HEAD", "HEAD~4"], "BAD: expected a commit after HEAD"),
        (["none", "HEAD"], "GOOD: expected a commit, got 'none'"),
        (["--", "-x", "HEAD"], "GOOD: expected a commit, got '-x'"),
    ):
        assert main(["bisect", *words, "test_ball.py::test_same"]) == 2
        assert message in capsys.readouterr().err


def test_rare_bright_samples_lower_what_must_pass():
    rng = np.random.default_rng(3)
    spp = 16

    def render(bright):
        base = rng.normal(0.5, 0.1 / 4, (32, 48))
        hits = rng.random((32, 48)) < bright
        return {"Y": (base + hits * 2.0).astype(np.float32)}

    assert calibration.own_shares([render(0) for _ in range(32)], spp) == {}
    passes = [render(0.003) for _ in range(32)]
    share = calibration.own_shares(passes, spp)[""]
    # some 0.3 % of the pixels of a render have such a sample
    assert 0.98 < share < 0.9975
    header = {calibration.ATTRIBUTE: json.dumps({"": share})}
    image = Image(passes[0], header)
    assert calibration.passing_share(image, "") == share
    for text in ("{", "[]", '{"": 0}', '{"": 2.0}', '{"": "x"}', "{}"):
        image = Image(passes[0], {calibration.ATTRIBUTE: text})
        assert calibration.passing_share(image, "") == 0.9975
