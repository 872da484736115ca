"""Write down what Dr.Jit generates for whole scenes in CUDA variants; little of it is run.

    python -m cuda_standin.scenes FOLDER CASE ...

with the environment of `standin.environment`, with `some`: OptiX, calls and atomics are not run.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

import mitsuba_bezier as mb  # isort: skip (first: it chooses Dr.Jit's LLVM)
import drjit as dr
import mitsuba as mi
import numpy as np

__all__ = ["CASES"]


def scene(integrator: dict[str, Any]) -> Any:
    net = mb.sphere(radius=0.5).control_points
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": integrator,
            "sensor": {
                "type": "perspective",
                "to_world": mi.ScalarTransform4f().look_at([0, -4, 0], [0, 0, 0], [0, 0, 1]),
                "film": {"type": "hdrfilm", "width": 8, "height": 8},
            },
            "sky": {"type": "constant"},
            "glass": {
                "type": "beziertriangle",
                "control_points": mi.TensorXf(net),
                "bsdf": {"type": "dielectric"},
            },
            "light": {
                "type": "beziertriangle",
                "control_points": mi.TensorXf(mb.torus(tube=0.2).control_points),
                "to_world": mi.ScalarTransform4f().translate([0, 0, 2]),
                "emitter": {"type": "area"},
            },
            "instances": {
                "type": "beziertriangle",
                "control_points": mi.TensorXf(mb.torus(tube=0.3).control_points),
                "instances": mi.TensorXf(np.eye(4)[None, :3] + [0, 0, 0, 2.0]),
            },
            "floor": {
                "type": "rectangle",
                "to_world": mi.ScalarTransform4f().translate([0, 0, -2]).scale(5),
            },
        }
    )


def path() -> None:
    dr.eval(mi.render(scene({"type": "bezierpath", "max_depth": 4}), spp=1))


def layers() -> None:
    aovs = "a:depth,b:position,c:sh_normal,d:dp_du,e:uv"
    dr.eval(mi.render(scene({"type": "bezieraov", "aovs": aovs}), spp=1))


CASES = {"path": path, "layers": layers}


def main(folder: Path, names: list[str]) -> None:
    mi.set_variant("cuda_ad_rgb")
    for name in names:
        out = folder / name
        out.mkdir(parents=True)
        os.environ["CUDA_STANDIN_OUT"] = str(out)
        CASES[name]()
        print(json.dumps({"case": name}), flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
