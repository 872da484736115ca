"""Sets of rays, patches and all their intersections in a file: a neutral test of intersectors.

`docs/conformance.md` describes the format. Roots come from `elimination`, in exact arithmetic, or
from `reference`, in float64. What both leave to judgement, how far each root is from being none,
comes from `intersections` and is a first-order estimate.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator
from fractions import Fraction
from typing import Any

import numpy as np

from .._files import write_file
from ..errors import FileFormatError, GeometryError
from ..geometry import bernstein
from ..geometry.triangles import BezierTriangles
from .bivariate import DOUBLE, NEAR_MISS, SIMPLE, UNRESOLVED
from .conformance_cases import Case
from .elimination import Continuum, ExactRoot, exact_roots
from .intersections import Intersections, describe
from .ray_polynomials import Patches, Rays
from .reference import candidates

__all__ = ["ARITHMETIC", "FORMAT", "VERSION", "entry", "read_lines", "read_set", "write_set"]

FORMAT = "bezier-triangle-conformance"
VERSION = 1

#: How the roots of a set were found.
ARITHMETIC = ("exact", "float64")

#: Roots of both methods nearer than this, in parameters, are one: a double root of float64 is
#: good to the square root of its rounding.
_SAME = 1e-6


def _number(x: float) -> float | None:
    return float(x) if np.isfinite(x) else None


def _decimal(x: Fraction) -> str:
    """Return 30 significant digits."""
    if not x:
        return "0"
    power, size = 0, abs(x)
    while size >= 10:
        size, power = size / 10, power + 1
    while size < 1:
        size, power = size * 10, power - 1
    digits = str(round(size * 10**29))
    return f"{'-' if x < 0 else ''}{digits[0]}.{digits[1:]}e{power}"


def _root(row: Intersections, multiplicity: int | None, exact: ExactRoot | None) -> dict[str, Any]:
    """Return the entry of a root; `row` has its measures."""
    t = float(row.t[0])
    if exact is not None:
        t = float("inf") if exact.t is None else float(exact.t)
    finite = np.isfinite(t) and np.isfinite(row.scale[0])
    margin = np.min([row.graze[0], row.edge_shift[0], row.horizon[0]])
    if multiplicity != 1 or np.isnan(margin):
        margin = 0.0
    cosine = abs(row.cosine[0])
    reach = row.scale[0] if finite else np.inf
    simple = finite and multiplicity == 1 and cosine > 0
    out: dict[str, Any] = {
        "t": _number(t),
        "u": float(row.uv[0, 0]) if exact is None else float(exact.u),
        "v": float(row.uv[0, 1]) if exact is None else float(exact.v),
        "multiplicity": multiplicity,
        "condition": _number(2 * reach / cosine) if simple else None,
        "reach": _number(reach),
        "margin": float(margin),
    }
    if exact is not None and exact.t is not None:
        out["digits"] = _decimal(exact.t)
    return out


def _near(rows: Intersections, index: np.ndarray) -> list[dict[str, Any]]:
    """Return the entries of what is no root, or may be none."""
    out = []
    for i in index.tolist():
        margin = rows.graze[i] if rows.kind[i] in (NEAR_MISS, SIMPLE) else 0.0
        if rows.kind[i] >= 0 and not rows.inside[i]:
            margin = rows.edge_shift[i]
        out.append(
            {
                "t": _number(rows.t[i]),
                "reach": _number(rows.scale[i]),
                "margin": float(np.nan_to_num(margin)),  # NaN at a base point
            }
        )
    return out


def _exact_ray(case: Case, k: int, patches: Patches, rays: Rays, rows: Intersections) -> Any:
    """Return the entry of one ray by `elimination`; None if it meets the patch along a curve."""
    try:
        found = exact_roots(case.net, case.origins[k], case.directions[k])
    except Continuum:
        return None
    ray, patch = np.array([k]), np.array([0])
    roots = []
    for root in found:
        if root.base_point:
            continue
        uv = np.array([[float(root.u), float(root.v)]])
        kind = np.array([SIMPLE if root.multiplicity == 1 else DOUBLE])
        measured = describe(patches, rays, ray, patch, uv, kind)
        roots.append(_root(measured, root.multiplicity, root))
    mine = np.flatnonzero(rows.ray == k)
    known = np.array([[float(r.u), float(r.v)] for r in found]).reshape(-1, 2)
    apart = np.abs(rows.uv[mine][:, None] - known).max(axis=2, initial=0.0)
    same = (apart < _SAME).any(axis=1) & (rows.kind[mine] >= 0)
    return {"roots": roots, "near": _near(rows, mine[~same])}


def _float_ray(k: int, rows: Intersections) -> Any:
    """Return the entry of one ray by `reference`."""
    mine = rows.ray == k
    root = mine & rows.inside & (rows.kind >= 0)
    multiplicity = {SIMPLE: 1, DOUBLE: 2, UNRESOLVED: None}
    roots = [
        _root(rows.select([i]), multiplicity[int(rows.kind[i])], None)
        for i in np.flatnonzero(root).tolist()
    ]
    return {"roots": roots, "near": _near(rows, np.flatnonzero(mine & ~root))}


def entry(case: Case, arithmetic: str = "exact") -> dict[str, Any]:
    """Return the entry of a patch: one line of the file.

    Parameters
    ----------
    case : Case
    arithmetic : str
        One of `ARITHMETIC`.

    Returns
    -------
    dict
        Rays that lie in the patch are left out.
    """
    nets = BezierTriangles(case.net)
    with np.errstate(divide="ignore", invalid="ignore"):  # 0/0 at base points
        rows = candidates(nets, case.origins, case.directions)
    patches, rays = Patches(nets, 0.0), Rays(case.origins, case.directions)
    out = []
    for k in range(len(case.origins)):
        if arithmetic == "exact":
            found = _exact_ray(case, k, patches, rays, rows)
        else:
            found = _float_ray(k, rows)
        if found is None:
            continue
        length = float(rays.length[k])
        for row in [*found["roots"], *found["near"]]:  # lengths in units of t
            for name in ("condition", "reach"):
                if row.get(name) is not None:
                    row[name] /= length
        ray = {"origin": case.origins[k].tolist(), "direction": case.directions[k].tolist()}
        out.append(ray | found)
    return {
        "family": case.family,
        "degree": bernstein.degree_of(len(case.net)),
        "net": case.net.tolist(),
        "rays": out,
    }


def write_set(
    path: str | os.PathLike[str], cases: Iterable[Case], arithmetic: str = "exact"
) -> int:
    """Write a set; return the number of rays.

    Raises
    ------
    GeometryError
        If `arithmetic` is unknown.
    FileFormatError
        If the file cannot be written.
    """
    if arithmetic not in ARITHMETIC:
        raise GeometryError.expected("arithmetic", " or ".join(ARITHMETIC), arithmetic)
    head = {"format": FORMAT, "version": VERSION, "arithmetic": arithmetic}
    lines, count = [json.dumps(head)], 0
    for case in cases:
        row = entry(case, arithmetic)
        count += len(row["rays"])
        lines.append(json.dumps(row))
    write_file(path, ("\n".join(lines) + "\n").encode())
    return count


def read_set(path: str | os.PathLike[str]) -> Iterator[dict[str, Any]]:
    """Yield the entries of a set.

    Raises
    ------
    FileFormatError
        If the file is missing or no such set.
    """
    yield from read_lines(path, FORMAT)[1]


def read_lines(path: str | os.PathLike[str], kind: str) -> tuple[dict[str, Any], list[Any]]:
    """Return the head and the other lines of a file of one of the two formats."""
    try:
        with open(path, encoding="utf-8") as file:
            rows = [json.loads(line) for line in file if line.strip()]
    except (OSError, ValueError) as error:
        raise FileFormatError.expected(str(path), f"JSON lines of {kind}", f"{error}") from error
    head = rows[0] if rows and isinstance(rows[0], dict) else {}
    if head.get("format") != kind or head.get("version") != VERSION:
        what = f"format {head.get('format')!r}, version {head.get('version')!r}"
        raise FileFormatError.expected(str(path), f"{kind}, version {VERSION}", what)
    return head, rows[1:]
