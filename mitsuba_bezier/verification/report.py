"""One self-contained HTML page that shows compared images: no network, no build step.

The page is ``report_template.html`` with the data put in as JSON, pictures as PNG data URIs. An
`Entry` can describe any pair of images, so that other checks than `comparison` can use it.
"""

from __future__ import annotations

import base64
import datetime
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from .._files import write_file
from .._version import __version__
from . import png, preview
from .comparison import Check, Comparison, Layer
from .records import Record, without_folders

__all__ = [
    "Entry",
    "HeatMap",
    "Panel",
    "Wording",
    "entry",
    "from_record",
    "heat_map",
    "panel",
    "render_report",
    "write_report",
]

_ORDER = {"fail": 0, "error": 1, "pass": 2}
_DATA = "__REPORT_DATA__"


@dataclass(frozen=True)
class HeatMap:
    """A picture in false colours with its scale.

    Attributes
    ----------
    title : str
        Short, for a button.
    picture : bytes
        PNG file, of the same size as the pair.
    low, high : float
        Values at the ends of the scale.
    colormap : str
        Key of `preview.COLORMAPS`.
    note : str
        What the values are.
    """

    title: str
    picture: bytes
    low: float
    high: float
    colormap: str
    note: str = ""


@dataclass(frozen=True)
class Panel:
    """One layer of an entry: the pair of pictures, maps, histogram and numbers.

    Attributes
    ----------
    title : str
        Name of the layer.
    size : (int, int)
        Width and height.
    reference, test : bytes
        The pictures, PNG files.
    caption : str
        How they are shown.
    maps : list of HeatMap
        At least one.
    checks : list of Check
        Numbers with their limits.
    histogram : Histogram or None
        Of the differences.
    marked : (int, int) or None
        Column and row of a pixel to mark, the one that differs most.
    """

    title: str
    size: tuple[int, int]
    reference: bytes
    test: bytes
    caption: str
    maps: list[HeatMap]
    checks: list[Check]
    histogram: preview.Histogram | None = None
    marked: tuple[int, int] | None = None


@dataclass(frozen=True)
class Entry:
    """One item of the report.

    Attributes
    ----------
    name : str
        Unique name.
    state : str
        ``"pass"``, ``"fail"`` or ``"error"`` (could not be compared).
    panels : list of Panel
        Layers; empty for an error.
    message : str
        What went wrong, in a line.
    command : str
        A shell command that repeats the comparison.
    facts : list of (str, str, str)
        Names, and values of the reference and of the test image: files, header attributes.
    thumbnail : bytes or None
        Small PNG file for the list.
    summary : str
        A line for the list if it passes; by default the judged numbers of the first panel.
    change : str
        What became of the image, of `records.STATES`; empty for what is no image of a test.
    notes : list of str
        What is wrong with the test itself.
    size : float
        How far it is beyond its limits, to sort by.
    record : dict, optional
        `records.Record` without its picture: what ``mitsuba-bezier accept`` needs.
    """

    name: str
    state: str
    panels: list[Panel] = field(default_factory=list)
    message: str = ""
    command: str = ""
    facts: list[tuple[str, str, str]] = field(default_factory=list)
    thumbnail: bytes | None = None
    summary: str = ""
    change: str = ""
    notes: list[str] = field(default_factory=list)
    size: float = 0.0
    record: dict[str, Any] | None = None


@dataclass(frozen=True)
class Wording:
    """What the page calls the entries, the two sides of a pair, and the facts."""

    item: str = "image"
    reference: str = "reference"
    test: str = "test"
    facts: str = "Files"


def heat_map(
    title: str, values: np.ndarray, low: float, high: float, colormap: str, note: str = ""
) -> HeatMap:
    """Return ``(H, W)`` values in false colours; NaN stands out."""
    picture = png.encode(preview.false_color(values, low, high, colormap))
    return HeatMap(title, picture, low, high, colormap, note)


