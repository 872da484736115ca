"""Score four intersectors against the conformance set (docs/conformance.md).

    python benchmarks/conformance.py SET [--folder DIR] [--only NAME ...] [--degree]

Ours in float32 and float64, OpenCASCADE (extra `cad`), and a tessellation of 2048 triangles a patch
in Mitsuba. Each writes a file of answers into the folder, and its table is printed.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import mitsuba_bezier  # noqa: F401 (before Dr.Jit, for which it finds LLVM)

sys.path.insert(0, str(Path(__file__).parent))  # for a caller that is not in this folder

import drjit.llvm as llvm
import mitsuba as mi
import numpy as np
from common import mesh, to_rays
from rich.progress import track

from mitsuba_bezier.cli.conformance import markdown
from mitsuba_bezier.errors import BezierError
from mitsuba_bezier.geometry import bernstein
from mitsuba_bezier.geometry.triangles import BezierTriangles
from mitsuba_bezier.kernels.structure import build_structure
from mitsuba_bezier.kernels.traverse import intersect
from mitsuba_bezier.leaves.builder import build_leaves
from mitsuba_bezier.leaves.records import Leaves
from mitsuba_bezier.oracles.conformance import read_set
from mitsuba_bezier.oracles.conformance_score import answer, score

Hits = list[list[float]]

#: Triangles of the tessellation: those of a patch drawn finely.
_TRIANGLES = 2048


def _first(t: np.ndarray, valid: np.ndarray) -> Hits:
    return [[x] if hit else [] for x, hit in zip(t.astype(float).tolist(), valid.tolist())]


@cache
def _leaves(net: bytes, rows: int) -> Leaves | None:
    """Return the leaves of a patch, for both precisions; cusps and base points take seconds."""
    try:
        return build_leaves(BezierTriangles(np.frombuffer(net).reshape(rows, 4)))
    except BezierError:
        return None


def ours(number: Any) -> Callable[[np.ndarray, np.ndarray, np.ndarray], Hits | None]:
    """Return our kernel, in `drjit.llvm.Float` or `Float64`."""

    def run(net: np.ndarray, o: np.ndarray, d: np.ndarray) -> Hits | None:
        leaves = _leaves(net.tobytes(), len(net))
        if leaves is None:
            return None
        columns = [[number(np.ascontiguousarray(a[:, k])) for k in range(3)] for a in (o, d)]
        hit = intersect(build_structure(leaves, number), *columns, number(np.inf))
        t = np.broadcast_to(np.array(hit.t), len(o))
        return _first(t, np.broadcast_to(np.array(hit.valid), len(o)))

    return run


def opencascade(net: np.ndarray, o: np.ndarray, d: np.ndarray) -> Hits | None:
    """Return OpenCASCADE's intersections with the patch as a tensor product; one edge collapses."""
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeFace
    from OCP.Geom import Geom_BezierSurface
    from OCP.gp import gp_Dir, gp_Lin, gp_Pnt
    from OCP.IntCurvesFace import IntCurvesFace_Intersector

    try:
        from OCP.collections import Array2_double, Array2_gp_Pnt
    except ImportError:  # before OpenCASCADE 8
        from OCP.TColgp import TColgp_Array2OfPnt as Array2_gp_Pnt
        from OCP.TColStd import TColStd_Array2OfReal as Array2_double

    if not (net[:, 3] > 0).all():
        return None  # it takes positive weights only
    n = bernstein.degree_of(len(net))
    points, weights = Array2_gp_Pnt(1, n + 1, 1, n + 1), Array2_double(1, n + 1, 1, n + 1)
    for i in range(n + 1):
        # u = s, v = (1 - s) r: row i of the triangle, a curve of degree n - i, elevated to n
        row = net[[bernstein.row(n, i, j) for j in range(n - i + 1)]]
        for degree in range(n - i + 1, n + 1):
            k = np.arange(degree + 1)[:, None] / degree
            row = np.concatenate([row, row[-1:]]) * (1 - k) + k * np.concatenate([row[:1], row])
        for j, (x, y, z, w) in enumerate(row.tolist()):
            points.SetValue(i + 1, j + 1, gp_Pnt(x / w, y / w, z / w))
            weights.SetValue(i + 1, j + 1, w)
    face = BRepBuilderAPI_MakeFace(Geom_BezierSurface(points, weights), 1e-9).Face()
    tool = IntCurvesFace_Intersector(face, 1e-10)
    out = []
    for origin, direction in zip(o.tolist(), d.tolist()):
        tool.Perform(gp_Lin(gp_Pnt(*origin), gp_Dir(*direction)), -1e6, 1e6)
        length = float(np.linalg.norm(direction))
        out.append([tool.WParameter(k + 1) / length for k in range(tool.NbPnt())])
    return out


def tessellated(net: np.ndarray, o: np.ndarray, d: np.ndarray) -> Hits | None:
    """Return Mitsuba's first hits of a mesh; a patch that reaches infinity has none."""
    try:
        shape = mesh(BezierTriangles(net), _TRIANGLES)
    except BezierError:
        return None
    scene = mi.load_dict({"type": "scene", "mesh": shape})
    found = scene.ray_intersect_preliminary(to_rays(o.astype(np.float32), d.astype(np.float32)))
    return _first(np.array(found.t), np.array(found.is_valid()))


#: Name, the intersector, its precision, and whether it returns first hits only.
INTERSECTORS: dict[str, tuple[Any, str, bool]] = {
    "mitsuba_bezier, float32": (ours(llvm.Float), "single", True),
    "mitsuba_bezier, float64": (ours(llvm.Float64), "double", True),
    "OpenCASCADE": (opencascade, "double", False),
    "2048 triangles in Mitsuba": (tessellated, "single", True),
}


def main(argv: list[str] | None = None) -> None:
    """Run the intersectors and print their tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("set", metavar="SET", type=Path)
    parser.add_argument("--folder", type=Path, default=Path("benchmarks/results/conformance"))
    parser.add_argument("--only", metavar="NAME", nargs="+", default=list(INTERSECTORS))
    parser.add_argument("--degree", action="store_true", help="a row a degree")
    args = parser.parse_args(argv)
    args.folder.mkdir(parents=True, exist_ok=True)
    mi.set_variant("llvm_ad_rgb")
    patches = len(list(read_set(args.set)))
    for name in args.only:
        function, precision, first = INTERSECTORS[name]
        progress = iter(track(range(patches), name, transient=True))

        def shown(net: Any, o: Any, d: Any, run: Any = function, steps: Any = progress) -> Any:
            next(steps, None)
            return run(net, o, d)

        path = args.folder / f"{name}.jsonl"
        answer(path, args.set, shown, name, precision, first)
        print(f"{name} ({precision} precision, {'first hits' if first else 'all hits'})\n")
        print(markdown(score(args.set, path)[1], args.degree) + "\n")


if __name__ == "__main__":
    main()
