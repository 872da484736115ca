"""Bodies made by OpenCASCADE, as STEP files: rays against its own intersections.

    python benchmarks/cad_bodies.py [--rays 2500] [--only TEXT ...] [--list]

Box, cylinder, sphere, cone and torus, each cut and joined with each about turned axes; fillets,
counterbores, rings of bolt holes, balls, cones and tori with bores in several directions, cuts
through poles and apexes, and bodies far from the origin. Each is written to a STEP file and read
from it; the rays go to IntCurvesFace_ShapeIntersector with the body as it was before.

Bodies as NURBS are compared with the same bodies of elementary surfaces, whose grazing rays
OpenCASCADE does not miss.

A ray is *wrong* if hit and miss differ, or t by more than 1e-4 of the size of the body, unless it
lies *at an edge*: then OpenCASCADE's own answer changes when the ray is moved by 1e-4 of the size.
Needs the extra ``[cad]``.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

#: Of the size of a body: how far rays are moved, and by how much t may differ.
NEAR = 1e-4

Vector = tuple[float, float, float]


class Maker:
    """Makes solids; a place is a point and an axis."""

    def __init__(self) -> None:
        from OCP import BRepAlgoAPI, BRepBuilderAPI, BRepFilletAPI, BRepPrimAPI, gp

        self.algo, self.build, self.fillets = BRepAlgoAPI, BRepBuilderAPI, BRepFilletAPI
        self.prim, self.gp = BRepPrimAPI, gp

    def place(self, at: Vector, axis: Vector) -> Any:
        return self.gp.gp_Ax2(self.gp.gp_Pnt(*at), self.gp.gp_Dir(*axis))

    def box(self, sides: Vector, at: Vector = (0, 0, 0), axis: Vector = (0, 0, 1)) -> Any:
        """Make a box around a point."""
        box = self.prim.BRepPrimAPI_MakeBox(self.place((0, 0, 0), axis), *sides).Shape()
        frame = self.place((0, 0, 0), axis)
        corner = sum(
            np.array([d.X(), d.Y(), d.Z()]) * side / 2
            for d, side in zip((frame.XDirection(), frame.YDirection(), frame.Direction()), sides)
        )
        return self.moved(box, tuple(np.array(at) - corner))

    def cylinder(
        self, radius: float, height: float, at: Vector = (0, 0, 0), axis: Vector = (0, 0, 1)
    ) -> Any:
        """Make a cylinder around a point."""
        foot = np.array(at) - height / 2 * np.array(axis) / np.linalg.norm(axis)
        place = self.place(tuple(foot.tolist()), axis)
        return self.prim.BRepPrimAPI_MakeCylinder(place, radius, height).Shape()

    def sphere(self, radius: float, at: Vector = (0, 0, 0), axis: Vector = (0, 0, 1)) -> Any:
        return self.prim.BRepPrimAPI_MakeSphere(self.place(at, axis), radius).Shape()

    def cone(
        self,
        low: float,
        high: float,
        height: float,
        at: Vector = (0, 0, 0),
        axis: Vector = (0, 0, 1),
    ) -> Any:
        """Make a cone around a point, by the radii of its ends."""
        foot = np.array(at) - height / 2 * np.array(axis) / np.linalg.norm(axis)
        place = self.place(tuple(foot.tolist()), axis)
        return self.prim.BRepPrimAPI_MakeCone(place, low, high, height).Shape()

    def torus(
        self, major: float, minor: float, at: Vector = (0, 0, 0), axis: Vector = (0, 0, 1)
    ) -> Any:
        return self.prim.BRepPrimAPI_MakeTorus(self.place(at, axis), major, minor).Shape()

    def cut(self, body: Any, *tools: Any) -> Any:
        for tool in tools:
            body = self.algo.BRepAlgoAPI_Cut(body, tool).Shape()
        return body

    def join(self, body: Any, *others: Any) -> Any:
        for other in others:
            body = self.algo.BRepAlgoAPI_Fuse(body, other).Shape()
        return body

    def moved(self, body: Any, shift: Any) -> Any:
        move = self.gp.gp_Trsf()
        move.SetTranslation(self.gp.gp_Vec(*(float(x) for x in shift)))
        return self.build.BRepBuilderAPI_Transform(body, move, True).Shape()

    def as_nurbs(self, body: Any) -> Any:
        return self.build.BRepBuilderAPI_NurbsConvert(body, True).Shape()

    def rounded(self, body: Any, radius: float) -> Any:
        """Round all edges."""
        from OCP.TopAbs import TopAbs_ShapeEnum
        from OCP.TopExp import TopExp_Explorer
        from OCP.TopoDS import TopoDS

        as_edge = getattr(TopoDS, "Edge_s", None) or TopoDS.Edge
        tool = self.fillets.BRepFilletAPI_MakeFillet(body)
        edges = TopExp_Explorer(body, TopAbs_ShapeEnum.TopAbs_EDGE)
        while edges.More():
            tool.Add(radius, as_edge(edges.Current()))
            edges.Next()
        return tool.Shape()


def bodies() -> dict[str, Callable[[], Any]]:
    """Return functions that make the bodies, by name."""
    m = Maker()
    axes: list[Vector] = [(0, 0, 1), (1, 0, 0), (1, 1, 0), (0.3, -0.5, 0.8), (-0.6, 0.7, 0.1)]
    first: dict[str, Callable[[Vector], Any]] = {
        "box": lambda axis: m.box((20, 16, 12), axis=axis),
        "cylinder": lambda axis: m.cylinder(8, 20, axis=axis),
        "sphere": lambda axis: m.sphere(11, axis=axis),
        "cone": lambda axis: m.cone(11, 0, 20, axis=axis),
        "torus": lambda axis: m.torus(10, 4, axis=axis),
    }
    second: dict[str, Callable[[Vector], Any]] = {
        "box": lambda axis: m.box((7, 9, 40), (3, 2, 1), axis),
        "cylinder": lambda axis: m.cylinder(3, 50, (2, 1, 1), axis),
        "sphere": lambda axis: m.sphere(7, (7, -3, 4), axis),
        "cone": lambda axis: m.cone(6, 2, 40, (-2, 1, 0), axis),
        "torus": lambda axis: m.torus(9, 3, (3, 2, -1), axis),
    }
    out: dict[str, Callable[[], Any]] = {}
    names = list(first)
    for i, a in enumerate(names):
        for j, b in enumerate(names):
            one, two = axes[(i + 2 * j) % 5], axes[(2 * i + j + 1) % 5]
            out[f"{a} less {b}"] = lambda a=a, b=b, one=one, two=two: m.cut(
                first[a](one), second[b](two)
            )
            if j >= i:
                one, two = axes[(2 * i + j + 3) % 5], axes[(i + 3 * j) % 5]
                out[f"{a} and {b}"] = lambda a=a, b=b, one=one, two=two: m.join(
                    first[a](one), second[b](two)
                )
    for axis in ((0, 0, 1), (1, 0, 0), (0, 1, 0), (1, 1, 0), (1, 2, 3)):
        text = " ".join(map(str, axis))
        out[f"bored ball, axis {text}"] = lambda axis=axis: m.cut(
            m.sphere(12, (5, 5, 5), axis), m.cylinder(4, 60, (5, 5, 5))
        )
        out[f"bored torus, axis {text}"] = lambda axis=axis: m.cut(
            m.torus(10, 4, axis=axis),
            m.cylinder(2, 60, (9.5, 1, 0)),
            m.cylinder(1.5, 60, (0, 9, 0)),
        )
    for axis in ((1, 0, 0), (0, 1, 0), (1, 2, 2)):
        text = " ".join(map(str, axis))
        out[f"cone bored along {text}"] = lambda axis=axis: m.cut(
            m.cone(10, 0, 20), m.cylinder(2.5, 60, (0, 0, -3), axis)
        )
        out[f"ball cut at its pole by {text}"] = lambda axis=axis: m.cut(
            m.sphere(10), m.box((9, 9, 9), (0, 0, 10), axis)
        )
    out["ball with a hole through its pole"] = lambda: m.cut(
        m.sphere(10), m.cylinder(3, 60, (1.5, 0.7, 0))
    )
    out["cone with its apex cut sideways"] = lambda: m.cut(
        m.cone(10, 0, 20), m.box((12, 12, 12), (6, 0.5, 10))
    )
    out["ring with bolt holes"] = lambda: m.cut(
        m.cylinder(20, 10),
        m.cylinder(12, 20),
        *(
            m.cylinder(1.9, 20, (16 * np.cos(a), 16 * np.sin(a), 0))
            for a in np.arange(6) * np.pi / 3 + 0.2
        ),
    )
    out["counterbored plate"] = lambda: m.cut(
        m.box((40, 30, 8)),
        *(
            hole
            for x, y in ((-12, -8), (-12, 8), (12, -8), (12, 8))
            for hole in (m.cylinder(2, 20, (x, y, 0)), m.cylinder(4, 6, (x, y, 4)))
        ),
        m.cylinder(5, 50, (0, 0, 2), (1, 0, 0.2)),
    )
    out["rounded box"] = lambda: m.rounded(m.box((20, 16, 12)), 2.5)
    out["rounded box with holes"] = lambda: m.cut(
        m.rounded(m.box((20, 16, 12)), 3.0),
        m.cylinder(3, 50, (0, 1, 1), (1, 0.2, 0)),
        m.cylinder(2.5, 50, (7.5, 5.5, 0)),
    )
    out["rounded tube"] = lambda: m.rounded(m.cut(m.cylinder(9, 20), m.cylinder(5, 40)), 1.0)
    out["rounded cross of cylinders"] = lambda: m.rounded(
        m.join(m.cylinder(6, 30), m.cylinder(4, 30, axis=(1, 0, 0))), 0.8
    )
    for name in ("sphere less cylinder", "cylinder less cylinder", "torus less box"):
        out[f"{name}, as NURBS"] = lambda name=name: m.as_nurbs(out[name]())
    for name, shift in (
        ("sphere less cylinder", (1e3, -2e3, 500)),
        ("counterbored plate", (1e4, 1e4, -1e4)),
        ("torus less cylinder", (-1e4, 0, 3e3)),
    ):
        out[f"{name}, moved far"] = lambda name=name, shift=shift: m.moved(out[name](), shift)
    return out


def write(shape: Any, path: Path) -> Path:
    """Write a STEP file."""
    from OCP.Message import Message, Message_PrinterOStream
    from OCP.STEPControl import STEPControl_StepModelType, STEPControl_Writer

    Message.DefaultMessenger_s().RemovePrinters(Message_PrinterOStream.get_type_descriptor_s())
    writer = STEPControl_Writer()
    writer.Transfer(shape, STEPControl_StepModelType.STEPControl_AsIs)
    writer.Write(str(path))
    return path


def box_of(shape: Any) -> tuple[np.ndarray, np.ndarray]:
    from OCP.Bnd import Bnd_Box
    from OCP.BRepBndLib import BRepBndLib

    box = Bnd_Box()
    BRepBndLib.AddOptimal_s(shape, box, False, False)
    low, high = box.CornerMin(), box.CornerMax()
    return np.array([low.X(), low.Y(), low.Z()]), np.array([high.X(), high.Y(), high.Z()])


def rays(low: np.ndarray, high: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return rays from around a box to points of it, float32 numbers."""
    rng = np.random.default_rng(17)
    reach = float(np.linalg.norm(high - low))
    o = rng.normal(size=(count, 3))
    o = (low + high) / 2 + 1.2 * reach * o / np.linalg.norm(o, axis=1, keepdims=True)
    d = low + (high - low) * rng.random((count, 3)) - o
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    return o.astype(np.float32).astype(float), d.astype(np.float32).astype(float)


