"""Volumes and fields of VTK's and Gmsh's files, against VTK itself where it is installed."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from mitsuba_bezier import io
from mitsuba_bezier.errors import FileFormatError
from mitsuba_bezier.io.vtk.cell_types import CELL_NAMES, READ, cell_lattice


def array(name, values, components=1, kind="Float64") -> str:
    text = " ".join(map(repr, np.ravel(values).tolist()))
    return (
        f'<DataArray type="{kind}" Name="{name}" NumberOfComponents="{components}" '
        f'format="ascii">{text}</DataArray>'
    )


def vtu_text(types, cells, points, point_data="", cell_data="", version="2.2") -> str:
    return (
        f'<VTKFile type="UnstructuredGrid" version="{version}"><UnstructuredGrid>'
        f'<Piece NumberOfPoints="{len(points)}" NumberOfCells="{len(cells)}">'
        f"{point_data or '<PointData/>'}{cell_data or '<CellData/>'}"
        f"<Points>{array('p', points, 3)}</Points><Cells>"
        + array("connectivity", np.concatenate(cells), kind="Int64")
        + array("offsets", np.cumsum([len(c) for c in cells]), kind="Int64")
        + array("types", types, kind="UInt8")
        + "</Cells></Piece></UnstructuredGrid></VTKFile>"
    )


def places(kind: str, lattice: np.ndarray) -> np.ndarray:
    """Return where nodes lie in a cell of size one."""
    x = lattice.astype(float)
    if kind in ("triangle", "tetra"):
        return np.pad((x / x[0].sum())[:, 1:], ((0, 0), (0, 3 - (x.shape[1] - 1))))
    if kind == "wedge":
        return x[:, 1:] / np.array([x[0, :3].sum()] * 2 + [max(x[:, 3].max(), 1)])
    if kind == "pyramid":
        n = x[:, 2].max()
        return np.stack([x[:, 0] + x[:, 2] / 2, x[:, 1] + x[:, 2] / 2, x[:, 2]], axis=1) / n
    return np.pad(x / np.maximum(x.max(axis=0), 1), ((0, 0), (0, 3 - x.shape[1])))


def bent(x: np.ndarray, seed: int = 0) -> np.ndarray:
    """Return points a little off, each differently: an oracle sees any two that are exchanged."""
    return x + np.random.default_rng(seed).uniform(-0.03, 0.03, x.shape)


# number, points, degrees
VOLUMES = [(10, 4, None), (11, 8, None), (12, 8, None), (13, 6, None), (14, 5, None)]
VOLUMES += [(24, 10, None), (25, 20, None), (26, 15, None), (27, 13, None), (29, 27, None)]
VOLUMES += [(31, 12, None), (32, 18, None), (33, 24, None), (71, 20, None), (72, 64, None)]
VOLUMES += [(72, 36, (2, 3, 2)), (73, 40, None), (73, 30, (3, 3, 2)), (79, 36, (2, 2, 3))]
VOLUMES += [(80, 24, (2, 2, 3)), (78, 20, None), (72, 8, (1, 1, 1)), (73, 45, (4, 4, 2))]


def volume_file(path, number, size, degrees, version="2.2", turn=False):
    kind, bezier = READ[number]
    lattice = cell_lattice(number, size, degrees or (0, 0, 0), version < "2.1")
    points = places(kind, lattice)
    if number != 11:  # voxels are boxes
        points = bent(points, number + size)
    if turn:
        points[:, 2] *= -1
    rng = np.random.default_rng(size)
    vector, weights = rng.normal(size=(size, 2)), rng.uniform(0.5, 2, size)
    flag = ' RationalWeights="w"' if bezier else ""
    data = f"<PointData{flag}>{array('w', weights)}{array('a b', vector, 2)}</PointData>"
    cell_data = array("number", [7.5])
    if degrees:
        cell_data = array("degrees", degrees, 3) + cell_data
    head = ' HigherOrderDegrees="degrees"' if degrees else ""
    cells = f"<CellData{head}>{cell_data}</CellData>"
    path.write_text(vtu_text([number], [np.arange(size)], points, data, cells, version))
    return points, vector


def is_closed(patches) -> bool:
    """Tell whether each side of a patch is the side of another, turned."""
    t = np.linspace(0.05, 0.95, 7)
    sides = []
    for corner in range(3):
        uvw = np.zeros((7, 3))
        uvw[:, corner], uvw[:, (corner + 1) % 3] = 1 - t, t
        sides += [patches.points(k, uvw[:, :2]) for k in range(len(patches))]
    used = [False] * len(sides)
    for a, side in enumerate(sides):
        match = [b for b, o in enumerate(sides) if b != a and np.allclose(side, o[::-1], atol=1e-9)]
        used[a] = len(match) == 1
    return all(used)


def volume(patches) -> float:
    """Return the volume within patches, by Gauss's theorem: their corners will do."""
    n = patches.degree
    steps = max(8, 2 * n)
    total = 0.0
    for k in range(len(patches)):
        for i in range(steps):
            for j in range(steps - i):
                for up in (True, False) if i + j < steps - 1 else (True,):
                    ijk = [(i, j), (i + 1, j), (i, j + 1)] if up else [
                        (i + 1, j), (i + 1, j + 1), (i, j + 1)]  # fmt: skip
                    p = patches.points(k, np.array(ijk) / steps)
                    total += np.linalg.det(p) / 6
    return total


