"""A small file of each format that can be read."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import mitsuba_bezier as mb
from mitsuba_bezier import io

# ---------------------------------------------------------------------------- a file of each kind

CORNERS = ((0, 0, 0), (1, 0, 0), (1, 1, 0.5), (0, 1, 0))


def _lines(form: str) -> str:
    return "".join(form.format(k, *c) + "\n" for k, c in enumerate(CORNERS, start=1))


INP = "*NODE\n" + _lines("{}, {}, {}, {}") + "*ELEMENT, TYPE=S3\n1, 1, 2, 3\n2, 1, 3, 4\n"
BDF = (
    "BEGIN BULK\n"
    + _lines("GRID,{},,{:.1f},{:.1f},{:.1f}")
    + "CTRIA3,1,1,1,2,3\nCTRIA3,2,1,1,3,4\nENDDATA\n"
)
MESH = (
    "MeshVersionFormatted 2\nDimension 3\nVertices\n4\n"
    + "".join(f"{x} {y} {z} 0\n" for x, y, z in CORNERS)
    + "Triangles\n2\n1 2 3 0\n1 3 4 0\nEnd\n"
)
MSH = (
    "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n4\n"
    + _lines("{} {} {} {}")
    + "$EndNodes\n$Elements\n2\n1 2 2 1 1 1 2 3\n2 2 2 1 1 1 3 4\n$EndElements\n"
)
OBJ = (
    "".join(f"v {x} {y} {z}\n" for x, y, z in np.array(CORNERS)[[0, 1, 3, 2]])
    + "cstype bezier\ndeg 1 1\nsurf 0 1 0 1 1 2 3 4\nparm u 0 1\nparm v 0 1\nend\n"
)
OFF = "OFF\n4 2 5\n" + "".join(f"{x} {y} {z}\n" for x, y, z in CORNERS) + "3 0 1 2\n3 0 2 3\n"
GRID = [[i, j, i * j / 9] for j in range(4) for i in range(4)]
BEZ = "BEZ333\n" + "".join("{} {} {}\n".format(*p) for p in GRID)


_PLACES = " ".join(f"{x} {y} {z}" for x, y, z in CORNERS)
VTK = (
    "# vtk DataFile Version 3.0\ntwo triangles\nASCII\nDATASET POLYDATA\n"
    f"POINTS 4 double\n{_PLACES}\nPOLYGONS 2 8\n3 0 1 2 3 0 2 3\n"
)
VTP = (
    '<VTKFile type="PolyData" version="1.0"><PolyData><Piece NumberOfPoints="4" NumberOfPolys="2">'
    '<Points><DataArray type="Float64" NumberOfComponents="3" format="ascii">'
    f"{_PLACES}</DataArray></Points><Polys>"
    '<DataArray type="Int64" Name="connectivity" format="ascii">0 1 2 0 2 3</DataArray>'
    '<DataArray type="Int64" Name="offsets" format="ascii">3 6</DataArray>'
    "</Polys></Piece></PolyData></VTKFile>"
)


def _simplex(path: Path) -> None:
    """Write one triangle as pytorch-bsf does."""
    keys = ("(1, 0, 0)", "(0, 1, 0)", "(0, 0, 1)")
    rows = {key: list(map(float, p)) for key, p in zip(keys, CORNERS)}
    if path.suffix == ".json":
        path.write_text(json.dumps(rows))
    elif path.suffix in (".yaml", ".yml"):
        path.write_text("".join(f"{key}: {p}\n" for key, p in rows.items()))
    else:
        mark, between = ('"', ",") if path.suffix == ".csv" else ("", "\t")
        lines = (between.join([f"{mark}{k}{mark}", *map(str, p)]) for k, p in rows.items())
        path.write_text("\n".join(lines) + "\n")


def _pieces(path: Path) -> None:
    """Write a sphere as one piece of a file."""
    _net(path.with_name("piece.vtu"))
    path.write_text(
        '<VTKFile type="PUnstructuredGrid" version="1.0"><PUnstructuredGrid>'
        '<Piece Source="piece.vtu"/></PUnstructuredGrid></VTKFile>'
    )


def _text(text: str):
    return lambda path: path.write_text(text)


def _net(path: Path) -> None:
    io.save(mb.sphere(), path)


def _cad(path: Path) -> None:
    """Write a cylinder."""
    pytest.importorskip("OCP")
    from OCP.BRepPrimAPI import BRepPrimAPI_MakeCylinder
    from OCP.BRepTools import BRepTools
    from OCP.IGESControl import IGESControl_Writer
    from OCP.STEPControl import STEPControl_StepModelType, STEPControl_Writer

    shape = BRepPrimAPI_MakeCylinder(1.0, 3.0).Shape()
    if path.suffix == ".brep":
        BRepTools.Write_s(shape, str(path))
    elif path.suffix in (".iges", ".igs"):
        writer = IGESControl_Writer("MM", 1)
        writer.AddShape(shape)
        writer.Write(str(path))
    else:
        writer = STEPControl_Writer()
        writer.Transfer(shape, STEPControl_StepModelType.STEPControl_AsIs)
        writer.Write(str(path))


def _rhino(path: Path) -> None:
    rhino3dm = pytest.importorskip("rhino3dm")
    file = rhino3dm.File3dm()
    file.Objects.AddSphere(rhino3dm.Sphere(rhino3dm.Point3d(1, 2, 3), 2))
    file.Write(str(path), 7)


def _meshio(text: str):
    def write(path: Path) -> None:
        pytest.importorskip("meshio")
        path.write_text(text)

    return write


#: Suffix: how to write a small file, and the area of what it shows (None: of CAD's own accuracy).
FILES = {
    ".3dm": (_rhino, 16 * np.pi),
    ".bbp": (_text(BEZ.replace("BEZ333", "BBP")), None),
    ".bdf": (_meshio(BDF), "flat"),
    ".bez": (_text(BEZ), None),
    ".brep": (_cad, 8 * np.pi),
    ".bv": (_net, 4 * np.pi),
    ".csv": (_simplex, 0.5 * np.hypot(1, 0.5)),
    ".iges": (_cad, 8 * np.pi),
    ".igs": (_cad, 8 * np.pi),
    ".inp": (_meshio(INP), "flat"),
    ".json": (_simplex, 0.5 * np.hypot(1, 0.5)),
    ".mesh": (_meshio(MESH), "flat"),
    ".msh": (_text(MSH), "flat"),
    ".nas": (_meshio(BDF), "flat"),
    ".obj": (_text(OBJ), None),
    ".off": (_text(OFF), "flat"),
    ".pvtu": (_pieces, 4 * np.pi),
    ".step": (_cad, 8 * np.pi),
    ".stp": (_cad, 8 * np.pi),
    ".tsv": (_simplex, 0.5 * np.hypot(1, 0.5)),
    ".vtk": (_text(VTK), "flat"),
    ".vtp": (_text(VTP), "flat"),
    ".vtu": (_net, 4 * np.pi),
    ".yaml": (_simplex, 0.5 * np.hypot(1, 0.5)),
    ".yml": (_simplex, 0.5 * np.hypot(1, 0.5)),
}
#: Of the two triangles (0,0,0), (1,0,0), (1,1,.5) and (0,0,0), (1,1,.5), (0,1,0).
FLAT = 2 * 0.5 * np.hypot(1, 0.5)


def written(folder: Path, suffix: str) -> Path:
    path = folder / f"model{suffix}"
    FILES[suffix][0](path)
    return path
