"""The source archive has what the repository has: its tests look at all of it."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
#: What every archive of hatchling has by itself.
ALWAYS = {"LICENSE", "README.md", "pyproject.toml", ".gitignore"}
#: Settings of tools at work on the repository.
TOOLS = {".pre-commit-config.yaml", ".editorconfig", ".gitattributes", ".github", ".dockerignore"}


def test_the_source_archive_has_all_of_the_repository():
    done = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True)
    if done.returncode:
        pytest.skip("no checkout of git: this is the archive")
    names = {line.split("/")[0] for line in done.stdout.splitlines()}
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    (table,) = re.findall(r"\[tool\.hatch\.build\.targets\.sdist\]\n(.*?)\n\]", text, re.S)
    included = set(re.findall(r'"/([^"]+)"', table))
    assert names - ALWAYS - TOOLS == included
