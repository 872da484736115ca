"""
A patch and its net
===================

Control points, the legs between them, and lines of constant parameters, all as shapes of the scene: they cast
shadows and are seen in mirrors.
"""

import mitsuba as mi
import mitsuba_bezier as mb
import numpy as np

mi.set_variant("llvm_ad_rgb")

# a cubic: ten points over a triangle, lifted
rows = [(i, j, 3 - i - j) for i in range(3, -1, -1) for j in range(3 - i, -1, -1)]
corners = np.array([[-1.5, -1, 0], [1.5, -1, 0], [0, 1.5, 0]])
net = np.ones((10, 4))
net[:, :3] = np.array(rows) / 3 @ corners
net[:, 2] = [0, 0.8, 0.6, 0.7, 1.1, 0.5, 0, 0.8, 0.8, 0]
patch = mb.BezierTriangles(net)

# %%
# `net_shapes` and `isoparametric_lines` return shapes for the dictionary of a scene.

dark = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.02, 0.02, 0.03]}}
red = {"type": "plastic", "diffuse_reflectance": {"type": "rgb", "value": [0.6, 0.05, 0.03]}}
blue = {"type": "plastic", "diffuse_reflectance": {"type": "rgb", "value": [0.1, 0.3, 0.5]}}
scene = mb.scene(
    patch,
    view="25,35",
    size=(640, 420),
    spp=64,
    appearance=lambda part, group, patches: {"bsdf": {"type": "twosided", "bsdf": blue}},
)
scene["camera"] = {**scene["camera"], "fov": 29}  # the net is larger than the patch
scene |= mb.net_shapes(patch, radius=0.015, bsdf=dark, point_bsdf=red)
scene |= mb.isoparametric_lines(patch, radius=0.008, lines=5, bsdf=dark)
image = mi.render(mi.load_dict(scene))
mi.util.write_bitmap("net.png", image, write_async=False)
