"""Pieces of scenes that explain a surface: its net, curves on it, labels, arrows."""
