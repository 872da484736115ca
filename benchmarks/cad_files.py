"""Read CAD files as a render does: faces in, faces rendered, faces refused with the reason.

    python benchmarks/cad_files.py FILE.step FILE.iges FILE.3dm ... [--area]

Faces trimmed by curves keep their patches, with trims; so the table tells patches by degree, and
how many of them are trimmed. ``--area`` also restricts all patches to their trims, as
`mitsuba_bezier.load` and ``convert`` do, and compares the area of every face with OpenCASCADE's
own; the largest relative difference is shown. Needs the extras ``[cad]`` and ``[rhino]``.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from mitsuba_bezier.errors import BezierError
from mitsuba_bezier.geometry.triangles import BezierTriangles
from mitsuba_bezier.io.cad import opencascade as cad
from mitsuba_bezier.io.cad import rhino


def areas(triangles: BezierTriangles) -> np.ndarray:
    """Return the area of each patch by a Gauss rule of 16 x 16 points."""
    x, w = np.polynomial.legendre.leggauss(16)
    x, w = (x + 1) / 2, w / 2
    a, b = np.meshgrid(x, x)
    uv = np.stack([a, (1 - a) * b], axis=-1).reshape(-1, 2)
    weight = (np.outer(w, w) * (1 - a)).ravel()
    out = []
    for start in range(0, len(triangles), 200):
        part = triangles[start : start + 200]
        patch = np.repeat(np.arange(len(part)), len(uv))
        d = part.differential(patch, np.tile(uv, (len(part), 1)))
        normal = np.linalg.norm(np.cross(d.dp_du, d.dp_dv), axis=1)
        out.append(normal.reshape(len(part), -1) @ weight)
    return np.concatenate(out)


def reference_areas(path: Path) -> np.ndarray:
    """Return the area of each face, integrated by OpenCASCADE to 1e-7."""
    from OCP.BRepGProp import BRepGProp
    from OCP.GProp import GProp_GProps

    occ = cad._occ()
    out = []
    for item in cad._explore(occ, cad._load(occ, path), occ.abs.TopAbs_FACE):
        properties = GProp_GProps()
        BRepGProp.SurfaceProperties_s(occ.face(item), properties, 1e-7)
        out.append(abs(properties.Mass()))
    return np.array(out)


def row(path: Path, with_area: bool) -> list[str]:
    """Return one line of the table."""
    start = time.process_time()
    reader = rhino if path.suffix.lower() == ".3dm" else cad
    try:
        model = reader.read_here(path, trims=True)
    except BezierError as error:
        return [path.name, "0", "0", str(error).split(": ", 1)[-1][:60], "", "", ""]
    seconds = time.process_time() - start
    reasons: dict[str, int] = {}
    for refusal in model.report.refused:
        reasons[refusal.reason] = reasons.get(refusal.reason, 0) + refusal.count
    degrees = []
    for group, trims in zip(model.groups, model.trims or [None] * len(model.groups)):
        trimmed = 0 if trims is None else int((trims.region >= 0).sum())
        note = f" ({trimmed} trimmed)" if trimmed else ""
        degrees.append(f"{len(group)} of {group.degree}{note}")
    return [
        path.name,
        str(model.report.faces),
        str(model.report.converted),
        "; ".join(f"{n}: {reason}" for reason, n in reasons.items()),
        ", ".join(degrees),
        area_error(path) if with_area and reader is cad else "",
        f"{seconds:.1f}",
    ]


def area_error(path: Path) -> str:
    """Return the largest relative difference of area of a face, without trims."""
    model = cad.read_here(path)
    wanted = reference_areas(path)
    got = np.zeros(len(wanted))
    for group, source in zip(model.groups, model.sources):
        np.add.at(got, source, areas(group))
    done = got > 0
    error = np.abs(got - wanted)[done] / np.maximum(wanted[done], 1e-9 * wanted.sum())
    return f"{error.max():.0e}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("--area", action="store_true", help="compare areas (slow)")
    arguments = parser.parse_args()
    head = ["file", "faces", "rendered", "refused", "patches by degree", "area", "s"]
    print("|", " | ".join(head), "|")
    print("|", " | ".join("---" for _ in head), "|")
    for path in arguments.files:
        print("|", " | ".join(row(path, arguments.area)), "|", flush=True)


if __name__ == "__main__":
    main()
