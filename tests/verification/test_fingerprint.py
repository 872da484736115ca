"""The fingerprint of a scene tells it from others, and from no copy of itself."""

from __future__ import annotations

import numpy as np
import pytest
from backend_cases import VARIANT

import mitsuba_bezier as mb  # before Mitsuba

# isort: split
import mitsuba as mi

from mitsuba_bezier.errors import BezierError
from mitsuba_bezier.verification.fingerprint import scene_fingerprint

SCENE = """<scene version="3.0.0">
  <default name="light" value="1"/>
  <include filename="inner.xml"/>
  <shape type="beziertriangle"><string name="filename" value="ball.vtu"/></shape>
  <emitter type="constant"><float name="radiance" value="$light"/></emitter>
</scene>
"""
INNER = '<scene version="3.0.0"><integrator type="path"/></scene>'


@pytest.fixture(autouse=True)
def variant():
    mi.set_variant(VARIANT)


def write(folder, scene=SCENE, inner=INNER, radius=1.0):
    folder.mkdir()
    (folder / "scene.xml").write_text(scene, newline="")
    (folder / "inner.xml").write_text(inner)
    mb.save(mb.sphere(radius=radius), folder / "ball.vtu")
    return folder / "scene.xml"


def test_a_copy_elsewhere_is_the_same_and_any_other_contents_are_not(tmp_path):
    first = scene_fingerprint(write(tmp_path / "a"))
    assert len(first) == 32
    assert scene_fingerprint(write(tmp_path / "b")) == first
    assert scene_fingerprint(write(tmp_path / "c", SCENE.replace("\n", "\r\n"))) == first
    others = [
        scene_fingerprint(write(tmp_path / "d", radius=2.0)),
        scene_fingerprint(write(tmp_path / "e", inner=INNER.replace("path", "direct"))),
        scene_fingerprint(write(tmp_path / "f", SCENE.replace('"1"', '"2"'))),
        scene_fingerprint(tmp_path / "a" / "scene.xml", {"light": "2"}),
    ]
    assert len({first, *others}) == 5


def description(radius=1.0, offset=0.0, extra=1):
    return {
        "type": "scene",
        "ball": {"type": "sphere", "radius": radius},
        "net": {
            "type": "beziertriangle",
            "control_points": mi.TensorXf(mb.sphere().control_points + offset),
            "to_world": mi.ScalarTransform4f().translate([0, 0, extra]),
        },
        "light": mi.load_dict({"type": "constant", "radiance": float(extra)}),
    }


def test_scenes_built_in_python():
    kinds = [lambda scene: scene, mi.load_dict]
    for kind in kinds:
        first = scene_fingerprint(kind(description()))
        assert scene_fingerprint(kind(description())) == first
        others = [
            scene_fingerprint(kind(description(radius=2.0))),
            scene_fingerprint(kind(description(offset=0.5))),
            scene_fingerprint(kind(description(extra=2))),
        ]
        assert len({first, *others}) == 4


def test_numbers_of_any_type_are_one_number():
    first = scene_fingerprint({"type": "sphere", "radius": 2})
    assert scene_fingerprint({"type": "sphere", "radius": np.float32(2)}) == first
    assert scene_fingerprint({"type": "sphere", "radius": "2"}) != first


def test_what_has_no_fingerprint():
    with pytest.raises(BezierError, match="scene: expected numbers"):
        scene_fingerprint({"type": "sphere", "radius": object()})
