"""Meshes and grid functions of MFEM, against MFEM itself where it is installed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mitsuba_bezier import io
from mitsuba_bezier.errors import FileFormatError

DATA = Path(__file__).parent / "mfem_data"


def area(model) -> float:
    return float(sum(np.sum(group.area()) for group in model.groups))


# ---------------------------------------------------------------- MFEM's data


def areas_of_mfem(path, order: int) -> float:
    """Return the area of plane elements, or of the outer faces of volume elements."""
    mfem = pytest.importorskip("mfem.ser")
    mesh = mfem.Mesh(str(path), 1, 1)
    total = 0.0
    plane = mesh.Dimension() == 2
    for e in range(mesh.GetNE() if plane else mesh.GetNFaces()):
        if not plane and mesh.FaceIsInterior(e):
            continue
        t = mesh.GetElementTransformation(e) if plane else mesh.GetFaceTransformation(e)
        shape = mesh.GetElementBaseGeometry(e) if plane else mesh.GetFaceBaseGeometry(e)
        rule = mfem.IntRules.Get(shape, order)
        for k in range(rule.GetNPoints()):
            point = rule.IntPoint(k)
            t.SetIntPoint(point)
            total += point.weight * t.Weight()
    return total


# faces: elements, or outer faces, and Bézier patches of NURBS
MESHES = {
    "disc-nurbs": (5, 8 * np.pi),
    "square-disc-nurbs": (4, None),
    "square-disc-nurbs-patch": (5, None),
    "pipe-nurbs": (24, None),
    "mobius-strip": (16, None),
    "escher-p2": (48, None),
    "fichera-q2": (24, None),
    "fichera-mixed-p2": (36, None),
    "toroid-wedge": (24, None),
    "star-q3": (20, None),
}


@pytest.mark.parametrize("name", MESHES)
def test_areas_are_those_of_mfem(name):
    model = io.read(DATA / f"{name}.mesh")
    assert not model.report.refused
    # 1e-10, of which quadrature of these orders has some 1e-12 for roots of polynomials
    order = 24 if name in ("escher-p2", "fichera-mixed-p2") else 40
    expected = areas_of_mfem(DATA / f"{name}.mesh", order)
    assert area(model) == pytest.approx(expected, rel=1e-10)


def test_meshes_without_mfem():
    """Numbers that do not need it: a disc of radius 2 sqrt 2, faces, attributes."""
    for name, (_faces, exact) in MESHES.items():
        model = io.read(DATA / f"{name}.mesh")
        assert model.report.converted == model.report.faces > 0
        if exact is not None:
            assert area(model) == pytest.approx(exact, rel=1e-12)
        assert "attribute" in model.fields and not model.fields["attribute"].missing().any()
    disc = io.load(DATA / "disc-nurbs.mesh")
    rim = disc.evaluate(np.arange(len(disc)), np.tile([1.0, 0.0], (len(disc), 1)))
    assert np.isfinite(rim).all()


# ---------------------------------------------------------------- spaces


KINDS = {"triangle": 2, "quad": 3, "tetra": 4, "hexahedron": 5, "wedge": 6}


def made_by_mfem(folder, kind: str, order: int):
    """Write a bent mesh of several elements with MFEM; return MFEM's mesh and the file."""
    mfem = pytest.importorskip("mfem.ser")
    types = {
        "triangle": mfem.Element.TRIANGLE,
        "quad": mfem.Element.QUADRILATERAL,
        "tetra": mfem.Element.TETRAHEDRON,
        "hexahedron": mfem.Element.HEXAHEDRON,
        "wedge": mfem.Element.WEDGE,
    }
    if kind in ("triangle", "quad"):
        mesh = mfem.Mesh.MakeCartesian2D(2, 2, types[kind])
        mesh.SetCurvature(order, False, 3, 1)
    else:
        mesh = mfem.Mesh.MakeCartesian3D(2, 1, 2, types[kind])
        mesh.SetCurvature(order, False, 3, 1)
    nodes = mesh.GetNodes()
    x = nodes.GetDataArray().reshape(-1, 3)
    x += 0.08 * np.sin(3 * x[:, [1, 2, 0]] + [0.3, 1.0, 2.0])
    path = folder / f"{kind}{order}.mesh"
    mesh.Save(str(path), 16)
    # with the numbering that is read from the file
    return mfem.Mesh(str(path), 1, 0, False), path


@pytest.mark.parametrize("order", [1, 2, 3, 4])
@pytest.mark.parametrize("kind", KINDS)
def test_bent_meshes(tmp_path, kind, order):
    _mesh, path = made_by_mfem(tmp_path, kind, order)
    model = io.read(path)
    assert area(model) == pytest.approx(areas_of_mfem(path, 20), rel=2e-10)


