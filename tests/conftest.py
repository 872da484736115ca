"""What all tests share. Importing the package first lets it choose Dr.Jit's LLVM."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from subprocess import CompletedProcess
from types import ModuleType

import pytest
from hypothesis import settings

import mitsuba_bezier  # before anything imports Dr.Jit

# the same examples on every run; no deadline, since the first call of a kernel compiles it
settings.register_profile("fixed", derandomize=True, deadline=None)
settings.load_profile("fixed")


#: Tiers by folder; a test of these folders that needs Dr.Jit or Mitsuba is of the tier `kernel`.
TIERS = {
    "geometry": "unit",
    "oracles": "unit",
    "leaves": "unit",
    "fit": "render",
    "models": "unit",
    "optics": "unit",
    "io": "files",
    "figures": "files",
    "studio": "render",
    "kernels": "kernel",
    "plugins": "render",
    "rendering": "render",
    "verification": "files",
    "cli": "render",
    "project": "project",
    "regression": "render",
}
_NEEDS = re.compile(
    r"^\s*(from|import) "
    r"(drjit|mitsuba\b|(backend|leaf|mitsuba|render|derivative|lecture)_cases)",
    re.M,
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark each test with its tier: ``pytest -m unit``."""
    known: dict[Path, str] = {}
    for item in items:
        path = item.path
        if path not in known:
            tier = TIERS.get(path.parent.name, "project")
            if tier == "unit" and _NEEDS.search(path.read_text(encoding="utf-8")):
                tier = "kernel"
            known[path] = tier
        item.add_marker(known[path])


@pytest.fixture(scope="session")
def backend() -> ModuleType:
    """Dr.Jit's array types and Mitsuba's variant of this run: see `backend_cases`."""
    import backend_cases

    return backend_cases


@pytest.fixture(scope="session")
def python() -> Callable[..., CompletedProcess[str]]:
    """Run code in a fresh interpreter: ``python(code, {"VARIABLE": value or None})``.

    ``DRJIT_LIBLLVM_PATH`` is unset there unless it is given.
    """
    import os
    import subprocess
    import sys
    from pathlib import Path

    root = str(Path(mitsuba_bezier.__file__).parents[1])

    def run(
        code: str, variables: Mapping[str, str | None] | None = None, *arguments: str
    ) -> CompletedProcess[str]:
        environment: dict[str, str] = dict(os.environ, PYTHONPATH=root)
        for name, value in {"DRJIT_LIBLLVM_PATH": None, **(variables or {})}.items():
            environment.pop(name, None)
            if value is not None:
                environment[name] = value
        return subprocess.run(
            [sys.executable, "-c", code, *arguments],
            capture_output=True,
            text=True,
            timeout=600,
            env=environment,
        )

    return run


@pytest.fixture(autouse=True)
def _threads_stay() -> Iterator[None]:
    """Let no test change how many threads Dr.Jit has: with one, reading an EXR file never ends."""
    import sys

    before = sys.modules["drjit"].thread_count() if "drjit" in sys.modules else None
    yield
    if before is not None:
        after = sys.modules["drjit"].thread_count()
        if after != before:
            sys.modules["drjit"].set_thread_count(before)
        assert after == before


# for one module only: as long as it runs, playwright's event loop is in the way of others
@pytest.fixture(scope="module")
def chromium_browser():
    """One headless Chromium for the reports; skipped without one, but an error under ``CI``."""
    import os
    from importlib.util import find_spec

    import browser

    program = browser.find()
    missing = "no Chromium on the PATH" if program is None else ""
    if find_spec("playwright") is None:
        missing = "no playwright (pip install '.[test]')"
    if program is None or missing:
        message = f"reports were not tested in a browser: {missing}"
        if os.environ.get("CI", "").lower() in ("1", "true"):
            pytest.fail(f"{message}, which this environment (CI is set) must have")
        pytest.skip(message)
    with browser.Browser(program) as started:
        yield started