class Exact:
    """OpenCASCADE's own answers."""

    def __init__(self, shape: Any) -> None:
        from OCP.gp import gp_Dir, gp_Lin, gp_Pnt
        from OCP.IntCurvesFace import IntCurvesFace_ShapeIntersector

        self.dir, self.line, self.point = gp_Dir, gp_Lin, gp_Pnt
        self.tool = IntCurvesFace_ShapeIntersector()
        self.tool.Load(shape, 1e-7)

    def first(self, o: np.ndarray, d: np.ndarray) -> float:
        """Return the smallest t >= 0 of a hit, infinite if there is none."""
        self.tool.Perform(self.line(self.point(*o.tolist()), self.dir(*d.tolist())), 0, 1e9)
        found = (self.tool.WParameter(k + 1) for k in range(self.tool.NbPnt()))
        return min(found, default=np.inf) / float(np.linalg.norm(d))

    def at_edge(self, o: np.ndarray, d: np.ndarray, wanted: float, size: float) -> bool:
        """Tell whether the answer changes when the ray is moved a little."""
        side = np.cross(d, np.eye(3)[np.argmin(np.abs(d))])
        side /= np.linalg.norm(side)
        other = np.cross(d, side)
        for angle in np.arange(8) * np.pi / 4:
            shift = NEAR * size * (np.cos(angle) * side + np.sin(angle) * other)
            moved = self.first(o + shift, d)
            # fifty times further than the ray was moved: no surface met at more than two degrees
            if np.isfinite(moved) != np.isfinite(wanted) or (
                np.isfinite(wanted) and abs(moved - wanted) > 50 * NEAR * size
            ):
                return True
        return False


