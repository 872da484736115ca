"""STEP, IGES, BREP and .3dm files, against OpenCASCADE and rhino3dm where they are installed."""

from __future__ import annotations

import builtins
from types import SimpleNamespace

import numpy as np
import pytest

from mitsuba_bezier import io
from mitsuba_bezier.errors import FileFormatError
from mitsuba_bezier.geometry.triangles import BezierTriangles
from mitsuba_bezier.geometry.trims import Trims
from mitsuba_bezier.io import FormatWarning, isolated
from mitsuba_bezier.io.cad import opencascade as cad
from mitsuba_bezier.io.cad import rhino as rhino_reader
from mitsuba_bezier.io.tensor_nets import has_area

GAUSS = np.polynomial.legendre.leggauss(16)
S = (GAUSS[0] + 1) / 2
UV = np.stack([np.repeat(S, 16), np.outer(1 - S, S).ravel()], axis=1)
WEIGHT = (np.outer(GAUSS[1] * (1 - S), GAUSS[1]) / 4).ravel()


def integrals(triangles: list[BezierTriangles]) -> tuple[float, float, np.ndarray]:
    """Return area, volume by the divergence theorem, and the points used."""
    area = volume = 0.0
    points = []
    for t in triangles:
        d = t.differential(np.repeat(np.arange(len(t)), len(UV)), np.tile(UV, (len(t), 1)))
        normal = np.cross(d.dp_du, d.dp_dv)
        weight = np.tile(WEIGHT, len(t))
        area += np.linalg.norm(normal, axis=1) @ weight
        volume += np.einsum("nc,nc,n->", d.p, normal, weight) / 3
        points.append(d.p)
    return area, volume, np.concatenate(points)


@pytest.fixture(scope="module")
def occ():
    pytest.importorskip("OCP")
    from OCP.BRepAlgoAPI import BRepAlgoAPI_Cut, BRepAlgoAPI_Fuse
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeFace, BRepBuilderAPI_Transform
    from OCP.BRepGProp import BRepGProp
    from OCP.BRepPrimAPI import (
        BRepPrimAPI_MakeBox,
        BRepPrimAPI_MakeCone,
        BRepPrimAPI_MakeCylinder,
        BRepPrimAPI_MakeSphere,
        BRepPrimAPI_MakeTorus,
    )
    from OCP.BRepTools import BRepTools
    from OCP.gp import gp_Ax1, gp_Dir, gp_Pnt, gp_Trsf, gp_Vec
    from OCP.GProp import GProp_GProps
    from OCP.IGESControl import IGESControl_Writer
    from OCP.STEPControl import STEPControl_StepModelType, STEPControl_Writer

    def write(shape, path):
        suffix = path.suffix
        if suffix == ".brep":
            assert BRepTools.Write_s(shape, str(path))
        elif suffix in (".igs", ".iges"):
            writer = IGESControl_Writer("MM", 1)  # 1: faces as solids
            writer.AddShape(shape)
            assert writer.Write(str(path))
        else:
            writer = STEPControl_Writer()
            writer.Transfer(shape, STEPControl_StepModelType.STEPControl_AsIs)
            writer.Write(str(path))
        return path

    def moved(shape, shift=(0, 0, 0), axis=None, angle=0.0):
        turn = gp_Trsf()
        if axis is not None:
            turn.SetRotation(gp_Ax1(gp_Pnt(0, 0, 0), gp_Dir(*axis)), angle)
        move = gp_Trsf()
        move.SetTranslation(gp_Vec(*shift))
        return BRepBuilderAPI_Transform(shape, move.Multiplied(turn), True).Shape()

    def properties(shape):
        area, volume = GProp_GProps(), GProp_GProps()
        BRepGProp.SurfaceProperties_s(shape, area, 1e-9)
        BRepGProp.VolumeProperties_s(shape, volume, 1e-9)
        return area.Mass(), volume.Mass()

    return SimpleNamespace(
        box=lambda *size: BRepPrimAPI_MakeBox(*size).Shape(),
        cone=lambda *size: BRepPrimAPI_MakeCone(*size).Shape(),
        cylinder=lambda *size: BRepPrimAPI_MakeCylinder(*size).Shape(),
        sphere=lambda *size: BRepPrimAPI_MakeSphere(*size).Shape(),
        torus=lambda *size: BRepPrimAPI_MakeTorus(*size).Shape(),
        cut=lambda a, b: BRepAlgoAPI_Cut(a, b).Shape(),
        fuse=lambda a, b: BRepAlgoAPI_Fuse(a, b).Shape(),
        face=lambda surface: BRepBuilderAPI_MakeFace(surface, 1e-6).Face(),
        write=write,
        moved=moved,
        properties=properties,
    )


