"""A run in the words of CI: Markdown for a summary, annotations for GitHub."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any

from .records import STATES, Record

__all__ = ["append_summary", "github_lines", "markdown"]

#: GitHub takes a summary of 1 MiB and drops a longer one.
_MOST_ROWS = 200

_SIGNS = {
    "error": "⚠️",
    "changed": "❌",
    "new": "🆕",
    "removed": "➖",
    "unchanged": "✅",
    "accepted": "✅",
}


def markdown(run: Mapping[str, Any], records: Sequence[Record]) -> str:
    """Return a run as Markdown: counts, a table of what is not unchanged, notes."""
    counts = [(sum(r.state == s for r in records), s) for s in STATES]
    words = ", ".join(f"{n} {state}" for n, state in counts if n) or "nothing was compared"
    bad = any(record.failed for record in records)
    about = [
        f"branch {_cell(run['branch'])}" if run.get("branch") else "",
        f"commit {_cell(run['commit'])[:10]}" if run.get("commit") else "",
        f"{run['seconds']:.0f} s" if isinstance(run.get("seconds"), (int, float)) else "",
    ]
    lines = [
        f"### {'❌' if bad else '✅'} Renders: {words}",
        "",
        ", ".join(filter(None, about)),
        "",
    ]
    shown = [r for r in records if r.state not in ("unchanged", "accepted")]
    if shown:
        lines += ["| | image | test | what |", "| --- | --- | --- | --- |"]
    for record in shown[:_MOST_ROWS]:
        what = record.message or "; ".join(
            m["text"] for m in record.measures if m.get("passed") is False
        )
        cells = [_SIGNS[record.state], record.name, record.test, what]
        lines.append("| " + " | ".join(map(_cell, cells)) + " |")
    if len(shown) > _MOST_ROWS:
        lines.append(f"\nand {len(shown) - _MOST_ROWS} more")
    notes = [(record, note) for record in records for note in record.notes]
    if notes:
        lines += ["", "Wrong with the tests themselves:", ""]
        lines += [f"* {_cell(r.title)}: {_cell(note)}" for r, note in notes[:_MOST_ROWS]]
    if bad and run.get("report"):
        command = _code(f"mitsuba-bezier accept {run['report']}")
        lines += ["", f"To accept all of it, from the artefact of this run: {command}"]
    return "\n".join(lines).rstrip() + "\n"


def _cell(text: str) -> str:
    """Return text that stands in a cell of a table, and is neither HTML nor a mention."""
    for old, new in (("&", "&amp;"), ("<", "&lt;"), (">", "&gt;"), ("|", "\\|"), ("`", "\\`")):
        text = text.replace(old, new)
    for sign in "*_[]@#":
        text = text.replace(sign, f"&#{ord(sign)};")
    return " ".join(text.split())


def _code(text: str) -> str:
    fence = "`" * (1 + max((len(run) for run in text.split("`")), default=0) * ("`" in text))
    return f"{fence}{' '.join(text.split())}{fence}"


def github_lines(records: Sequence[Record]) -> list[str]:
    """Return lines that GitHub Actions shows beside the tests' files."""

    def escaped(text: str, more: str = "") -> str:
        for sign in "%\r\n" + more:
            text = text.replace(sign, f"%{ord(sign):02X}")
        return text

    lines = []
    for record in records:
        kind = "error" if record.failed else "warning"
        what = record.message or "; ".join(
            m["text"] for m in record.measures if m.get("passed") is False
        )
        texts = [f"{record.state}: {what}"] if record.failed or record.state == "removed" else []
        file = record.test.partition("::")[0] or record.reference
        place = f"file={escaped(file, ':,')},title={escaped(record.title, ':,')}"
        lines += [f"::{kind} {place}::{escaped(text)}" for text in texts]
        lines += [f"::warning {place}::{escaped(note)}" for note in record.notes]
    return lines


def append_summary(text: str, path: str | os.PathLike[str]) -> None:
    """Add Markdown to a file, as steps of GitHub Actions share one.

    Raises
    ------
    OSError
        If that cannot be.
    """
    with open(path, "a", encoding="utf-8", errors="backslashreplace") as file:
        file.write(text + "\n")
