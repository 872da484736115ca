"""
Fog in glass
============

A medium fills a ball of glass, and another a torus without any surface of its own: their boundaries are exact.
"""

import mitsuba as mi
import mitsuba_bezier as mb

mi.set_variant("llvm_ad_rgb")


def fog(colour, density):
    albedo = {"type": "rgb", "value": colour}
    return {"type": "homogeneous", "sigma_t": density, "albedo": albedo}


scene = {
    "type": "scene",
    "integrator": {"type": "volpath", "max_depth": 24},
    "eye": {
        "type": "perspective",
        "fov": 32,
        "to_world": mi.ScalarTransform4f().look_at([0, -8, 3.4], [0, 0, 0.75], [0, 0, 1]),
        "film": {"type": "hdrfilm", "width": 560, "height": 350},
    },
    "sky": {"type": "constant", "radiance": 0.9},
    "floor": mb.shape(mb.plane()),
    # the medium lies on the side from which normals point away
    "ball": mb.shape(
        mb.sphere((0, 0, 1)),
        bsdf={"type": "dielectric"},
        interior=fog([0.98, 0.75, 0.4], 1.5),
    ),
    "ring": mb.shape(
        mb.torus((0, 0, 0.35), 1.75, tube=0.33),
        bsdf={"type": "null"},
        interior=fog([0.5, 0.8, 0.98], 6.0),
    ),
}
mi.util.write_bitmap("fog.png", mi.render(mi.load_dict(scene), spp=96), write_async=False)
