"""Convert CAD files and compare the area of every face with OpenCASCADE's own.

    python benchmarks/cad_files.py FILE.step FILE.iges ... [--markdown]

Prints faces in, faces converted, faces refused with the reasons, the patches by degree, the
largest relative difference of area of a face, and the time. Needs the extra ``[cad]``.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from mitsuba_bezier.errors import BezierError
from mitsuba_bezier.geometry.triangles import BezierTriangles
from mitsuba_bezier.io import cad


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


def row(path: Path) -> list[str]:
    """Return one line of the table."""
    start = time.perf_counter()
    try:
        model = cad.read_here(path)
    except BezierError as error:
        return [path.name, "-", "-", str(error).split(": ", 1)[-1][:60], "", "", ""]
    seconds = time.perf_counter() - start
    wanted = reference_areas(path)
    got = np.zeros(len(wanted))
    for group, source in zip(model.groups, model.sources):
        np.add.at(got, source, areas(group))
    done = got > 0
    error = np.abs(got - wanted)[done] / np.maximum(wanted[done], 1e-9 * wanted.sum())
    reasons: dict[str, int] = {}
    for refusal in model.report.refused:
        reasons[refusal.reason] = reasons.get(refusal.reason, 0) + refusal.count
    degrees = ", ".join(f"{len(g)} of {g.degree}" for g in model.groups)
    return [
        path.name,
        str(model.report.faces),
        str(model.report.converted),
        "; ".join(f"{n}: {reason}" for reason, n in reasons.items()),
        degrees,
        f"{error.max():.0e}",
        f"{seconds:.1f}",
    ]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("--markdown", action="store_true")
    arguments = parser.parse_args()
    head = ["file", "faces", "converted", "refused", "patches by degree", "area", "s"]
    separator = " | " if arguments.markdown else "  "
    print(separator.join(head))
    if arguments.markdown:
        print(separator.join("---" for _ in head))
    for path in arguments.files:
        print(separator.join(row(path)), flush=True)


if __name__ == "__main__":
    main()
