"""Pack a model into plain numbers and arrays, and unpack it: what goes between two processes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..geometry.triangles import BezierTriangles
from ..geometry.trims import Trims
from .parts import Part
from .report import Model, Refusal, Report
from .trim_arrays import packed_trims, unpacked_trims

__all__ = ["packed_model", "unpacked_model"]

#: What of a part is told as it is.
_FACTS = ("name", "places", "colour", "paints", "layer", "material", "visible", "faces")


def packed_model(model: Model) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Return facts for JSON, and arrays by name; parts that share nets share them there."""
    report = model.report
    facts: dict[str, Any] = {
        "path": report.path,
        "format": report.format,
        "faces": report.faces,
        "converted": report.converted,
        "refused": [[r.face, r.reason, r.count] for r in report.refused],
        "notes": report.notes,
        "remarks": report.remarks,
    }
    out: dict[str, Any] = {"report": facts, "unit": model.unit, "parts": None, "groups": []}
    arrays: dict[str, np.ndarray] = {}
    if not model.has_parts:
        out["groups"] = _pack(arrays, model.groups, model.sources, model.trims)
        return out, arrays
    out["parts"] = []
    known: dict[int, list[str]] = {}
    for k, part in enumerate(model.parts):
        if id(part.groups) not in known:
            known[id(part.groups)] = _pack(arrays, part.groups, part.sources, part.trims)
        arrays[f"places{k}"] = part.placements
        arrays |= {f"paint{k}.{j}": numbers for j, numbers in enumerate(part.painted)}
        told = {name: getattr(part, name) for name in _FACTS}
        out["parts"].append({**told, "groups": known[id(part.groups)]})
    return out, arrays


def _pack(
    arrays: dict[str, np.ndarray],
    groups: Sequence[BezierTriangles],
    sources: Sequence[np.ndarray],
    trims: Sequence[Trims | None],
) -> list[str]:
    """Put groups into the arrays; return their names there."""
    names = []
    for group, source, part in zip(groups, sources, trims or [None] * len(groups)):
        name = f"net{sum(key.startswith('net') for key in arrays)}"
        names.append(name)
        arrays[name] = group.control_points
        arrays[f"source-{name}"] = source
        if part is not None:
            arrays |= {f"trim-{name}.{key}": a for key, a in packed_trims(part).items()}
    return names


def unpacked_model(facts: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> Model:
    """Return the model of `packed_model`."""
    told = dict(facts["report"])
    told["refused"] = [Refusal(*item) for item in told["refused"]]
    report = Report(**told)
    trims_of: dict[str, dict[str, np.ndarray]] = {}
    for key, values in arrays.items():
        if key.startswith("trim-"):
            net, _, what = key.removeprefix("trim-").partition(".")
            trims_of.setdefault(net, {})[what] = values

    def groups_of(names: Sequence[str]) -> Any:
        groups = [BezierTriangles(arrays[name]) for name in names]
        sources = [arrays[f"source-{name}"] for name in names]
        trims = [unpacked_trims(trims_of[n]) if n in trims_of else None for n in names]
        return groups, sources, trims

    if facts["parts"] is None:
        groups, sources, trims = groups_of(facts["groups"])
        some = any(t is not None for t in trims)
        return Model(groups, sources, report, trims if some else [], unit=facts["unit"])
    parts = []
    known: dict[str, Any] = {}
    for k, item in enumerate(facts["parts"]):
        key = " ".join(item["groups"])
        if key not in known:
            known[key] = groups_of(item["groups"])
        groups, sources, trims = known[key]
        painted = [arrays[f"paint{k}.{j}"] for j in range(len(groups)) if f"paint{k}.{j}" in arrays]
        named = {name: item[name] for name in _FACTS}
        named["colour"] = None if named["colour"] is None else tuple(named["colour"])
        named["paints"] = [tuple(colour) for colour in named["paints"]]
        parts.append(
            Part(
                groups=groups,
                sources=sources,
                trims=trims,
                placements=arrays[f"places{k}"],
                painted=painted,
                **named,
            )
        )
    return Model(report=report, parts=parts, unit=facts["unit"])
