"""Rays against CAD parts, compared with OpenCASCADE's own intersections.

    python benchmarks/cad_rays.py [FILE.step ...] [--rays 4000]

Without files: four parts made here, with holes through curved faces. For each: the closest hits of
random rays, ours in float32 and OpenCASCADE's (IntCurvesFace_ShapeIntersector), on the whole part.
A ray is *wrong* if the two differ and the nearer of both hits is not within the band, 1e-5 of
the size of the part, of an edge. Needs the extra ``[cad]``.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

# isort: off
import mitsuba_bezier  # noqa: F401 (before Dr.Jit, for which it finds LLVM)
import drjit as dr
import mitsuba as mi

# isort: on

from mitsuba_bezier.io.cad import opencascade as cad

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

BAND = 1e-5


def rays(low: np.ndarray, high: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return rays from around a box to points of it, float32 numbers."""
    rng = np.random.default_rng(0)
    center, reach = (low + high) / 2, float(np.linalg.norm(high - low))
    o = rng.normal(size=(count, 3))
    o = center + reach * o / np.linalg.norm(o, axis=1, keepdims=True)
    d = low + (high - low) * rng.random((count, 3)) - o
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    return o.astype(np.float32).astype(float), d.astype(np.float32).astype(float)


def compare(path: Path, part: Any, count: int) -> list[str]:
    """Return one line of the table."""
    from OCP.BRep import BRep_Builder
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeVertex
    from OCP.BRepExtrema import BRepExtrema_DistShapeShape
    from OCP.gp import gp_Dir, gp_Lin, gp_Pnt
    from OCP.IntCurvesFace import IntCurvesFace_ShapeIntersector
    from OCP.TopoDS import TopoDS_Compound

    start = time.process_time()
    shape = mi.load_dict({"type": "beziertriangle", "filename": str(path)})
    boxes = shape.patches.hulls()
    low, high = boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)
    size = float(np.linalg.norm(high - low))
    o, d = rays(low, high, count)
    ray = mi.Ray3f(mi.Point3f(o.T), mi.Vector3f(d.T))
    pi = shape.ray_intersect_preliminary(ray)
    any_hit = shape.ray_test(ray)
    dr.eval(pi, any_hit)
    t, hit = np.array(pi.t).astype(float), np.array(pi.is_valid())
    seconds = time.process_time() - start
    occ = cad._occ()
    tool = IntCurvesFace_ShapeIntersector()
    tool.Load(part, 1e-9)
    edges, builder = TopoDS_Compound(), BRep_Builder()
    builder.MakeCompound(edges)
    for edge in cad._explore(occ, part, occ.abs.TopAbs_EDGE):
        builder.Add(edges, edge)
    wrong = band = 0
    worst = 0.0
    for k in range(count):
        tool.PerformNearest(gp_Lin(gp_Pnt(*o[k]), gp_Dir(*d[k])), 0, 1e9)
        found = [tool.WParameter(i + 1) for i in range(tool.NbPnt())]
        wanted = min(found, default=np.inf) / np.linalg.norm(d[k])
        same = hit[k] == np.isfinite(wanted)
        if same and (not hit[k] or abs(t[k] - wanted) < BAND * size):
            worst = max(worst, abs(t[k] - wanted) / size if hit[k] else 0.0)
            continue
        place = o[k] + min(t[k] if hit[k] else np.inf, wanted) * d[k]
        vertex = BRepBuilderAPI_MakeVertex(gp_Pnt(*place)).Vertex()
        if BRepExtrema_DistShapeShape(vertex, edges).Value() < BAND * size:
            band += 1
        else:
            wrong += 1
            print(f"  wrong: ray {o[k]} {d[k]}: {t[k] if hit[k] else 'none'}, {wanted}", flush=True)
    trimmed = 0 if shape.trims is None else int((shape.trims.region >= 0).sum())
    return [
        path.name,
        f"{len(shape.patches)}, {trimmed} trimmed",
        str(count),
        f"{hit.mean():.2f}",
        str(wrong),
        str(band),
        str(int((np.array(any_hit) != hit).sum())),
        f"{worst:.0e}",
        f"{seconds:.1f}",
    ]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("files", nargs="*", type=Path)
    parser.add_argument("--rays", type=int, default=4000)
    args = parser.parse_args()
    mi.set_variant("llvm_ad_rgb")
    head = ["part", "patches", "rays", "hit", "wrong", "in band", "any hit differs", "t", "s"]
    print(" | ".join(head))
    occ = cad._occ()
    for path in args.files:
        print(" | ".join(compare(path, cad._load(occ, path), args.rays)), flush=True)
    if not args.files:
        from test_trimmed_shapes import PARTS, parts, write

        with tempfile.TemporaryDirectory() as folder:
            made = parts()
            for name in PARTS:
                path = write(made[name], Path(folder) / f"{name}.brep")
                exact = made[name.replace("as NURBS ", "")]
                print(" | ".join(compare(path, exact, args.rays)), flush=True)


if __name__ == "__main__":
    main()
