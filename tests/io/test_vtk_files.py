"""VTK's other files, `.pvtu`, `.vtp` and `.vtk`, as VTK writes them; Bézier simplices."""

from __future__ import annotations

import json

import numpy as np
import pytest
from test_io_fields import VOLUMES, array, places, volume_file, vtu_text

from mitsuba_bezier import io
from mitsuba_bezier.errors import FileFormatError
from mitsuba_bezier.io.vtk.cell_types import READ, cell_lattice


def same(one, two) -> None:
    """Compare models: patches, and fields by name."""
    assert [len(g) for g in one.groups] == [len(g) for g in two.groups]
    for a, b in zip(one.groups, two.groups):
        np.testing.assert_allclose(a.control_points, b.control_points, atol=1e-12)
    assert set(one.fields) == set(two.fields)
    for name, field in one.fields.items():
        np.testing.assert_allclose(field.ordinates, two.fields[name].ordinates, atol=1e-12)


def grid_of(vtk, path):
    reader = vtk.vtkXMLUnstructuredGridReader()
    reader.SetFileName(str(path))
    reader.Update()
    return reader.GetOutput()


@pytest.mark.parametrize("binary", [False, True])
@pytest.mark.parametrize("version", [42, 51])
@pytest.mark.parametrize("number, size, degrees", [c for c in VOLUMES if not READ[c[0]][1]][::3])
def test_legacy_grids_as_vtk_writes_them(tmp_path, number, size, degrees, version, binary):
    vtk = pytest.importorskip("vtk")
    if degrees is not None and len({*degrees}) > 1:
        pytest.skip("VTK's legacy files do not tell degrees of several directions")
    source = tmp_path / "a.vtu"
    volume_file(source, number, size, None)
    writer = vtk.vtkUnstructuredGridWriter()
    writer.SetInputData(grid_of(vtk, source))
    out = tmp_path / "a.vtk"
    writer.SetFileName(str(out))
    writer.SetFileVersion(version)
    writer.SetFileTypeToBinary() if binary else writer.SetFileTypeToASCII()
    if number == 72 and version == 42:
        pytest.skip("VTK 9.7 itself reads such a file with two edges exchanged")
    assert writer.Write()
    expected = io.read(source)
    same(io.read(out), expected)


@pytest.mark.parametrize("version", ["3.0", "5.0", "5.1"])
def test_hexahedra_of_old_legacy_files(tmp_path, version):
    """As VTK reads them: before 5.1 two edges are exchanged."""
    old = version < "5.1"
    lattice = cell_lattice(72, 64, (3, 3, 3), old)
    x = places("hexahedron", lattice)
    points = x + 0.05 * np.sin(5 * x[:, ::-1])
    rows = "\n".join(" ".join(map(repr, p)) for p in points.tolist())
    nodes = " ".join(map(str, range(64)))
    cells = f"CELLS 1 65\n64 {nodes}\n"
    if version >= "5":
        cells = f"CELLS 2 64\nOFFSETS vtktypeint64\n0 64\nCONNECTIVITY vtktypeint64\n{nodes}\n"
    path = tmp_path / "a.vtk"
    path.write_text(
        f"# vtk DataFile Version {version}\ntitle\nASCII\nDATASET UNSTRUCTURED_GRID\n"
        f"POINTS 64 double\n{rows}\n{cells}CELL_TYPES 1\n72\n"
    )
    other = tmp_path / "a.vtu"
    new = cell_lattice(72, 64, (3, 3, 3)).tolist()
    order = [lattice.tolist().index(row) for row in new]
    other.write_text(vtu_text([72], [order], points))
    same(io.read(path), io.read(other))


def polygons(vtk):
    """Return polygons of VTK: a sphere of triangles with data, and a plane of quadrilaterals."""
    ball = vtk.vtkSphereSource()
    ball.SetThetaResolution(7)
    ball.SetPhiResolution(5)
    plane = vtk.vtkPlaneSource()
    plane.SetResolution(3, 2)
    plane.SetOrigin(2, 0, 0)
    both = vtk.vtkAppendPolyData()
    both.AddInputConnection(ball.GetOutputPort())
    both.AddInputConnection(plane.GetOutputPort())
    both.Update()
    data = both.GetOutput()
    for name, target, count in (
        ("height", data.GetPointData(), data.GetNumberOfPoints()),
        ("number", data.GetCellData(), data.GetNumberOfCells()),
    ):
        values = vtk.vtkDoubleArray()
        values.SetName(name)
        for k in range(count):
            values.InsertNextValue(data.GetPoint(k)[2] if name == "height" else k)
        target.AddArray(values)
    return data


