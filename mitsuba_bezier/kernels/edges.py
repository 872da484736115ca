"""How far outside of its leaf a hit may be: so that no ray slips through a common edge."""

from __future__ import annotations

from typing import Any

import drjit as dr

from .arrays import reciprocal

__all__ = ["ACROSS", "EDGE", "EDGE_GRAZING", "edge_tolerance"]

#: A hit this far outside its leaf still counts, in leaf barycentrics: ten roundings of a
#: number near one, so that two leaves cannot both refuse a ray that meets their common edge.
EDGE = 1e-6
#: ... and at grazing angles, where an error across the surface is an error along it divided
#: by the cosine; never more than this.
EDGE_GRAZING = 3e-3
#: Error across the surface of a graph leaf in float32, in leaf sizes.
ACROSS = 1e-7


def edge_tolerance(cosine: Any, across: Any = ACROSS) -> Any:
    """Return the tolerance in leaf barycentrics for a hit at this ``|cos|``.

    `across` is by how much, in leaf sizes, the surface that was met may differ from the patch.
    """
    return dr.minimum(EDGE_GRAZING, EDGE + across * reciprocal(dr.maximum(cosine, 1e-12)))
