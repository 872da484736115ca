"""Misspelt parameters are named, with the one that was meant."""

from __future__ import annotations

from pathlib import Path

import mitsuba as mi
import pytest
from backend_cases import VARIANT
from mitsuba_cases import bezier, sphere_net

import mitsuba_bezier as mb
from mitsuba_bezier.cli import main
from mitsuba_bezier.io import save
from mitsuba_bezier.plugins.spelling import PARAMETERS

if mi.variant() is None:
    mi.set_variant(VARIANT)

NEEDED = {"bezieraov": {"aovs": "d:depth"}, "beziertriangle": bezier()}

#: All parameters of all plugins, those of README and of the plugins' own pages.
ALL = [
    (plugin, name)
    for plugin, names in PARAMETERS.items()
    for name in names
    if name != "face_normals"  # any other name that begins so is an attribute
]


def misspelt(name: str) -> list[str]:
    """Return the usual slips: a letter less, twice, or exchanged; another case; a dash."""
    middle = len(name) // 2
    return [
        name[:-1] if len(name) > 4 else name + "s",
        name[:middle] + name[middle + 1 :],
        name[:middle] + name[middle] + name[middle:],
        name[: middle - 1] + name[middle] + name[middle - 1] + name[middle + 1 :],
        name.title(),
        name.replace("_", "-") if "_" in name else name + "_",
    ]


@pytest.mark.parametrize(("plugin", "name"), ALL)
def test_beside_what_is_needed(plugin, name):
    for slip in set(misspelt(name)) - {name}:
        value = {"type": "homogeneous"} if name in ("interior", "exterior") else 1.0
        with pytest.raises(RuntimeError) as error:
            mi.load_dict({"type": plugin, **NEEDED.get(plugin, {}), slip: value})
        line = str(error.value).strip().splitlines()[-1]
        meant = "spp" if name.startswith("spp") else f"{name}'?"  # sppc, sppp and sppi are alike
        assert f"{plugin}: unknown parameter '{slip}'; did you mean '{meant}" in line


@pytest.mark.parametrize(
    ("properties", "slip", "name"),
    [
        ({"type": "beziertriangle", "control_point": sphere_net()}, "control_point", None),
        ({"type": "beziertriangle", "filname": "ball.vtu"}, "filname", "filename"),
        ({"type": "bezieraov", "aov": "d:depth"}, "aov", "aovs"),
    ],
)
def test_in_place_of_what_is_needed(properties, slip, name):
    with pytest.raises(RuntimeError) as error:
        mi.load_dict(properties)
    line = str(error.value).strip().splitlines()[-1]
    name = name or "control_points"
    assert f"unknown parameter '{slip}'; did you mean '{name}'?" in line


def test_nothing_of_the_parser_stands_before():
    with pytest.raises(RuntimeError) as error:
        mi.load_dict(bezier(flip_normal=True))
    assert str(error.value) == (
        'At dictionary node "root": BezierError: beziertriangle: unknown parameter '
        "'flip_normal'; did you mean 'flip_normals'?"
    )
    with pytest.raises(RuntimeError) as error:
        mi.load_dict({"type": "scene", "a": bezier(control_points=3)})
    assert str(error.value).startswith('At dictionary node "a": NetError: control_points: expected')
    # what is not ours stays as it was
    with pytest.raises(RuntimeError, match='property in shape plugin of type "sphere"'):
        mi.load_dict({"type": "sphere", "radus": 3})


def test_without_any_likeness_all_are_listed():
    with pytest.raises(RuntimeError, match="unknown parameter 'wibble'; its parameters are cont"):
        mi.load_dict(bezier(wibble=1.0))


@pytest.mark.parametrize(
    ("slip", "name"), [("facecolor", "face_color"), ("Vertex-color", "vertex_color")]
)
def test_attributes(slip, name):
    for value in (mi.TensorXf([1.0] * 8), {"type": "checkerboard"}):
        with pytest.raises(RuntimeError, match=f"parameter '{slip}'; did you mean '{name}'"):
            mi.load_dict(bezier(**{slip: value}))


def test_nested_objects_may_have_any_name():
    shape = mi.load_dict(
        bezier(
            skin={"type": "diffuse"},
            lamp={"type": "area"},
            interior={"type": "homogeneous"},
            face_tone={"type": "checkerboard"},
        )
    )
    assert shape.emitter() is not None and shape.interior_medium() is not None


def test_in_a_scene_file(tmp_path, capsys):
    mb.save(mb.sphere(), tmp_path / "ball.vtu")
    path = Path(tmp_path / "s.xml")
    path.write_text(
        '<scene version="3.0.0"><shape type="beziertriangle">'
        '<string name="filname" value="ball.vtu"/></shape></scene>'
    )
    assert main.main(["render", str(path)]) == 2
    error = capsys.readouterr().err
    assert error.strip().endswith(
        "beziertriangle: unknown parameter 'filname'; did you mean 'filename'?"
    )
    assert "plugin of type" not in error and error.count("\n") == 1


def test_keywords_of_python():
    with pytest.raises(TypeError, match="'control_point'"):
        mb.BezierTriangles(control_point=[])  # type: ignore[call-arg]
    with pytest.raises(
        mb.FileFormatError,
        match=r"encodin: .*\(encoding or trims or attributes or fields or edges\)",
    ):
        save(mb.sphere(), "ball.vtu", encodin="ascii")


@pytest.mark.parametrize(
    ("old", "new"), [("copies", "instances"), ("copies_filename", "instances_filename")]
)
def test_what_was_called_otherwise_once(old, new):
    value = "maps.npy" if "filename" in old else mi.TensorXf([1.0] * 12, (1, 3, 4))
    with pytest.raises(RuntimeError, match=f"unknown parameter '{old}'; did you mean '{new}'"):
        mi.load_dict(bezier(**{old: value}))
