# %% [markdown]
# # Curves and duality
#
# Bézier curves are made of linear interpolations alone. With homogeneous control points the same algorithm
# makes conics, curves through infinity, and, with lines in place of points, envelopes.

# %%
import numpy as np

import mitsuba_bezier as mb
from mitsuba_bezier import figures
from mitsuba_bezier.geometry.conic_elements import conic_by_focus
from mitsuba_bezier.geometry.projective import is_ideal
from mitsuba_bezier.geometry.tangents import three_tangent_ratios

# %% [markdown]
# ## De Casteljau

# %%
curve = mb.BezierCurve.from_points([[0, 0], [0.8, 2.3], [3.2, 2.6], [4.6, 0.2]])
drawing = figures.plane((-0.6, 5.4), (-0.3, 3.075))
drawing.de_casteljau(curve, 0.62)
drawing.curve(curve)
drawing.title("Your own figure: three calls.")
drawing

# %% [markdown]
# For a parabola the algorithm is a theorem on three tangents.

# %%
parabola = mb.BezierCurve.from_points([[0, 0], [1.7, 2.5], [4.8, 0.5]])
ratios = three_tangent_ratios(parabola, 0.0, 0.36, 1.0)
print(ratios)
assert np.allclose(ratios, 0.36 / 0.64)
figures.draw("three_tangents", s=0.36)

# %% [markdown]
# ## Weights
#
# One weight makes all conics.

# %%
figures.draw("conics_by_weight")

# %% [markdown]
# ## Kepler
#
# As the ellipse becomes a parabola, its second focus goes to infinity, where it is a point like any other.

# %%
for e in (0.9, 0.99, 1.0, 1.01):
    found = mb.conic_elements(conic_by_focus((0, 0), (-1, 0), 1.4, e))
    print(e, found.kind, found.foci[1].round(4), bool(is_ideal(found.foci[1])))
assert is_ideal(mb.conic_elements(conic_by_focus((0, 0), (-1, 0), 1.4, 1.0)).foci[1])
figures.draw("kepler")

# %% [markdown]
# ## Duality
#
# Control lines make a curve of lines; a polarity turns one kind into the other.

# %%
polarity = mb.Polarity(np.diag([1.0, 1, -1]))
reciprocal = polarity.reciprocal_curve(curve)
assert reciprocal.degree == 2 * curve.degree - 2
figures.draw("reciprocal", weight=2.0)

# %%
figures.draw("dual_curve", t=0.6)
