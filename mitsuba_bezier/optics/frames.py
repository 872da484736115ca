"""Rigid motions between the frames of surfaces: decentrations and tilts of prescriptions."""

from __future__ import annotations

import numpy as np


def shift(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    """Return the motion ``(4, 4)`` to a frame whose origin is at (x, y, z)."""
    matrix = np.eye(4)
    matrix[:3, 3] = x, y, z
    return matrix


def turn(alpha: float = 0.0, beta: float = 0.0, gamma: float = 0.0) -> np.ndarray:
    """Return the motion to a frame turned about x, then the new y, then the newest z.

    Angles are in degrees. As in CODE V and Zemax, positive `alpha` and `beta` are left-handed
    about x and y, positive `gamma` right-handed about z.
    """
    a, b, c = np.radians([-alpha, -beta, gamma])
    ca, sa, cb, sb, cc, sc = np.cos(a), np.sin(a), np.cos(b), np.sin(b), np.cos(c), np.sin(c)
    x = np.array([[1, 0, 0], [0, ca, -sa], [0, sa, ca]])
    y = np.array([[cb, 0, sb], [0, 1, 0], [-sb, 0, cb]])
    z = np.array([[cc, -sc, 0], [sc, cc, 0], [0, 0, 1]])
    matrix = np.eye(4)
    matrix[:3, :3] = x @ y @ z
    return matrix
