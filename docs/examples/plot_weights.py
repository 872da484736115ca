"""
One weight
==========

A patch of degree 2 has six control points. Only the weight of one of them changes from left to right: 0.3, 1, 4 and
-0.4.
"""

import mitsuba as mi
import mitsuba_bezier as mb
import numpy as np

mi.set_variant("llvm_ad_rgb")

points = np.array(
    [[-1, -1, 0], [0, -1, 0.7], [-1, 0.2, 0.7], [1, -1, 0], [0.4, 0, 1.4], [0, 1.2, 0]]
)
nets = []
for k, weight in enumerate((0.3, 1.0, 4.0, -0.4)):
    net = np.ones((6, 4))
    net[:, :3] = points + np.array([2.6 * k, 0, 0])
    net[4] *= weight  # the point and its weight: a homogeneous point
    nets.append(net)
patches = mb.BezierTriangles(np.stack(nets))

# %%
# The studio that `mb.scene` makes has light from all sides and a white ground.

scene = mb.scene(
    patches, view="-12,38", size=(640, 240), spp=64, materials={"*": "plastic:#2a6f97"}
)
image = mi.render(mi.load_dict(scene))
mi.util.write_bitmap("weights.png", image, write_async=False)
