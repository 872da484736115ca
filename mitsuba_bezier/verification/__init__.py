"""Comparison of images, reports, merging, a pytest plugin: regression tests of renders."""
