"""Leaves that are graphs of functions: subdivision until proved bounds are small."""