@pytest.mark.parametrize("order", [0, 1, 2, 3])
@pytest.mark.parametrize("kind", ["triangle", "quad", "tetra", "hexahedron"])
@pytest.mark.parametrize("space", ["H1", "H1Pos", "L2", "L2closed"])
def test_grid_functions(tmp_path, space, kind, order):
    """Values at random places of elements, of a degree that is not that of the mesh."""
    mfem = pytest.importorskip("mfem.ser")
    volume = kind in ("tetra", "hexahedron")
    if (order == 0 and space != "L2") or (volume and space == "L2" and order):
        pytest.skip("no such space, or values that are not on faces")
    mesh, path = made_by_mfem(tmp_path, kind, 2)
    basis = mfem.BasisType
    dim = mesh.Dimension()
    if space.startswith("H1"):
        kind_of = basis.GaussLobatto if space == "H1" else basis.Positive
        collection = mfem.H1_FECollection(order, dim, kind_of)
    else:
        kind_of = basis.GaussLegendre if space == "L2" else basis.GaussLobatto
        collection = mfem.L2_FECollection(order, dim, kind_of)
    components = 1 if order == 2 else 1 + order
    ordering = mfem.Ordering.byVDIM if order == 1 else mfem.Ordering.byNODES
    fes = mfem.FiniteElementSpace(mesh, collection, components, ordering)
    function = mfem.GridFunction(fes)
    values = function.GetDataArray()
    values[:] = np.random.default_rng(order).normal(size=values.shape)
    file = tmp_path / "sol.gf"
    function.Save(str(file), 16)
    model = io.read(path, fields=[file])
    field, patches = model.fields["sol"], model.triangles()
    assert field.components == components
    compared = 0
    rng = np.random.default_rng(1)
    point = mfem.IntegrationPoint()
    for element in range(mesh.GetNE()):
        t = mesh.GetElementTransformation(element)
        for _ in range(3):
            x = local_place(kind, rng)
            point.Set3(*x)
            where = t.Transform(point)
            expected = [function.GetValue(element, point, c + 1) for c in range(components)]
            found = lookup(patches, np.array([where[k] for k in range(3)]))
            if found is None:
                continue
            compared += 1
            options = [field.evaluate([k], [uv])[0] for k, uv in found]
            # L2: elements have values of their own on the sides they share
            assert min(np.abs(value - expected).max() for value in options) < 1e-9
    assert compared >= 6


def local_place(kind: str, rng) -> list[float]:
    """Return a place in a reference element: inside if it is plane, else on a face."""
    if kind == "triangle":
        return [*rng.dirichlet([1, 1, 1])[:2], 0.0]
    if kind == "quad":
        return [*rng.random(2), 0.0]
    if kind == "tetra":
        x = rng.dirichlet([1, 1, 1])
        return np.insert(x, rng.integers(0, 4), 0.0)[:3].tolist()
    return np.insert(rng.random(2), rng.integers(0, 3), rng.integers(0, 2)).tolist()


def lookup(patches, x):
    """Return the patches and parameters of a point, None if it is on none."""
    net = patches.control_points
    points = net[..., :3] / net[..., 3:]
    near = (points.min(axis=1) <= x + 1e-9) & (points.max(axis=1) >= x - 1e-9)
    found = []
    for k in np.flatnonzero(near.all(axis=1)).tolist():
        uv = np.array([1 / 3, 1 / 3])
        for _ in range(25):
            h = 1e-6
            p = patches.points(k, uv + h * np.array([[0, 0], [1, 0], [0, 1]]))
            step = np.linalg.lstsq((p[1:] - p[0]).T / h, x - p[0], rcond=None)[0]
            uv = uv + step
            if np.abs(step).max() < 1e-13 or np.abs(uv).max() > 3:
                break
        inside = min(*uv, 1 - uv.sum()) > -1e-9
        if inside and np.linalg.norm(patches.points(k, [uv])[0] - x) < 1e-10:
            found.append((k, uv))
    return found or None


def test_grid_functions_on_nurbs(tmp_path):
    mfem = pytest.importorskip("mfem.ser")
    for name in ("disc-nurbs", "square-disc-nurbs", "square-disc-nurbs-patch", "pipe-nurbs"):
        path = DATA / f"{name}.mesh"
        mesh = mfem.Mesh(str(path), 1, 1)
        fes = mfem.FiniteElementSpace(mesh, mesh.GetNodes().FESpace().FEColl(), 1)
        function = mfem.GridFunction(fes)
        values = function.GetDataArray()
        values[:] = np.random.default_rng(0).normal(size=values.shape)
        file = tmp_path / f"{name}.gf"
        function.Save(str(file), 16)
        model = io.read(path, fields=[file])
        field, patches = model.fields[name], model.triangles()
        point = mfem.IntegrationPoint()
        rng = np.random.default_rng(2)
        compared = 0
        for element in range(mesh.GetNE()):
            t = mesh.GetElementTransformation(element)
            for _ in range(3):
                x = rng.random(3)
                if mesh.Dimension() == 3:
                    x[rng.integers(0, 2)] = rng.integers(0, 2)
                point.Set3(*x.tolist())
                where = np.zeros(3)
                place = t.Transform(point)
                where[: len(place)] = [place[k] for k in range(mesh.SpaceDimension())]
                found = lookup(patches, where)
                if found is None:
                    continue
                compared += 1
                expected = function.GetValue(element, point)
                got = [float(field.evaluate([k], [uv])[0, 0]) for k, uv in found]
                assert min(abs(v - expected) for v in got) < 1e-9
        assert compared >= 6, name


