"""Depth images of CAD files against OpenCASCADE's tessellation, pixel by pixel.

    python benchmarks/cad_depth.py FILE.step FILE.iges ... [--size 256] [--deflection 5e-5]

Each part is looked at along an oblique direction, by parallel rays: ours meet the exact patches
with their trims, the others a mesh that OpenCASCADE makes (deflection 5e-5 of the size of the
part, 0.05 radian) in Mitsuba. A pixel *differs* if one is hit and the other is not, or depths
differ by more than 1e-3 of the size. It is *explained* if it lies within one pixel of an outline
of either image (where hit and miss or two surfaces meet), or if OpenCASCADE's exact intersection
for that ray is ours. What is left over should be 0. Faces that are refused are named. Needs the
extra ``[cad]``.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np

# isort: off
import mitsuba_bezier  # noqa: F401 (before Dr.Jit, for which it finds LLVM)
import mitsuba as mi

# isort: on

from mitsuba_bezier import io
from mitsuba_bezier.io.cad import opencascade as cad

#: Of the size of a part: what two depths may differ by.
NEAR = 1e-3
DIRECTION = np.array([-0.48, 0.71, -0.515])


def load(path: Path) -> Any:
    """Return OpenCASCADE's shape of a file."""
    return cad._load(cad.import_library(), path)


def tessellated(shape: Any, deflection: float) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices and triangles of a mesh of a shape."""
    from OCP.BRep import BRep_Tool
    from OCP.BRepMesh import BRepMesh_IncrementalMesh
    from OCP.TopLoc import TopLoc_Location

    occ = cad.import_library()
    BRepMesh_IncrementalMesh(shape, deflection, False, 0.05, True)
    points, faces, start = [], [], 0
    for item in cad._explore(occ, shape, occ.abs.TopAbs_FACE):
        place = TopLoc_Location()
        mesh = BRep_Tool.Triangulation_s(occ.face(item), place)
        if mesh is None:
            continue
        move = place.Transformation()
        for k in range(1, mesh.NbNodes() + 1):
            p = mesh.Node(k).Transformed(move)
            points.append([p.X(), p.Y(), p.Z()])
        for k in range(1, mesh.NbTriangles() + 1):
            faces.append([start + i - 1 for i in mesh.Triangle(k).Get()])
        start = len(points)
    return np.array(points), np.array(faces)


def as_mesh(points: np.ndarray, faces: np.ndarray) -> Any:
    mesh = mi.Mesh("reference", len(points), len(faces))
    params = mi.traverse(mesh)
    params["vertex_positions"] = points.ravel().astype(np.float32)
    params["faces"] = faces.ravel().astype(np.uint32)
    params.update()
    return mi.load_dict({"type": "scene", "mesh": mesh})


def view(points: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Return origins ``(size * size, 3)`` of parallel rays, their direction, the part's size."""
    low, high = points.min(axis=0), points.max(axis=0)
    reach = float(np.linalg.norm(high - low))
    d = DIRECTION / np.linalg.norm(DIRECTION)
    right = np.cross(d, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, d)
    local = (points - (low + high) / 2) @ np.stack([right, up]).T
    middle = (local.min(axis=0) + local.max(axis=0)) / 2
    half = 0.52 * float(np.ptp(local, axis=0).max())
    # no symmetric places: rays through edges decide nothing
    at = (np.arange(size) + 0.5137) / size * 2 - 1
    x, y = np.meshgrid(middle[0] + half * at, middle[1] - half * at)
    o = (low + high) / 2 - 0.75 * reach * d + x.reshape(-1, 1) * right + y.reshape(-1, 1) * up
    return o.astype(np.float32).astype(float), d.astype(np.float32).astype(float), reach


