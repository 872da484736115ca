"""The scenes: their models are those of the script, and each can be rendered."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from types import ModuleType
from typing import Any
from xml.etree import ElementTree

import mitsuba as mi
import numpy as np
import pytest
from backend_cases import VARIANT

import mitsuba_bezier as mb

SCENES = Path(__file__).resolve().parents[2] / "scenes"
FILES = sorted(SCENES.glob("*.xml"))
NAMES = [file.stem for file in FILES]


def script() -> ModuleType:
    """Return `make_models.py` as a module."""
    spec = importlib.util.spec_from_file_location("make_models", SCENES / "make_models.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def load(name: str) -> Any:
    """Return a scene with a film of 16 x 16 pixels and one sample a pixel."""
    mi.set_variant(VARIANT)
    return mi.load_file(str(SCENES / f"{name}.xml"), width="16", height="16", spp="1")


def shapes(scene: Any) -> dict[str, mb.BezierTriangles]:
    """Return the patches of the Bézier shapes of a scene, in world space."""
    return {s.id(): s.patches for s in scene.shapes() if hasattr(s, "patches")}


def box(patches: mb.BezierTriangles) -> np.ndarray:
    """Return lower and upper corner ``(2, 3)`` of points of the surfaces."""
    points = patches.tessellate(24)[0]
    return np.stack([points.min(axis=0), points.max(axis=0)])


def test_the_three_scenes_are_there():
    assert {"cornell", "quadrics", "sphere"} <= set(NAMES)


def test_models_are_those_of_the_script():
    models = script().models()
    assert len(models) >= 10
    for name, patches in models.items():
        saved = mb.load(SCENES / "models" / f"{name}.vtu")
        # 1e-12: points are stored divided by their weights, and libraries of other machines
        # may round sines and roots differently
        np.testing.assert_allclose(
            saved.control_points, patches.control_points, rtol=1e-12, atol=1e-12, err_msg=name
        )


def test_script_writes_what_it_makes(tmp_path, monkeypatch):
    module = script()
    monkeypatch.setattr(module, "FOLDER", tmp_path / "models")
    module.main()
    written = sorted(file.name for file in (tmp_path / "models").iterdir())
    assert written == sorted(f"{name}.vtu" for name in module.models())
    for name, patches in module.models().items():
        # exact: the format is lossless
        assert mb.load(tmp_path / "models" / f"{name}.vtu") == patches


@pytest.mark.parametrize("file", FILES, ids=NAMES)
def test_files_lie_within_the_folder(file):
    """No path is absolute or points outside, and each names a file that is there."""
    root = ElementTree.parse(file).getroot()
    names = [node.get("value") for node in root.iter("string") if node.get("name") == "filename"]
    assert names
    for name in names:
        assert not Path(name).is_absolute()
        inside = (SCENES / name).resolve()
        assert inside.is_relative_to(SCENES)
        assert inside.is_file()
    # nor is any other value a path out of here
    for node in root.iter():
        for value in node.attrib.values():
            assert not re.match(r"/|~|\.\.|[A-Za-z]:\\", value), value


@pytest.mark.parametrize("name", NAMES)
def test_renders(name):
    scene = load(name)
    if name in {"decasteljau", "farin"}:  # drawings in the plane, of Mitsuba's own curve shapes
        assert scene.shapes() and not shapes(scene)
    else:
        assert shapes(scene)
    for number in range(len(scene.sensors())):
        image = np.array(mi.render(scene, sensor=number, spp=1, seed=number))
        assert image.shape[:2] == (16, 16)
        assert np.isfinite(image).all()
        assert (image >= 0).all()
        # 16 x 16 pixels of one sample: whatever the noise, something is lit
        assert image.max() > 0.05


def test_quadrics_has_all_quadrics_and_they_stand_on_the_floor():
    patches = shapes(load("quadrics"))
    standing = {
        "cone",
        "cylinder",
        "ellipsoid",
        "elliptic_paraboloid",
        "foot_of_saddle",
        "hyperboloid_one_sheet",
        "hyperboloid_two_sheets",
        "torus",
    }
    assert standing | {"hyperbolic_paraboloid"} <= set(patches)
    for name in standing:
        # 1e-6: float32 transformations of the file; 1e-3: the lowest point of the paraboloid
        # is inside a patch, whose 24 divisions miss it by up to 0.55 / 24^2
        assert -1e-6 < box(patches[name])[0, 2] < 1e-3, name
    held = box(patches["hyperbolic_paraboloid"])
    assert held[0, 2] > 0.05
    # the rod ends below the saddle, so near that no gap is seen
    top = box(patches["rod_of_saddle"])[1]
    assert 0 < 0.72 - top[2] < 0.02


def test_quadrics_do_not_touch_each_other():
    patches = shapes(load("quadrics"))
    together = [
        {"hyperbolic_paraboloid", "rod_of_saddle", "foot_of_saddle"},
        {"hyperboloid_two_sheets", "rod_between_sheets"},
    ]
    points = {name: p.tessellate(12)[0] for name, p in patches.items()}
    for a in points:
        for b in points:
            if a >= b or any({a, b} <= group for group in together):
                continue
            gaps = np.linalg.norm(points[a][:, None] - points[b][None, ::3], axis=-1)
            # 5 cm: the scene's lengths are metres, its objects about one metre large
            assert gaps.min() > 0.05, (a, b)


def test_sphere_has_both_covers_in_glass_and_metal():
    scene = load("sphere")
    found = {
        (len(s.patches), "dielectric" in str(s.bsdf()).lower())
        for s in scene.shapes()
        if hasattr(s, "patches") and len(s.patches) in (8, 10)
    }
    assert found == {(8, True), (8, False), (10, True), (10, False)}
    for name, net in shapes(scene).items():
        if name == "sweep":
            continue
        # The table top is 0.12 high. The lowest point of a tetrahedral cover is inside a patch,
        # whose 24 divisions of 110 degrees miss it by up to 1 - cos 2.3 degrees = 8e-4.
        assert -1e-6 < box(net)[0, 2] - 0.12 < 1e-3, name


def test_cornell_leans_the_torus_on_floor_and_wall():
    patches = shapes(load("cornell"))
    lower, upper = box(patches["torus"])
    # it does not enter floor or wall, and touches them: 24 divisions of an arc of 90 degrees
    # miss its lowest point by up to 0.58 (1 - cos 2 degrees) = 4e-4
    assert 0 <= lower[2] < 1e-3 and 0 <= 1 - upper[1] < 1e-3
    assert lower[0] > -1
    lower, upper = box(patches["ball"])
    assert abs(lower[2]) < 1e-6 and upper[0] < 1
