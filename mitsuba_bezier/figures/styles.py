"""How things are drawn: one look for each role, told apart without colour.

Roles differ in width, dash and marker, so that all is read in black and white; on the screen some
have a dark colour besides.
"""

from __future__ import annotations

from typing import Any

from ..errors import GeometryError, RuntimeSetupError

__all__ = ["ROLES", "STYLES", "font", "matplotlib", "role"]

#: Width in points of 1/72 inch (the drawing is 8 inches wide), dash pattern, grey, and order.
ROLES: dict[str, dict[str, Any]] = {
    "curve": {"linewidth": 2.4, "color": "0.0", "zorder": 5},
    "second": {"linewidth": 2.4, "color": "0.0", "linestyle": (0, (5, 1.6)), "zorder": 5},
    "third": {"linewidth": 2.4, "color": "0.0", "linestyle": (0, (1.2, 1.2)), "zorder": 5},
    "polygon": {"linewidth": 1.3, "color": "0.35", "zorder": 4},
    "construction": {"linewidth": 1.1, "color": "0.25", "linestyle": (0, (4, 2)), "zorder": 4},
    "line": {"linewidth": 1.1, "color": "0.2", "zorder": 3},
    "thin": {"linewidth": 0.7, "color": "0.45", "zorder": 2},
    "hidden": {"linewidth": 1.1, "color": "0.5", "linestyle": (0, (2, 2)), "zorder": 2},
    "ideal": {"linewidth": 1.6, "color": "0.0", "linestyle": (0, (6, 2, 1, 2)), "zorder": 4},
    "tangent": {"linewidth": 1.6, "color": "0.0", "zorder": 4},
    "point": {"color": "0.0", "markersize": 6.0, "zorder": 7},
    "second point": {"color": "1.0", "markeredgecolor": "0.0", "markersize": 6.5, "zorder": 7},
    "text": {"color": "0.0", "zorder": 9},
}

_COLOURS = {
    "second": "#1f4e9c",
    "third": "#a3341c",
    "polygon": "#5a5a5a",
    "construction": "#1f6f4a",
    "ideal": "#7a1fa2",
    "tangent": "#a3341c",
}

#: Names of the styles: "print" is black and grey alone.
STYLES: dict[str, dict[str, str]] = {"screen": _COLOURS, "print": {}}


def role(name: str, style: str, **changes: Any) -> dict[str, Any]:
    """Return how a role is drawn in a style, as keywords of matplotlib's lines.

    Raises
    ------
    GeometryError
        If there is no such role or style.
    """
    if name not in ROLES:
        raise GeometryError.expected("role", "one of " + ", ".join(ROLES), repr(name))
    if style not in STYLES:
        raise GeometryError.expected("style", "one of " + ", ".join(STYLES), repr(style))
    out = dict(ROLES[name])
    if name in STYLES[style]:
        out["color"] = STYLES[style][name]
    return {**out, **changes}


#: Text as paths (the same everywhere), formulas in the font of formulas, no time in files.
_SETTINGS = {
    "svg.fonttype": "path",
    "svg.hashsalt": "mitsuba_bezier",
    "pdf.fonttype": 42,
    "mathtext.fontset": "cm",
    "font.family": "DejaVu Sans",
    "path.simplify": False,
}


def matplotlib() -> Any:
    """Return the module matplotlib.

    Raises
    ------
    RuntimeSetupError
        If it is not installed: the message says how.
    """
    try:
        import matplotlib as module
        import matplotlib.figure
    except ImportError as error:
        raise RuntimeSetupError.expected(
            "figures",
            "matplotlib, which draws them",
            f"none ({error}): pip install 'mitsuba-bezier[figures]'",
        ) from None
    return module


def font() -> dict[str, Any]:
    """Return the settings under which drawings are made and written."""
    return dict(_SETTINGS)
