"""How the parameters of a point are found on each kind of leaf with a closed form."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ...leaves.records import LeafKind
from .cones import cone_parameters, from_corner
from .inverted import inverted_parameters
from .sections import section_parameters

__all__ = ["KINDS", "Inversion"]


@dataclass(frozen=True)
class Inversion:
    """What is done beside dividing the rows by their sum, which is all there is for `LINEAR`."""

    #: Whether a point is on a leaf, and its parameters, where the sides alone do not say so.
    decide: Callable[..., tuple[Any, Any, Any]] | None = None
    #: Parameters of a point between the sides.
    at_point: Callable[..., tuple[Any, Any]] | None = None
    #: Parameters of the hit that counts, from those of its point.
    at_hit: Callable[..., tuple[Any, Any]] | None = None
    #: Whether the quadric may have a singular point on a leaf, as a cone in its apex.
    singular: bool = False


#: One line a kind.
KINDS = {
    LeafKind.LINEAR: Inversion(),
    LeafKind.CONE: Inversion(at_point=cone_parameters, at_hit=from_corner, singular=True),
    LeafKind.PLANE_SECTIONS: Inversion(at_hit=section_parameters),
    LeafKind.INVERTED: Inversion(decide=inverted_parameters),
    LeafKind.INVERTED_APEX: Inversion(decide=inverted_parameters, singular=True),
}
