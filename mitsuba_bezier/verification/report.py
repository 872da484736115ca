"""An HTML page that shows compared images: no network, no build step.

The page is ``report_template.html`` with the data put in as JSON. Pictures and numbers are in the
page itself, as data URIs, or in files beside it. An `Entry` can describe any pair of images, for
other checks than `comparison`, too.
"""

from __future__ import annotations

import base64
import contextlib
import datetime
import hashlib
import json
import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from .._files import write_file
from .._version import __version__
from . import png, preview
from .comparison import Check, Comparison, Layer
from .images import Image
from .records import Record, without_folders
from .values import Values, pack
from .ztest import comparable_layers

__all__ = [
    "LARGEST_PAGE",
    "Entry",
    "HeatMap",
    "Panel",
    "Wording",
    "entry",
    "from_record",
    "heat_map",
    "panel",
    "render_report",
    "single",
    "write_report",
]

#: A page of more bytes takes browsers seconds to open.
LARGEST_PAGE = 20_000_000

#: Names of the files beside a page.
_OWN = re.compile(r"[0-9a-f]{16}\.(png|jpeg|js)")

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
    first : int
        The map that is shown first: that of the measure that failed first.
    values : Values or None
        The numbers, for the cursor, exposure, channels and selections.
    single : str
        ``"reference"`` or ``"test"`` where there is only that picture.
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
    first: int = 0
    values: Values | None = None
    single: str = ""


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
    titles = {"Z-test": "Z-score", "FLIP": "FLIP"}
    failed = [titles.get(c.name, "absolute") for c in layer.checks if c.passed is False]
    first = [m.title for m in maps].index(failed[0]) if failed[:1] != [] else 0
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
        first,
        pack(
            layer.reference,
            np.where(np.isfinite(difference), difference, layer.test - layer.reference),
            names,
            preview.mapping(layer.reference[..., :3], encoding, layer.name == "", exposure),
        ),
    )


def single(image: Image, which: str, exposure: float | None = None) -> list[Panel]:
    """Return how an image without a counterpart is shown, layer by layer."""
    panels = []
    for name, channels in comparable_layers(image).items():
        pixels = image.stack(channels)
        picture, _, caption = preview.show(pixels, pixels, image.encoding, name == "", exposure)
        shown = preview.mapping(pixels[..., :3], image.encoding, name == "", exposure)
        last = [channel.rpartition(".")[2] for channel in channels]
        panels.append(
            Panel(
                name or "colour",
                (picture.shape[1], picture.shape[0]),
                data := png.encode(picture),
                data,
                caption,
                [],
                [],
                values=pack(pixels, np.zeros_like(pixels), last, shown),
                single=which,
            )
        )
    return panels