PRIMITIVES = {
    "sphere": (("sphere", 2.0), 16 * np.pi, 32 / 3 * np.pi),
    "sphere's zone": (("sphere", 2.0, -0.5, 0.7), None, None),
    "cylinder": (("cylinder", 1.0, 3.0), 8 * np.pi, 3 * np.pi),
    "part of a cylinder": (("cylinder", 1.0, 3.0, 2.0), None, None),
    "cone": (("cone", 2.0, 0.0, 1.5), (4 + 5) * np.pi, 2 * np.pi),
    "frustum": (("cone", 2.0, 1.0, 1.5), None, None),
    "torus": (("torus", 3.0, 1.0), 12 * np.pi**2, 6 * np.pi**2),
    "box": (("box", 1.0, 2.0, 3.0), 22, 6),
}


@pytest.mark.parametrize("suffix", [".step", ".stp", ".igs", ".brep"])
@pytest.mark.parametrize("call, area, volume", PRIMITIVES.values(), ids=PRIMITIVES.keys())
def test_primitives_are_exact(occ, tmp_path, suffix, call, area, volume):
    name, *size = call
    shape = occ.moved(getattr(occ, name)(*size), (1, 2, 3), (1, 1, 0), 0.8)
    if area is None:
        area, volume = occ.properties(shape)
    model = cad.read_here(occ.write(shape, tmp_path / f"a{suffix}"))
    assert not model.report.refused
    got_area, got_volume, _points = integrals(model.groups)
    # 1e-9: lengths are written with 15 digits, IGES has an own accuracy for knots
    assert got_area == pytest.approx(area, rel=1e-9)
    assert got_volume == pytest.approx(volume, rel=1e-9)  # so normals point outward


def test_points_on_a_torus(occ, tmp_path):
    shape = occ.torus(3.0, 1.0)
    model = cad.read_here(occ.write(shape, tmp_path / "a.brep"))
    x, y, z = integrals(model.groups)[2].T
    # 1e-13: rounding of lengths near 4
    np.testing.assert_allclose((np.hypot(x, y) - 3) ** 2 + z**2, 1, atol=1e-13)


def test_plane_faces_with_round_holes_are_exact(occ, tmp_path):
    plate = occ.box(4.0, 3.0, 1.0)
    for x, y, r in ((1, 1, 0.5), (2.6, 1.4, 0.8)):
        plate = occ.cut(plate, occ.moved(occ.cylinder(r, 5.0), (x, y, -1)))
    model = cad.read_here(occ.write(plate, tmp_path / "a.step"))
    assert (model.report.faces, model.report.converted) == (8, 8)
    _area, volume, _points = integrals(model.groups)
    assert volume == pytest.approx(12 - np.pi * (0.25 + 0.64), rel=1e-12)
    assert max(g.degree for g in model.groups) == 3


@pytest.mark.parametrize("suffix", [".step", ".igs"])
def test_faces_trimmed_by_curves(occ, tmp_path, suffix):
    """Cylinder through cylinder, cone, sphere and torus: no trim is a parameter line."""
    drill = occ.moved(occ.cylinder(0.6, 8.0), (-4, 0.1, 0.2), (0, 1, 0), np.pi / 2)
    for body in (
        occ.moved(occ.cylinder(1.0, 4.0), (0, 0, -2)),
        occ.moved(occ.cone(1.5, 0.8, 4.0), (0, 0, -2)),
        occ.sphere(1.3),
        occ.moved(occ.torus(2.0, 0.9), (0, 0, 0)),
    ):
        shape = occ.cut(body, drill)
        area, volume = occ.properties(shape)
        model = cad.read_here(occ.write(shape, tmp_path / f"a{suffix}"))
        assert not model.report.refused, model.report.summary()
        got_area, got_volume, _points = integrals(model.groups)
        # the trimming curves are followed to 1e-5 of the size, and OpenCASCADE's own curves of
        # intersection are no better than 1e-6
        assert got_area == pytest.approx(area, rel=2e-5)
        assert got_volume == pytest.approx(volume, rel=2e-5)


