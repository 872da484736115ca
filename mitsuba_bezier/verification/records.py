"""What became of each image of a run, as plain data: for reports, CI, history and acceptance.

Paths are relative, with slashes: references to the root of the project, images to the folder of
the report. So a report can be moved, and tells nobody where it was made.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from .comparison import Comparison

__all__ = ["STATES", "Record", "measures", "relative", "without_folders"]

#: What can become of an image, worst first.
STATES = ("error", "changed", "new", "removed", "unchanged", "accepted")


@dataclass
class Record:
    """One comparison of a run.

    Attributes
    ----------
    title : str
        Unique in a run: the test and the image.
    test : str
        Node id of the test; empty for a reference that no test uses.
    name : str
        Of the reference.
    state : str
        One of `STATES`.
    reference : str
        The file of the reference, there or not.
    image : str
        The render that was compared, if it was kept.
    candidate : str
        What becomes the reference when the change is accepted.
    message : str
        Why there is no comparison.
    command : str
        What repeats it.
    limits : dict
        Limits that hold for it.
    measures : list of dict
        Name, value, limit, passed, expected, layer.
    notes : list of str
        What is wrong with the test itself.
    seconds : float
        Of rendering and comparing.
    thumbnail : str
        A small JPEG, base64.
    was : str
        Digest of the reference that was compared (`accept.digest`).
    """

    title: str
    test: str = ""
    name: str = ""
    state: str = "error"
    reference: str = ""
    image: str = ""
    candidate: str = ""
    message: str = ""
    command: str = ""
    limits: dict[str, Any] = field(default_factory=dict)
    measures: list[dict[str, Any]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    seconds: float = 0.0
    thumbnail: str = ""
    was: str = ""

    @property
    def failed(self) -> bool:
        """Whether it fails its test."""
        return self.state in ("error", "changed", "new")

    @property
    def size(self) -> float:
        """How far it is beyond its limits, 1 at a limit: what a list is sorted by."""
        return max((share for share in map(_excess, self.measures) if share is not None), default=0)

    def as_json(self) -> dict[str, Any]:
        """Return it as plain data."""
        return asdict(self)

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Record:
        """Return what `as_json` gave; fields that are not known are left out."""
        return cls(**{f.name: data[f.name] for f in fields(cls) if f.name in data})

    def figures(self) -> dict[str, Any]:
        """Return what a machine wants to know, without pictures."""
        data = {k: v for k, v in self.as_json().items() if v not in ("", [], {}, None)}
        data.pop("thumbnail", None)
        return data


def _excess(measure: Mapping[str, Any]) -> float | None:
    value, limit = measure["value"], measure["limit"]
    if value is None or limit is None:
        return None
    if measure["name"] == "Z-test":  # a share of pixels that may fail, and the one that does
        value, limit = 1 - value, 1 - limit
    if limit <= 0:
        return 0.0 if value <= 0 else 1e9
    return float(min(value / limit, 1e9))


def measures(result: Comparison) -> list[dict[str, Any]]:
    """Return the checks of a comparison as plain data, those that failed first."""
    found = [
        {
            "layer": layer["name"],
            **{k: check[k] for k in ("name", "value", "limit", "passed", "expected", "text")},
        }
        for layer in result.as_json()["layers"]
        for check in layer["checks"]
    ]
    return sorted(found, key=lambda m: m["passed"] is not False)


def relative(path: str | os.PathLike[str], root: str | os.PathLike[str]) -> str:
    """Return a path relative to a folder, with slashes, also upwards."""
    try:
        return Path(os.path.relpath(path, root)).as_posix()
    except ValueError:  # another drive
        return Path(path).name


_ABSOLUTE = re.compile(r"(?<![\w.:/~-])(?:[A-Za-z]:)?[/\\](?:[^\s/\\'\"<>|:;,]+[/\\])+")


def without_folders(text: str, roots: Sequence[str | os.PathLike[str]] = ()) -> str:
    """Return text in which no absolute path is left: relative to a root, else the last name."""
    for root in roots:
        name = os.fspath(root)
        if len(name) > 1:
            text = text.replace(name + os.sep, "").replace(name, ".")
    return _ABSOLUTE.sub("", text)