def compare(path: Path, shape: Any, count: int, verbose: bool = True) -> dict[str, Any]:
    """Return the figures of one body."""
    import mitsuba_bezier  # noqa: F401  isort: skip (before Dr.Jit, for which it finds LLVM)
    import mitsuba as mi

    from mitsuba_bezier import io

    start = time.process_time()
    report = io.read(path, trims=True).report
    ours = mi.load_dict({"type": "beziertriangle", "filename": str(path)})
    low, high = box_of(shape)
    size = float(np.linalg.norm(high - low))
    o, d = rays(low, high, count)
    pi = ours.ray_intersect_preliminary(mi.Ray3f(mi.Point3f(o.T), mi.Vector3f(d.T)))
    t, hit = np.array(pi.t).astype(float), np.array(pi.is_valid())
    exact = Exact(shape)
    wrong, edge, worst = [], 0, 0.0
    for k in range(count):
        wanted = exact.first(o[k], d[k])
        if hit[k] == np.isfinite(wanted):
            off = abs(t[k] - wanted) if hit[k] else 0.0
            if off <= NEAR * size:
                worst = max(worst, off / size)
                continue
        if exact.at_edge(o[k], d[k], wanted, size):
            edge += 1
            continue
        wrong.append((o[k].tolist(), d[k].tolist(), float(t[k]) if hit[k] else np.inf, wanted))
        if verbose and len(wrong) <= 3:
            print(f"  wrong: ray {o[k].tolist()} {d[k].tolist()}: {t[k]}, right {wanted}")
    return {
        "faces": report.faces,
        "refused": report.faces - report.converted,
        "patches": len(ours.patches),
        "hits": int(hit.sum()),
        "wrong": wrong,
        "edge": edge,
        "t": worst,
        "seconds": time.process_time() - start,
    }


