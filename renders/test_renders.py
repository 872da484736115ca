"""Hold the scenes against stored references: ``pytest renders``.

Small images, so that a minute or two are enough; ``--bezier-generate-refs`` makes the references
anew where a picture has changed on purpose. The package must be installed, for its plugin of
pytest brings the fixture.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mitsuba as mi
import pytest

import mitsuba_bezier as mb

SCENES = Path(__file__).resolve().parents[1] / "scenes"
NAMES = sorted(file.stem for file in SCENES.glob("*.xml"))

#: Share of pixels that must pass the Z-test, where it is not Mitsuba's 0.9975: the light that glass
#: and metal gather comes in rare bright samples, which are far from normal.
SHARES = {"caustic": 0.98, "cornell": 0.98, "media": 0.99, "quadrics": 0.99, "sphere": 0.99}


@pytest.mark.parametrize("name", NAMES)
def test_scene_is_as_it_was(render_regression: Any, name: str) -> None:
    mb.register()
    mi.set_variant("llvm_ad_rgb")
    # meshes in the order of the file: with another the same seeds give another image
    path = str(SCENES / f"{name}.xml")
    scene = mi.load_file(path, optimize=False, width="48", height="32")
    render_regression(scene, name, spp=64, z_share=SHARES.get(name, 0.9975))
