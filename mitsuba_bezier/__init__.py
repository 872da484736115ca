"""Exact rational Bézier triangles for Mitsuba 3."""