def main() -> None:
    """Print the table."""
    import mitsuba_bezier  # noqa: F401  isort: skip
    import mitsuba as mi

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rays", type=int, default=2500)
    parser.add_argument("--only", nargs="*", default=[""], help="parts of names")
    parser.add_argument("--list", action="store_true", help="print the names only")
    args = parser.parse_args()
    all_bodies = bodies()
    made = {n: f for n, f in all_bodies.items() if any(text in n for text in args.only)}
    if args.list:
        print("\n".join(made))
        return
    mi.set_variant("llvm_ad_rgb")
    print("| body | faces | refused | patches | rays | hits | wrong | at edges | t | s |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |")
    total = 0
    with tempfile.TemporaryDirectory() as folder:
        for name, make in made.items():
            shape = make()
            path = write(shape, Path(folder) / "body.step")
            # OpenCASCADE misses grazing rays on NURBS surfaces; the body is the same without
            exact = all_bodies[name.removesuffix(", as NURBS")]()
            r = compare(path, exact, args.rays)
            total += len(r["wrong"])
            print(
                f"| {name} | {r['faces']} | {r['refused']} | {r['patches']} | {args.rays} "
                f"| {r['hits']} | {len(r['wrong'])} | {r['edge']} | {r['t']:.0e} "
                f"| {r['seconds']:.1f} |",
                flush=True,
            )
    print(f"{len(made)} bodies, {total} of {len(made) * args.rays} rays wrong")


if __name__ == "__main__":
    main()
