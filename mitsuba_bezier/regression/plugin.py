"""A pytest plugin: hold renders against stored references, with a report of what changed.

::

    def test_sphere(render_regression):
        render_regression({"type": "scene", ...}, "sphere", spp=16)

``pytest --bezier-accept`` renders the references that are missing, 32 passes with other seeds, and
stores mean and variance as ``references/sphere.exr`` beside the test file. Every later run renders
with `spp` samples, as ``mitsuba-bezier render`` does, and applies the Z-test of `ztest`; limits may
be given besides. The report of all tests, and what failed, lie under ``bezier-artifacts/``, also
under pytest-xdist; nothing of an earlier run stays there.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from .fixture import RECORDS, RenderRegression
from .session import Collector, collected
from .settings import add_options, settings, split_paths

__all__ = ["RenderRegression", "render_regression"]


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options of this plugin."""
    add_options(parser)


def pytest_configure(config: pytest.Config) -> None:
    """Collect the outcomes in the process that talks to the user."""
    names = config.getoption("--bezier-accept")
    if names:  # "--bezier-accept NAME tests/test_x.py": files and folders are no names
        names, paths = split_paths(names, Path(config.invocation_params.dir))
        config.option.bezier_accept = names
        if paths:
            own = config.args_source == pytest.Config.ArgsSource.ARGS
            config.args[:] = [*config.args, *paths] if own else paths
            config.args_source = pytest.Config.ArgsSource.ARGS
    if not hasattr(config, "workerinput"):  # pytest-xdist: reports of the workers come here
        config.pluginmanager.register(Collector(config), "mitsuba-bezier-collector")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_finish(session: pytest.Session) -> None:
    """Remove what earlier runs left, before any test runs; in xdist all workers come here first."""
    found = collected(session)
    if not found["tests"]:
        return
    given = getattr(session.config, "workerinput", {})
    if given.get("bezier_clean", True):
        settings(session.config).artifacts.clean()
    if hasattr(session.config, "workeroutput"):
        session.config.workeroutput["bezier_collected"] = found
    else:
        collector = session.config.pluginmanager.get_plugin("mitsuba-bezier-collector")
        if collector is not None:
            collector.found.append(found)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Iterator[None]:
    """Hand what the test recorded to its report, which finds the way from workers."""
    report: Any = yield
    records = item.stash.get(RECORDS, None)
    if records:
        report.bezier_records = list(records)
        written = [r["reference"] for r in records if r["state"] == "accepted"]
        if written and report.outcome == "passed":  # nothing was tested
            word = "reference written" + ("s" if len(written) > 1 else "")
            path, line, _name = item.location
            report.outcome = "skipped"
            report.longrepr = (path, (line or 0) + 1, f"Skipped: {word}: {', '.join(written)}")
        records.clear()
    return report


@pytest.fixture
def render_regression(request: pytest.FixtureRequest) -> RenderRegression:
    """Give a function that renders a scene and compares it with its reference."""
    return RenderRegression(request)