def test_surface_of_a_trimmed_face_stays_exact(occ, tmp_path):
    drill = occ.moved(occ.cylinder(0.6, 8.0), (-4, 0.1, 0.2), (0, 1, 0), np.pi / 2)
    shape = occ.cut(occ.sphere(1.3), drill)
    model = cad.read_here(occ.write(shape, tmp_path / "a.brep"))
    points = integrals(model.groups)[2]
    on_sphere = np.abs(np.linalg.norm(points, axis=1) - 1.3)
    on_drill = np.abs(np.hypot(points[:, 1] - 0.1, points[:, 2] - 0.2) - 0.6)
    assert np.minimum(on_sphere, on_drill).max() < 1e-12


@pytest.mark.parametrize("periodic", [False, True])
def test_nurbs_surface_equals_opencascade(occ, tmp_path, periodic):
    """Evaluation at the same parameters."""
    from OCP.Geom import Geom_CylindricalSurface, Geom_Plane, Geom_RectangularTrimmedSurface
    from OCP.GeomConvert import GeomConvert
    from OCP.gp import gp_Ax3, gp_Pnt

    rng = np.random.default_rng(0)
    if periodic:
        start = Geom_CylindricalSurface(gp_Ax3(), 2.0)
        part = Geom_RectangularTrimmedSurface(start, 0.0, 2 * np.pi, 0.0, 4.0)
    else:
        part = Geom_RectangularTrimmedSurface(Geom_Plane(gp_Ax3()), 0.0, 3.0, 0.0, 4.0)
    surface = GeomConvert.SurfaceToBSplineSurface_s(part)
    assert surface.IsUPeriodic() == periodic
    surface.IncreaseDegree(3, 2)
    for u in (1, 2.5):
        surface.InsertUKnot(u, 1, 1e-9)
    for v in (1, 2):
        surface.InsertVKnot(v, 1, 1e-9)
    for i in range(1, surface.NbUPoles() + 1):
        for j in range(1, surface.NbVPoles() + 1):
            x = surface.Pole(i, j)
            x = np.array([x.X(), x.Y(), x.Z()]) + rng.normal(scale=0.2, size=3)
            surface.SetPole(i, j, gp_Pnt(*x.tolist()))
            surface.SetWeight(i, j, float(rng.uniform(0.7, 1.4)))
    model = cad.read_here(occ.write(occ.face(surface), tmp_path / "a.brep"))
    (t,) = model.groups
    u_breaks = [surface.UKnot(k) for k in range(1, surface.NbUKnots() + 1)]
    v_breaks = (0, 1, 2, 4)
    assert len(t) == 2 * (len(u_breaks) - 1) * 3
    st = rng.dirichlet([1, 1, 1], 5)[:, :2]
    places = []
    for k in range(len(t)):
        i, j = divmod(k // 2, 3)
        inside = st if k % 2 == 0 else 1 - st
        low = np.array([u_breaks[i], v_breaks[j]])
        size = np.array([u_breaks[i + 1], v_breaks[j + 1]]) - low
        places.append(low + inside * size)
        for uv, point in zip(places[-1].tolist(), t.points(k, st)):
            wanted = surface.Value(*uv)
            # 1e-12 as required; the coordinates are below 6
            gap = np.abs(point - [wanted.X(), wanted.Y(), wanted.Z()]).max()
            assert gap < 1e-12


def test_patches_without_area_are_left_out():
    """Where a surface of revolution runs along its axis, or ends in a point."""
    rng = np.random.default_rng(0)
    nets = np.ones((5, 6, 4))
    nets[..., :3] = rng.normal(size=(5, 6, 3))
    nets[1, :, :2] = 7.0  # a line
    nets[2, :, :3] = [1, 2, 3]  # a point
    nets[3, :, 1] = nets[3, :, 0] + 1e-6 * rng.normal(size=6)  # flat, but a surface
    nets[3, :, 2] = 0
    nets[4, :, 3] = -1  # weights that say nothing about points
    assert has_area(nets).tolist() == [True, False, False, True, True]
    trims = Trims.none(5)
    ((left, left_trims),) = cad._with_area([(nets, trims), (nets[1:3], None)])
    assert len(left) == len(left_trims) == 3
    assert cad._with_area([(nets[1:3], None)]) == "a sliver without area"


def test_faces_are_named_when_refused(occ, tmp_path, monkeypatch):
    path = occ.write(occ.box(1.0, 1.0, 1.0), tmp_path / "a.step")
    original = cad._convert

    def convert(library, face, collector, name, trims):
        if name == "face 2":
            return "a reason"
        if name == "face 4":
            raise RuntimeError("Standard_Failure\nmore")
        return original(library, face, collector, name, trims)

    monkeypatch.setattr(cad, "_convert", convert)
    model = cad.read_here(path)
    with pytest.warns(FormatWarning, match=r"4 of 6 faces converted; refused: 1 \(a reason\); 1"):
        model.report.warn()
    assert len(model.triangles()) == 8
    refused = model.report.refused
    assert [str(r) for r in refused] == [
        "face 2: a reason",
        "face 4: failed with RuntimeError: Standard_Failure",
    ]


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("a.step", b"solid\n" * 100, "a STEP file .*'ISO-10303-21'"),
        ("a.step", b"ISO-10303-21;\ngarbage", "a file that OpenCASCADE can read|faces"),
        ("a.brep", b"\0\1\2" * 100, "BREP file"),
        ("a.igs", b"x" * 1000, "an IGES file"),
        ("a.iges", b"", "an IGES file"),
    ],
)
def test_bad_cad_files(occ, tmp_path, name, data, message):
    path = tmp_path / name
    path.write_bytes(data)
    with pytest.raises(FileFormatError, match=message):
        io.load(path)


