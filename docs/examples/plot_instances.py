"""
Six hundred rings
=================

One torus of 32 patches, stored once, stands at six hundred places.
"""

import mitsuba as mi
import mitsuba_bezier as mb
import numpy as np

mi.set_variant("llvm_ad_rgb")
rng = np.random.default_rng(4)

# %%
# A rotation for each, from the QR decomposition of random matrices; a size, and a place on a spiral.

count = 600
turns, _ = np.linalg.qr(rng.normal(size=(count, 3, 3)))
angle = np.linspace(0, 26, count)
radius = 0.4 + angle / 9
maps = np.zeros((count, 3, 4))
maps[:, :, :3] = 0.17 * turns
maps[:, 0, 3], maps[:, 1, 3] = radius * np.cos(angle), radius * np.sin(angle)
maps[:, 2, 3] = 0.3 + rng.uniform(0, 0.5, count)

scene = {
    "type": "scene",
    "integrator": {"type": "path", "max_depth": 5},
    "eye": {
        "type": "perspective",
        "fov": 34,
        "to_world": mi.ScalarTransform4f().look_at([0, -9, 6], [0, -0.3, 0], [0, 0, 1]),
        "film": {"type": "hdrfilm", "width": 640, "height": 400},
    },
    "sky": {"type": "constant", "radiance": {"type": "rgb", "value": [0.6, 0.7, 0.85]}},
    "lamp": {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().look_at([5, -2, 7], [0, 0, 0], [0, 0, 1]).scale(2),
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [9, 8, 6]}},
    },
    "floor": mb.shape(mb.plane()),
    "rings": mb.shape(
        mb.torus(),
        instances=mi.TensorXf(maps),
        bsdf={"type": "roughconductor", "material": "Cu", "alpha": 0.15},
    ),
}
mi.util.write_bitmap("rings.png", mi.render(mi.load_dict(scene), spp=64), write_async=False)