@pytest.mark.parametrize("form", ["xml", "text", "binary"])
def test_polygons_as_vtk_writes_them(tmp_path, form):
    vtk = pytest.importorskip("vtk")
    data = polygons(vtk)
    out = tmp_path / ("a.vtp" if form == "xml" else "a.vtk")
    writer = vtk.vtkXMLPolyDataWriter() if form == "xml" else vtk.vtkPolyDataWriter()
    writer.SetInputData(data)
    writer.SetFileName(str(out))
    if form != "xml":
        writer.SetFileTypeToBinary() if form == "binary" else writer.SetFileTypeToASCII()
    assert writer.Write()
    model = io.read(out)
    assert model.report.converted == data.GetNumberOfCells()
    patches, height = model.triangles(), model.fields["height"]
    uv = np.array([[0.2, 0.5], [0.6, 0.1]])
    for k in range(len(patches)):  # the field is the height of the point
        z = patches.points(k, uv)[:, 2]
        np.testing.assert_allclose(height.evaluate([k, k], uv)[:, 0], z, atol=1e-6)
    numbers = set(model.fields["number"].ordinates.ravel().tolist())
    assert numbers == set(range(data.GetNumberOfCells()))


def test_pieces_of_a_pvtu(tmp_path):
    (tmp_path / "parts").mkdir()
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], dtype=float)
    pieces = []
    for k in range(3):
        data = f"<PointData>{array('f', points[:, 0] + k)}</PointData>"
        text = vtu_text([5], [range(3)], points + np.array([2 * k, 0, 0]), data)
        (tmp_path / "parts" / f"p{k}.vtu").write_text(text)
        pieces.append(f'<Piece Source="parts/p{k}.vtu"/>')
    path = tmp_path / "all.pvtu"
    head = '<VTKFile type="PUnstructuredGrid" version="0.1"><PUnstructuredGrid GhostLevel="0">'
    text = f"{head}{''.join(pieces)}</PUnstructuredGrid></VTKFile>"
    path.write_text(text)
    model = io.read(path)
    assert len(model.triangles()) == model.report.converted == 3
    low, high = model.fields["f"].range()
    assert (low, high) == (0, 3)
    for bad, message in (
        ("../secret.vtu", "a Source in the folder of the file"),
        ("/etc/passwd", "a Source in the folder of the file"),
        ("", "a Source in the folder of the file"),
        ("parts/no.vtu", "which does not exist"),
    ):
        path.write_text(text.replace("parts/p1.vtu", bad))
        with pytest.raises(FileFormatError, match=message):
            io.read(path)


LEGACY = """# vtk DataFile Version 3.0
title
ASCII
DATASET UNSTRUCTURED_GRID
POINTS 4 float
0 0 0 1 0 0
1 1 0 0 1 0
CELLS 2 8
3 0 1 2
3 0 2 3
CELL_TYPES 2
5 5
POINT_DATA 4
SCALARS T double 1
LOOKUP_TABLE default
0 1 2 1
VECTORS u%20v float
0 0 1 0 0 1
0 0 1 0 0 1
FIELD FieldData 1
q 2 4 int
1 2 3 4 5 6 7 8
CELL_DATA 2
SCALARS part int
LOOKUP_TABLE default
4 5
"""


def test_legacy_text_by_hand(tmp_path):
    path = tmp_path / "a.vtk"
    path.write_text(LEGACY)
    model = io.read(path)
    assert {n: f.components for n, f in model.fields.items()} == {
        "T": 1,
        "u v": 3,
        "q": 2,
        "part": 1,
    }
    x = model.triangles().points(1, [[0.2, 0.3]])[0]
    assert model.fields["T"].evaluate([1], [[0.2, 0.3]])[0, 0] == pytest.approx(x[0] + x[1])
    assert model.fields["part"].ordinates.ravel().tolist() == [4, 5]