def panel(layer: Layer, encoding: str = "linear", exposure: float | None = None) -> Panel:
    """Return how a compared layer is shown; `exposure` in stops, see `preview.show`."""
    a, b, caption = preview.show(layer.reference, layer.test, encoding, layer.name == "", exposure)
    difference = layer.metrics.difference
    # the channel that differs most stands for the pixel, with its sign
    channel = np.argmax(np.nan_to_num(np.abs(difference), nan=-1.0), axis=-1)[..., None]
    signed = np.take_along_axis(difference, channel, axis=-1)[..., 0]
    signed[np.isnan(difference).any(axis=-1)] = np.nan
    size = np.abs(signed[np.isfinite(signed)])
    limit = 0.0
    if size.size:  # a few fireflies shall not make all else black
        limit = float(np.percentile(size, 99.8)) or float(size.max())
    which = "of the channel that differs most"
    maps = [
        heat_map("absolute", np.abs(signed), 0, limit, "magma", f"|test − reference| {which}"),
        heat_map(
            "signed",
            signed,
            -limit,
            limit,
            "diverging",
            f"test − reference {which}: blue darker, orange brighter",
        ),
    ]
    if layer.flip is not None:
        maps.append(heat_map("FLIP", layer.flip, 0, 1, "magma", "perceived difference, 0 to 1"))
    if layer.z is not None:
        worst, top = np.max(np.abs(layer.z.z), axis=-1), layer.z.critical
        note = f"|Z| of the worst channel; a pixel fails from {top:.3g} on"
        maps.append(heat_map("Z-score", worst, 0, top, "magma", note))
    if layer.metrics.not_finite:
        caption += "; magenta, in maps green: not finite"
    names = [name.rpartition(".")[2] for name in layer.channels]
    return Panel(
        layer.name or "colour",
        (a.shape[1], a.shape[0]),
        png.encode(a),
        png.encode(b),
        caption,
        maps,
        layer.checks,
        preview.difference_histogram(difference, names),
        layer.metrics.max_at[:2] if layer.metrics.max_abs > 0 else None,
    )


def entry(comparison: Comparison, command: str = "", exposure: float | None = None) -> Entry:
    """Return how a comparison is shown; `command` repeats it."""
    files = [
        str(p) if p is not None else "missing" for p in (comparison.reference, comparison.test)
    ]
    facts = [("file", files[0], files[1])]
    a, b = comparison.attributes
    standard = ("pixelAspectRatio", "screenWindowWidth")  # every EXR file has them
    facts += [
        (key, str(a.get(key, "")), str(b.get(key, "")))
        for key in sorted(a.keys() | b.keys())
        if key not in standard
    ]
    panels = [panel(layer, comparison.encoding, exposure) for layer in comparison.layers]
    # the layers that failed first
    failed = {layer.name or "colour" for layer in comparison.layers if not layer.passed}
    panels.sort(key=lambda p: p.title not in failed)
    small = None
    if comparison.layers:
        layer = comparison.layers[0]
        pictures = preview.show(
            layer.reference, layer.test, comparison.encoding, layer.name == "", exposure
        )
        small = png.encode(preview.thumbnail(pictures[1]))
    return Entry(comparison.name, comparison.state, panels, comparison.error, command, facts, small)


def from_record(
    found: Entry,
    record: Record,
    state: str,
    thumbnail: bytes | None = None,
    root: str | os.PathLike[str] = ".",
) -> Entry:
    """Return an entry with what a test recorded, and no absolute path in it."""
    numbers = [m["text"] for m in record.measures if m["passed"] is not None]
    root = Path(root).resolve()
    files = ("file", record.reference or "missing", record.image or record.candidate or "missing")
    return replace(
        found,
        name=record.title,
        state=state,
        message=without_folders(found.message, [root]),
        command=without_folders(found.command, [root]),
        facts=[
            (key, without_folders(a, [root]), without_folders(b, [root]))
            for key, a, b in [files, *found.facts[1:]]
        ],
        thumbnail=thumbnail or found.thumbnail,
        summary="; ".join(numbers) or record.message,
        change=record.state,
        notes=record.notes,
        size=record.size,
        record=record.figures(),
    )


