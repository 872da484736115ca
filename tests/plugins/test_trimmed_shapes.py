"""Trimmed patches in files and under rays."""

from __future__ import annotations

import re
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from backend_cases import VARIANT

import mitsuba_bezier as mb
from mitsuba_bezier import io
from mitsuba_bezier.cli.main import main
from mitsuba_bezier.errors import FileFormatError, NetError
from mitsuba_bezier.geometry.trims import Trims, closed_region, square_map
from mitsuba_bezier.io import FormatWarning
from mitsuba_bezier.io.cad import opencascade as cad


@pytest.fixture(autouse=True)
def variant():
    mi.set_variant(VARIANT)


def circle(center, radius) -> list[np.ndarray]:
    out = []
    for a in np.pi / 2 * np.arange(4):
        points = [(np.cos(a + b), np.sin(a + b)) for b in (0, np.pi / 4, np.pi / 2)]
        w = np.array([1, np.cos(np.pi / 4), 1])
        points[1] = tuple(np.array(points[1]) / w[1])
        out.append(np.column_stack([(np.array(points) * radius + center) * w[:, None], w]))
    return closed_region(out, 1e-9)


SQUARE = [
    np.array([[*a, 1], [*b, 1]], float)
    for a, b in zip([(0, 0), (1, 0), (1, 1), (0, 1)], [(1, 0), (1, 1), (0, 1), (0, 0)])
]


def windows(patches) -> Trims:
    """A round window in each patch but every third, which is its pane instead, or whole."""
    regions = [SQUARE + circle((0.3, 0.35), 0.22), circle((0.4, 0.3), 0.27)]
    count = len(patches)
    region = np.array([0, 1, -1])[np.arange(count) % 3]
    return Trims(regions, region, [square_map()] * count, [[[0, 0], [1, 1]]] * count)


def shape(path, patches, trims=None):
    io.save(patches, path, trims=trims)
    return mi.load_dict({"type": "beziertriangle", "filename": str(path)})


def rays(count, seed, reach):
    rng = np.random.default_rng(seed)
    o = rng.normal(size=(3, count))
    o *= reach / np.linalg.norm(o, axis=0)
    d = rng.uniform(-0.6, 0.6, (3, count)) * reach / 2 - o
    return mi.Ray3f(mi.Point3f(o), mi.Vector3f(d / np.linalg.norm(d, axis=0)))


FLAT = mb.BezierTriangles(
    [[[1, 0, 0, 1], [0, 1, 0, 1], [0, 0, 0, 1]], [[0, 1, 0, 1], [1, 0, 0, 1], [1, 1, 0, 1]]]
)
MAPS = [square_map(), square_map(True)]
DISK = Trims([circle((0.5, 0.5), 0.4)], [0, 0], MAPS, [[[0, 0], [1, 1]]] * 2)

BALL = mb.sphere(cover="tetrahedral")

SURFACES = {
    "closed forms": (lambda: BALL, 3),
    "inverted": (lambda: mb.sphere(cover="octants"), 3),
    "several roots": (lambda: mb.torus(tube=0.4), 3),
    "infinity": (lambda: mb.hyperboloid_one_sheet().elevate(), 4),
}


