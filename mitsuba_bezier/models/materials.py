"""Find the BSDF of a material by its name."""

from __future__ import annotations

import difflib
import re
from collections.abc import Sequence
from typing import Any
from xml.etree import ElementTree

from ..errors import BezierError
from ..io.parts import Colour

__all__ = ["MATERIALS", "PALETTE", "linear", "material", "painted"]

_HEX = re.compile(r"#(?:[0-9a-fA-F]{3}|[0-9a-fA-F]{6})")


def linear(text: str) -> Colour:
    """Return ``#rrggbb`` as linear RGB.

    Raises
    ------
    BezierError
        If it is no colour.
    """
    if not _HEX.fullmatch(text):
        raise BezierError.expected("colour", "#rrggbb or #rgb", repr(text))
    digits = text[1:] if len(text) == 7 else "".join(2 * c for c in text[1:])
    values = [int(digits[k : k + 2], 16) / 255 for k in (0, 2, 4)]
    return tuple(  # type: ignore[return-value]
        x / 12.92 if x <= 0.04045 else ((x + 0.055) / 1.055) ** 2.4 for x in values
    )


def rgb(colour: Sequence[float]) -> dict[str, Any]:
    """Return a colour for a description of a scene."""
    return {"type": "rgb", "value": [float(x) for x in colour]}


def _both(inner: dict[str, Any]) -> dict[str, Any]:
    """Return a BSDF that both sides have: faces of foreign files are not all turned outwards."""
    return {"type": "twosided", "bsdf": inner}


def _metal(name: str, alpha: float, **more: Any) -> dict[str, Any]:
    return _both({"type": "roughconductor", "material": name, "alpha": alpha, **more})


def _principled(colour: Colour, **parameters: float) -> dict[str, Any]:
    return _both({"type": "principled", "base_color": rgb(colour), **parameters})


def painted(colour: Colour) -> dict[str, Any]:
    """Return what parts are made of whose files tell no more than a colour."""
    return plastic(colour)


def plastic(colour: Colour) -> dict[str, Any]:
    """Return smooth plastic; no colour is darker or brighter than things are."""
    factor = min(1.0, 0.7 / max(*colour, 1e-9))
    kept: Any = tuple(max(x * factor, 0.012) for x in colour)
    return _principled(kept, roughness=0.32, specular=0.5)


def matte(colour: Colour) -> dict[str, Any]:
    """Return a surface without gloss."""
    return _both({"type": "diffuse", "reflectance": rgb(colour)})


def paint(colour: Colour) -> dict[str, Any]:
    """Return lacquer."""
    return _principled(colour, roughness=0.45, specular=0.5, clearcoat=1.0, clearcoat_gloss=0.95)


def metal(colour: Colour) -> dict[str, Any]:
    """Return a metal of any colour."""
    return _principled(colour, metallic=1.0, roughness=0.28)


def rubber(colour: Colour) -> dict[str, Any]:
    """Return rubber."""
    return _principled(colour, roughness=0.75, specular=0.3)


def glass(colour: Colour) -> dict[str, Any]:
    """Return glass that is tinted where light passes its surface."""
    return {"type": "dielectric", "specular_transmittance": rgb(colour)}


#: Those that have a colour, and the one they have without.
_COLOURED = {
    "plastic": (plastic, "#5f7f9f"),
    "matte": (matte, "#b8b8b4"),
    "paint": (paint, "#a01c1c"),
    "metal": (metal, "#b0aea8"),
    "rubber": (rubber, "#1c1c1c"),
    "glass": (glass, "#ffffff"),
}

_FIXED: dict[str, dict[str, Any]] = {
    "gold": _metal("Au", 0.12),
    "silver": _metal("Ag", 0.12),
    "copper": _metal("Cu", 0.14),
    "aluminium": _metal("Al", 0.22),
    "steel": _metal("Cr", 0.2),
    "chrome": _both({"type": "conductor", "material": "Cr"}),
    "mirror": _both({"type": "conductor", "material": "none"}),
    "brass": _principled(linear("#d3b15f"), metallic=1.0, roughness=0.25),
    "bronze": _principled(linear("#a97142"), metallic=1.0, roughness=0.32),
    "iron": _principled(linear("#6b6866"), metallic=1.0, roughness=0.45),
    "ceramic": _principled(linear("#ece8e1"), roughness=0.2, specular=0.6, clearcoat=0.8),
    "wood": _principled(linear("#9a6b3f"), roughness=0.6, specular=0.3),
    "clay": matte(linear("#b8795a")),
}
_FIXED["aluminum"] = _FIXED["aluminium"]

#: The names, for messages.
MATERIALS = tuple(sorted([*_FIXED, *_COLOURED]))

#: Colours of parts whose file has none, in their order; models of one part have the first.
PALETTE = tuple(
    linear(x)
    for x in (
        "#5f86ad",
        "#d08a4a",
        "#6f9f6a",
        "#b7595a",
        "#8a78b0",
        "#c9b458",
        "#5fa3a3",
        "#9b9b9b",
    )
)


def material(text: str) -> dict[str, Any]:
    """Return the BSDF of a name, ``NAME:#rrggbb``, ``#rrggbb``, or a snippet of XML.

    Raises
    ------
    BezierError
        If it is none of these.
    """
    text = text.strip()
    if text.startswith("<"):
        return _snippet(text)
    if text.startswith("#"):
        return plastic(linear(text))
    name, colon, colour = text.partition(":")
    name = name.strip().lower()
    if name in _COLOURED:
        make, own = _COLOURED[name]
        return make(linear(colour.strip() if colon else own))
    if name in _FIXED and not colon:
        return _FIXED[name]
    if name in _FIXED:
        raise BezierError.expected("material", f"'{name}' without a colour", repr(text))
    near = difflib.get_close_matches(name, MATERIALS, n=2)
    hint = f" (did you mean {' or '.join(map(repr, near))}?)" if near else ""
    expected = f"{', '.join(MATERIALS)}, NAME:#rrggbb, #rrggbb, or a <bsdf> of XML"
    raise BezierError.expected("material", expected, f"{text!r}{hint}")


def _snippet(text: str) -> dict[str, Any]:
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise BezierError.expected("material", "XML of a <bsdf>", f"{error}") from None
    if root.tag != "bsdf":
        raise BezierError.expected("material", "XML of a <bsdf>", f"a <{root.tag}>")
    return {"xml": text}