# ---------------------------------------------------------------- without MFEM

SQUARE = """MFEM mesh v1.0

# a comment
dimension
2

elements
2
1 2 0 1 2
7 2 0 2 3

boundary
0

vertices
4
2
0 0
1 0
1 1
0 1
"""

FUNCTION = """FiniteElementSpace
FiniteElementCollection: H1_2D_P2
VDim: 1
Ordering: 0

0 1 4 1
{edges}
"""


def test_a_function_written_by_hand(tmp_path):
    """Edges are numbered as elements meet them: 01, 12, 20, then 23, 30."""
    mesh, file = tmp_path / "a.mesh", tmp_path / "f.gf"
    mesh.write_text(SQUARE)
    # (x + y)^2 at the vertices 0, 1, 4, 1 and the middles of edges
    file.write_text(FUNCTION.format(edges="0.25 2.25 1 2.25 0.25"))
    model = io.read(mesh, fields=[file])
    field, patches = model.fields["f"], model.triangles()
    uv = np.random.default_rng(0).dirichlet([1, 1, 1], 20)[:, :2]
    for k in (0, 1):
        x = patches.points(k, uv)
        expected = (x[:, 0] + x[:, 1]) ** 2
        np.testing.assert_allclose(field.evaluate([k] * 20, uv)[:, 0], expected, atol=1e-13)
    assert sorted(io.read(mesh).fields["attribute"].ordinates.ravel()) == [1, 7]


@pytest.mark.parametrize(
    "change, message",
    [
        (("MFEM mesh v1.0", "MFEM NC mesh v1.0"), "got an NC mesh, which has elements of several"),
        (("MFEM mesh v1.0", "MFEM INLINE mesh v1.0"), "got an INLINE mesh"),
        (("MFEM mesh v1.0", "MFEM mesh v2.0"), "another header"),
        (("2 0 1 2", "2 0 1 9"), "elements of vertices from 0 to 3"),
        (("1 2 0 1 2", "1 9 0 1 2"), "a geometry from 0 to 7"),
        (("1 1\n", "1 x\n"), "a finite number for vertices"),
        (("0 1\n", ""), "numbers for vertices"),
        (("elements\n2", "elements\n200000000"), "the number of elements"),
    ],
)
def test_damaged_meshes(tmp_path, change, message):
    assert change[0] in SQUARE
    path = tmp_path / "a.mesh"
    head, _found, tail = SQUARE.rpartition(change[0])
    path.write_text(head + change[1] + tail)
    with pytest.raises(FileFormatError, match=message):
        io.read(path)


@pytest.mark.parametrize(
    "change, message",
    [
        (("H1_2D_P2", "RT_2D_P1"), "a grid function of H1 or L2, got RT_2D_P1"),
        (("H1_2D_P2", "H1_2D_P3"), "values of H1_2D_P3"),
        (("VDim: 1", "VDim: 2"), "that 2 divides"),
        (("Ordering: 0", "Ordering: 3"), "Ordering: 0 or 1"),
        (("FiniteElementSpace", "Space"), "expected FiniteElementSpace"),
    ],
)
def test_damaged_functions(tmp_path, change, message):
    mesh, file = tmp_path / "a.mesh", tmp_path / "f.gf"
    mesh.write_text(SQUARE)
    file.write_text(FUNCTION.format(edges="1 2 3 4 5").replace(*change))
    with pytest.raises(FileFormatError, match=message):
        io.read(mesh, fields=[file])


def test_functions_are_for_meshes_of_mfem(tmp_path):
    path = tmp_path / "a.mesh"
    path.write_text("MeshVersionFormatted 2\nDimension 3\nEnd\n")
    with pytest.raises(FileFormatError, match="a mesh of MFEM, for grid functions"):
        io.read(path, fields=[tmp_path / "f.gf"])


def test_a_grid_function_gives_the_colours(tmp_path, capsys):
    from mitsuba_bezier.cli.main import main

    mesh, file = tmp_path / "a.mesh", tmp_path / "f.gf"
    mesh.write_text(SQUARE)
    file.write_text(FUNCTION.format(edges="0.25 2.25 1 2.25 0.25"))
    out = tmp_path / "a.exr"
    words = ["render", str(mesh), "--color-by", str(file), "--size", "16x16", "--spp", "1"]
    assert main([*words, "--view", "top", "--no-bar", "-o", str(out)]) == 0
    assert out.exists()
    assert main(["render", str(mesh), "--color-by", str(tmp_path / "g.gf")]) == 2
    assert "which does not exist" in capsys.readouterr().err
