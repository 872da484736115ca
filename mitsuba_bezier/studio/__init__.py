"""A page to drag control points in: the exact surface behind, its net in front."""
