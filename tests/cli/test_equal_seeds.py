"""Equal seeds give equal images, whichever process loads the scene, and how often.

Mitsuba orders shapes that it merges by their addresses, which differ from load to load.
"""

from __future__ import annotations

import json

import pytest

SCENE = """
<scene version="3.0.0">
    <integrator type="bezierpath"/>
    <sensor type="perspective">
        <transform name="to_world">
            <lookat origin="0, -6, 2" target="0, 0, 0" up="0, 0, 1"/>
        </transform>
        <sampler type="independent"><integer name="sample_count" value="2"/></sampler>
        <film type="hdrfilm">
            <integer name="width" value="12"/> <integer name="height" value="8"/>
            <rfilter type="box"/>
        </film>
    </sensor>
    <emitter type="constant"><rgb name="radiance" value="0.1, 0.2, 0.3"/></emitter>
    <emitter type="point">
        <point name="position" x="3" y="-3" z="3"/><rgb name="intensity" value="3, 1, 2"/>
    </emitter>
    {shapes}
    <shape type="beziertriangle">
        <string name="filename" value="ball.vtu"/>
        <emitter type="area"><rgb name="radiance" value="0.3, 0.7, 0.2"/></emitter>
    </shape>
    <shape type="beziertriangle">
        <string name="filename" value="ball.vtu"/>
        <transform name="to_world"><translate x="-1.5" z="0.5"/></transform>
    </shape>
</scene>
"""
#: Meshes, some of which share their (default) BSDF: those that would be merged.
SHAPE = """
    <shape type="{kind}" {name}>
        <transform name="to_world">
            <scale value="0.3"/><rotate x="1" angle="{angle}"/><translate x="{x}" y="{y}" z="1"/>
        </transform>
        {light}
    </shape>
"""

#: What each process does: four loads of the file and of a dictionary with the same seeds.
RUN = """
import hashlib, json, sys
import numpy as np
from mitsuba_bezier.cli.main import main
from mitsuba_bezier.verification.images import read_image
from mitsuba_bezier.regression.shot import Shot
import mitsuba as mi

def digest(channels):
    return hashlib.sha256(b"".join(np.ascontiguousarray(x).tobytes() for x in channels)).hexdigest()

def rendered(*words):
    assert main(["render", "-q", sys.argv[1], "-o", sys.argv[2], "--seed", "5", *words]) == 0
    channels = read_image(sys.argv[2]).channels
    return digest(channels[name] for name in sorted(channels))

def dictionary():
    scene = {"type": "scene", "integrator": {"type": "bezierpath"},
        "sensor": {"type": "perspective",
            "to_world": mi.ScalarTransform4f().look_at([0, -6, 2], [0, 0, 0], [0, 0, 1]),
            "film": {"type": "hdrfilm", "width": 12, "height": 8, "rfilter": {"type": "box"}}},
        "ball": {"type": "beziertriangle", "filename": sys.argv[3]}}
    for i in range(6):
        scene[f"s{i}"] = {"type": "cube" if i % 2 else "rectangle",
            "to_world": mi.ScalarTransform4f().translate([i - 2.5, 1, 1]).rotate([1, 0, 0], 50 * i)
                .scale(0.3),
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [i, 3, 6 - i]}}}
        scene[f"t{i}"] = {"type": "cube",
            "to_world": mi.ScalarTransform4f().translate([i - 2.5, 2, 0]).scale(0.3)}
    return scene

result = {"file": [], "part": [], "fixture": [], "fixture, dict": []}
for _ in range(4):
    result["file"].append(rendered())
    result["part"].append(rendered("--part", "2/2", "--spp-per-pass", "1"))
    for key, scene in (("fixture", sys.argv[1]), ("fixture, dict", dictionary())):
        shot = Shot(scene, spp=2)
        image = shot.render(5)
        result[key].append(digest(image.channels[name] for name in sorted(image.channels)))
print(json.dumps(result))
"""


@pytest.mark.parametrize("named", [True, False], ids=["named shapes", "unnamed shapes"])
def test_twelve_loads_in_three_processes(tmp_path, python, named):
    import mitsuba_bezier as mb

    ball = str(tmp_path / "ball.vtu")
    mb.save(mb.sphere(radius=0.6, cover="tetrahedral"), ball)
    shapes = []
    for i in range(12):
        light = f'<emitter type="area"><rgb name="radiance" value="{i}, 4, {12 - i}"/></emitter>'
        shapes.append(
            SHAPE.format(
                kind=("rectangle", "cube")[i % 2],
                name=f'id="shape{i}"' if named else "",
                angle=40 * i,
                x=i % 4 - 1.5,
                y=i // 4,
                light="" if i % 3 == 0 else light,
            )
        )
    scene = tmp_path / "lights.xml"
    scene.write_text(SCENE.format(shapes="".join(shapes)), encoding="utf-8")
    images: dict[str, list[str]] = {}
    for number in range(3):
        out = str(tmp_path / f"{number}.exr")
        run = python(RUN, {"PYTHONHASHSEED": str(number)}, str(scene), out, ball)
        assert run.returncode == 0, run.stderr
        for key, digests in json.loads(run.stdout.splitlines()[-1]).items():
            images.setdefault(key, []).extend(digests)
    assert {key: len(digests) for key, digests in images.items()} == dict.fromkeys(images, 12)
    assert {key: len(set(digests)) for key, digests in images.items()} == dict.fromkeys(images, 1)
    # a part is not the whole
    assert len(set(images["file"] + images["part"])) == 2