def _uri(picture: bytes) -> str:
    kind = "jpeg" if picture.startswith(b"\xff\xd8") else "png"
    return f"data:image/{kind};base64," + base64.b64encode(picture).decode()


def _number(value: float | None) -> float | None:
    """Return what JSON can hold: it has no NaN."""
    return None if value is None or not np.isfinite(value) else float(value)


def _panel_data(panel: Panel) -> dict[str, Any]:
    return {
        "title": panel.title,
        "width": panel.size[0],
        "height": panel.size[1],
        "reference": _uri(panel.reference),
        # the page shows the reference for both if they are equal
        "test": None if panel.test == panel.reference else _uri(panel.test),
        "caption": panel.caption,
        "marked": panel.marked,
        "maps": [
            {
                "title": m.title,
                "picture": _uri(m.picture),
                "low": m.low,
                "high": m.high,
                "gradient": preview.gradient(m.colormap),
                "note": m.note,
            }
            for m in panel.maps
        ],
        "checks": [
            {**asdict(c), "value": _number(c.value), "limit": _number(c.limit)}
            for c in panel.checks
        ],
        "histogram": None if panel.histogram is None else asdict(panel.histogram),
    }


def _now() -> str:
    try:
        now = datetime.datetime.now().astimezone()
    except ValueError:  # a TZ a whole day off
        now = datetime.datetime.now(datetime.timezone.utc)
    return now.strftime("%Y-%m-%d %H:%M %z")


def render_report(
    entries: Sequence[Entry],
    title: str,
    subtitle: str = "",
    command: str = "",
    wording: Wording | None = None,
    by_name: bool = True,
    run: Mapping[str, Any] | None = None,
) -> str:
    """Return the page as text, failures first.

    Parameters
    ----------
    entries : sequence of Entry
        What to show.
    title, subtitle : str
        Heading, and what was compared with what.
    command : str
        A shell command that makes the whole report.
    wording : Wording, optional
        Other words than those for images.
    by_name : bool
        Whether entries of one state are sorted by name; else they stay as given.
    run : mapping, optional
        Commit, branch, machine, seconds; and ``root``, the folder that references are relative to.
    """
    data = {
        "words": asdict(wording or Wording()),
        "title": title,
        "subtitle": subtitle,
        "command": command,
        "made": _now(),
        "version": __version__,
        "run": dict(run or {}),
        "entries": [
            {
                "name": e.name,
                "state": e.state,
                "message": e.message,
                "summary": e.summary,
                "command": e.command,
                "facts": e.facts,
                "thumbnail": None if e.thumbnail is None else _uri(e.thumbnail),
                "change": e.change,
                "notes": e.notes,
                "size": e.size,
                "record": e.record,
                "panels": [_panel_data(p) for p in e.panels],
            }
            for e in sorted(entries, key=lambda e: (_ORDER[e.state], e.name if by_name else ""))
        ],
    }
    template = files(__package__).joinpath("report_template.html").read_text(encoding="utf-8")
    # within <script>, no text may look like a tag
    text = json.dumps(data, ensure_ascii=False, allow_nan=False).replace("<", "\\u003c")
    before, after = template.split(_DATA)
    return before + text + after


def write_report(
    path: str | os.PathLike[str],
    entries: Sequence[Entry],
    title: str,
    subtitle: str = "",
    command: str = "",
    wording: Wording | None = None,
    by_name: bool = True,
) -> None:
    """Write the page of `render_report`; folders on the way are made.

    Raises
    ------
    FileFormatError
        If the file cannot be written.
    """
    text = render_report(entries, title, subtitle, command, wording, by_name)
    # a file name may hold bytes that are no text
    write_file(path, text.encode("utf-8", "backslashreplace"), make_folders=True)
