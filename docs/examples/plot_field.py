"""
A field on a surface
====================

A polynomial of degree 3 on each patch of a ball, in bands, with isolines: the value is exact at every hit.
"""

import mitsuba as mi
import mitsuba_bezier as mb
import numpy as np
from mitsuba_bezier.geometry.bernstein import multi_indices
from mitsuba_bezier.geometry.fields import BezierField

mi.set_variant("llvm_ad_rgb")
ball = mb.sphere(cover="octants")

# %%
# Ordinates of the field: one number for each of the ten points of a cubic, on each of the eight patches. Here
# it is the cosine of four times the height.

uv = multi_indices(3)[:, :2] / 3
height = np.stack([ball.points(np.full(10, p), uv)[:, 2] for p in range(len(ball))])
field = BezierField("wave", np.cos(4 * height)[..., None])

mb.save(ball, "ball.vtu", fields=[field])
scene = mb.scene("ball.vtu", color_by="wave", levels=10, isolines=True, size=(640, 420), spp=64)
image = mi.render(mi.load_dict(scene))
mi.util.write_bitmap("field.png", image, write_async=False)
