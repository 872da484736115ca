"""Sections: what is kept, where a cap is, and how large it is."""

from __future__ import annotations

from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

import mitsuba_bezier as mb
from mitsuba_bezier.errors import BezierError
from mitsuba_bezier.io import Part, read
from mitsuba_bezier.models import section
from mitsuba_bezier.models.description import to_dictionary
from mitsuba_bezier.models.scene import Look, describe, models_of

BACK = np.array([0.0, 0.0, 1.0])


@pytest.fixture(autouse=True)
def variant():
    mi.set_variant("llvm_ad_rgb")


def shapes(model, **look):
    """Return a scene of the shapes only, and the plane."""
    notes: list[str] = []
    node = describe(models_of(model), Look(ground=False, **look), None, notes)
    node = {k: v for k, v in node.items() if k == "type" or k.startswith("part-")}
    planes = {v["section"] for k, v in node.items() if k != "type"}
    (text,) = planes
    return mi.load_dict(to_dictionary(mi, node)), np.array(text.split(), dtype=float), notes


def area_of_caps(scene, plane: np.ndarray, low, high, count: int) -> float:
    """Return the area of what rays against the plane's normal meet in the plane."""
    n = plane[:3]
    x = np.cross(np.eye(3)[np.argmin(np.abs(n))], n)
    x /= np.linalg.norm(x)
    axes = np.stack([x, np.cross(n, x)])
    corners = np.stack(np.meshgrid(*np.stack([low, high]).T), axis=-1).reshape(-1, 3) @ axes.T
    start, size = corners.min(axis=0), np.ptp(corners, axis=0)
    # a sequence of low discrepancy (Roberts 2018): edges of any direction cut it evenly
    steps = (np.arange(count * count)[:, None] * [0.7548776662466927, 0.5698402909980532]) % 1.0
    points = (start + steps * size) @ axes + (plane[3] + 1.0) * n
    ray = mi.Ray3f(mi.Point3f(*points.T), mi.Vector3f(*(-n).tolist()))
    t = np.array(scene.ray_intersect_preliminary(ray).t, dtype=np.float64)
    # float32 at coordinates near 50
    return float((np.abs(t - 1.0) < 1e-4).mean() * size.prod())


def test_a_ball_is_cut_where_it_says():
    scene, plane, notes = shapes(mb.sphere((1, 2, 3), 2), section="z<4")
    assert np.allclose(plane, [0, 0, 1, 4]) and not notes
    found = area_of_caps(scene, plane, [-1, 0, 1], [3, 4, 5], 1500)
    # a circle on a lattice of 2e6 points: 1e-5
    assert found == pytest.approx(np.pi * (4 - 1), rel=1e-4)
    down = mi.Ray3f(mi.Point3f(1, 2, 9), mi.Vector3f(0, 0, -1))
    si = scene.ray_intersect(down)
    assert np.allclose(si.p, [[1], [2], [4]], atol=1e-5) and np.allclose(si.n, [[0], [0], [1]])
    # from inside: up against the cap, down against the ball; above nothing is left
    inside = mi.Point3f(1.2, 2.1, 3)
    assert np.allclose(scene.ray_intersect(mi.Ray3f(inside, mi.Vector3f(0, 0, 1))).t, 1, atol=1e-5)
    t = scene.ray_intersect(mi.Ray3f(inside, mi.Vector3f(0, 0, -1))).t
    assert np.allclose(t, np.sqrt(4 - 0.05), atol=1e-5)
    assert not scene.ray_test(mi.Ray3f(mi.Point3f(1, 2, 4.01), mi.Vector3f(0.3, 0, 1)))[0]
    assert scene.ray_test(mi.Ray3f(mi.Point3f(1, 2, 4.01), mi.Vector3f(0.3, 0, -1)))[0]
    # beside the cap, in the plane that is cut away
    assert not scene.ray_test(mi.Ray3f(mi.Point3f(-5, 2, 4.5), mi.Vector3f(1, 0, 0)))[0]


def test_a_body_of_two_shells_has_a_hole_in_its_cap():
    outer, inner = mb.sphere((0, 0, 0), 2), mb.sphere((0, 0, 0), 1)
    turned = inner.control_points[:, [0, 2, 1, 5, 4, 3, 9, 8, 7, 6, 14, 13, 12, 11, 10]]
    assert outer.degree == 4
    net = mb.BezierTriangles(np.concatenate([outer.control_points, turned]))
    scene, plane, _notes = shapes(net, section="z=0", view="top")
    assert area_of_caps(scene, plane, [-2] * 3, [2] * 3, 1500) == pytest.approx(3 * np.pi, rel=1e-4)


def test_bodies_that_touch_have_caps_of_their_own():
    inner = mb.cylinder((0, 0, -1), 0.5, 2, capped=True)
    outer = mb.cylinder((1, 0, -1), 0.5, 2, capped=True)
    scene, plane, _notes = shapes([inner, outer, mb.sphere((0, 3, 0))], section="z=0")
    found = area_of_caps(scene, plane, [-1, -1, -1], [2, 4, 1], 1500)
    assert found == pytest.approx(np.pi * (0.25 + 0.25 + 1), rel=1e-4)