@pytest.mark.parametrize("surface, reach", SURFACES.values(), ids=SURFACES.keys())
def test_trimmed_hits_are_skipped(tmp_path, surface, reach):
    """The hit is the first of the whole surface that the oracle leaves."""
    patches = surface()
    trims = windows(patches)
    whole = shape(tmp_path / "whole.vtu", patches)
    trimmed = shape(tmp_path / "trimmed.vtu", patches, trims)
    assert whole.trims is None and trimmed.trims == trims
    ray = rays(3000, 11, reach)
    wanted = np.full(3000, np.inf)
    doubtful = np.zeros(3000, bool)
    open_ = np.ones(3000, bool)
    start = dr.zeros(mi.Float, 3000)
    skipped = 0
    for _ in range(5):  # a torus has four roots
        further = mi.Ray3f(mi.Point3f(ray.o + start * ray.d), ray.d)
        pi = whole.ray_intersect_preliminary(further, mi.Bool(open_))
        hit = np.array(pi.is_valid()) & open_
        uv = np.stack([np.array(pi.prim_uv.x), np.array(pi.prim_uv.y)], axis=1).astype(float)
        patch = np.where(hit, np.array(pi.prim_index), 0)
        uv[~hit] = 0.3
        left = trims.inside(patch, uv)
        # (u, v) are float32, and the trims' own slack is 1e-6
        for step in ([3e-6, 0], [-3e-6, 0], [0, 3e-6], [0, -3e-6]):
            doubtful |= hit & (trims.inside(patch, uv + step) != left)
        t = np.array(start + pi.t)
        wanted = np.where(hit & left, t, wanted)
        skipped += int((hit & ~left).sum())
        open_ = hit & ~left
        start = dr.select(mi.Bool(open_), start + pi.t + 1e-3, start)  # past the hit it left
    assert not open_.any() and skipped > 300
    pi = trimmed.ray_intersect_preliminary(ray)
    hit = np.array(pi.is_valid())
    # 1e-3: two sheets nearer to each other than the step behind a hit
    ok = (hit == np.isfinite(wanted)) | doubtful
    assert (~ok).sum() <= 1
    both = hit & np.isfinite(wanted) & ~doubtful
    # 1e-5 of t: two marches to one root, from different origins
    np.testing.assert_allclose(np.array(pi.t)[both], wanted[both], rtol=2e-5, atol=2e-5)
    assert (np.array(trimmed.ray_test(ray)) == hit).all()
    # what was hit is left by the oracle
    uv = np.stack([np.array(pi.prim_uv.x), np.array(pi.prim_uv.y)], axis=1).astype(float)
    sure = both & hit
    assert trims.inside(np.array(pi.prim_index)[sure], uv[sure]).all()


def test_bounds_of_a_round_window_are_round(tmp_path):
    """A disk cut out of two flat patches: its edge is where it should be, to 2e-6."""
    disk = shape(tmp_path / "disk.vtu", FLAT, DISK)
    angles = np.random.default_rng(0).uniform(0, 2 * np.pi, 3000)
    for off, wanted in ((-2.5e-6, True), (2.5e-6, False)):
        x = 0.5 + (0.4 + off) * np.cos(angles)
        y = 0.5 + (0.4 + off) * np.sin(angles)
        ray = mi.Ray3f(mi.Point3f(x, y, 0.5), mi.Vector3f(0, 0, -1))
        assert (np.array(disk.ray_test(ray)) == wanted).all()


def test_area_and_light_of_a_disk(tmp_path):
    """A trimmed emitter has the area and gives the light of what is left of it."""
    from mitsuba_bezier.plugins.scene_data import data_for_shapes

    disk = shape(tmp_path / "a.vtu", FLAT, DISK)
    # 1e-3: the boundary is made of small triangles that count by a share
    assert float(disk.surface_area()[0]) == pytest.approx(np.pi * 0.16, rel=1e-3)
    sampling = data_for_shapes([disk]).surface_sampling((0,))
    sample = np.random.default_rng(0).random((2, 200_000))
    ps, _patch = sampling.sample(mi.UInt32(0), mi.Point2f(sample), mi.Bool(True))
    inverse = dr.select(ps.pdf > 0, 1 / ps.pdf, 0)
    # the area by sampling; were half of all samples in vain, its deviation would be 0.0011
    assert float(dr.mean(inverse)[0]) == pytest.approx(np.pi * 0.16, abs=0.0045)
    inside = np.hypot(np.array(ps.p.x) - 0.5, np.array(ps.p.y) - 0.5) < 0.4 + 2e-6
    assert (inside | (np.array(ps.pdf) == 0)).all() and inside.any()