def test_truncated_cad_files(occ, tmp_path):
    for suffix in (".step", ".brep", ".igs"):
        whole = occ.write(occ.sphere(1.0), tmp_path / f"a{suffix}").read_bytes()
        path = tmp_path / f"b{suffix}"
        for part in (0.1, 0.5, 0.8):
            path.write_bytes(whole[: int(part * len(whole))])
            with pytest.raises(FileFormatError, match=f"b{suffix}"):
                io.load(path)


@pytest.mark.parametrize(
    "name, package, extra", [("a.step", "OCP", "cad"), ("a.3dm", "rhino3dm", "rhino")]
)
def test_missing_libraries_are_told(tmp_path, monkeypatch, name, package, extra):
    path = tmp_path / name
    path.write_bytes(b"3D Geometry File Format " + b"ISO-10303-21;" * 10)
    original = builtins.__import__

    def no_import(module, *arguments, **options):
        if module.split(".")[0] == package:
            raise ImportError(f"No module named {module!r}")
        return original(module, *arguments, **options)

    monkeypatch.setattr(builtins, "__import__", no_import)
    module = cad if extra == "cad" else rhino_reader
    with pytest.raises(FileFormatError, match=rf"pip install 'mitsuba-bezier\[{extra}\]'"):
        module.read_here(path)


def test_a_process_of_its_own(occ, tmp_path):
    """It hands over every number and the whole report."""
    path = occ.write(occ.cut(occ.sphere(2.0), occ.box(5.0, 5.0, 5.0)), tmp_path / "a.step")
    here, there = cad.read_here(path), io.read(path)
    assert here.groups == there.groups
    assert [s.tolist() for s in here.sources] == [s.tolist() for s in there.sources]
    assert here.report == there.report


