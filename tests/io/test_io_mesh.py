"""High-order meshes: Gmsh files, and the other cells of VTK files."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from mitsuba_bezier import io
from mitsuba_bezier.errors import FileFormatError
from mitsuba_bezier.geometry import bernstein
from mitsuba_bezier.geometry.triangles import BezierTriangles
from mitsuba_bezier.io import FormatWarning, meshes
from mitsuba_bezier.io.lattices import (
    hexahedron_lattice,
    quad_lattice,
    tetra_lattice,
    triangle_lattice,
)

LATTICES = {
    "triangle": triangle_lattice,
    "quad": lambda n: quad_lattice(n, n, "gmsh"),
    "tetra": lambda n: tetra_lattice(n, "gmsh"),
    "hexahedron": hexahedron_lattice,
}
# numbers of the element types of orders 1 to 6, from the manual of Gmsh
TYPES = {
    "triangle": (2, 9, 21, 23, 25, 42),
    "quad": (3, 10, 36, 37, 38, 47),
    "tetra": (4, 11, 29, 30, 31, 71),
    "hexahedron": (5, 12, 92, 93, 94, 95),
}


def bend(x: np.ndarray, n: int) -> np.ndarray:
    """A polynomial map of degree n in each variable's total: the cells reproduce it exactly."""
    u, v, w = x.T
    return np.stack([u + 0.2 * v**n, v - 0.1 * w**n, w + 0.3 * u**n], axis=1)


def reference_nodes(kind: str, n: int) -> np.ndarray:
    lattice = LATTICES[kind](n)
    if kind in ("triangle", "tetra"):
        lattice = lattice[:, 1:]
    return np.pad(lattice / n, ((0, 0), (0, 3 - lattice.shape[1])))


def write_msh(path, version: str, binary: bool, order: str, kind: int, points, cells, extra=()):
    """Write one kind of element; node numbers have gaps and do not start at 1."""
    e = order
    tags = 10 + 3 * np.arange(len(points))
    nodes = tags[np.array(cells)]
    out = [f"$MeshFormat\n{version} {int(binary)} 8\n".encode()]
    if binary:
        out.append(struct.pack(e + "i", 1) + b"\n")
    out.append(b'$EndMeshFormat\n$PhysicalNames\n1\n2 1 "a $ name"\n$EndPhysicalNames\n')
    rows = [kind, *extra]
    if version == "2.2":
        out.append(f"$Nodes\n{len(points)}\n".encode())
        for tag, p in zip(tags.tolist(), points.tolist()):
            line = struct.pack(e + "i3d", tag, *p)
            out.append(line if binary else f"{tag} {p[0]!r} {p[1]!r} {p[2]!r}\n".encode())
        out.append(f"$EndNodes\n$Elements\n{len(nodes) + 1}\n".encode())
        elements = [(15, [int(tags[0])]), *((kind, row) for row in nodes.tolist())]
        for number, (k, row) in enumerate(elements, start=1):
            if binary:
                values = [k, 1, 2, number, 7, 7, *row]
                out.append(struct.pack(f"{e}{len(values)}i", *values))
            else:
                out.append((" ".join(map(str, [number, k, 2, 7, 7, *row])) + "\n").encode())
    elif binary:
        out.append(b"$Nodes\n" + struct.pack(e + "4Q", 1, len(points), 10, tags[-1]))
        out.append(struct.pack(e + "3iQ", 2, 1, 0, len(points)))
        out.append(struct.pack(f"{e}{len(tags)}Q", *tags.tolist()))
        out.append(struct.pack(f"{e}{points.size}d", *points.ravel().tolist()))
        out.append(b"\n$EndNodes\n$Elements\n" + struct.pack(e + "4Q", 1, len(nodes), 1, 9))
        out.append(struct.pack(e + "3iQ", 2, 1, kind, len(nodes)))
        for number, row in enumerate(nodes.tolist()):
            out.append(struct.pack(f"{e}{len(row) + 1}Q", number, *row))
    else:
        out.append(f"$Nodes\n1 {len(points)} 10 {tags[-1]}\n2 1 1 {len(points)}\n".encode())
        out.append("".join(f"{t}\n" for t in tags.tolist()).encode())  # parametric: u, v follow
        out.append("".join(f"{x!r} {y!r} {z!r} 5 6\n" for x, y, z in points.tolist()).encode())
        out.append(f"$EndNodes\n$Elements\n1 {len(nodes)} 1 9\n2 1 {kind} {len(nodes)}\n".encode())
        for number, row in enumerate(nodes.tolist()):
            out.append((" ".join(map(str, [number, *row])) + "\n").encode())
    out.append(b"\n$EndElements\n")
    path.write_bytes(b"".join(out))
    del rows
    return path


