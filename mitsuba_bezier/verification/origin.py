"""Where a run was made: commit, branch, machine."""

from __future__ import annotations

import os
import platform
import subprocess
from pathlib import Path

from .._children import program

__all__ = ["commit_of", "machine"]


def commit_of(folder: Path) -> dict[str, str]:
    """Return commit, branch, time and subject of the commit, and whether files differ from it.

    Empty texts where there is no repository, or no git. What the environment of CI says is used
    for the branch, since CI checks out single commits.
    """
    git = program("git")
    branch = os.environ.get("GITHUB_HEAD_REF") or os.environ.get("GITHUB_REF_NAME")
    branch = branch or os.environ.get("CI_COMMIT_REF_NAME") or ""
    commit = os.environ.get("GITHUB_SHA") or os.environ.get("CI_COMMIT_SHA") or ""

    def ask(*words: str) -> str:
        if git is None:
            return ""
        # optional locks off: a question must not write, as into a read-only checkout
        command = [git, "--no-optional-locks", "-C", str(folder), *words]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=20)
        except (OSError, subprocess.SubprocessError, UnicodeError):
            return ""
        return done.stdout.strip() if done.returncode == 0 else ""

    own = ask("rev-parse", "HEAD")
    found = {"commit": own or commit, "branch": branch or ask("branch", "--show-current")}
    if own:
        found["date"], _, found["subject"] = ask("log", "-1", "--format=%cI %s").partition(" ")
        if ask("status", "--porcelain", "--untracked-files=no"):
            found["changed"] = "yes"
    return {key: value for key, value in found.items() if value}


def machine() -> str:
    """Return system, processor, cores and Python in a line; no name of a computer."""
    processor = platform.processor() or platform.machine()
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                processor = line.partition(":")[2].strip()
                break
    except OSError:
        pass
    return (
        f"{platform.system()} {platform.machine()}, {processor}, {os.cpu_count()} cores, "
        f"Python {platform.python_version()}"
    )