def test_what_is_not_closed_gets_no_cap():
    scene, plane, notes = shapes(mb.cylinder((0, 0, -1), 0.5, 2), section="z=0")
    assert notes == ["no cap, for these are no closed bodies: net"]
    assert area_of_caps(scene, plane, [-1] * 3, [1] * 3, 200) == 0
    scene, plane, notes = shapes(mb.sphere(), section="z=0", cap="none")
    assert not notes and area_of_caps(scene, plane, [-1] * 3, [1] * 3, 200) == 0


def test_normals_tell_what_is_closed():
    def part(net):
        return Part("p", [net], [np.arange(len(net))], [None])

    n = mb.sphere()
    assert section.closed(part(n)) == 1
    k = n.control_points[:, [0, 2, 1, 5, 4, 3, 9, 8, 7, 6, 14, 13, 12, 11, 10]]
    assert section.closed(part(mb.BezierTriangles(k))) == -1
    assert section.closed(part(n[:4])) == 0


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("z=10", ((0, 0, 1), 10, False, 0)),
        ("-y > 3", ((0, -1, 0), 3, False, 1)),
        ("X<=25%", ((1, 0, 0), 25, True, -1)),
        ("3,0,4=10", ((0.6, 0, 0.8), 2, False, 0)),
    ],
)
def test_planes_as_they_are_written(text, expected):
    plane = section.read_section(text)
    assert np.allclose(plane.normal, expected[0])
    assert (plane.at, plane.percent, plane.keep) == (pytest.approx(expected[1]), *expected[2:])


@pytest.mark.parametrize(
    "text", ["", "z", "z=", "z=a", "q=1", "0,0,0=1", "1,2=3", "z=nan", "z=1e999"]
)
def test_a_plane_that_is_none(text):
    with pytest.raises(BezierError, match="a plane such as z=10"):
        Look(section=text)


def test_a_plane_that_misses():
    with pytest.raises(BezierError, match="reaches from -1 to 1 there, got 7"):
        describe(models_of(mb.sphere()), Look(section="z=7"))
    with pytest.raises(BezierError, match="a plane that meets the model"):
        describe(models_of(mb.sphere()), Look(section="z=100%"))


def test_the_camera_looks_at_the_cut():
    points = np.array([[-1.0, -1, -1], [1, 1, 1]])
    for text, back in (("z=0", [0, 0, 1]), ("z=0", [0, 0, -1]), ("-z=0", [0, 0, 1])):
        plane = section.resolved(section.read_section(text), points, np.array(back, dtype=float))
        assert plane[:3] @ back == 1


def filleted(path: Path):
    """Write a block with a bore and all edges rounded; return its shape."""
    from OCP.BRepAlgoAPI import BRepAlgoAPI_Cut
    from OCP.BRepFilletAPI import BRepFilletAPI_MakeFillet
    from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox, BRepPrimAPI_MakeCylinder
    from OCP.gp import gp_Ax2, gp_Dir, gp_Pnt
    from OCP.STEPControl import STEPControl_StepModelType, STEPControl_Writer
    from OCP.TopAbs import TopAbs_ShapeEnum
    from OCP.TopExp import TopExp_Explorer
    from OCP.TopoDS import TopoDS

    edge = getattr(TopoDS, "Edge_s", None) or TopoDS.Edge
    box = BRepPrimAPI_MakeBox(40, 30, 20).Shape()
    rounding = BRepFilletAPI_MakeFillet(box)
    explorer = TopExp_Explorer(box, TopAbs_ShapeEnum.TopAbs_EDGE)
    while explorer.More():
        rounding.Add(4.0, edge(explorer.Current()))
        explorer.Next()
    axis = gp_Ax2(gp_Pnt(20, 15, -1), gp_Dir(0, 0, 1))
    bore = BRepPrimAPI_MakeCylinder(axis, 6, 30).Shape()
    shape = BRepAlgoAPI_Cut(rounding.Shape(), bore).Shape()
    writer = STEPControl_Writer()
    writer.Transfer(shape, STEPControl_StepModelType.STEPControl_AsIs)
    writer.Write(str(path))
    return shape


def area_by_opencascade(shape, plane: np.ndarray) -> float:
    from OCP.BRepAlgoAPI import BRepAlgoAPI_Common
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeFace
    from OCP.BRepGProp import BRepGProp
    from OCP.gp import gp_Dir, gp_Pln, gp_Pnt
    from OCP.GProp import GProp_GProps

    at = gp_Pnt(*(plane[3] * plane[:3]).tolist())
    face = BRepBuilderAPI_MakeFace(
        gp_Pln(at, gp_Dir(*plane[:3].tolist())), -200, 200, -200, 200
    ).Face()
    properties = GProp_GProps()
    BRepGProp.SurfaceProperties_s(BRepAlgoAPI_Common(shape, face).Shape(), properties)
    return float(properties.Mass())


def test_a_filleted_body_as_opencascade_cuts_it(tmp_path):
    pytest.importorskip("OCP")
    shape = filleted(tmp_path / "block.step")
    model = read(tmp_path / "block.step", trims=True)
    for text in ("z=18.3", "y<11", "1,0.4,0.7=30", "-0.3,1,0.2=9"):
        scene, plane, notes = shapes(model, section=text)
        assert not notes
        expected = area_by_opencascade(shape, plane)
        found = area_of_caps(scene, plane, [0, 0, 0], [40, 30, 20], 1400)
        print(text, expected, found, found / expected - 1)
        assert found == pytest.approx(expected, rel=1e-4), text
