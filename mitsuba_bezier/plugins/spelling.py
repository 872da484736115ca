"""Name parameters that a plugin does not know, and the one that was meant."""

from __future__ import annotations

import difflib
import re
from typing import Any

import mitsuba as mi

from ..errors import BezierError
from .shape.attributes import is_attribute

__all__ = ["PARAMETERS", "check_known", "check_read"]

_PATH = ("max_depth", "rr_depth", "hide_emitters")
_SAMPLES = ("sppc", "sppp", "sppi", "spps")
_MEDIA = ("interior", "exterior")
_SHAPES = ("beziertriangle", "asphere")

#: What each plugin documents, and what Mitsuba's class below it takes besides.
PARAMETERS = {
    "beziertriangle": (
        *("control_points", "filename", "to_world", "instances", "instances_filename"),
        *("flip_normals", "section", "body", "cap", "trims", "texcoords", "uv", "face_normals"),
        *("silhouette_sampling_weight", *_MEDIA),
    ),
    "asphere": (
        *("radius", "curvature", "conic", "coefficients", "aperture", "inner_radius", "to_world"),
        *("instances", "instances_filename", "flip_normals", "section", "body", "cap", *_MEDIA),
    ),
    "bezierfield": (
        *("ordinates", "weights", "filename", "field", "component", "colormap", "minimum"),
        *("maximum", "levels", "isolines", "isoline_width", "isoline_color", "edges", "edge_width"),
        *("edge_color", "world_to_pixel", "texcoords"),
    ),
    "lens": (
        *("filename", "film_width", "focus_distance", "f_number", "scale", "dispersion"),
        *("blades", "blade_rotation", "coating", "ghosts", "absorption", "glass"),
        *("to_world", "shutter_open", "shutter_close"),
    ),
    "dispersive": ("material", "exterior", "int_ior", "ext_ior", "coating"),
    "bezierpath": (*_PATH, "shadow_steps"),
    "beziervolpath": _PATH,
    "bezieraov": ("aovs", "hide_emitters"),
    "bezierdepth": ("hide_emitters",),
    "bezierdirect": ("shading_samples", "emitter_samples", "bsdf_samples", "hide_emitters"),
    "beziermoment": ("hide_emitters",),
    "bezierptracer": (*_PATH, "samples_per_pass"),
    "bezierstokes": ("hide_emitters",),
    "bezier_prb_projective": (*_PATH, *_SAMPLES),
    "bezier_direct_projective": (*_PATH[1:], *_SAMPLES),
}


#: What parameters were called once.
RENAMED = {"copies": "instances", "copies_filename": "instances_filename"}


def check_known(plugin: str, props: mi.Properties) -> None:
    """Refuse what is nearly a parameter, before the plugin misses the right one.

    Raises
    ------
    BezierError
        If there is a parameter that is not one of `PARAMETERS`, but looks like one.
    """
    for key in props.keys():  # noqa: SIM118 (Properties is no dict)
        known = key in PARAMETERS[plugin] or (plugin == "beziertriangle" and is_attribute(key))
        if known:
            continue
        if props.type(key) != mi.Properties.Type.Object:
            # 0.75: one letter in four is another, or missing
            if _meant(plugin, key, 0.75):
                raise _unknown(plugin, key)
        # any name will do for a BSDF or an emitter, but these would not be seen at all
        elif plugin in _SHAPES and isinstance(props[key], (mi.Medium, mi.Texture)):
            raise _unknown(plugin, key)


def check_read(plugin: str, props: mi.Properties) -> None:
    """Refuse what the plugin, now built, has not read.

    Raises
    ------
    BezierError
        If there is such a parameter.
    """
    for key in props.unqueried():
        raise _unknown(plugin, key)


def _meant(plugin: str, key: str, cutoff: float) -> str | None:
    word = key.lower().replace("-", "_")
    if RENAMED.get(word) in PARAMETERS[plugin]:
        return RENAMED[word]
    if plugin == "beziertriangle" and (attribute := re.fullmatch(r"(face|vertex)_?(\w+)", word)):
        return "_".join(attribute.groups())
    near = difflib.get_close_matches(word, PARAMETERS[plugin], n=1, cutoff=cutoff)
    # of a short name with its letters exchanged only one in two is in its place
    near = near or [name for name in PARAMETERS[plugin] if sorted(name) == sorted(word)]
    return near[0] if near else None


def _unknown(plugin: str, key: str) -> Any:
    meant = _meant(plugin, key, 0.65)
    names = ", ".join(PARAMETERS[plugin])
    more = ", face_NAME, vertex_NAME" if plugin == "beziertriangle" else ""
    hint = f"did you mean '{meant}'?" if meant else f"its parameters are {names}{more}"
    return BezierError(f"{plugin}: unknown parameter '{key}'; {hint}")