@pytest.mark.parametrize("version", ["2.2", "4.1"])
@pytest.mark.parametrize("form", ["text", "<", ">"])
@pytest.mark.parametrize("kind", ["triangle", "quad"])
@pytest.mark.parametrize("n", range(1, 7))
def test_gmsh_surfaces(tmp_path, version, form, kind, n):
    points = bend(reference_nodes(kind, n), n)
    cells = [list(range(len(points)))]
    number = TYPES[kind][n - 1]
    path = write_msh(
        tmp_path / "a.msh", version, form != "text", form.strip("tex") or "<", number, points, cells
    )
    model = io.read(path)
    (t,) = model.groups
    assert (t.weights == 1).all()
    uv = np.random.default_rng(n).dirichlet([1, 1, 1], 20)[:, :2]
    if kind == "triangle":
        assert (len(t), t.degree) == (1, n)
        where = np.stack([uv[:, 1], 1 - uv.sum(axis=1), 0 * uv[:, 0]], axis=1)
        # corners 0, 1, 2 are A, B, C: x = (v, w)
        # 1e-12: interpolation at the regular lattice of order 6 has a condition of some 100
        np.testing.assert_allclose(t.points(0, uv), bend(where, n), atol=1e-12)
    else:
        assert (len(t), t.degree) == (2, 2 * n)
        for half in range(2):
            st = uv if half == 0 else 1 - uv
            where = np.pad(st, ((0, 0), (0, 1)))
            np.testing.assert_allclose(t.points(half, uv), bend(where, n), atol=1e-12)


def test_gmsh_eight_node_quad(tmp_path):
    """It lacks s^2 t^2, so it reproduces s t^2, s^2 t and below."""
    lattice = quad_lattice(2, 2, "gmsh")[:8] / 2
    s, t = lattice.T
    points = np.stack([s, t, 1 + s * t**2 - 3 * s**2 * t + s**2], axis=1)
    path = write_msh(tmp_path / "a.msh", "4.1", False, "<", 16, points, [range(8)])
    (nets,) = io.read(path).groups
    uv = np.random.default_rng(0).dirichlet([1, 1, 1], 20)[:, :2]
    x, y, z = nets.points(0, uv).T
    np.testing.assert_allclose(z, 1 + x * y**2 - 3 * x**2 * y + x**2, atol=1e-14)


def is_closed(t: BezierTriangles) -> bool:
    """Volume inside by the divergence theorem does not depend on the origin if it is closed."""
    values = []
    for shift in (0, 10):
        moved = t.transform([[1, 0, 0, shift], [0, 1, 0, shift], [0, 0, 1, shift], [0, 0, 0, 1]])
        values.append(volume(moved))
    return bool(np.isclose(*values, rtol=1e-9))


