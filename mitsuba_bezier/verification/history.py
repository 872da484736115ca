"""Measures over many runs: one JSON file a run, and a page that plots them."""

from __future__ import annotations

import html
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..errors import FileFormatError
from .accept import read_report
from .records import Record

__all__ = ["file_name", "read_history", "render_history"]

_WIDTH, _HEIGHT, _LEFT, _BOTTOM = 640, 150, 62, 22


def file_name(run: Mapping[str, Any]) -> str:
    """Return the name of a run's file: time and commit, so that names sort by time."""
    made = "".join(c for c in str(run.get("made", "")) if c.isalnum())
    return f"{made or 'run'}-{str(run.get('commit', 'none'))[:10]}.json"


def read_history(
    folder: str | os.PathLike[str],
) -> list[tuple[dict[str, Any], list[Record]]]:
    """Return the runs of a folder, by time.

    Raises
    ------
    FileFormatError
        If there is none, or a file is no run.
    """
    paths = sorted(Path(folder).glob("*.json"))
    if not paths:
        raise FileFormatError.expected(f"{folder}", "a folder with runs (.json)", "none")
    found = [read_report(path) for path in paths]
    return sorted(found, key=lambda item: str(item[0].get("made", "")))


def _series(
    runs: Sequence[tuple[dict[str, Any], list[Record]]],
) -> dict[tuple[str, str], list[tuple[int, float, float | None, float | None, str]]]:
    """Return, by image and measure: number of the run, value, limit, noise, state."""
    out: dict[tuple[str, str], list[tuple[int, float, float | None, float | None, str]]] = {}
    for index, (_run, records) in enumerate(runs):
        for record in records:
            for m in record.measures:
                value, limit = m.get("value"), m.get("limit")
                if value is None or (limit is None and m["name"] in ("mean difference", "max")):
                    continue
                layer = f"{m['layer']}: " if m.get("layer") else ""
                name = layer + m["name"]
                if m["name"] == "Z-test":  # what fails, so that less is better everywhere
                    name, value = layer + "Z-test, share that fails", 1 - value
                    limit = None if limit is None else 1 - limit
                point = (index, float(value), limit, m.get("expected"), record.state)
                out.setdefault((record.title, name), []).append(point)
    return out


def _chart(
    points: Sequence[tuple[int, float, float | None, float | None, str]], labels: Sequence[str]
) -> str:
    """Return an SVG of one measure over the runs."""
    tops = [v for p in points for v in p[1:4] if v is not None]
    top = 1.08 * max(tops) or 1.0
    width, height = _WIDTH - _LEFT - 10, _HEIGHT - _BOTTOM - 8

    def x(index: int) -> float:
        return _LEFT + width * (index + 0.5) / len(labels)

    def y(value: float) -> float:
        return 8 + height * (1 - value / top)

    parts = [f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img">']
    for tick in (0.0, top / 2, top):
        parts.append(
            f'<path class="grid" d="M{_LEFT} {y(tick):.1f}H{_WIDTH - 10}"/>'
            f'<text x="{_LEFT - 6}" y="{y(tick) + 4:.1f}" text-anchor="end">{tick:.3g}</text>'
        )
    for column, kind in ((2, "limit"), (3, "noise"), (1, "value")):
        row = [(p[0], p[column]) for p in points if p[column] is not None]
        line = " ".join(f"{x(i):.1f},{y(float(v or 0)):.1f}" for i, v in row)
        if row:
            parts.append(f'<polyline class="{kind}" points="{line}"/>')
    for index, value, _limit, _noise, state in points:
        title = html.escape(f"{labels[index]}: {value:.4g}, {state}")
        bad = " bad" if state in ("changed", "error") else ""
        parts.append(
            f'<circle class="dot{bad}" cx="{x(index):.1f}" cy="{y(value):.1f}" r="3.2">'
            f"<title>{title}</title></circle>"
        )
    for index in sorted({0, len(labels) - 1}):
        anchor = "start" if index == 0 else "end"
        parts.append(
            f'<text x="{x(index):.1f}" y="{_HEIGHT - 6}" text-anchor="{anchor}">'
            f"{html.escape(labels[index])}</text>"
        )
    return "".join([*parts, "</svg>"])


_STYLE = """
:root {
  color-scheme: light dark; --card: light-dark(#fff, #1b1d21); --page: light-dark(#f4f5f7, #121316);
  --text: light-dark(#1c1f24, #e6e8eb); --muted: light-dark(#5b626d, #9aa1ac);
  --line: light-dark(#d9dce1, #30343b); --accent: light-dark(#2f55c8, #8fabff);
  --fail: light-dark(#b3261e, #ff8a80);
}
body { margin: 0; padding: 1.2rem; background: var(--page); color: var(--text);
  font: 15px/1.5 system-ui, sans-serif; }
h1 { font-size: 1.35rem; margin: 0 0 .2rem; }
h2 { font-size: 1rem; margin: 0 0 .5rem; overflow-wrap: anywhere; }
h3 { font-size: .8rem; margin: .4rem 0 0; color: var(--muted); }
p { color: var(--muted); margin: 0 0 1rem; }
section { background: var(--card); border: 1px solid var(--line); border-radius: 12px;
  padding: .8rem 1rem; margin-bottom: .8rem; }
.charts { display: grid; gap: .6rem 1.4rem;
  grid-template-columns: repeat(auto-fill, minmax(min(100%, 26rem), 1fr)); }
svg { width: 100%; height: auto; display: block; }
text { fill: var(--muted); font-size: 11px; }
polyline { fill: none; }
.grid { stroke: var(--line); }
.value { stroke: var(--accent); stroke-width: 1.8; }
.limit { stroke: var(--fail); stroke-dasharray: 6 4; }
.noise { stroke: var(--muted); stroke-dasharray: 2 3; }
.dot { fill: var(--accent); }
.dot.bad { fill: var(--fail); }
"""


def render_history(runs: Sequence[tuple[dict[str, Any], list[Record]]]) -> str:
    """Return a page with a plot for each image and measure: value, limit, and what noise gives."""
    labels = [
        f"{str(run.get('made', ''))[:10]} {str(run.get('commit', ''))[:7]}".strip() or str(k)
        for k, (run, _records) in enumerate(runs)
    ]
    by_image: dict[str, list[str]] = {}
    for (title, measure), points in _series(runs).items():
        chart = f"<div><h3>{html.escape(measure)}</h3>{_chart(points, labels)}</div>"
        by_image.setdefault(title, []).append(chart)
    sections = [
        f"<section><h2>{html.escape(title)}</h2>"
        f'<div class="charts">{"".join(charts)}</div></section>'
        for title, charts in sorted(by_image.items())
    ]
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        '<meta http-equiv="Content-Security-Policy" '
        """content="default-src 'none'; style-src 'unsafe-inline'">"""
        f"<title>History of renders</title><style>{_STYLE}</style></head><body>"
        f"<h1>History of renders</h1><p>{len(runs)} runs, {labels[0]} to {labels[-1]}. "
        "Line: value; dashed: limit; dotted: what noise alone gives.</p>"
        f"{''.join(sections)}</body></html>\n"
    )