@pytest.mark.parametrize("number, size, degrees", VOLUMES)
def test_surface_of_a_volume_cell(tmp_path, number, size, degrees):
    """Closed, normals outward, with the values that the points have."""
    path = tmp_path / "a.vtu"
    points, vector = volume_file(path, number, size, degrees)
    model = io.read(path)
    patches = model.triangles()
    assert is_closed(patches)
    assert volume(patches) > 0.1
    assert set(model.fields) == {"a b", "w", "number"} - ({"w"} if READ[number][1] else set())
    # corners are points of the file: their values are there
    corners = [[1, 0], [0, 1], [0, 0]]
    for k in range(len(patches)):
        p = patches.points(k, corners)
        near = np.linalg.norm(points[:, None] - p, axis=2).argmin(axis=0)
        np.testing.assert_allclose(points[near], p, atol=1e-12)
        got = model.fields["a b"].evaluate([k] * 3, corners)
        np.testing.assert_allclose(got, vector[near], atol=1e-11)
    assert (model.fields["number"].ordinates == 7.5).all()
    # the file turned inside out: normals are outward again
    volume_file(path, number, size, degrees, turn=True)
    assert volume(io.load(path)) > 0.1


@pytest.mark.parametrize("number, size, degrees", VOLUMES)
def test_faces_are_those_of_vtk(tmp_path, number, size, degrees):
    """Points and values on each face, as VTK interpolates them, lie on our patches."""
    vtk = pytest.importorskip("vtk")
    path = tmp_path / "a.vtu"
    volume_file(path, number, size, degrees)
    model = io.read(path)
    patches, field = model.triangles(), model.fields["a b"]
    reader = vtk.vtkXMLUnstructuredGridReader()
    reader.SetFileName(str(path))
    reader.Update()
    cell = reader.GetOutput().GetCell(0)
    data = reader.GetOutput().GetPointData().GetArray("a b")
    rng = np.random.default_rng(0)
    whole = (cell, [cell.GetPointId(i) for i in range(size)])

    def spots():
        if number == 80:  # VTK 9.7 gives faces of rational wedges the weights of other points
            sides = ((0.3, 0.2, 0), (0.3, 0.2, 1), (0.3, 0, 0.4), (0, 0.3, 0.4), (0.4, 0.6, 0.7))
            yield from ((*whole, pcoords) for pcoords in sides)
            return
        for f in range(cell.GetNumberOfFaces()):
            face = cell.GetFace(f)  # the same object, filled anew
            ids = [face.GetPointId(i) for i in range(face.GetNumberOfPoints())]
            for rs in rng.dirichlet([1, 1, 1], 4)[:, :2]:
                yield face, ids, (*rs, 0.0)

    for face, ids, pcoords in spots():
        x, w = [0.0] * 3, [0.0] * len(ids)
        face.EvaluateLocation(vtk.reference(0), pcoords, x, w)
        value = sum(a * np.array(data.GetTuple(i)) for a, i in zip(w, ids))
        place, patch = nearest(patches, np.array(x))
        # 1e-10: points of the size one, found by Newton's method to that
        np.testing.assert_allclose(patches.points(patch, place[None])[0], x, atol=1e-10)
        np.testing.assert_allclose(field.evaluate([patch], [place])[0], value, atol=1e-9)


