"""A run as a whole: what all tests recorded, references without a test, and the report."""

from __future__ import annotations

import os
import shlex
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import pytest

from .._files import write_file
from ..errors import BezierError
from ..verification import history, runs
from ..verification.accept import digest, fits
from ..verification.records import STATES, Record, relative, without_folders
from ..verification.summary import append_summary, github_lines, markdown
from .settings import Settings, settings

__all__ = ["Collector", "collected"]


def collected(session: pytest.Session) -> dict[str, Any]:
    """Return what a process collected: tests with the fixture, files, and whether all are there."""
    config = session.config
    items = [i for i in session.items if "render_regression" in getattr(i, "fixturenames", ())]
    folders: dict[str, str] = {}
    own = settings(config)
    for item in items:
        folders[str(item.path.parent)] = str(own.references(item.path))
    option = config.option
    part = any(
        (
            getattr(option, "keyword", ""),
            getattr(option, "markexpr", ""),
            getattr(option, "lf", False),
            getattr(option, "failedfirst", False) and getattr(option, "maxfail", 0),
            getattr(option, "deselect", None),
            getattr(option, "ignore", None),
            getattr(option, "ignore_glob", None),
            any("::" in str(arg) for arg in config.args),
            # one folder for all tests: those that are not asked for have theirs in it, too
            config.args_source == pytest.Config.ArgsSource.ARGS
            and not all(Path(place).is_relative_to(tests) for tests, place in folders.items()),
        )
    )
    return {
        "tests": [item.nodeid for item in items],
        "files": sorted({str(item.path) for item in session.items}),
        "folders": folders,
        "whole": not part and not session.testsfailed,
        "patterns": list(config.getini("python_files")),
    }


class Collector:
    """Gathers what the tests recorded, and writes what the run leaves."""

    def __init__(self, config: pytest.Config) -> None:
        self._config = config
        self._records: dict[str, Record] = {}
        self._lines: list[str] = []
        self._annotations: list[str] = []
        self._finished: set[str] = set()
        self._incomplete = False
        self._started = False
        self.found: list[dict[str, Any]] = []

    @property
    def _settings(self) -> Settings:
        return settings(self._config)

    @pytest.hookimpl(optionalhook=True)
    def pytest_configure_node(self, node: Any) -> None:
        """Let workers of pytest-xdist clean up, but for those that take a crashed one's place."""
        node.workerinput["bezier_clean"] = not self._started

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: Any, error: Any) -> None:
        """Take what a worker collected."""
        found = getattr(node, "workeroutput", {}).get("bezier_collected")
        if found:
            self.found.append(found)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Take what a test recorded; its last run counts."""
        self._started = True
        for data in getattr(report, "bezier_records", ()):
            record = Record.from_json(data)
            self._records[record.title] = record
            self._finished.add(record.test)
        if report.when != "teardown" and report.outcome == "skipped":
            self._incomplete = self._incomplete or report.nodeid not in self._finished

    @pytest.hookimpl(trylast=True)
    def pytest_sessionfinish(self, session: pytest.Session, exitstatus: int) -> None:
        """Write the report."""
        if self._config.getoption("--bezier-accept"):
            self._check_names(session)
        if not self._records:
            return
        if not self._settings.generates:
            for record in self._removed():
                self._records[record.title] = record
        records = runs.sort(list(self._records.values()))
        for line in _told(records):
            self._lines.append(line)
        try:
            self._write(records)
        except (BezierError, OSError) as error:
            self._lines.append(f"report not written: {error}")
            if self._config.getoption("--bezier-report") and session.exitstatus == 0:
                session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def _check_names(self, session: pytest.Session) -> None:
        for pattern in self._config.getoption("--bezier-accept"):
            if not any(fits(pattern, r.name, r.test) for r in self._records.values()):
                self._lines.append(f"--bezier-accept: no render is called {pattern!r}")
                if session.exitstatus in (0, pytest.ExitCode.NO_TESTS_COLLECTED):
                    session.exitstatus = pytest.ExitCode.USAGE_ERROR

    def _removed(self) -> list[Record]:
        """Return references that no test uses, where that is certain."""
        whole = bool(self.found) and all(f["whole"] for f in self.found) and not self._incomplete
        wanted = {test for found in self.found for test in found["tests"]}
        if not whole or not wanted <= self._finished:
            return []
        root = self._settings.root
        files = {name for found in self.found for name in found["files"]}
        patterns = self.found[0]["patterns"]
        used = {(root / r.reference).resolve() for r in self._records.values()}
        # a test that ended early may have had more to ask for
        failed = {r.test for r in self._records.values() if r.failed}
        out = []
        folders = {k: v for found in self.found for k, v in found["folders"].items()}
        for tests, references in sorted(folders.items()):
            beside = [
                str(path)
                for path in Path(tests).glob("*.py")
                if any(fnmatch(path.name, pattern) for pattern in patterns)
                and "render_regression" in path.read_text(encoding="utf-8", errors="replace")
            ]
            if not set(beside) <= files:
                continue
            for path in sorted(Path(references).rglob("*.exr")):
                if path.resolve() not in used and not (failed and _owner(path) in {"", *failed}):
                    name = path.relative_to(references).with_suffix("").as_posix()
                    where = relative(path, root)
                    note = f"{where}: no test uses it"
                    out.append(
                        Record(where, "", name, "removed", where, message=note, was=digest(path))
                    )
        return out

    def _write(self, records: list[Record]) -> None:
        own = self._settings
        command = without_folders(
            shlex.join(["pytest", *map(str, self._config.invocation_params.args)]), [own.root]
        )
        run = runs.about_run(own.root, own.artifacts.folder, records, command)
        own.artifacts.write(runs.RESULTS, runs.encode(run, records))
        chosen = bool(self._config.getoption("--bezier-report"))
        kept = [(record, own.artifacts.folder) for record in records]
        write = None if chosen else own.artifacts.write
        note = runs.write_run_report(own.report, own.root, run, kept, own.form, write)
        # artefacts may have gone to another folder: the report is where they are
        self._lines += [f"report: {own.report}", *([f"report: {note}"] if note else [])]
        run["report"] = relative(own.report, own.root)
        for path in own.summaries:
            append_summary(markdown(run, records), path)
        if own.history is not None:
            path = own.history / history.file_name(run)
            write_file(path, runs.encode(run, records, pictures=False), make_folders=True)
        if os.environ.get("GITHUB_ACTIONS") == "true":
            self._annotations = github_lines(records)

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        """Tell the user what is worth knowing, and where the report is."""
        for line in self._annotations:
            terminalreporter.write_line(line)
        if self._lines:
            terminalreporter.write_sep("-", "render regression")
            for line in self._lines:
                terminalreporter.write_line(line)


def _owner(path: Path) -> str:
    """Return the test that a reference says it was made by, or nothing."""
    from ..verification.images import read_image

    try:
        return str(read_image(path).attributes.get("test", ""))
    except BezierError:
        return ""


def _told(records: list[Record]) -> list[str]:
    """Return the lines of the terminal."""
    counts = {state: sum(r.state == state for r in records) for state in STATES}
    lines = [", ".join(f"{n} {state}" for state, n in counts.items() if n)]
    for record in records:
        for note in record.notes:
            lines.append(f"note: {record.title}: {note}")
        if record.state == "removed":
            lines.append(f"removed: {record.message}")
    return lines
