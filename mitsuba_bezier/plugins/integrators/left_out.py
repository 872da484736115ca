"""What an integrator leaves out of a derivative: said once, or refused where nothing is left."""

from __future__ import annotations

import warnings
from typing import Any

import mitsuba as mi

from ...errors import BezierError, DerivativeWarning
from ..frozen import is_bezier
from .chains import with_derivatives

__all__ = ["checked_parameters", "warn_of_outlines"]

#: What has been said: a fit asks for the same derivative at each of its steps.
_said: set[str] = set()


def checked_parameters(integrator: str, scene: Any) -> list[tuple[str, Any, Any]]:
    """Return `with_derivatives`; refuse what Mitsuba has none by, as the place of a camera.

    Raises
    ------
    BezierError
        If such a parameter has derivatives enabled.
    """
    found = with_derivatives(scene)
    fixed = [key for key, _node, flags in found if flags & mi.ParamFlags.NonDifferentiable]
    if fixed:
        raise BezierError.expected(
            integrator,
            "parameters that an integrator has derivatives by (none has any by the place of "
            "cameras, and of lights that are no shapes; bezierpath has them by that of shapes)",
            ", ".join(fixed),
        )
    return found


def warn_of_outlines(integrator: str, found: list[tuple[str, Any, Any]], patches: bool) -> None:
    """Say once that shapes move whose outlines have no derivatives here.

    Parameters
    ----------
    integrator : str
        Its name.
    found : list
        Of `checked_parameters`.
    patches : bool
        Whether the integrator has outlines of `beziertriangle` shapes.
    """
    ours: list[str] = []
    theirs: list[str] = []
    for key, node, flags in found:
        if isinstance(node, mi.Shape) and flags & mi.ParamFlags.Discontinuous:
            (ours if is_bezier(node) else theirs).append(key)
    moving = theirs if patches else ours + theirs
    if not moving:
        return
    who = []
    if ours and not patches:
        who.append(f"bezier_prb_projective has those by {', '.join(ours)}")
    if theirs:
        who.append(f"no integrator here has those by {', '.join(theirs)}")
    what = f"derivatives by {', '.join(moving)} leave out outlines"
    text = f"{integrator}: {what}, where one thing begins to hide another; {'; '.join(who)}"
    if text not in _said:
        _said.add(text)
        warnings.warn(text, DerivativeWarning, stacklevel=2)
