"""Patches of quadrics on the device: the quadratic, then which patch it is."""