def nearest(patches, x):
    """Return the parameters and the patch of a point that lies on one."""
    best = (np.inf, None, 0)
    for k in range(len(patches)):
        grid = [[a / 4, b / 4] for a in range(5) for b in range(5 - a)]
        uv = np.array(min(grid, key=lambda uv: np.linalg.norm(patches.points(k, [uv])[0] - x)))
        for _ in range(30):
            h = 1e-6
            p = patches.points(k, uv + h * np.array([[0, 0], [1, 0], [0, 1]]))
            step = np.linalg.lstsq((p[1:] - p[0]).T / h, x - p[0], rcond=None)[0]
            uv = uv + step
            if np.abs(step).max() < 1e-13 or np.abs(uv).max() > 3:
                break
        inside = min(*uv, 1 - uv.sum()) > -1e-9
        off = np.linalg.norm(patches.points(k, [uv])[0] - x)
        if inside and off < best[0]:
            best = (off, uv, k)
    return best[1], best[2]


@pytest.mark.parametrize("number, size", [(72, 64), (79, 64)])
def test_hexahedra_of_old_files(tmp_path, number, size):
    """Before version 2.1 two edges were exchanged; VTK reads both alike, and so do we."""
    vtk = pytest.importorskip("vtk")
    kind = READ[number][0]
    old, new = (cell_lattice(number, size, (3, 3, 3), o) for o in (True, False))
    assert old.tolist() != new.tolist()
    found = []
    for lattice, version in ((old, "2.0"), (new, "2.1")):
        path = tmp_path / f"{version}.vtu"
        x = places(kind, lattice)
        points = x + 0.05 * np.sin(5 * x[:, ::-1])
        path.write_text(vtu_text([number], [np.arange(size)], points, version=version))
        found.append(io.load(path))
        reader = vtk.vtkXMLUnstructuredGridReader()
        reader.SetFileName(str(path))
        reader.Update()
        from vtk.util.numpy_support import vtk_to_numpy

        ids = vtk_to_numpy(reader.GetOutput().GetCells().GetConnectivityArray())
        seen = vtk_to_numpy(reader.GetOutput().GetPoints().GetData())[ids]
        np.testing.assert_array_equal(seen, points[[old.tolist().index(r) for r in new.tolist()]]
                                      if version == "2.0" else points)  # fmt: skip
    # the order of nodes is that of the rounding of their interpolation
    nets = [t.control_points for t in found]
    np.testing.assert_allclose(*nets, atol=1e-12)