def test_parameters_keep_trims(tmp_path):
    patches = BALL
    trimmed = shape(tmp_path / "a.vtu", patches, windows(patches))
    params = mi.traverse(trimmed)
    ray = rays(500, 1, 3)
    before = np.array(trimmed.ray_test(ray))
    params["to_world"] = mi.Transform4f().scale(2)
    params.update()
    assert (np.array(trimmed.ray_test(mi.Ray3f(2 * ray.o, ray.d))) == before).all()
    params["control_points"] = mi.TensorXf(patches.control_points[:2])
    with pytest.raises(NetError, match="expected 10 patches, as the trims have, got 2"):
        params.update()


# ---------------------------------------------------------------------------- files


@pytest.mark.parametrize("encoding", ["ascii", "binary", "appended"])
def test_vtu_keeps_trims(tmp_path, encoding):
    groups = [BALL, mb.sphere(cover="octants"), BALL]
    trims = [windows(groups[0]), None, windows(groups[2])]
    path = tmp_path / "a.vtu"
    io.save(groups, path, encoding=encoding, trims=trims)
    model = io.read(path, trims=True)
    assert model.groups == [mb.BezierTriangles.join([groups[0], groups[2]]), groups[1]]
    assert model.trims == [Trims.join([trims[0], trims[2]]), None]
    joined, all_trims = model.trimmed()
    assert (all_trims.region >= 0).sum() == 14 and len(all_trims) == len(joined)
    uv = np.random.default_rng(0).dirichlet([1, 1, 1], 200)[:, :2]
    first = len(groups[0])
    assert all_trims[:first] == trims[0] and (all_trims.region[first : first + 8] == -1).all()
    assert (all_trims.inside(1, uv) == trims[0].inside(1, uv)).all()
    with pytest.warns(FormatWarning, match="trims are not used: patches are returned whole"):
        io.load(path)
    assert io.load_trimmed(path) == (joined, all_trims)


def test_vtk_keeps_trims(tmp_path):
    vtk = pytest.importorskip("vtk")
    patches = BALL
    io.save(patches, tmp_path / "a.vtu", trims=windows(patches))
    reader, writer = vtk.vtkXMLUnstructuredGridReader(), vtk.vtkXMLUnstructuredGridWriter()
    reader.SetFileName(str(tmp_path / "a.vtu"))
    reader.Update()
    writer.SetInputData(reader.GetOutput())
    writer.SetFileName(str(tmp_path / "b.vtu"))
    writer.Write()
    assert io.load_trimmed(tmp_path / "b.vtu") == (patches, windows(patches))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('NumberOfTuples="12"', 'NumberOfTuples="13"', "values in DataArray 'TrimCurves'"),
        ('Name="TrimMap" NumberOfComponents="12"', 'Name="TrimMap"', "12 components in 'TrimMap'"),
        ("\n-1\n", "\n7\n", "trims that fit together.*region"),
        ("\n1 3\n", "\n1 5\n", "trims that fit together.*curves with"),
        ("\n1 3\n", "\n-4 3\n", "trims that fit together.*curves of regions below"),
    ],
)
def test_damaged_trims(tmp_path, old, new, message):
    patches = BALL
    path = tmp_path / "a.vtu"
    io.save(patches, path, trims=windows(patches), encoding="ascii")
    text = path.read_text()
    at = text.index("TrimCurves") if "3" in old else 0
    old_at = text.find(old, at)
    assert old_at >= 0
    path.write_text(text[:old_at] + new + text[old_at + len(old) :])
    with pytest.raises(FileFormatError, match=message):
        io.load_trimmed(path)


def test_trims_of_other_patches(tmp_path):
    with pytest.raises(
        FileFormatError, match=r"trims: expected those of \[8\] patches, got \[10\]"
    ):
        io.save(mb.sphere(cover="octants"), tmp_path / "a.vtu", trims=windows(BALL))
    with pytest.raises(FileFormatError, match="trims: expected no such option"):
        io.save(BALL, tmp_path / "a.bv", trims=windows(BALL))


def test_the_page_on_formats_runs(tmp_path, monkeypatch):
    page = Path(__file__).parents[2] / "docs" / "formats.md"
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"^```python\n(.*?)^```$", page.read_text(encoding="utf-8"), re.S | re.M)
    assert len(blocks) >= 2
    for block in blocks:
        exec(compile(block, str(page), "exec"), {})