@pytest.mark.parametrize(
    "code, message",
    [
        ("import os; os.kill(os.getpid(), 11)", "its process died of SIGSEGV"),
        ("raise RuntimeError('no luck')", "RuntimeError: no luck"),
        ("x = bytearray(1 << 60)", "GiB of memory"),
    ],
)
def test_a_process_that_dies(tmp_path, monkeypatch, code, message):
    """A reader that crashes, fails or fills the memory is an error like any other."""
    broken = (
        "from mitsuba_bezier.io.cad import opencascade as cad\n"
        f"def read_here(path, trims):\n    {code}\n"
        "cad.read_here = read_here\n"
    )
    start = isolated.python_command
    monkeypatch.setattr(isolated, "python_command", lambda c, *words: start(broken + c, *words))
    path = tmp_path / "a.step"
    path.write_bytes(b"ISO-10303-21;")
    with pytest.raises(FileFormatError, match=message):
        io.load(path)


# ---------------------------------------------------------------------------- Rhino


@pytest.fixture(scope="module")
def rhino():
    return pytest.importorskip("rhino3dm")


def write_3dm(rhino, path, *adds):
    file = rhino.File3dm()
    for add in adds:
        add(file.Objects)
    assert file.Write(str(path), 7)
    return path


def shapes(rhino) -> dict:
    sphere = rhino.Sphere(rhino.Point3d(1, 2, 3), 2)
    cylinder = rhino.Cylinder(rhino.Circle(rhino.Point3d(0, 0, 0), 1.5), 4.0)
    circle = rhino.Circle(rhino.Point3d(0, 0, 0), 1.0).ToNurbsCurve()
    box = rhino.Box(rhino.BoundingBox(0, 0, 0, 1, 2, 3))
    brep = rhino.Brep
    return {
        "surface": (lambda o: o.AddSphere(sphere), 16 * np.pi, 32 / 3 * np.pi),
        "sphere": (lambda o: o.AddBrep(brep.CreateFromSphere(sphere)), 16 * np.pi, 32 / 3 * np.pi),
        "cylinder": (lambda o: o.AddBrep(cylinder.ToBrep(True, True)), 16.5 * np.pi, 9 * np.pi),
        "box": (lambda o: o.AddBrep(brep.CreateFromBox(box)), 22, 6),
        "disk": (
            lambda o: o.AddBrep(brep.CreateTrimmedPlane(rhino.Plane.WorldXY(), circle)),
            np.pi,
            0,
        ),
        "extrusion": (
            lambda o: o.AddExtrusion(rhino.Extrusion.Create(circle, 3.0, True), None),
            8 * np.pi,
            None,
        ),
    }


@pytest.mark.parametrize("name", ["surface", "sphere", "cylinder", "box", "disk", "extrusion"])
def test_rhino_objects(rhino, tmp_path, name):
    add, area, volume = shapes(rhino)[name]
    model = rhino_reader.read_here(write_3dm(rhino, tmp_path / "a.3dm", add))
    assert not model.report.refused, model.report.summary()
    got_area, got_volume, _points = integrals(model.groups)
    assert got_area == pytest.approx(area, rel=1e-12)
    if volume is not None:
        assert got_volume == pytest.approx(volume, rel=1e-12, abs=1e-12)
    else:  # which way an extrusion goes depends on its profile
        assert abs(got_volume) == pytest.approx(3 * np.pi, rel=1e-12)


def test_rhino_other_objects(rhino, tmp_path):
    mesh = rhino.Mesh()
    for x in ((0, 0, 0), (1, 0, 0), (0, 1, 0)):
        mesh.Vertices.Add(*x)
    mesh.Faces.AddFace(0, 1, 2)
    path = write_3dm(
        rhino,
        tmp_path / "a.3dm",
        shapes(rhino)["surface"][0],
        lambda o: o.AddMesh(mesh),
        lambda o: o.AddPoint(rhino.Point3d(0, 0, 0)),
    )
    with pytest.warns(FormatWarning, match=r"1 of 2 faces converted.*Mesh: no NURBS surface"):
        io.load(path)
    assert io.read(path).report.remarks == ["1 objects of type Point, no surfaces"]


