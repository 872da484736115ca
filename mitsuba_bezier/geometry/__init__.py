"""Projective geometry and Bézier nets in NumPy float64; imports neither Mitsuba nor Dr.Jit."""