def flux(t: BezierTriangles) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return points, normals times area and weights of a Gauss rule of 16 x 16 points a patch."""
    x, w = np.polynomial.legendre.leggauss(16)
    x, w = (x + 1) / 2, w / 2
    a, b = np.meshgrid(x, x)
    uv = np.stack([a, (1 - a) * b], axis=-1).reshape(-1, 2)
    weight = np.tile((np.outer(w, w) * (1 - a)).ravel(), len(t))
    d = t.differential(np.repeat(np.arange(len(t)), len(uv)), np.tile(uv, (len(t), 1)))
    return d.p, np.cross(d.dp_du, d.dp_dv), weight


def volume(t: BezierTriangles) -> float:
    """Integral of p.n / 3, exact up to degree 10 (the rule is exact up to 31)."""
    p, n, weight = flux(t)
    return float(np.einsum("nc,nc,n->", p, n, weight) / 3)


@pytest.mark.parametrize("kind", ["tetra", "hexahedron"])
@pytest.mark.parametrize("n", range(1, 5))
def test_gmsh_surface_of_a_volume(tmp_path, kind, n):
    """Two cells share a face, which is not part of the surface; normals point outward."""
    nodes = reference_nodes(kind, n)
    other = nodes.copy()
    if kind == "tetra":  # mirror at x = 0 (and exchange corners 2, 3 to keep the orientation)
        lattice = LATTICES[kind](n)
        turned = {tuple(row): k for k, row in enumerate(lattice[:, [0, 1, 3, 2]].tolist())}
        order = [turned[tuple(row)] for row in lattice.tolist()]
        other = (nodes * [-1, 1, 1])[order]
        expected = 2 / 6
    else:
        other[:, 0] += 1
        expected = 2
    both = np.concatenate([nodes, other])
    unique, index = np.unique(both.round(12), axis=0, return_inverse=True)
    cells = index.reshape(2, -1)
    number = TYPES[kind][n - 1]
    path = write_msh(tmp_path / "a.msh", "2.2", False, "<", number, unique, cells)
    model = io.read(path)
    t = model.triangles()
    assert model.report.faces == model.report.converted == (6 if kind == "tetra" else 10)
    assert "2 volume cells" in " ".join(model.report.remarks)
    assert volume(t) == pytest.approx(expected, abs=1e-12)
    assert is_closed(t)


def test_gmsh_twenty_node_hexahedron(tmp_path):
    nodes = hexahedron_lattice(2)[:20] / 2
    path = write_msh(tmp_path / "a.msh", "4.1", True, "<", 17, nodes, [range(20)])
    assert volume(io.read(path).triangles()) == pytest.approx(1, abs=1e-12)


def test_gmsh_surface_elements_on_a_volume_count_once(tmp_path):
    nodes = reference_nodes("tetra", 1)
    path = write_msh(tmp_path / "a.msh", "2.2", False, "<", 4, nodes, [range(4)])
    text = path.read_text().replace("$Elements\n2\n", "$Elements\n3\n9 2 2 1 1 10 16 13\n")
    path.write_text(text)
    model = io.read(path)
    assert model.report.converted == 4
    assert volume(model.triangles()) == pytest.approx(1 / 6, abs=1e-15)


def test_gmsh_reports_other_elements(tmp_path):
    nodes = reference_nodes("tetra", 1)
    path = write_msh(tmp_path / "a.msh", "2.2", False, "<", 2, nodes, [range(3)])
    text = path.read_text().replace(
        "$Elements\n2\n", "$Elements\n3\n9 20 0 10 13 16 19 10 13 16 19 10\n"
    )
    path.write_text(text)
    with pytest.warns(FormatWarning, match=r"1 of 2 faces converted.*incomplete triangle"):
        assert len(io.load(path)) == 1


def triangle_msh(tmp_path, version="4.1", binary=False):
    points = reference_nodes("triangle", 2)
    return write_msh(tmp_path / "a.msh", version, binary, "<", 9, points, [range(6)])


@pytest.mark.parametrize(
    ("version", "change", "message"),
    [
        ("4.1", ("4.1 0 8", "4.0 0 8"), r"line 2: expected version 2.2 or 4.1.*'4.0'"),
        ("4.1", ("$MeshFormat", "$Mesh"), r"line 1: expected \$MeshFormat"),
        ("4.1", ("\n1 6 10 25", "\n99999999999 6 10 25"), "blocks of nodes that fits"),
        ("4.1", ("2 1 1 6", "2 1 1 999999999"), "number of nodes that fits"),
        ("4.1", ("2 1 9 1", "2 1 9 700"), "number of elements that fits.*got 700"),
        ("4.1", ("2 1 9 1", "2 1 999 1"), "known type of element, got type 999"),
        ("4.1", ("0 10 13", "0 11 13"), r"nodes that are in \$Nodes"),
        ("4.1", ("$EndElements", "$EndElement"), r"expected \$EndElements, got '\$EndElement'"),
        ("4.1", ("$EndPhysicalNames", ""), r"\$EndPhysicalNames, got the end"),
        ("4.1", ("0.5", "zero"), "finite number for nodes, got 'zero'"),
        ("2.2", ("$Nodes\n6", "$Nodes\n6000000"), "number of nodes that fits|end of the file"),
        ("2.2", ("$Nodes\n6", "$Nodes\nsix"), "number of nodes that fits.*'six'"),
        ("2.2", ("2 9 2 7 7", "2 9 -2 7 7"), "a number of tags, got -2"),
        ("2.2", ("10 13 16 19 22 25", "10 13 16 19 22"), "an integer|end of the file|others"),
        ("2.2", ("2 9 2 7 7", "2 8 2 7 7"), r"expected \$EndElements"),
    ],
)
def test_gmsh_bad(tmp_path, version, change, message):
    path = triangle_msh(tmp_path, version)
    text = path.read_text()
    assert change[0] in text
    path.write_text(text.replace(*change))
    with pytest.raises(FileFormatError, match=message):
        io.load(path)


@pytest.mark.parametrize("version", ["2.2", "4.1"])
@pytest.mark.parametrize("binary", [False, True])
def test_gmsh_truncated(tmp_path, version, binary):
    whole = triangle_msh(tmp_path, version, binary).read_bytes()
    path = tmp_path / "b.msh"
    for cut in range(0, len(whole) - 2, 3):
        path.write_bytes(whole[:cut])
        with pytest.raises(FileFormatError, match=r"b\.msh"):
            io.load(path)


# ---------------------------------------------------------------------------- VTK


def vtu_text(types, cells, points, weights=None, degrees=None) -> str:
    def array(name, values, kind="Float64", components=1):
        text = " ".join(map(repr, np.ravel(values).tolist()))
        return (
            f'<DataArray type="{kind}" Name="{name}" NumberOfComponents="{components}" '
            f'format="ascii">{text}</DataArray>'
        )

    flag = ' RationalWeights="w"' if weights is not None else ""
    extra = array("w", weights) if weights is not None else ""
    cell_data = ""
    if degrees is not None:
        cell_data = (
            '<CellData HigherOrderDegrees="d">' + array("d", degrees, "Float64", 3) + "</CellData>"
        )
    return (
        '<VTKFile type="UnstructuredGrid" version="2.2"><UnstructuredGrid>'
        f'<Piece NumberOfPoints="{len(points)}" NumberOfCells="{len(cells)}">'
        f"<PointData{flag}>{extra}</PointData>{cell_data}"
        f"<Points>{array('p', points, 'Float64', 3)}</Points><Cells>"
        + array("connectivity", np.concatenate(cells), "Int64")
        + array("offsets", np.cumsum([len(c) for c in cells]), "Int64")
        + array("types", types, "UInt8")
        + "</Cells></Piece></UnstructuredGrid></VTKFile>"
    )


def vtk_evaluate(path, cell_number: int, pcoords: np.ndarray) -> np.ndarray:
    vtk = pytest.importorskip("vtk")
    reader = vtk.vtkXMLUnstructuredGridReader()
    reader.SetFileName(str(path))
    reader.Update()
    cell = vtk.vtkGenericCell()
    reader.GetOutput().GetCell(cell_number, cell)
    weights = [0.0] * cell.GetNumberOfPoints()
    out = []
    for pc in pcoords:
        x = [0.0] * 3
        cell.EvaluateLocation(vtk.reference(0), (*pc, 0.0), x, weights)
        out.append(x)
    return np.array(out)


CASES = [(22, 2, None), (69, 1, None), (69, 3, None), (69, 6, None), (28, 2, None), (23, 2, None)]
CASES += [(70, 3, None), (70, 2, (2, 3, 0)), (77, 2, None), (77, 1, (3, 1, 0)), (77, 4, None)]


@pytest.mark.parametrize("kind, n, degrees", CASES)
def test_vtk_cells(tmp_path, kind, n, degrees):
    """Equal to VTK where it is installed; without it, to the points at the corners."""
    rng = np.random.default_rng(kind + n)
    triangle = kind in (22, 69)
    p, q = degrees[:2] if degrees else (n, n)
    count = bernstein.size(n) if triangle else (8 if kind == 23 else (p + 1) * (q + 1))
    points = rng.normal(size=(count, 3))
    weights = rng.uniform(0.5, 2, count) if kind == 77 else None
    text = vtu_text([kind], [np.arange(count)], points, weights, degrees and [degrees])
    path = tmp_path / "a.vtu"
    path.write_text(text)
    t = io.load(path)
    uv = rng.dirichlet([1, 1, 1], 20)[:, :2]
    corners = [[1, 0], [0, 1], [0, 0]]
    if triangle:
        assert (len(t), t.degree) == (1, n)
        np.testing.assert_allclose(t.points(0, corners), points[:3], atol=1e-12)
        got = vtk_evaluate(path, 0, np.stack([uv[:, 1], 1 - uv.sum(axis=1)], axis=1))
        # 1e-12 as required; nodes of size 1, condition of the interpolation some 100
        np.testing.assert_allclose(t.points(0, uv), got, atol=1e-12)
        return
    assert (len(t), t.degree) == (2, p + q)
    np.testing.assert_allclose(t.points(0, corners), points[[1, 3, 0]], atol=1e-12)
    for half in range(2):
        got = vtk_evaluate(path, 0, uv if half == 0 else 1 - uv)
        np.testing.assert_allclose(t.points(half, uv), got, atol=1e-12)


@pytest.mark.parametrize("kind, n", [(24, 2), (71, 1), (71, 3), (71, 5), (78, 2), (78, 4)])
def test_vtk_surface_of_tetrahedra(tmp_path, kind, n):
    nodes = tetra_lattice(n, "vtk")[:, 1:] / n
    # of degree n where the nodes are interpolated; Bézier points may lie anywhere
    points = bend(nodes, n)
    path = tmp_path / "a.vtu"
    path.write_text(vtu_text([kind], [np.arange(len(points))], points))
    t = io.load(path)
    assert (len(t), t.degree) == (4, n)
    assert is_closed(t) and volume(t) > 0.1


def test_vtk_mixed_cells(tmp_path):
    """Face numbers are those of the cells, so the order of the file is kept."""
    points = np.concatenate([reference_nodes("triangle", 2), reference_nodes("quad", 1)])
    text = vtu_text([76, 42, 77, 22], [range(6), range(3), range(6, 10), range(6)], points)
    path = tmp_path / "a.vtu"
    path.write_text(text)
    model = io.read(path)
    assert model.sources[0].tolist() == [0, 2, 2, 3]
    assert (model.report.faces, model.report.converted) == (4, 3)
    assert "VTK_POLYHEDRON: not supported" in model.report.summary()


@pytest.mark.parametrize("kind, size", [(69, 8), (70, 5), (77, 3), (71, 5), (76, 1)])
def test_vtk_impossible_sizes(tmp_path, kind, size):
    points = np.random.default_rng(0).normal(size=(size, 3))
    path = tmp_path / "a.vtu"
    path.write_text(vtu_text([kind], [np.arange(size)], points))
    with pytest.raises(FileFormatError, match=f"fits VTK_.*got {size} points in cell 0"):
        io.load(path)


# ---------------------------------------------------------------------------- meshio


@pytest.mark.parametrize(
    "suffix, kind",
    [
        (".inp", "triangle6"),
        (".inp", "quad8"),
        (".bdf", "triangle"),
        (".bdf", "quad9"),
        (".mesh", "triangle"),
        (".mesh", "quad"),
        (".inp", "tetra10"),
        (".inp", "hexahedron20"),
        (".mesh", "hexahedron"),
    ],
)
def test_meshes_of_other_programs(tmp_path, suffix, kind):
    meshio = pytest.importorskip("meshio")
    _kind, lattice = meshes._TYPES[kind]
    nodes = lattice[:, 1:] if _kind in ("triangle", "tetra") else lattice
    points = np.pad(nodes / lattice.max(), ((0, 0), (0, 3 - nodes.shape[1])))
    path = tmp_path / f"a{suffix}"
    meshio.Mesh(points, [(kind, np.arange(len(points))[None])]).write(path)
    model = meshes.read_here(path)
    assert not model.report.refused
    if _kind in ("triangle", "quad"):
        area = sum(normal[:, 2] @ weight for _p, normal, weight in map(flux, model.groups))
        # 1e-7: some of these formats write few digits
        assert area == pytest.approx(0.5 if _kind == "triangle" else 1.0, abs=1e-7)
    else:
        assert volume(model.triangles()) == pytest.approx(
            1 / 6 if _kind == "tetra" else 1, abs=1e-7
        )


@pytest.mark.parametrize("suffix", [".inp", ".bdf", ".mesh"])
def test_bad_meshes(tmp_path, suffix):
    pytest.importorskip("meshio")
    path = tmp_path / f"a{suffix}"
    for data in (b"", b"garbage\n" * 10, bytes(range(256))):
        path.write_bytes(data)
        with pytest.raises(FileFormatError, match=rf"a\{suffix}"):
            meshes.read_here(path)


# ---------------------------------------------------------------------------- Gmsh itself


def test_lattices_are_those_of_gmsh():
    gmsh = pytest.importorskip("gmsh")
    gmsh.initialize(interruptible=False)
    try:
        for kind, numbers in TYPES.items():
            for n, number in enumerate(numbers, start=1):
                count, coordinates = gmsh.model.mesh.getElementProperties(number)[3:5]
                theirs = np.array(coordinates).reshape(count, -1)
                ours = reference_nodes(kind, n)
                if kind in ("quad", "hexahedron"):
                    ours = 2 * ours - 1  # Gmsh has -1 .. 1 there
                # 1e-15: k/n rounds
                np.testing.assert_allclose(ours[:, : theirs.shape[1]], theirs, atol=1e-15)
    finally:
        gmsh.finalize()


@pytest.mark.parametrize("n, quads", [(1, 0), (3, 0), (6, 0), (1, 1), (2, 1)])
def test_area_is_that_of_gmsh(tmp_path, n, quads):
    gmsh = pytest.importorskip("gmsh")
    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("Mesh.MeshSizeMax", 2)
        gmsh.option.setNumber("Mesh.RecombineAll", quads)
        gmsh.model.occ.addSphere(0, 0, 0, 1)
        gmsh.model.occ.synchronize()
        gmsh.model.mesh.generate(2)
        gmsh.model.mesh.setOrder(n)
        area = 0.0
        for number in gmsh.model.mesh.getElementTypes(2):
            places, weights = gmsh.model.mesh.getIntegrationPoints(number, "Gauss16")
            jacobians = gmsh.model.mesh.getJacobians(number, places)[0].reshape(-1, 9)
            cross = np.cross(jacobians[:, :3], jacobians[:, 3:6])
            area += (np.linalg.norm(cross, axis=1).reshape(-1, len(weights)) @ weights).sum()
        for binary in (0, 1):
            gmsh.option.setNumber("Mesh.Binary", binary)
            gmsh.write(str(tmp_path / "a.msh"))
            t = io.load(tmp_path / "a.msh")
            _p, normal, weight = flux(t)
            # 1e-6: two different rules for the length of the normal, which is no polynomial
            assert np.linalg.norm(normal, axis=1) @ weight == pytest.approx(area, rel=1e-6)
    finally:
        gmsh.finalize()


@pytest.mark.parametrize(
    ("nodes", "message"),
    [
        ([[0, 1, 7]], "expected cells of the 4 nodes that the file has, got node 7"),
        ([[0, 1, -1]], "expected cells of the 4 nodes that the file has, got node -1"),
        ([[0, 1, 2, 3]], "expected 3 nodes in each triangle"),
        ([0, 1, 2], "expected 3 nodes in each triangle"),
    ],
)
def test_cells_of_nodes_that_are_not_there(nodes, message):
    from mitsuba_bezier.io.cells import Cells, add_cells
    from mitsuba_bezier.io.lattices import triangle_lattice
    from mitsuba_bezier.io.report import Collector

    points = np.ones((4, 4))
    cells = Cells("triangle", triangle_lattice(1), np.array(nodes))
    with pytest.raises(FileFormatError, match=message):
        add_cells(Collector("a.inp", "Abaqus"), cells, points, np.zeros(1, dtype=int))