def test_rhino_evaluation(rhino, tmp_path):
    """Equal to rhino3dm's own evaluation at the same parameters."""
    surface = rhino.NurbsSurface.CreateFromSphere(rhino.Sphere(rhino.Point3d(1, 2, 3), 2))
    (t,) = io.read(write_3dm(rhino, tmp_path / "a.3dm", lambda o: o.AddSurface(surface))).groups
    u, v = (np.unique(list(knots)) for knots in (surface.KnotsU.ToList(), surface.KnotsV.ToList()))
    st = np.random.default_rng(0).dirichlet([1, 1, 1], 5)[:, :2]
    for k in range(len(t)):
        i, j = divmod(k // 2, len(v) - 1)
        inside = st if k % 2 == 0 else 1 - st
        places = [u[i], v[j]] + inside * [u[i + 1] - u[i], v[j + 1] - v[j]]
        for place, point in zip(places.tolist(), t.points(k, st)):
            wanted = surface.PointAt(*place)
            np.testing.assert_allclose(point, [wanted.X, wanted.Y, wanted.Z], atol=1e-12)


@pytest.mark.parametrize("turned, beside", [(False, 0), (True, 0), (False, 0.004)])
def test_rhino_faces_trimmed_by_curves(rhino, turned, beside):
    """A cylinder cut by an oblique plane; rhino3dm cannot make such Breps, so we play one.

    Edges of real files lie beside their surfaces by more than the files' own tolerance.
    """
    r, h, a = 1.5, 2.0, 0.7

    def conic(height):  # the closed curve z = height + a x / r on the cylinder
        curve = rhino.Circle(rhino.Point3d(0, 0, 0), r).ToNurbsCurve()
        for k in range(len(curve.Points)):
            p = curve.Points[k]
            z = height * p.W + (a * p.X / r if height else 0.0)
            out = 1 + beside / r
            curve.Points[k] = rhino.Point4d(p.X * out, p.Y * out, z, p.W)
        return curve

    def edge(curve):
        return SimpleNamespace(ToNurbsCurve=lambda: curve)

    cylinder = rhino.Cylinder(rhino.Circle(rhino.Point3d(0, 0, 0), r), 4.0)
    surface = cylinder.ToNurbsSurface()
    top, bottom = conic(h), conic(0.0)
    start = top.PointAtStart
    seam = rhino.LineCurve(bottom.PointAtStart, start).ToNurbsCurve()
    brep = SimpleNamespace(Edges=[edge(bottom), edge(seam), edge(top)])
    order = ((0, False), (1, False), (2, True), (1, True))
    trims = [SimpleNamespace(EdgeIndex=k, IsReversed=back) for k, back in order]
    face = SimpleNamespace(
        UnderlyingSurface=lambda: surface,
        OrientationIsReversed=turned,
        Loops=[SimpleNamespace(TrimCount=4, Trims=trims)],
    )
    told: list[float] = []
    (part,) = rhino_reader._brep_face(brep, face, True, told.append)
    assert told == [pytest.approx(beside, abs=1e-12)]
    patches, left = BezierTriangles(part[0]), part[1]
    assert patches.degree == 3 and (left.region >= 0).any()
    uv = np.random.default_rng(0).dirichlet([1, 1, 1], 500)[:, :2]
    normal_out = 0
    for k in range(len(patches)):
        x, y, z = patches.points(k, uv).T
        off = z - (h + a * x / r)
        # 1e-6: the edge is followed to 1e-7 of the size of the surface, which is 6
        sure = np.abs(off) > 1e-6
        np.testing.assert_array_equal(left.inside(k, uv)[sure], (off < 0)[sure])
        normal = patches.normals(k, uv)
        normal_out += int(np.sign((normal[:, 0] * x + normal[:, 1] * y).mean()))
    assert normal_out == (-1 if turned else 1) * len(patches)
    # without trims: the same area, restricted
    nets = rhino_reader._brep_face(brep, face, False)
    area = integrals([BezierTriangles(net) for net, none in nets if none is None])[0]
    assert area == pytest.approx(2 * np.pi * r * h, rel=1e-5)


@pytest.mark.parametrize("data", [b"", b"garbage" * 100, b"3D Geometry File Format 7" + b"\1" * 99])
def test_bad_rhino_files(rhino, tmp_path, data):
    path = tmp_path / "a.3dm"
    path.write_bytes(data)
    with pytest.raises(FileFormatError, match=r"a\.3dm"):
        io.load(path)
