"""Fit patches, poses and other parameters of a scene to images.

A *parametrization* says what is unknown of a parameter, such that every value is valid: weights
stay positive, a quadric stays one, neighbours stay joined. `minimize` searches the unknowns by
Adam or L-BFGS, coarse to fine, with a checkpoint from which a search goes on.

Needs SciPy: ``pip install mitsuba_bezier[fit]``.
"""

from __future__ import annotations

try:
    import scipy as _scipy  # noqa: F401
except ImportError as error:
    from ..errors import RuntimeSetupError

    raise RuntimeSetupError(
        f"mitsuba_bezier.fit needs SciPy ({error}); pip install mitsuba_bezier[fit]"
    ) from None

from .joins import Joins
from .maps import Collineation, Pose, Sphere
from .minimize import Fit, minimize
from .nets import Net
from .parametrization import Parametrization, Values
from .quadrics import Quadric

__all__ = [
    "Collineation",
    "Fit",
    "Joins",
    "Net",
    "Parametrization",
    "Pose",
    "Quadric",
    "Sphere",
    "Values",
    "minimize",
]
