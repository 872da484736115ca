"""Bézier simplices of `pytorch-bsf`: control points by their index, as text or JSON.

A 2-simplex in space is one Bézier triangle: the index ``(i, j, k)`` of a control point is ours.
Lines of ``.csv`` and ``.tsv`` are an index, in quotation marks, and the point; ``.json``, ``.yml``
and ``.yaml`` hold a mapping from indices to points.

Source: torch_bsf/bezier_simplex.py, https://github.com/opthub-org/pytorch-bsf
"""

from __future__ import annotations

import csv
import io
import json
import re
from os import PathLike
from pathlib import Path

import numpy as np

from ..geometry import bernstein
from .files import damaged, read_text
from .report import Collector, Model
from .tensor_nets import homogeneous
from .text import numbers

__all__ = ["read"]

#: Highest degree.
_MAX_DEGREE = 40
_LINE = re.compile(r"""\s*(['"]?[(\[][^)\]]*[)\]]['"]?|['"][^'"]*['"])\s*:\s*(.*?)\s*""")


def read(path: str | PathLike[str]) -> Model:
    """Read the control points of a Bézier simplex.

    Raises
    ------
    FileFormatError
        If the file is missing or damaged, or it is no 2-simplex in three dimensions.
    """
    text = read_text(path)
    suffix = Path(path).suffix.lower()
    rows = _mapping(path, text, suffix) if suffix in (".json", ".yml", ".yaml") else None
    if rows is None:
        rows = []
        try:
            for words in csv.reader(io.StringIO(text), delimiter="," if suffix == ".csv" else "\t"):
                words = [word.strip() for word in words]
                while words and not words[-1]:
                    words.pop()
                if words:
                    rows.append((words[0], words[1:]))
        except csv.Error as error:
            raise damaged(path, "lines of an index and a point", str(error)) from None
    if not rows:
        raise damaged(path, "control points of a Bézier simplex", "none")
    points: dict[tuple[int, ...], np.ndarray] = {}
    for number, (key, words) in enumerate(rows, start=1):
        index = _index(key)
        if index is None:
            raise damaged(path, "an index such as (2, 0, 1)", repr(key[:40]), line=number)
        point = numbers([word.strip() for word in words])
        if point is None:
            raise damaged(path, "finite numbers", repr(words[:3])[:60], line=number)
        if index in points:
            raise damaged(path, "each index once", repr(index), line=number)
        points[index] = point
    first = next(iter(points))
    if len(first) != 3:
        expected = "a 2-simplex, with indices of three numbers"
        raise damaged(path, expected, f"a {len(first) - 1}-simplex")
    n = sum(first)
    if not 1 <= n <= _MAX_DEGREE:
        raise damaged(path, f"a degree from 1 to {_MAX_DEGREE}", n)
    wanted = [tuple(x) for x in bernstein.multi_indices(n).tolist()]
    if set(points) != set(wanted):
        odd = sorted(set(points) ^ set(wanted))[0]
        raise damaged(path, f"the {len(wanted)} indices that sum to {n}", f"{odd} missing or odd")
    widths = {len(p) for p in points.values()}
    if widths != {3}:
        raise damaged(path, "points of three numbers", f"of {sorted(widths)}")
    collector = Collector(path, "bsf")
    net = homogeneous(np.stack([points[index] for index in wanted]))
    collector.add(net[None], 0)
    collector.report.accept()
    return collector.model(lambda: damaged(path, "a Bézier simplex", "none"))


def _index(key: str) -> tuple[int, ...] | None:
    """Return the numbers of an index such as ``(2, 0, 1)``, None if it is none."""
    text = key.strip().strip("'\"").strip()
    match = re.fullmatch(r"[(\[]?\s*(\d{1,4}(?:\s*,\s*\d{1,4})*)\s*,?\s*[)\]]?", text)
    return tuple(int(word) for word in match[1].split(",")) if match else None


def _mapping(path: str | PathLike[str], text: str, suffix: str) -> list[tuple[str, list[str]]]:
    """Return the items of a JSON or YAML mapping; of YAML only what `yaml.dump` makes of such."""
    try:
        found = json.loads(text)
    except (ValueError, RecursionError) as error:
        if suffix == ".json":
            raise damaged(path, "a JSON mapping of indices to points", str(error)[:80]) from None
        return _yaml(path, text)
    if not isinstance(found, dict) or not all(isinstance(v, list) for v in found.values()):
        raise damaged(path, "a mapping of indices to points", type(found).__name__)
    rows = []
    for key, values in found.items():
        if not all(isinstance(x, (int, float)) and not isinstance(x, bool) for x in values):
            raise damaged(path, "points of numbers", repr(values)[:60])
        rows.append((key, [repr(float(x)) for x in values]))
    return rows


def _yaml(path: str | PathLike[str], text: str) -> list[tuple[str, list[str]]]:
    rows: list[tuple[str, list[str]]] = []
    for number, line in enumerate(text.split("\n"), start=1):
        if not line.strip() or line.lstrip().startswith("#") or line.strip() == "---":
            continue
        if match := _LINE.fullmatch(line):
            value = match[2]
            inner = value[1:-1] if value.startswith("[") and value.endswith("]") else ""
            if value and not inner:
                raise damaged(path, "a point such as [0.0, 1.0]", repr(value[:40]), line=number)
            rows.append((match[1], [w for w in inner.split(",") if w.strip()]))
        elif rows and re.fullmatch(r"\s*-\s+\S+\s*", line):
            rows[-1][1].append(line.strip()[1:].strip())
        else:
            raise damaged(path, "lines (i, j, k): [x, y, z]", repr(line[:40]), line=number)
    return rows
