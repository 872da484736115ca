"""``mitsuba-bezier info``: what a file holds."""

from __future__ import annotations

import argparse
import json
from typing import TYPE_CHECKING, Any

from ._limits import add_limits
from ._streams import printable

if TYPE_CHECKING:
    from ..io import Model

__all__ = ["add_parser", "examine", "run"]


#: Patches times control points to the power 1.5 of which tight bounds are found.
_MAX_SPLIT = 5e6
#: Highest degree of which they are: the matrices of its splits take long to find.
_MAX_DEGREE = 16


def add_parser(subparsers: Any) -> None:
    """Add the parser of this command."""
    parser = subparsers.add_parser(
        "info",
        help="tell what a file of surfaces holds",
        description="Read a file as 'mitsuba-bezier convert' does and print its faces, patches, "
        "degrees, weights, control points at infinity and bounds, and the reason for each face "
        "that cannot be converted.",
    )
    parser.add_argument("file", metavar="FILE", help="the file to read")
    parser.add_argument("--json", action="store_true", help="print JSON")
    add_limits(parser)


def examine(model: Model) -> dict[str, Any]:
    """Return the facts about a model as plain numbers, lists and strings."""
    import numpy as np

    from ..geometry.boxes import hull_boxes, reaches_infinity, surface_boxes

    report = model.report
    groups = []
    parts = model.trims or [None] * len(model.groups)
    for group, trims in zip(model.groups, parts):
        net = group.control_points
        weight = net[..., 3]
        groups.append(
            {
                "degree": group.degree,
                "patches": len(group),
                "polynomial": int((weight == weight[:, :1]).all(axis=1).sum()),
                "weights": [float(weight.min()), float(weight.max())],
                "reach_infinity": int(reaches_infinity(net).sum()),
                "at_infinity": int(((weight == 0) & net.any(axis=-1)).sum()),
                "negative_weights": int((weight < 0).sum()),
                "trimmed": 0 if trims is None else int((trims.region >= 0).sum()),
            }
        )
    nets = [group.control_points for group in model.groups]
    remarks = list(report.remarks)
    # splitting takes time with the cube of the degree: 16 s for 4000 patches of degree 20
    work = sum(net.shape[0] * net.shape[1] ** 1.5 for net in nets)
    if work > _MAX_SPLIT or any(group.degree > _MAX_DEGREE for group in model.groups):
        bounds = np.concatenate([hull_boxes(net) for net in nets])
        remarks.append("bounds are those of the control points: the surface may be smaller")
    else:
        bounds = np.concatenate([surface_boxes(net, together=True) for net in nets])
    low, high = bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0)
    fields = [
        {
            "name": name,
            "components": field.components,
            "degree": field.degree,
            "unit": field.unit,
            "rational": field.weights is not None,
            "missing": int(field.missing().sum()),
            "range": _range(field),
        }
        for name, field in model.fields.items()
    ]
    return {
        "file": report.path,
        "format": report.format,
        "faces": report.faces,
        "converted": report.converted,
        "refused": [{"face": r.face, "count": r.count, "reason": r.reason} for r in report.refused],
        "notes": report.notes,
        "remarks": remarks,
        "unit": model.unit,
        "parts": _parts(model),
        "patches": groups,
        "fields": fields,
        # of the surface, before trims, up to a thousandth; None where it reaches infinity
        "bounds": [[x if np.isfinite(x) else None for x in side.tolist()] for side in (low, high)],
    }


def _parts(model: Model) -> list[dict[str, Any]]:
    """Return what is known of the parts, if the file tells any."""
    from ..io.parts import srgb

    return [
        {
            "name": part.name,
            "patches": len(part),
            "faces": part.faces,
            "places": part.places,
            "colour": None if part.colour is None else srgb(part.colour),
            "face_colours": [srgb(colour) for colour in part.paints],
            "layer": part.layer,
            "material": part.material,
            "visible": part.visible,
        }
        for part in (model.parts if model.has_parts else [])
    ]


def _range(field: Any) -> list[float] | None:
    """Return the ends of a field, None where they are not found soon, or are none."""
    from ..errors import GeometryError

    if field.ordinates.size > _MAX_SPLIT:
        return None
    try:
        return list(field.range())
    except GeometryError:
        return None


def run(args: argparse.Namespace) -> int:
    """Print the facts; return 0."""
    from ..io import read

    found = examine(read(args.file, trims=True))
    if args.json:
        print(json.dumps(found, indent=2))
        return 0
    print(printable(f"{found['file']} ({found['format']})"))
    print(f"  faces       {found['converted']} of {found['faces']} converted")
    for group in found["patches"]:
        low, high = group["weights"]
        weights = "polynomial" if group["polynomial"] == group["patches"] else ""
        if not weights:
            weights = f"weights {low:.6g} to {high:.6g}"
            if group["at_infinity"]:
                weights += f", {group['at_infinity']} control points at infinity"
            if group["negative_weights"]:
                weights += f", {group['negative_weights']} negative"
        if group["trimmed"]:
            weights += f", {group['trimmed']} with trims"
        if group["reach_infinity"]:
            weights += f", {group['reach_infinity']} reach infinity"
        print(f"  patches     {group['patches']} of degree {group['degree']}, {weights}")
    if found["unit"]:
        print(f"  unit        {found['unit']}")
    for part in found["parts"]:
        words = [part["name"]]
        if len(part["places"]) > 1:
            words.append(f"{len(part['places'])} places")
        words += [part["colour"]] if part["colour"] else []
        if part["face_colours"]:
            words.append(f"faces {', '.join(part['face_colours'][:8])}")
        words += [f"layer {part['layer']}"] if part["layer"] else []
        words += [f"material {part['material']}"] if part["material"] else []
        words += [] if part["visible"] else ["hidden"]
        print(printable(f"  part        {', '.join(words)}"))
    for name, side, infinity in zip(("from", "to"), found["bounds"], ("-infinity", "infinity")):
        numbers = ", ".join(infinity if x is None else f"{x:.6g}" for x in side)
        print(f"  bounds {name:4} ({numbers})")
    for field in found["fields"]:
        count = field["components"]
        what = f"{count} component{'s' * (count > 1)} of degree {field['degree']}"
        if field["range"] is not None:
            low, high = field["range"]
            unit = f" {field['unit']}" if field["unit"] else ""
            what += f", {'magnitude ' * (count > 1)}{low:.6g} to {high:.6g}{unit}"
        if field["missing"]:
            what += f", none on {field['missing']} patches"
        print(printable(f"  field       {field['name']}: {what}"))
    for refusal in found["refused"]:
        count = f"{refusal['count']} x " if refusal["count"] > 1 else ""
        print(printable(f"  refused     {count}{refusal['face']}: {refusal['reason']}"))
    for note in found["notes"]:
        print(printable(f"  note        {note}"))
    for remark in found["remarks"]:
        print(printable(f"  also        {remark}"))
    return 0