# ---------------------------------------------------------------------------- CAD parts


def parts() -> dict:
    """Return OpenCASCADE shapes with holes through curved faces."""
    from OCP.BRepAlgoAPI import BRepAlgoAPI_Cut
    from OCP.BRepBuilderAPI import BRepBuilderAPI_NurbsConvert, BRepBuilderAPI_Transform
    from OCP.BRepFilletAPI import BRepFilletAPI_MakeFillet
    from OCP.BRepPrimAPI import (
        BRepPrimAPI_MakeBox,
        BRepPrimAPI_MakeCylinder,
        BRepPrimAPI_MakeSphere,
        BRepPrimAPI_MakeTorus,
    )
    from OCP.gp import gp_Ax1, gp_Dir, gp_Pnt, gp_Trsf, gp_Vec
    from OCP.TopAbs import TopAbs_ShapeEnum
    from OCP.TopExp import TopExp_Explorer
    from OCP.TopoDS import TopoDS

    def moved(shape, shift, axis=(0, 0, 1), angle=0.0):
        turn, move = gp_Trsf(), gp_Trsf()
        turn.SetRotation(gp_Ax1(gp_Pnt(0, 0, 0), gp_Dir(*axis)), angle)
        move.SetTranslation(gp_Vec(*shift))
        return BRepBuilderAPI_Transform(shape, move.Multiplied(turn), True).Shape()

    def cut(a, b):
        return BRepAlgoAPI_Cut(a, b).Shape()

    def round_box():
        box = moved(BRepPrimAPI_MakeBox(3.0, 2.0, 2.0).Shape(), (-1.5, -1, -1))
        fillet = BRepFilletAPI_MakeFillet(box)
        edges = TopExp_Explorer(box, TopAbs_ShapeEnum.TopAbs_EDGE)
        as_edge = getattr(TopoDS, "Edge_s", None) or TopoDS.Edge
        while edges.More():
            fillet.Add(0.3, as_edge(edges.Current()))
            edges.Next()
        return fillet.Shape()

    drill = moved(BRepPrimAPI_MakeCylinder(0.6, 8.0).Shape(), (-4, 0.1, 0.2), (0, 1, 0), np.pi / 2)
    corner = moved(BRepPrimAPI_MakeCylinder(0.5, 4.0).Shape(), (1.1, 0.75, -2))
    block = moved(BRepPrimAPI_MakeBox(2.0, 1.5, 3.0).Shape(), (0.7, -0.9, -1.2), (1, 1, 0), 0.4)
    rod = moved(BRepPrimAPI_MakeCylinder(1.0, 4.0).Shape(), (0, 0, -2))
    ball = BRepPrimAPI_MakeSphere(1.3).Shape()
    return {
        "cylinder with a hole across": cut(rod, drill),
        "sphere with a hole": cut(ball, drill),
        "sphere as NURBS with a hole": BRepBuilderAPI_NurbsConvert(cut(ball, drill)).Shape(),
        "rounded box with holes": cut(cut(round_box(), drill), corner),
        "torus less a box": cut(BRepPrimAPI_MakeTorus(2.0, 0.9).Shape(), block),
    }


@pytest.fixture(scope="module")
def occ() -> dict:
    pytest.importorskip("OCP")
    return parts()


PARTS = (
    "cylinder with a hole across",
    "sphere as NURBS with a hole",
    "rounded box with holes",
    "torus less a box",
)


def write(part, path):
    """Write a BREP file."""
    from OCP.BRepTools import BRepTools

    assert BRepTools.Write_s(part, str(path))
    return path


