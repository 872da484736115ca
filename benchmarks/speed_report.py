"""Tables for the terminal and for `docs/performance.md`."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from mitsuba_bezier._files import write_file

__all__ = ["Section", "judged", "markdown", "print_sections", "short", "update_blocks"]


@dataclass(frozen=True)
class Section:
    """One table: text columns first, then numbers."""

    title: str
    header: list[str]
    rows: list[list[str]]
    text_columns: int = 1


def short(value: float) -> str:
    """Return a number with three significant digits at most."""
    size = abs(value)
    return f"{value:.0f}" if size >= 20 else f"{value:.1f}" if size >= 2 else f"{value:.2f}"


def judged(value: float, required: float | None, at_most: bool = False) -> str:
    """Return a number, and what is required of it with a mark if it is met."""
    if required is None:
        return short(value)
    met = value <= required if at_most else value >= required
    return f"{short(value)} ({'≤' if at_most else '≥'} {required:g} {'✓' if met else '✗'})"


def print_sections(sections: Iterable[Section]) -> None:
    """Print tables, as wide as they are."""
    console = Console()
    for section in sections:
        table = Table(title=section.title, box=SIMPLE_HEAD, title_justify="left")
        for k, name in enumerate(section.header):
            table.add_column(name, justify="left" if k < section.text_columns else "right")
        for row in section.rows:
            table.add_row(*row)
        console.print(table)


def markdown(sections: Iterable[Section]) -> str:
    """Return the tables in Markdown, each under its title."""
    parts = []
    for section in sections:
        rule = ["---" if k < section.text_columns else "---:" for k in range(len(section.header))]
        lines = [section.header, rule, *section.rows]
        table = "\n".join(f"| {' | '.join(line)} |" for line in lines)
        parts.append(f"{section.title}:\n\n{table}")
    return "\n\n".join(parts)


def update_blocks(path: Path, blocks: dict[str, str]) -> None:
    """Replace what stands between ``<!-- NAME -->`` and ``<!-- end of NAME -->`` in a page.

    Raises
    ------
    SystemExit
        If the page has no such place; nothing is written then.
    """
    text = path.read_text(encoding="utf-8")
    for name, content in blocks.items():
        first, last = f"<!-- {name} -->", f"<!-- end of {name} -->"
        place = re.compile(re.escape(first) + ".*?" + re.escape(last), re.DOTALL)
        new = f"{first}\n{content}\n{last}"
        text, count = place.subn(lambda _match, new=new: new, text)
        if count != 1:
            raise SystemExit(f"{path}: expected one place for the table {name}, got {count}")
    write_file(path, text.encode())
