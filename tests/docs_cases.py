"""The pages of the documentation, their blocks of code, and the commands in them."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"

#: Pages of the repository, below docs/ and beside it.
PAGES = {
    page.relative_to(DOCS).with_suffix("").as_posix(): page
    for page in sorted(DOCS.rglob("*.md"))
    if not {"_build", "generated"} & set(page.relative_to(DOCS).parts)
} | {name: ROOT / f"{name}.md" for name in ("README", "CONTRIBUTING")}


class Block(NamedTuple):
    """A block between fences: its language, the number of its line, and what is in it."""

    language: str
    line: int
    text: str


def blocks(text: str) -> list[Block]:
    """Return the blocks of a page, in order."""
    pattern = r"^( *)(`{3,}|:{3,})([^\n`]*)\n(.*?)^\1\2 *$"
    return [
        Block(found[3].strip(), text[: found.start(4)].count("\n"), found[4])
        for found in re.finditer(pattern, text, re.S | re.M)
        if not found[2].startswith(":")
    ]


def commands(text: str) -> Iterator[list[str]]:
    """Return the words of each command of a block for the shell; comments are none."""
    for line in text.replace("\\\n", " ").splitlines():
        words: list[str] = []
        for word in [*shlex.split(line, comments=True), "&&"]:
            if word == "&&":
                if words:
                    yield words
                words = []
            else:
                words.append(word)


def named_commands(text: str) -> Iterator[list[str]]:
    """Return the words of each command in the lines of a page, between backticks."""
    text = re.sub(r"^( *)(`{3,}).*?^\1\2 *$", "", text, flags=re.S | re.M)
    for found in re.findall(r"`((?:mitsuba-bezier|python|pytest) [^`]+)`", text):
        one = re.sub(r"\[(\w+)(?: \\?\| \w+)+\]", r"[\1]", " ".join(found.split()))  # of [A | B]
        words = shlex.split(one, comments=True)
        if "..." not in words:
            yield words
