# %% [markdown]
# # Perspective
#
# Central projection, ideal points, and what stays when lengths do not: the cross ratio. Each figure is one
# call; change its arguments and run the cell again.

# %%
import numpy as np

import mitsuba_bezier as mb
from mitsuba_bezier import figures
from mitsuba_bezier.geometry.camera import look_at
from mitsuba_bezier.geometry.cross_ratio import cross_ratio
from mitsuba_bezier.geometry.projective import affine, ideal, is_ideal, join, meet, point
from mitsuba_bezier.geometry.theorems import desargues

# %% [markdown]
# ## Vanishing points
#
# Parallels have one ideal point. A camera sees it as any other point: that is their vanishing point.

# %%
camera = mb.Camera(look_at([2, -6, 1.6], [0, 0, 1], [0, 0, 1]), fov=45, film_size=(640, 360))
rail = ideal([0, 1, 0])
print("vanishing point in pixels:", affine(camera.image(rail)))
far = camera.pixels([[0, 1e3, 0], [0, 1e6, 0]])
print("points far down the rail: ", far)
assert np.allclose(far[1], affine(camera.image(rail)), atol=0.01)

# %%
figures.draw("vanishing_point", pitch=-6, turn=12)

# %% [markdown]
# ## Completed planes
#
# With its ideal line a plane is complete, and projection onto another plane is one to one. The vanishing
# line goes to the ideal line.

# %%
view = mb.Perspectivity(point([0, -2.4, 2.2]), [0, 0, 1, 0], [0, 1, 0, 0])
p = np.array([0.7, -2.4, 0, 1])  # on the vanishing line
assert is_ideal(view.image(p))
assert np.allclose(np.cross(view.preimage(view.image(p))[:3], p[:3]), 0)
figures.draw("completed_planes", height=2.6)

# %% [markdown]
# ## The cross ratio

# %%
four = point([[0, 0], [1, 0], [3, 0], [4, 0]])
eye, wall = point([1, 5]), join(point([0, 2]), point([4, 3]))
images = [meet(join(eye, x), wall) for x in four]
print(float(cross_ratio(*four)), float(cross_ratio(*images)))
assert np.isclose(cross_ratio(*four), cross_ratio(*images))
figures.draw("four_points", tilt=18)

# %% [markdown]
# ## Desargues
#
# Triangles in perspective from a point are so from a line.

# %%
a = point([[-2.6, -0.2], [-0.4, 0.4], [-0.4, -0.7]])
b = a + np.array([[1.0], [0.4], [0.7]]) * point([-4.3, 1.5])
found = desargues(a, b)
print("from a point:", found.from_center, " from a line:", found.from_axis)
assert found.from_center < 1e-12 and found.from_axis < 1e-12
figures.draw("desargues", stretch=0.7)
