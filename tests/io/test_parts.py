"""Parts of CAD files: names, colours, places; each net once, in its own coordinates."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from mitsuba_bezier.cli import main
from mitsuba_bezier.cli.info import examine
from mitsuba_bezier.errors import BezierError
from mitsuba_bezier.io import Part, read
from mitsuba_bezier.io.packing import packed_model, unpacked_model
from mitsuba_bezier.models.selection import Selection, selected

RED, BLUE, GREEN = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)


def moved(x: float, y: float, z: float, turn: float = 0.0):
    """Return a location of OpenCASCADE."""
    from OCP.gp import gp_Ax1, gp_Dir, gp_Pnt, gp_Trsf, gp_Vec
    from OCP.TopLoc import TopLoc_Location

    shift, turned = gp_Trsf(), gp_Trsf()
    shift.SetTranslation(gp_Vec(x, y, z))
    turned.SetRotation(gp_Ax1(gp_Pnt(0, 0, 0), gp_Dir(0, 0, 1)), turn)
    return TopLoc_Location(shift.Multiplied(turned))


def write_assembly(path: Path) -> None:
    """Write a table of four legs of two colours: a plate, and an assembly that stands twice."""
    from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox, BRepPrimAPI_MakeCylinder
    from OCP.Quantity import Quantity_Color, Quantity_TypeOfColor
    from OCP.STEPCAFControl import STEPCAFControl_Writer
    from OCP.STEPControl import STEPControl_StepModelType
    from OCP.TCollection import TCollection_ExtendedString as Text
    from OCP.TDataStd import TDataStd_Name
    from OCP.TDocStd import TDocStd_Document
    from OCP.TopAbs import TopAbs_ShapeEnum
    from OCP.TopExp import TopExp_Explorer
    from OCP.XCAFApp import XCAFApp_Application
    from OCP.XCAFDoc import XCAFDoc_ColorType, XCAFDoc_DocumentTool

    document = TDocStd_Document(Text("MDTV-XCAF"))
    XCAFApp_Application.GetApplication_s().NewDocument(Text("MDTV-XCAF"), document)
    shapes = XCAFDoc_DocumentTool.ShapeTool_s(document.Main())
    colours = XCAFDoc_DocumentTool.ColorTool_s(document.Main())

    def colour(value):
        return Quantity_Color(*value, Quantity_TypeOfColor.Quantity_TOC_RGB)

    def named(label, name):
        TDataStd_Name.Set_s(label, Text(name))
        return label

    surface = XCAFDoc_ColorType.XCAFDoc_ColorSurf
    leg = named(shapes.AddShape(BRepPrimAPI_MakeCylinder(1, 10).Shape(), False), "leg")
    colours.SetColor(leg, colour(RED), surface)
    box = BRepPrimAPI_MakeBox(20, 10, 1).Shape()
    plate = named(shapes.AddShape(box, False), "plate")
    colours.SetColor(plate, colour(BLUE), surface)
    faces = TopExp_Explorer(box, TopAbs_ShapeEnum.TopAbs_FACE)
    colours.SetColor(shapes.AddSubShape(plate, faces.Current()), colour(GREEN), surface)
    pair = named(shapes.NewShape(), "pair")
    named(shapes.AddComponent(pair, leg, moved(0, 0, 0)), "near")
    named(shapes.AddComponent(pair, leg, moved(0, 8, 0)), "far")
    table = named(shapes.NewShape(), "table")
    named(shapes.AddComponent(table, plate, moved(0, 0, 10)), "plate_1")
    named(shapes.AddComponent(table, pair, moved(1, 1, 0)), "left")
    named(shapes.AddComponent(table, pair, moved(19, 9, 0, np.pi)), "right")
    shapes.UpdateAssemblies()
    writer = STEPCAFControl_Writer()
    writer.SetColorMode(True)
    writer.SetNameMode(True)
    writer.Transfer(document, STEPControl_StepModelType.STEPControl_AsIs)
    writer.Write(str(path))


@pytest.fixture(scope="module")
def table(tmp_path_factory) -> Path:
    pytest.importorskip("OCP")
    path = tmp_path_factory.mktemp("parts") / "table.step"
    write_assembly(path)
    return path


@pytest.fixture(scope="module")
def model(table):
    return read(table, trims=True)


def test_an_instance_is_stored_once(model):
    parts = {part.name: part for part in model.parts}
    assert sorted(parts) == ["leg", "plate"] and model.unit == "mm"
    leg, plate = parts["leg"], parts["plate"]
    assert len(leg.placements) == 4 and len(plate.placements) == 1
    assert sorted(leg.places) == [
        "table/left/far",
        "table/left/near",
        "table/right/far",
        "table/right/near",
    ]
    # a cylinder around the origin, as it was made; placed, its axes stand at the corners
    own = np.concatenate([g.bounds().reshape(-1, 3) for g in leg.groups])
    assert np.allclose([own.min(axis=0), own.max(axis=0)], [[-1, -1, 0], [1, 1, 10]], atol=2e-2)
    assert sorted(np.round(leg.placements[:, :2, 3], 9).tolist()) == [
        [1, 1],
        [1, 9],
        [19, 1],
        [19, 9],
    ]
    assert model.report.faces == model.report.converted == 4 * 3 + 6
    # flattened: the same area, at all places
    flat = sum(group.area().sum() for group in model.groups)
    assert flat == pytest.approx(4 * (20 * np.pi + 2 * np.pi) + 2 * (200 + 20 + 10), rel=1e-6)
    assert len({s for source in model.sources for s in source.tolist()}) == 18


def test_colours_of_parts_and_of_faces(model):
    parts = {part.name: part for part in model.parts}
    assert parts["leg"].colour == pytest.approx(RED, abs=1e-6) and not parts["leg"].paints
    plate = parts["plate"]
    assert plate.colour == pytest.approx(BLUE, abs=1e-6)
    assert np.allclose(plate.paints, [GREEN], atol=1e-6)
    painted = sum(
        group.area()[plate.paint_of(k) == 0].sum() for k, group in enumerate(plate.groups)
    )
    assert painted == pytest.approx(10)  # the first face of a box: at x = 0, 10 x 1


def test_parts_go_through_a_process_as_they_are(model):
    facts, arrays = packed_model(model)
    again = unpacked_model(json.loads(json.dumps(facts)), arrays)
    for a, b in zip(model.parts, again.parts, strict=True):
        assert (a.name, a.places, a.colour, a.paints, a.faces) == (
            b.name,
            b.places,
            b.colour,
            b.paints,
            b.faces,
        )
        assert np.array_equal(a.placements, b.placements)
        for g, h in zip(a.groups, b.groups, strict=True):
            assert np.array_equal(g.control_points, h.control_points)


def test_parts_are_chosen_by_name_place_and_pattern(model):
    parts = model.parts

    def places(**names) -> list[str]:
        return sorted(p for part in selected(parts, Selection(**names)) for p in part.places)

    assert len(places()) == 5
    assert places(only=("plate",)) == ["table/plate_1"]
    assert len(places(only=("LEG",))) == 4
    assert places(only=("left",)) == ["table/left/far", "table/left/near"]
    assert places(hide=("le*",)) == ["table/plate_1"]
    assert places(only=("leg",), hide=("right", "left/near")) == ["table/left/far"]
    with pytest.raises(BezierError, match=r"'legg' \(did you mean 'leg'"):
        selected(parts, Selection(only=("legg",)))
    with pytest.raises(BezierError, match="at least one part"):
        selected(parts, Selection(hide=("table",)))


def test_info_lists_them(table, model, capsys):
    assert main.main(["info", str(table)]) == 0
    out = capsys.readouterr().out
    assert "unit        mm" in out
    assert "leg, 4 places, #ff0000" in out and "plate, #0000ff" in out
    found = examine(model)
    assert [p["name"] for p in found["parts"]] == [p.name for p in model.parts]
    assert {p["name"]: len(p["places"]) for p in found["parts"]} == {"leg": 4, "plate": 1}


def test_layers_blocks_and_visibility_of_rhino_files(tmp_path):
    rhino = pytest.importorskip("rhino3dm")
    file = rhino.File3dm()
    file.Settings.ModelUnitSystem = rhino.UnitSystem.Centimeters
    for name, colour, shown in (
        ("Outer", (200, 0, 0, 255), True),
        ("Gone", (0, 200, 0, 255), False),
    ):
        layer = rhino.Layer()
        layer.Name, layer.Color, layer.Visible = name, colour, shown
        file.Layers.Add(layer)

    def ball(x: float):
        return rhino.Sphere(rhino.Point3d(x, 0, 0), 1.0).ToBrep()

    for x, layer, name in ((0, 0, ""), (5, 1, "ghost"), (9, 0, "solo")):
        attributes = rhino.ObjectAttributes()
        attributes.LayerIndex, attributes.Name = layer, name
        file.Objects.AddBrep(ball(x), attributes)
    path = tmp_path / "layers.3dm"
    assert file.Write(str(path), 7)
    model = read(path)
    assert model.unit == "cm"
    parts = {part.name: part for part in model.parts}
    assert set(parts) == {"Outer", "ghost", "solo"}
    assert parts["Outer"].visible and not parts["ghost"].visible
    # 200 / 255 in linear light, IEC 61966-2-1
    assert parts["Outer"].colour == pytest.approx((0.5775805, 0, 0), abs=1e-6)
    assert parts["ghost"].layer == "Gone"
    assert [p.name for p in selected(model.parts, Selection())] == ["Outer", "solo"]
    assert [p.name for p in selected(model.parts, Selection(only=("Gone",)))] == ["ghost"]


def test_a_file_without_parts_is_one(tmp_path):
    import mitsuba_bezier as mb

    mb.save(mb.sphere(), tmp_path / "ball.vtu")
    model = read(tmp_path / "ball.vtu")
    (part,) = model.parts
    assert isinstance(part, Part) and part.name == "ball" and part.colour is None
    assert part.groups is model.groups and model.unit == ""