def outlines(depth: np.ndarray, near: float) -> np.ndarray:
    """Tell which pixels ``(size, size)`` are within one pixel of a jump of depth.

    Depths go on where second differences are small, however steep the surface is.
    """
    finite = np.where(np.isfinite(depth), depth, 1e9)
    out = np.zeros(depth.shape, dtype=bool)
    for axis in (0, 1):
        step = np.diff(finite, axis=axis)
        bend = np.abs(np.diff(step, axis=axis)) > near
        pad = [(1, 1) if k == axis else (0, 0) for k in (0, 1)]
        out |= np.pad(bend, pad)
    grown = np.pad(out, 1)
    n, m = depth.shape
    return np.any([grown[i : i + n, j : j + m] for i in range(3) for j in range(3)], axis=0)


def row(path: Path, size: int, deflection: float, verbose: bool = True) -> list[str]:
    """Return one line of the table."""
    from OCP.gp import gp_Dir, gp_Lin, gp_Pnt
    from OCP.IntCurvesFace import IntCurvesFace_ShapeIntersector

    start = time.process_time()
    report = io.read(path, trims=True).report
    shape = load(path)
    points, faces = tessellated(shape, 1.0)  # for the size, roughly
    reach = float(np.linalg.norm(np.ptp(points, axis=0)))
    points, faces = tessellated(shape, deflection * reach)
    o, d, reach = view(points, size)
    rays = mi.Ray3f(mi.Point3f(o.T), mi.Vector3f(*d.tolist()))
    other = np.array(as_mesh(points, faces).ray_intersect_preliminary(rays).t).astype(float)
    ours_shape = mi.load_dict({"type": "beziertriangle", "filename": str(path)})
    pi = ours_shape.ray_intersect_preliminary(rays)
    ours = np.where(np.array(pi.is_valid()), np.array(pi.t).astype(float), np.inf)
    both = np.isfinite(ours) & np.isfinite(other)
    gap = np.where(both, np.abs(np.where(both, ours, 0) - np.where(both, other, 0)), 0.0)
    mask = np.isfinite(ours) != np.isfinite(other)
    differs = mask | (gap > NEAR * reach)
    edge = np.zeros(len(o), dtype=bool)
    for image in (ours, other):
        edge |= outlines(image.reshape(size, size), NEAR * reach).ravel()
    tool = IntCurvesFace_ShapeIntersector()
    tool.Load(shape, 1e-7)
    left = 0
    for k in np.flatnonzero(differs & ~edge):
        tool.Perform(gp_Lin(gp_Pnt(*o[k].tolist()), gp_Dir(*d.tolist())), 0, 1e9)
        exact = min((tool.WParameter(i + 1) for i in range(tool.NbPnt())), default=np.inf)
        same = np.isfinite(exact) == np.isfinite(ours[k])
        if not same or (np.isfinite(exact) and abs(exact - ours[k]) > 1e-4 * reach):
            left += 1
            if verbose and left <= 3:
                print(f"  unexplained: {o[k].tolist()}: {ours[k]}, mesh {other[k]}, exact {exact}")
    smooth = both & ~edge & ~differs
    reasons: dict[str, int] = {}
    for refusal in report.refused:
        reasons[refusal.reason] = reasons.get(refusal.reason, 0) + refusal.count
    return [
        path.name,
        str(report.faces),
        str(len(ours_shape.patches)),
        "; ".join(f"{n}: {reason}" for reason, n in reasons.items()),
        f"{len(faces)}",
        str(int(both.sum())),
        str(int(mask.sum())),
        str(int(differs.sum())),
        str(int((differs & ~edge).sum())),
        str(left),
        f"{gap[smooth].max(initial=0.0) / reach:.0e}",
        f"{time.process_time() - start:.0f}",
    ]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("--size", type=int, default=256, help="pixels along a side")
    parser.add_argument("--deflection", type=float, default=5e-5, help="of the size of the part")
    args = parser.parse_args()
    mi.set_variant("llvm_ad_rgb")
    head = ["file", "faces", "patches", "refused", "triangles", "pixels", "masks differ", "differ"]
    head += ["not at outlines", "unexplained", "depth", "s"]
    print("|", " | ".join(head), "|")
    print("|", " | ".join("---" for _ in head), "|")
    for path in args.files:
        print("|", " | ".join(row(path, args.size, args.deflection)), "|", flush=True)


if __name__ == "__main__":
    main()
