"""Runs on disk: the figures as ``results.json``, the report, several runs as one."""

from __future__ import annotations

import base64
import json
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from .._version import __version__
from ..errors import BezierError, FileFormatError
from . import report
from .accept import read_report
from .comparison import Comparison, compare_images
from .images import read_image
from .origin import commit_of, machine
from .records import STATES, Record, relative
from .thresholds import Thresholds

__all__ = ["RESULTS", "about_run", "encode", "read_runs", "sort", "write_run_report"]

RESULTS = "results.json"


def about_run(root: Path, folder: Path, records: Sequence[Record], command: str) -> dict[str, Any]:
    """Return when, where and from what a run was made.

    Parameters
    ----------
    root, folder : Path
        Of the project, and of what the run leaves.
    records : sequence of Record
        What became of its images.
    command : str
        What makes it again.
    """
    return {
        "made": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        "version": __version__,
        "root": relative(root, folder),
        **commit_of(root),
        "machine": machine(),
        "seconds": round(sum(record.seconds for record in records), 2),
        "command": command,
    }


def encode(run: Mapping[str, Any], records: Sequence[Record], pictures: bool = True) -> bytes:
    """Return the contents of ``results.json``; without thumbnails for what is to be kept long."""
    items = [record.as_json() if pictures else record.figures() for record in records]
    text = json.dumps({"run": dict(run), "records": items}, indent=1, ensure_ascii=False) + "\n"
    return text.encode("utf-8", "backslashreplace")


def sort(records: Sequence[Record]) -> list[Record]:
    """Return records, the worst first."""
    return sorted(records, key=lambda r: (STATES.index(r.state), -r.size, r.title))


def read_runs(
    paths: Sequence[str | os.PathLike[str]],
) -> tuple[dict[str, Any], list[tuple[Record, Path]]]:
    """Return several runs, shards or retries of one, as one: records and their folders.

    What comes twice counts as the last run has it.

    Parameters
    ----------
    paths : sequence of path
        Files ``results.json``, reports, or folders with a ``results.json``.

    Raises
    ------
    FileFormatError
        If one is none of these, or two are of different commits.
    """
    found: dict[str, tuple[str, Record, Path]] = {}
    first: dict[str, Any] = {}
    seconds = 0.0
    for name in paths:
        path = Path(name)
        path = path / RESULTS if path.is_dir() else path
        run, records = read_report(path)
        commit, other = first.get("commit"), run.get("commit")
        if commit and other and commit != other:
            raise FileFormatError.expected(
                f"{path}", f"a run of commit {commit[:10]}, as of the others", str(other)[:10]
            )
        first = {**run, **first}
        seconds += run["seconds"] if isinstance(run.get("seconds"), (int, float)) else 0.0
        made = str(run.get("made", ""))
        for record in records:
            if record.state not in STATES:
                raise FileFormatError.expected(f"{path}", "states of images", repr(record.state))
            before = found.get(record.title)
            if before is None or made >= before[0]:
                found[record.title] = made, record, path.parent
    first["seconds"] = round(seconds, 2)
    return first, [(record, folder) for _made, record, folder in found.values()]


def write_run_report(
    target: Path,
    root: Path,
    run: Mapping[str, Any],
    records: Sequence[tuple[Record, Path]],
    form: str = "auto",
    write: Callable[[str, bytes], object] | None = None,
) -> str:
    """Write the report of a run; return what the user should be told.

    Parameters
    ----------
    target : Path
        The page.
    root : Path
        Of the project, where the references are.
    run : mapping
        See `about_run`.
    records : sequence of (Record, Path)
        Records, with the folder that their images are relative to.
    form, write
        As for `report.write_report`.
    """
    about = {
        **run,
        "root": relative(root, target.resolve().parent),
        "report": relative(target.resolve(), root.resolve()),
        "accept": True,
    }
    return report.write_report(
        target,
        [_entry(record, root, folder, target.resolve().parent) for record, folder in records],
        "Render regression",
        f"Tests below {root.resolve().name}",
        str(run.get("command", "")),
        by_name=False,
        run=about,
        form=form,
        write=write,
    )


def _entry(record: Record, root: Path, folder: Path, place: Path) -> report.Entry:
    """Build the entry of a report; the images that were kept are read again."""
    a, b = root / record.reference, folder / record.image
    result = Comparison(record.title, a, b, error=record.message)
    if record.image and not record.message:
        try:
            images = read_image(a), read_image(b)
            limits = Thresholds(record.limits)
            result = compare_images(*images, limits, record.title)
        except BezierError as error:  # it was there when the test ran
            result = Comparison(record.title, a, b, error=str(error))
    found = report.entry(result, record.command)
    lone = "reference" if record.state == "removed" else "test"
    picture = a if lone == "reference" else folder / (record.candidate or record.image)
    if not found.panels and record.state in ("new", "removed", "error") and picture.is_file():
        try:
            found = replace(found, panels=report.single(read_image(picture), lone))
        except BezierError:
            pass  # the message says what is wrong
    state = {"unchanged": "pass", "accepted": "pass", "removed": "pass", "changed": "fail"}
    small = None
    if record.thumbnail:
        try:
            small = base64.b64decode(record.thumbnail, validate=True)
        except ValueError:
            small = None
    if place != folder.resolve():  # what is accepted lies elsewhere
        image, candidate = (
            relative(folder.resolve() / name, place) if name else ""
            for name in (record.image, record.candidate)
        )
        record = replace(record, image=image, candidate=candidate)
    return report.from_record(found, record, state.get(record.state, "error"), small, root)
