"""Write what a run leaves: the figures as JSON, and the report."""

from __future__ import annotations

import base64
import json
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from .. import __version__
from ..errors import BezierError
from ..verification import report
from ..verification.comparison import Comparison, compare_images
from ..verification.images import read_image
from ..verification.origin import commit_of, machine
from ..verification.records import Record, relative
from ..verification.thresholds import Thresholds
from .settings import Settings

__all__ = ["write_results"]

RESULTS = "results.json"


def write_results(own: Settings, records: Sequence[Record], command: str) -> tuple[Path, str]:
    """Write ``results.json`` and the report; return where the report is, and a note.

    Raises
    ------
    FileFormatError
        If a file cannot be written.
    """
    run: dict[str, Any] = {
        "made": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        "version": __version__,
        "root": relative(own.root, own.artifacts.folder),
        **commit_of(own.root),
        "machine": machine(),
        "seconds": round(sum(record.seconds for record in records), 2),
        "command": command,
    }
    data = {"run": run, "records": [record.as_json() for record in records]}
    text = json.dumps(data, indent=1, ensure_ascii=False) + "\n"
    own.artifacts.write(RESULTS, text.encode("utf-8", "backslashreplace"))
    entries = [_entry(record, own) for record in records]
    target = own.report
    run |= {
        "root": relative(own.root, target.parent),
        "report": relative(target, own.root),
        "accept": True,
    }
    note = report.write_report(
        target,
        entries,
        "Render regression",
        f"Tests below {own.root.name}",
        command,
        by_name=False,
        run=run,
        form=own.form,
        write=None if own.config.getoption("--bezier-report") else own.artifacts.write,
    )
    # artefacts may have gone to another folder: the report is where they are
    return own.report, note


def _entry(record: Record, own: Settings) -> Any:
    """Build the entry of a report; the images that were kept are read again."""
    root, folder = own.root, own.artifacts.folder
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
    small = base64.b64decode(record.thumbnail) if record.thumbnail else None
    place = own.report.parent
    if place != folder:  # --bezier-report: what is accepted lies elsewhere
        image, candidate = (
            relative(folder / name, place) if name else ""
            for name in (record.image, record.candidate)
        )
        record = replace(record, image=image, candidate=candidate)
    return report.from_record(found, record, state.get(record.state, "error"), small, root)
