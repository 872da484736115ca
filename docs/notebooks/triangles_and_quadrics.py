# %% [markdown]
# # Triangles and quadrics
#
# Bézier triangles, and which quadratic ones lie on a quadric: those whose boundary conics, extended, meet in
# one point S with tangents in one plane.

# %%
import numpy as np

import mitsuba_bezier as mb
from mitsuba_bezier import figures
from mitsuba_bezier.geometry.four_sided import boundary_curve, four_sided_net
from mitsuba_bezier.geometry.projective import point
from mitsuba_bezier.geometry.tensor import evaluate_tensor

# %%
figures.draw("triangle_net")

# %% [markdown]
# De Casteljau's algorithm divides every small triangle of the net alike.

# %%
rng = np.random.default_rng(1)
patch = mb.BezierTriangles(rng.normal(size=(10, 4)) + 4 * np.eye(4)[3])
scheme = patch.de_casteljau(0, (0.3, 0.3))
assert np.allclose(scheme[-1][0], patch.evaluate(0, [[0.3, 0.3]])[0])
figures.draw("triangle_decasteljau", u=0.2, v=0.5)

# %% [markdown]
# ## The point S

# %%
sphere = np.diag([1.0, 1, 1, -1])
corners = point(np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3))
net = mb.quadric_patch(sphere, corners[3], corners[:3])
found = mb.characterize(net)
print(
    found.name, "S =", (found.center / found.center[3]).round(6)[:3], "coplanar:", found.coplanarity
)
assert found.meeting < 1e-9 and found.coplanarity < 1e-9
figures.draw("sphere_point")

# %% [markdown]
# Move one control point, and no quadric holds the patch.

# %%
moved = net.copy()
moved[4] += [0.01, 0, 0, 0]
assert mb.fit_quadric(moved) is None
figures.draw("stereographic")

# %% [markdown]
# ## Patchwork
#
# Between two triangles there is a gap; a four-sided patch, two sides of which are points, fills it exactly.

# %%
other = mb.quadric_patch(sphere, corners[2], corners[[1, 0, 3]])
gap = four_sided_net(sphere, boundary_curve(net, 0), boundary_curve(other, 0).reverse())
x = evaluate_tensor(gap, rng.uniform(0, 1, (50, 2)))
print("off the sphere:", np.abs(np.einsum("ni,ij,nj->n", x, sphere, x)).max())
assert np.allclose(np.einsum("ni,ij,nj->n", x, sphere, x), 0, atol=1e-12)
figures.draw("patchwork")

# %%
figures.draw("figure2", apart=0.8)
