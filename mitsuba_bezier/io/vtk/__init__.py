"""VTK files: `.vtu` with Bézier cells, in every encoding."""
