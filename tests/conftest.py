"""What all tests share. Importing the package first lets it choose Dr.Jit's LLVM."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from subprocess import CompletedProcess

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
    "models": "unit",
    "optics": "unit",
    "io": "files",
    "figures": "files",
    "kernels": "kernel",
    "plugins": "render",
    "rendering": "render",
    "verification": "files",
    "cli": "render",
    "project": "project",
    "regression": "render",
}
_NEEDS = re.compile(
    r"^\s*(from|import) (drjit|mitsuba\b|(leaf|mitsuba|render|derivative|lecture)_cases)", re.M
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
            timeout=120,
            env=environment,
        )

    return run


@pytest.fixture(scope="session")
def chromium_browser():
    """One headless Chromium for all reports; skipped without one, but an error under ``CI``."""
    import os

    import chromium

    program = chromium.find()
    if program is None:
        message = "reports were not tested in a browser: no Chromium on the PATH"
        if os.environ.get("CI", "").lower() in ("1", "true"):
            pytest.fail(f"{message}, which this environment (CI is set) must have")
        pytest.skip(message)
    with chromium.Chromium(program) as browser:
        yield browser
