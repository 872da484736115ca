"""Write the CAD part and the high-order mesh: ``python scenes/make_cad.py``.

``cad_part.vtu``: a valve body, made with OpenCASCADE (the extra ``[cad]``), whose faces keep their
surfaces: planes, cylinders, cones and tori, with trims where they cut each other.
``high_order_mesh.vtu``: a knotted pipe as a mesh of order 4 by Gmsh (the package ``gmsh`` and the
extra ``[mesh]``). The z axis points up; lengths in metres.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from mitsuba_bezier import io

__all__ = ["FOLDER", "main"]

FOLDER = Path(__file__).resolve().parent / "models"


def cad_part() -> Any:
    """Return the valve body in millimetres, as an OpenCASCADE shape."""
    from OCP.BRepAlgoAPI import BRepAlgoAPI_Cut, BRepAlgoAPI_Fuse
    from OCP.BRepBuilderAPI import BRepBuilderAPI_Transform
    from OCP.BRepFilletAPI import BRepFilletAPI_MakeFillet
    from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox, BRepPrimAPI_MakeCone, BRepPrimAPI_MakeCylinder
    from OCP.gp import gp_Ax2, gp_Dir, gp_Pnt, gp_Trsf
    from OCP.TopAbs import TopAbs_ShapeEnum
    from OCP.TopExp import TopExp_Explorer
    from OCP.TopoDS import TopoDS

    as_edge = getattr(TopoDS, "Edge_s", None) or TopoDS.Edge

    def cylinder(at, way, radius, height):
        frame = gp_Ax2(gp_Pnt(*at), gp_Dir(*way))
        return BRepPrimAPI_MakeCylinder(frame, radius, height).Shape()

    def edges(shape):
        explorer = TopExp_Explorer(shape, TopAbs_ShapeEnum.TopAbs_EDGE)
        while explorer.More():
            yield as_edge(explorer.Current())
            explorer.Next()

    def middle(edge):
        from OCP.BRepAdaptor import BRepAdaptor_Curve

        curve = BRepAdaptor_Curve(edge)
        p = curve.Value(0.5 * (curve.FirstParameter() + curve.LastParameter()))
        return np.array([p.X(), p.Y(), p.Z()])

    def blend(shape, radius, chosen):
        tool = BRepFilletAPI_MakeFillet(shape)
        found = [e for e in edges(shape) if chosen(middle(e))]
        seen = []
        for edge in found:
            if not any(edge.IsSame(other) for other in seen):
                tool.Add(radius, edge)
                seen.append(edge)
        return tool.Shape()

    def fuse(*parts):
        out = parts[0]
        for part in parts[1:]:
            out = BRepAlgoAPI_Fuse(out, part).Shape()
        return out

    def cut(shape, *parts):
        for part in parts:
            shape = BRepAlgoAPI_Cut(shape, part).Shape()
        return shape

    # foot with rounded corners
    foot = BRepPrimAPI_MakeBox(gp_Pnt(-45, -32, 0), 90, 64, 10).Shape()
    foot = blend(foot, 12, lambda m: abs(abs(m[0]) - 45) < 1e-6 and abs(abs(m[1]) - 32) < 1e-6)
    # upright boss, and a pipe across it
    boss = cylinder((0, 0, 5), (0, 0, 1), 24, 50)
    pipe = cylinder((0, 18, 36), (0, -1, 0), 15, 62)
    collar = cylinder((0, -36, 36), (0, -1, 0), 20, 8)
    body = fuse(foot, boss, pipe, collar)

    def on_foot(m):
        return abs(m[2] - 10) < 1e-6 and abs(np.hypot(m[0], m[1]) - 24) < 1e-3

    body = blend(body, 5, on_foot)
    body = blend(body, 2, lambda m: abs(m[2] - 55) < 1e-6 and abs(np.hypot(*m[:2]) - 24) < 1e-3)
    body = blend(
        body, 1.5, lambda m: abs(m[2] - 10) < 1e-6 and (abs(m[0]) > 30 or abs(m[1]) > 31.9)
    )
    # bores
    body = cut(
        body, cylinder((0, 0, 14), (0, 0, 1), 17, 60), cylinder((0, 0, 36), (0, -1, 0), 10, 60)
    )
    body = cut(body, cylinder((0, 0, -5), (0, 0, 1), 6, 40))
    for x in (-34, 34):
        for y in (-21, 21):
            body = cut(
                body, cylinder((x, y, -1), (0, 0, 1), 4, 20), cylinder((x, y, 7), (0, 0, 1), 7, 9)
            )
    # a slanted port through the wall of the boss, and a countersink on its top
    way = np.array([0.75, -0.45, 0.5])
    way /= np.linalg.norm(way)
    body = cut(body, cylinder(np.array([0, 0, 26.0]) + 10 * way, way, 4.5, 40))
    frame = gp_Ax2(gp_Pnt(0, 0, 51), gp_Dir(0, 0, 1))
    body = cut(body, BRepPrimAPI_MakeCone(frame, 16.0, 20.5, 4.5).Shape())
    for angle in np.arange(4) * np.pi / 2 + np.pi / 4:
        at = (15 * np.cos(angle), -48, 36 + 15 * np.sin(angle))
        body = cut(body, cylinder(at, (0, 1, 0), 1.8, 14))
    scale = gp_Trsf()
    scale.SetScale(gp_Pnt(0, 0, 0), 0.02)  # twenty times as large: a monument of a valve
    return BRepBuilderAPI_Transform(body, scale, True).Shape()


def write_cad_part(path: Path) -> None:
    """Write the part through a STEP file, as any other would come."""
    from OCP.STEPControl import STEPControl_StepModelType, STEPControl_Writer

    with tempfile.TemporaryDirectory() as folder:
        step = Path(folder) / "part.step"
        writer = STEPControl_Writer()
        writer.Transfer(cad_part(), STEPControl_StepModelType.STEPControl_AsIs)
        writer.Write(str(step))
        model = io.read(step, trims=True)
    print(model.report.summary())
    patches, trims = model.trimmed()
    io.save(patches, path, trims=trims)
    print(f"{path.name}: {patches}, {trims}, {path.stat().st_size} bytes")


def write_mesh(path: Path) -> None:
    """Write the surface mesh of a pipe along a trefoil knot, through a .msh file."""
    import gmsh

    t = np.linspace(0, 2 * np.pi, 37)[:-1]
    knot = np.stack(
        [np.sin(t) + 2 * np.sin(2 * t), np.cos(t) - 2 * np.cos(2 * t), -np.sin(3 * t)], axis=1
    )
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "knot.msh"
        gmsh.initialize(interruptible=False)
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.add("knot")
        occ = gmsh.model.occ
        points = [occ.addPoint(*p) for p in knot.tolist()]
        wire = occ.addWire([occ.addBSpline([*points, points[0]])])
        tangent = np.array([5.0, 0, -3])  # of the knot at its first point
        disk = occ.addDisk(*knot[0].tolist(), 0.5, 0.5, zAxis=tangent.tolist())
        occ.addPipe([(2, disk)], wire, "DiscreteTrihedron")
        occ.remove([(2, disk)])
        occ.synchronize()
        gmsh.option.setNumber("Mesh.MeshSizeMin", 0.7)
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.7)
        gmsh.option.setNumber("Mesh.Algorithm", 6)
        gmsh.model.mesh.generate(2)
        gmsh.model.mesh.setOrder(4)
        gmsh.write(str(file))
        gmsh.finalize()
        model = io.read(file)
    print(model.report.summary())
    net = model.triangles()
    io.save(net.transform(np.diag([0.25, 0.25, 0.25, 1.0])), path)
    print(f"{path.name}: {net}, {path.stat().st_size} bytes")


def main() -> None:
    """Write both models."""
    write_cad_part(FOLDER / "cad_part.vtu")
    write_mesh(FOLDER / "high_order_mesh.vtu")


if __name__ == "__main__":
    main()
