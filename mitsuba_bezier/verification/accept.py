"""Take over what a report shows: its candidates become the references.

A report may come from elsewhere. It can have nothing done but images put in the place of images:
below a folder that the user names or works in, and only where the old one is still the one that the
report compared.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from .._files import write_files
from ..errors import BezierError, FileFormatError
from .images import SUFFIXES, read_image
from .records import Record

__all__ = ["Acceptance", "apply", "digest", "fits", "plan", "read_report"]

#: A report of some hundred images has 20 MB; what is much larger is none of ours.
_MAX_BYTES = 1 << 30


@dataclass(frozen=True)
class Acceptance:
    """One reference that is to be replaced, added or removed.

    Attributes
    ----------
    record : Record
        What the report says of it.
    target : Path
        The reference.
    data : bytes or None
        Its new contents; None: it is removed.
    """

    record: Record
    target: Path
    data: bytes | None


def digest(path: str | os.PathLike[str]) -> str:
    """Return what tells the contents of a file from others, or nothing if it is not there."""
    total = hashlib.sha256()
    try:
        with open(path, "rb") as file:
            while block := file.read(1 << 20):
                total.update(block)
    except OSError:
        return ""
    return total.hexdigest()[:16]


def fits(pattern: str, name: str, nodeid: str) -> bool:
    """Tell whether a name or pattern means an image of a test."""
    return pattern in (name, nodeid, f"{nodeid} {name}") or any(
        fnmatchcase(text, pattern) for text in (name, nodeid)
    )


def read_report(path: str | os.PathLike[str]) -> tuple[dict[str, Any], list[Record]]:
    """Return what a report, or the ``results.json`` beside one, says of its run and images.

    Raises
    ------
    FileFormatError
        If the file is none of these.
    """
    name = os.fspath(path)
    try:
        if os.stat(path).st_size > _MAX_BYTES:
            raise FileFormatError.expected(name, "a report", "a file of more than 1 GiB")
        text = Path(path).read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise FileFormatError.expected(name, "a report", error.strerror) from None
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', text, re.S)
    try:
        data = json.loads(found.group(1) if found else text)
        if found:
            run, items = data.get("run", {}), [e.get("record") for e in data["entries"]]
        else:
            run, items = data["run"], data["records"]
        records = [Record.from_json(item) for item in items if item]
        checked = all(_is_sound(record) for record in records) and isinstance(run, dict)
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        checked = False
    if not checked:
        raise FileFormatError.expected(
            name, "a report of mitsuba-bezier (.html) or its results.json", "other contents"
        )
    return run, records


def _is_sound(record: Record) -> bool:
    texts = (record.title, record.test, record.name, record.state, record.reference)
    return all(isinstance(text, str) for text in (*texts, record.candidate, record.was))


def plan(
    report: str | os.PathLike[str], names: Sequence[str] = (), root: Path | None = None
) -> list[Acceptance]:
    """Return what accepting a report means, everything checked.

    Parameters
    ----------
    report : path
        The report.
    names : sequence of str
        Images or tests, or patterns of them; all that is not as its reference, if there is none.
    root : Path, optional
        The folder that the references lie below; by default the root that the report tells, if it
        holds the tests of the report, or the current folder or one above it.

    Raises
    ------
    BezierError
        If a name fits nothing, a picture is gone or was not kept, or a reference lies elsewhere or
        is another than the one that was compared.
    """
    run, records = read_report(report)
    chosen = [r for r in records if r.state in ("changed", "new", "removed", "error")]
    for name in names:
        if not any(fits(name, r.name, r.test or r.title) for r in records):
            raise BezierError.expected("NAME", "an image or a test of the report", repr(name))
    if names:
        chosen = [r for r in chosen if any(fits(n, r.name, r.test or r.title) for n in names)]
    elif any(not r.candidate and r.state == "error" for r in chosen):
        chosen = [r for r in chosen if r.candidate or r.state != "error"]
    folder = Path(report).resolve().parent
    base = _root(run, records, folder, root)
    within = Path.cwd().resolve() if root is None and base == folder else base
    found: dict[Path, Acceptance] = {}
    for record in chosen:
        step = _step(record, folder, base, within)
        other = found.setdefault(step.target, step)
        if other.data != step.data:
            raise BezierError.expected(
                "NAME",
                f"one of the tests that share {record.reference}",
                f"{other.record.title} and {record.title}",
            )
    return list(found.values())


def _root(run: Mapping[str, Any], records: list[Record], folder: Path, root: Path | None) -> Path:
    if root is not None:
        if not root.is_dir():
            raise FileFormatError.expected("--root", "a folder", f"{root}")
        return root.resolve()
    tests = {record.test.partition("::")[0] for record in records if record.test}
    if not tests:  # of two folders: paths are relative to the report
        return folder
    told = run.get("root")
    here = Path.cwd().resolve()
    places = [(folder / told).resolve()] if isinstance(told, str) else []
    for place in [*places, here, *here.parents]:
        if all((place / test).is_file() for test in tests):
            return place
    raise FileFormatError.expected(
        "--root", "the folder of the project, with the tests of the report", f"none at {here}"
    )


def _step(record: Record, folder: Path, base: Path, within: Path) -> Acceptance:
    """Return what accepting one image means."""
    target = Path(os.path.normpath(base / record.reference))
    real = target.parent.resolve() / target.name
    if not record.reference or target.suffix.lower() not in SUFFIXES:
        raise FileFormatError.expected(
            record.title, "a reference that is an image", f"{record.reference!r}"
        )
    if not real.is_relative_to(within):
        raise FileFormatError.expected(
            "--root", f"a folder that holds the reference {record.reference}", f"{within}"
        )
    if target.is_symlink():
        raise FileFormatError.expected(record.reference, "a file", "a link")
    if record.state == "removed":
        _check_old(record, target)
        return Acceptance(record, target, None)
    source = folder / record.candidate
    if not record.candidate:
        again = f"{record.command} --bezier-accept" if record.test else "compare again"
        raise BezierError.expected(
            record.title, "a picture that can be accepted", f"none in the report; {again}"
        )
    image = read_image(source)  # whatever is no image ends here
    if source.suffix.lower() != target.suffix.lower():
        raise FileFormatError.expected(
            record.candidate, f"an image {target.suffix}, as the reference", source.suffix
        )
    del image
    data = source.read_bytes()
    if hashlib.sha256(data).hexdigest()[:16] != digest(target):
        _check_old(record, target)
    return Acceptance(record, target, data)


def _check_old(record: Record, target: Path) -> None:
    if digest(target) != record.was:
        raise BezierError.expected(
            record.reference,
            "the reference that the report compared",
            "another one: it has changed since; run the tests again",
        )


def apply(steps: Sequence[Acceptance]) -> None:
    """Do it: all new references are on the disk before an old one goes.

    Raises
    ------
    FileFormatError
        If a file cannot be written or removed.
    """
    new: dict[str | os.PathLike[str], bytes | bytearray | memoryview] = {
        step.target: step.data for step in steps if step.data is not None
    }
    for target in map(Path, new):
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise FileFormatError.expected(
                f"{target}", "a file that can be written", error.strerror
            ) from None
    if new:
        write_files(new)
    for step in steps:
        if step.data is None:
            try:
                step.target.unlink(missing_ok=True)
            except OSError as error:
                raise FileFormatError.expected(
                    f"{step.target}", "a file that can be removed", error.strerror
                ) from None