def entry(comparison: Comparison, command: str = "", exposure: float | None = None) -> Entry:
    """Return how a comparison is shown; `command` repeats it."""
    files = [
        str(p) if p is not None else "missing" for p in (comparison.reference, comparison.test)
    ]
    facts = [("file", files[0], files[1])]
    a, b = comparison.attributes
    standard = ("pixelAspectRatio", "screenWindowWidth")  # every EXR file has them
    facts += [
        (key, _short(str(a.get(key, ""))), _short(str(b.get(key, ""))))
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


def _short(text: str) -> str:
    """Return a list of consecutive numbers, such as seeds, by its ends."""
    words = text.split()
    if len(words) > 4 and all(word.isdecimal() for word in words):
        numbers = [int(word) for word in words]
        if numbers == list(range(numbers[0], numbers[0] + len(numbers))):
            return f"{words[0]} to {words[-1]}"
    return text


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


class _Store:
    """Where pictures and numbers go: into the page, or into files beside it.

    Files have names of their contents, so that those of an older page stay what they are.
    """

    def __init__(self, folder: str = "") -> None:
        self.folder = folder
        self.files: dict[str, bytes] = {}
        self.bytes = 0

    def put(self, data: bytes, kind: str = "") -> str:
        """Return the source of a picture (PNG or JPEG), or of what is to be run."""
        kind = kind or ("jpeg" if data.startswith(b"\xff\xd8") else "png")
        self.bytes += len(data) * 4 // 3
        if not self.folder:
            prefix = "" if kind == "js" else f"data:image/{kind};base64,"
            return prefix + base64.b64encode(data).decode()
        number = hashlib.sha256(data).hexdigest()[:16]
        if kind == "js":
            text = base64.b64encode(data).decode()
            data = f'reportValues("{number}","{text}")'.encode()
        name = f"{number}.{kind}"
        self.files[name] = data
        return f"{self.folder}/{name}"


def _number(value: float | None) -> float | None:
    """Return what JSON can hold: it has no NaN."""
    return None if value is None or not np.isfinite(value) else float(value)


def _check_data(check: Check) -> dict[str, Any]:
    numbers = {k: _number(getattr(check, k)) for k in ("value", "limit", "expected")}
    return {**asdict(check), **numbers}


def _panel_data(panel: Panel, store: _Store) -> dict[str, Any]:
    values = panel.values
    return {
        "title": panel.title,
        "width": panel.size[0],
        "height": panel.size[1],
        "single": panel.single,
        "reference": store.put(panel.reference),
        # the page shows the reference for both if they are equal
        "test": None if panel.test == panel.reference else store.put(panel.test),
        "caption": panel.caption,
        "marked": panel.marked,
        "first": panel.first,
        "maps": [
            {
                "title": m.title,
                "picture": store.put(m.picture),
                "low": m.low,
                "high": m.high,
                "gradient": preview.gradient(m.colormap),
                "note": m.note,
            }
            for m in panel.maps
        ],
        "checks": [_check_data(c) for c in panel.checks],
        "histogram": None if panel.histogram is None else asdict(panel.histogram),
        "values": None
        if values is None
        else {
            "source": store.put(values.data, "js"),
            "channels": values.channels,
            "scales": values.scales,
            "shown": values.shown,
        },
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
    """Return the page as text, pictures and all, failures first.

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
        ``commit``, ``branch``, ``subject``, ``changed``, ``machine``, ``seconds``; ``root``, the
        folder that references are relative to; ``report``, what commands call the page;
        ``accept``: whether ``mitsuba-bezier accept`` can do something with it.
    """
    about = (title, subtitle, command, wording, by_name, run)
    return _page(entries, _Store(), *about)


def _page(
    entries: Sequence[Entry],
    store: _Store,
    title: str,
    subtitle: str,
    command: str,
    wording: Wording | None,
    by_name: bool,
    run: Mapping[str, Any] | None,
) -> str:
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
                "thumbnail": None if e.thumbnail is None else store.put(e.thumbnail),
                "change": e.change,
                "notes": e.notes,
                "size": e.size,
                "record": e.record,
                "panels": [_panel_data(p, store) for p in e.panels],
            }
            for e in sorted(entries, key=lambda e: (_ORDER[e.state], e.name if by_name else ""))
        ],
    }
    template = files(__package__).joinpath("report_template.html").read_text(encoding="utf-8")
    if store.folder:  # pages opened as files are no origin of their own
        template = template.replace("img-src data:", "img-src data: file: 'self'").replace(
            "script-src 'unsafe-inline'", "script-src 'unsafe-inline' file: 'self'"
        )
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
    run: Mapping[str, Any] | None = None,
    form: str = "auto",
    write: Callable[[str, bytes], object] | None = None,
) -> str:
    """Write the page of `render_report`; folders on the way are made.

    The pictures are written first, under new names, and the page last: whatever fails on the way,
    an older report is as it was.

    Parameters
    ----------
    path, entries, title, subtitle, command, wording, by_name, run
        As for `render_report`.
    form : str
        ``"page"``: all in one page; ``"folder"``: pictures in a folder ``<name>_files`` beside it;
        ``"auto"``: one page if it has no more than `LARGEST_PAGE` bytes.
    write : callable, optional
        Writes a file, given its name relative to the folder of the page, and its bytes.

    Returns
    -------
    str
        What the user should be told, or nothing.

    Raises
    ------
    FileFormatError
        If a file cannot be written.
    """
    target = Path(path)
    about = (title, subtitle, command, wording, by_name, run)
    note = ""
    store = _Store(f"{target.stem}_files" if form == "folder" else "")
    text = _page(entries, store, *about)
    if form != "folder" and len(text) > LARGEST_PAGE:
        size = f"{len(text) / 1e6:.0f} MB, more than {LARGEST_PAGE / 1e6:.0f}"
        if form == "page":
            note = f"one page has {size}: use the form of a folder"
        else:
            store = _Store(f"{target.stem}_files")
            text = _page(entries, store, *about)
            note = f"one page would have {size}: its pictures are in {store.folder}/ beside it"
    own = target.parent / f"{target.stem}_files"
    before = set(os.listdir(own)) if own.is_dir() else set()

    def default(name: str, data: bytes) -> None:
        write_file(target.parent / name, data, make_folders=True)

    put = write or default
    try:
        for name, data in store.files.items():
            put(f"{store.folder}/{name}", data)
        # a file name may hold bytes that are no text
        put(target.name, text.encode("utf-8", "backslashreplace"))
    except BaseException:
        _discard(own, store.files.keys() - before)
        raise
    _discard(own, {n for n in before if _OWN.fullmatch(n)} - store.files.keys())
    return note


def _discard(folder: Path, names: Iterable[str]) -> None:
    """Remove files of ours, and their folder if nothing else is in it."""
    for name in names:
        with contextlib.suppress(OSError):
            (folder / name).unlink()
    with contextlib.suppress(OSError):
        folder.rmdir()
