"""Patches become what rays can meet: closed forms, graphs with proved bounds, the BVH."""