@pytest.mark.parametrize("name", PARTS)
def test_rays_equal_opencascade(occ, tmp_path, name):
    """Closest hits with whole parts, against IntCurvesFace: no face dropped, no edge moved."""
    from OCP.BRep import BRep_Builder
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeVertex
    from OCP.BRepExtrema import BRepExtrema_DistShapeShape
    from OCP.gp import gp_Dir, gp_Lin, gp_Pnt
    from OCP.IntCurvesFace import IntCurvesFace_ShapeIntersector
    from OCP.TopAbs import TopAbs_ShapeEnum
    from OCP.TopExp import TopExp_Explorer
    from OCP.TopoDS import TopoDS_Compound

    part = occ[name]
    path = write(part, tmp_path / "part.brep")
    report = io.read(path, trims=True).report
    assert report.converted == report.faces and report.faces >= 2
    ours = mi.load_dict({"type": "beziertriangle", "filename": str(path)})
    assert ours.trims is not None and (ours.trims.region >= 0).any()
    count = 400  # more of them: benchmarks/cad_rays.py
    ray = rays(count, 5, 6)
    pi = ours.ray_intersect_preliminary(ray)
    hit, t = np.array(pi.is_valid()), np.array(pi.t)
    assert (np.array(ours.ray_test(ray)) == hit).all()
    # OpenCASCADE itself misses rays that graze a NURBS sphere; it is better with spheres
    part = occ[name.replace("as NURBS ", "")]
    tool = IntCurvesFace_ShapeIntersector()
    tool.Load(part, 1e-9)
    edges, builder = TopoDS_Compound(), BRep_Builder()
    builder.MakeCompound(edges)
    explorer = TopExp_Explorer(part, TopAbs_ShapeEnum.TopAbs_EDGE)
    while explorer.More():
        builder.Add(edges, explorer.Current())
        explorer.Next()
    o, d = np.array(ray.o).T.astype(float), np.array(ray.d).T.astype(float)
    in_band = 0
    for k in range(count):
        tool.PerformNearest(gp_Lin(gp_Pnt(*o[k]), gp_Dir(*d[k])), 0, 100)
        wanted = min((tool.WParameter(i + 1) for i in range(tool.NbPnt())), default=np.inf)
        # 1e-5: our t has float32 digits, 2e-7 of a distance near 6, over the cosine
        if hit[k] == np.isfinite(wanted) and (not hit[k] or abs(t[k] - wanted) < 1e-5):
            continue
        near = min(t[k] if hit[k] else np.inf, wanted)
        vertex = BRepBuilderAPI_MakeVertex(gp_Pnt(*(o[k] + near * d[k]))).Vertex()
        # the band: 1e-5 around edges, whose curves OpenCASCADE itself has to some 1e-6
        assert BRepExtrema_DistShapeShape(vertex, edges).Value() < 1e-5, (k, hit[k], t[k], wanted)
        in_band += 1
    assert in_band <= 1 and 0.2 < hit.mean() < 1


@pytest.mark.parametrize("suffix", ["brep", "step"])
def test_trims_cross_processes(occ, tmp_path, suffix):
    part = occ["cylinder with a hole across"]
    path = tmp_path / f"part.{suffix}"
    if suffix == "brep":
        write(part, path)
    else:
        from OCP.STEPControl import STEPControl_StepModelType, STEPControl_Writer

        writer = STEPControl_Writer()
        writer.Transfer(part, STEPControl_StepModelType.STEPControl_AsIs)
        writer.Write(str(path))
    here, there = cad.read_here(path, trims=True), io.read(path, trims=True)
    assert here.groups == there.groups and here.trims == there.trims
    assert max(g.degree for g in here.groups) == 3  # without trims 6


def test_commands(occ, tmp_path, capsys):
    path = write(occ["cylinder with a hole across"], tmp_path / "part.brep")
    assert main(["info", str(path)]) == 0
    assert "with trims" in capsys.readouterr().out
    want = cad.read_here(path, trims=True)
    for options in ([], ["--elevate"]):
        out = tmp_path / "part.vtu"
        assert main(["convert", str(path), str(out), "--trims", "-q", *options]) == 0
        got = io.read(out, trims=True)
        if options:
            assert got.trimmed() == want.trimmed()
        else:
            assert got.groups == want.groups and got.trims == want.trims
    assert main(["convert", str(path), str(tmp_path / "part.ply"), "--trims"]) == 2
    assert "trims: expected no such option" in capsys.readouterr().err