def test_linear_cells_polygons_and_strips(tmp_path):
    points = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0], [2, 1, 0], [1.5, 2, 0]]
    cells = [[0, 1, 2], [0, 1, 2, 3], [0, 1, 3, 2], [1, 4, 5, 6, 2], [0, 1, 3, 2], [1, 4, 2, 5, 0]]
    types = [5, 9, 8, 7, 6, 7]
    values = np.arange(7.0)
    text = vtu_text(types, cells, points, f"<PointData>{array('f', values)}</PointData>")
    path = tmp_path / "a.vtu"
    path.write_text(text)
    model = io.read(path)
    patches, f = model.triangles(), model.fields["f"]
    sources = np.concatenate(model.sources)
    assert np.bincount(sources).tolist() == [1, 2, 2, 3, 2]
    assert (model.report.faces, model.report.converted) == (6, 5)
    assert "polygon that is not convex" in model.report.summary()
    # on each patch the field at the corners is the number of the point
    for k in range(len(patches)):
        for corner in ([1, 0], [0, 1], [0, 0]):
            number = round(float(f.evaluate([k], [corner])[0, 0]))
            np.testing.assert_allclose(patches.points(k, [corner])[0], points[number], atol=1e-12)
    # sides between two patches of one face are none of the face
    order = np.sort(sources)
    inner = (~model.edges).sum(axis=1)
    per_face = [int(inner[order == k].sum()) for k in range(5)]
    assert per_face == [0, 2, 2, 4, 0]


def test_biquadratic_triangle_is_that_of_vtk(tmp_path):
    vtk = pytest.importorskip("vtk")
    lattice = cell_lattice(34, 7, (0, 0, 0))
    points = bent(places("triangle", lattice))
    path = tmp_path / "a.vtu"
    path.write_text(vtu_text([34], [np.arange(7)], points))
    patches = io.load(path)
    assert patches.degree == 3
    cell = vtk.vtkBiQuadraticTriangle()
    for i, p in enumerate(points):
        cell.GetPoints().SetPoint(i, p)
    for u, v in np.random.default_rng(0).dirichlet([1, 1, 1], 9)[:, :2]:
        x = [0.0] * 3
        cell.EvaluateLocation(vtk.reference(0), (v, 1 - u - v, 0), x, [0.0] * 7)
        np.testing.assert_allclose(patches.points(0, [[u, v]])[0], x, atol=1e-14)


def test_faces_between_cells_of_several_kinds_are_inside(tmp_path):
    """A hexahedron, a pyramid on it, a wedge beside it: faces that they share are no surface."""
    cube = np.array(cell_lattice(12, 8, (0, 0, 0)), float)
    points = [*cube, [0.5, 0.5, 2], [2, 0, 0], [2, 0, 1]]
    cells = [range(8), [4, 5, 6, 7, 8], [1, 9, 2, 5, 10, 6]]
    path = tmp_path / "a.vtu"
    path.write_text(vtu_text([12, 14, 13], cells, points))
    model = io.read(path)
    assert is_closed(model.triangles())
    assert volume(model.triangles()) == pytest.approx(1 + 1 / 3 + 1 / 2, abs=1e-12)


def test_pyramids_of_high_degree_are_told(tmp_path):
    path = tmp_path / "a.vtu"
    rng = np.random.default_rng(0)
    path.write_text(vtu_text([74], [range(30)], rng.normal(size=(30, 3))))
    with pytest.raises(FileFormatError, match="pyramids above degree 2: VTK defines no order"):
        io.load(path)


def test_units_strings_and_field_data_are_told(tmp_path):
    points = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    unit = '<InformationKey name="UNITS_LABEL" location="vtkDataArray"> m/s </InformationKey>'
    speed = array("speed", [1, 2, 3]).replace("</DataArray>", unit + "</DataArray>")
    words = '<Array type="String" Name="words" format="ascii">0</Array>'
    text = vtu_text([5], [range(3)], points, f"<PointData>{speed}{words}</PointData>")
    more = f"<FieldData>{array('TimeValue', [3])}</FieldData><Piece"
    path = tmp_path / "a.vtu"
    path.write_text(text.replace("<Piece", more))
    model = io.read(path)
    assert model.fields["speed"].unit == "m/s"
    assert "'words' is not of numbers" in model.report.notes[0]
    assert "TimeValue" in model.report.remarks[0]
    with pytest.raises(FileFormatError, match=r"'speed'.*got 'sped'"):
        model.field("sped")
    with warnings.catch_warnings():  # who asks for no fields is not told of them
        warnings.simplefilter("error")
        assert len(io.load(path)) == 1