@pytest.mark.parametrize(
    "change, message",
    [
        (("# vtk DataFile", "# ply"), "# vtk DataFile Version"),
        (("ASCII", "TEXT"), "ASCII or BINARY"),
        (("UNSTRUCTURED_GRID", "STRUCTURED_POINTS"), "UNSTRUCTURED_GRID or POLYDATA"),
        (("POINTS 4", "POINTS 4000000"), "a number of points that fits"),
        (("3 0 2 3", "3 0 2 9"), "point numbers from 0 to 3"),
        (("3 0 2 3", "7 0 2 3"), "2 cells in 8 numbers"),
        (("CELL_TYPES 2\n5 5", "CELL_TYPES 1\n5"), "2 cell types"),
        (("0 1 2 1", "0 1 x 1"), "numbers for array"),
        (("SCALARS T double 1", "THINGS T double 1"), "an attribute such as SCALARS"),
    ],
)
def test_damaged_legacy_files(tmp_path, change, message):
    assert change[0] in LEGACY
    path = tmp_path / "a.vtk"
    path.write_text(LEGACY.replace(*change, 1))
    with pytest.raises(FileFormatError, match=message):
        io.read(path)


# ---------------------------------------------------------------- Bézier simplices

POINTS = {
    (i, j, 2 - i - j): [float(i), 10.0 * j, 0.5 + i * j] for i in range(3) for j in range(3 - i)
}


def written(suffix: str) -> str:
    """Return the text that pytorch-bsf 0.25 writes, but for the order of points."""
    if suffix in (".csv", ".tsv"):
        mark, between = ('"', ",") if suffix == ".csv" else ("", "\t")
        return "".join(
            f"{mark}{key}{mark}{between}" + between.join(map(repr, p)) + "\r\n"
            for key, p in POINTS.items()
        )
    if suffix == ".json":
        return json.dumps({str(key): p for key, p in POINTS.items()})
    if suffix == ".yaml":
        return "".join(f"{key}: {p}\n" for key, p in POINTS.items())
    lines = "".join(f"{k}:\n" + "".join(f"- {x}\n" for x in p) for k, p in POINTS.items())
    return lines.replace("(", "'(").replace(")", ")'")


@pytest.mark.parametrize("suffix", [".csv", ".tsv", ".json", ".yml", ".yaml"])
def test_bezier_simplices(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    path.write_text(written(suffix))
    patch = io.load(path)
    assert (len(patch), patch.degree) == (1, 2)
    # the value at t is sum n!/(i! j! k!) t^(i, j, k) p_ijk
    from math import factorial

    t = np.array([0.2, 0.5, 0.3])
    expected = sum(
        2 / np.prod([factorial(i) for i in key]) * np.prod(t**key) * np.array(p)
        for key, p in POINTS.items()
    )
    np.testing.assert_allclose(patch.points(0, [t[:2]])[0], expected, atol=1e-14)


@pytest.mark.parametrize(
    "suffix, text, message",
    [
        (".csv", "", "control points of a Bézier simplex"),
        (".csv", '"(1, 0)",1,2,3\n"(0, 1)",1,2,3\n', "a 2-simplex, .*got a 1-simplex"),
        (".csv", '"(1, 0, 0)",1,2,3\n', "the 3 indices that sum to 1"),
        (".csv", '"(1, 0, 0)",1,2,x\n', "finite numbers"),
        (".csv", "name,1,2,3\n", "an index such as"),
        (".csv", '"(1, 0, 0)",1,2\n"(0, 1, 0)",1,2\n"(0, 0, 1)",1,2\n', "points of three numbers"),
        (".json", "[1, 2]", "a mapping of indices to points"),
        (".json", "{", "a JSON mapping"),
        (".json", '{"(1, 0, 0)": ["a", 1, 2]}', "points of numbers"),
        (".yml", "a: !!python/object:x\n", "an index such as|lines"),
        (".tsv", "(90, 0, 0)\t1\t2\t3\n", "a degree from 1 to 40"),
    ],
)
def test_damaged_simplices(tmp_path, suffix, text, message):
    path = tmp_path / f"a{suffix}"
    path.write_text(text)
    with pytest.raises(FileFormatError, match=message):
        io.load(path)
