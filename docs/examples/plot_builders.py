"""
All quadrics
============

Every quadric has a builder. Each body here is three to twelve patches of degree 2, and exact.
"""

import mitsuba as mi
import mitsuba_bezier as mb

mi.set_variant("llvm_ad_rgb")

bodies = {
    "ball": mb.sphere((-3.2, 0, 0.7), 0.7),
    "egg": mb.ellipsoid((-1.55, 0, 1), (0.5, 0.5, 1)),
    "cone": mb.cone((0, 0, 0), 0.7, 1.7, capped=True),
    "tower": mb.hyperboloid_one_sheet((1.6, 0, 0.9), (0.4, 0.4, 0.55), 1.8, capped=True),
    "bowl": mb.elliptic_paraboloid((3.2, 0, 0), 0.75, 1.1),
    "can": mb.cylinder((-2.4, -1.7, 0), 0.5, 0.7, capped=True),
    "saddle": mb.hyperbolic_paraboloid((0.2, -1.9, 0.45), 0.6, 0.4),
    "ring": mb.torus((2.3, -1.7, 0.25), 0.6, tube=0.25),
}
hues = [
    *([0.55, 0.1, 0.05], [0.05, 0.3, 0.5], [0.6, 0.4, 0.05], [0.1, 0.35, 0.15]),
    *([0.4, 0.1, 0.35], [0.05, 0.35, 0.4], [0.5, 0.25, 0.1], [0.25, 0.25, 0.3]),
]

# %%
# A saddle and a bowl are seen from both sides, so their material is two-sided.

scene = {
    "type": "scene",
    "integrator": {"type": "path", "max_depth": 6},
    "eye": {
        "type": "perspective",
        "fov": 39,
        "to_world": mi.ScalarTransform4f().look_at([0, -11, 4.6], [0, -0.6, 0.6], [0, 0, 1]),
        "film": {"type": "hdrfilm", "width": 640, "height": 360},
    },
    "sky": {"type": "constant", "radiance": 0.35},
    "lamp": {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().look_at([-5, -5, 7], [0, 0, 0], [0, 0, 1]).scale(2),
        "emitter": {"type": "area", "radiance": 8.0},
    },
    "floor": mb.shape(mb.plane()),
}
for (name, net), hue in zip(bodies.items(), hues):
    plastic = {"type": "plastic", "diffuse_reflectance": {"type": "rgb", "value": hue}}
    scene[name] = mb.shape(net, bsdf={"type": "twosided", "bsdf": plastic})
image = mi.render(mi.load_dict(scene), spp=64)
mi.util.write_bitmap("builders.png", image, write_async=False)