def test_every_cell_type_has_a_name():
    assert set(READ) <= set(CELL_NAMES)


# ---------------------------------------------------------------------------- Gmsh

MSH = """$MeshFormat
2.2 0 8
$EndMeshFormat
$Nodes
5
1 0 0 0
2 1 0 0
3 0 1 0
4 0 0 1
9 1 1 0
$EndNodes
$Elements
3
1 2 2 0 1 1 2 3
5 4 2 0 1 1 2 3 4
7 2 2 0 1 2 9 3
$EndElements
$NodeData
1
"temperature [K]"
1
0.5
3
{step}
1
{count}
{rows}
$EndNodeData
"""

ELEMENTS = """$ElementData
1
"material"
0
3
0
1
2
5 2.5
7 3.5
$EndElementData
$ElementNodeData
1
"flux"
0
3
0
3
2
5 4 0 0 0 1 0 0 0 1 0 0 0 1
7 3 1 0 0 1 1 0 0 1 0
$EndElementNodeData
"""


def msh(rows="1 1\n2 2\n3 3\n4 4\n9 9", step=0) -> str:
    return MSH.format(step=step, count=len(rows.split("\n")), rows=rows)


def test_gmsh_fields(tmp_path):
    """The boundary triangle has no data of its own: it shows the tetrahedron's face."""
    path = tmp_path / "a.msh"
    path.write_text(msh() + ELEMENTS)
    model = io.read(path)
    patches = model.triangles()
    assert len(patches) == 5
    corners = [[1, 0], [0, 1], [0, 0]]
    for k in range(5):
        p = patches.points(k, corners)
        number = {(0, 0, 0): 1, (1, 0, 0): 2, (0, 1, 0): 3, (0, 0, 1): 4, (1, 1, 0): 9}
        expected = [number[tuple(np.round(x).astype(int))] for x in p]
        got = model.fields["temperature [K]"].evaluate([k] * 3, corners)[:, 0]
        np.testing.assert_allclose(got, expected, atol=1e-12)
        # the flux of each element is the place of its nodes
        np.testing.assert_allclose(model.fields["flux"].evaluate([k] * 3, corners), p, atol=1e-12)
    assert sorted(model.fields["material"].ordinates.ravel()) == [2.5] * 4 + [3.5]


def test_gmsh_steps_and_missing_values(tmp_path):
    path = tmp_path / "a.msh"
    second = msh("1 10\n2 20\n3 30", step=1)
    second = second[second.index("$NodeData") :]
    path.write_text(msh() + second)
    model = io.read(path)
    assert set(model.fields) == {"temperature [K]", "temperature [K]@0"}
    assert model.fields["temperature [K]"].missing().sum() == 4  # nodes 4 and 9 have no values
    assert not model.fields["temperature [K]@0"].missing().any()


@pytest.mark.parametrize(
    "change, message",
    [
        (('1\n"temperature [K]"', "-1\n"), "a number of string tags"),
        (("3\n0\n1\n5\n", "3\n0\n2\n5\n"), "1, 3 or 9 components"),
        (("3\n0\n1\n5\n", "2\n0\n1\n5\n"), "three integer tags"),
        (("3\n0\n1\n5\n", "3\n0\n1\n500000\n"), "a number of entries that fits"),
        (("9 9", "9 x"), "a finite number for values"),
    ],
)
def test_gmsh_damaged_fields(tmp_path, change, message):
    text = msh()
    assert change[0] in text
    path = tmp_path / "a.msh"
    path.write_text(text.replace(*change))
    with pytest.raises(FileFormatError, match=message):
        io.read(path)
    assert len(io.load(path)) >= 1  # who does not ask for fields gets the mesh
