"""Paint light around a model: a studio and a sky, in the directions of the camera.

Each is one `envmap`, which Mitsuba samples by its brightness: boxes of light give soft shadows
without the noise of many lamps, and a ground below is lit alike everywhere. The studio is adjusted
so that a white ground that nothing shades is as bright as the white behind it: no horizon is seen.
"""

from __future__ import annotations

import numpy as np

__all__ = ["GROUND", "LIGHTS", "sky", "studio"]

LIGHTS = ("studio", "sky", "lamp")
#: Reflectance of the ground.
GROUND = 0.8
#: Height of the pictures; they are twice as wide.
_HEIGHT = 128
#: Brightness of the ground and of what is behind it: white, with some to spare for noise.
_WHITE = 1.12


def _directions() -> tuple[np.ndarray, np.ndarray]:
    """Return unit vectors (right, up, towards the camera) and solid angles of the pixels.

    Mitsuba's column 0 lies towards -z, and a quarter further towards x; rows begin at +y.
    """
    theta = (np.arange(_HEIGHT) + 0.5) / _HEIGHT * np.pi
    phi = (np.arange(2 * _HEIGHT) + 0.5) / _HEIGHT * np.pi
    t, p = np.meshgrid(theta, phi, indexing="ij")
    d = np.stack([np.sin(t) * np.sin(p), np.cos(t), -np.sin(t) * np.cos(p)], axis=-1)
    return d, np.sin(t) * (np.pi / _HEIGHT) ** 2


def _smooth(x: np.ndarray, low: float, high: float) -> np.ndarray:
    t = np.clip((x - low) / (high - low), 0.0, 1.0)
    return t * t * (3 - 2 * t)


def _box(
    d: np.ndarray, towards: tuple[float, float, float], width: float, height: float
) -> np.ndarray:
    """Return a rectangle of light around a direction, with soft edges; sizes are half angles."""
    n = np.array(towards) / np.linalg.norm(towards)
    right = np.cross([0.0, 1.0, 0.0], n)
    right /= np.linalg.norm(right)
    x, y = (np.degrees(np.arctan2(d @ axis, d @ n)) for axis in (right, np.cross(n, right)))
    edges = (1 - _smooth(np.abs(x), width - 2, width + 2)) * (
        1 - _smooth(np.abs(y), height - 2, height + 2)
    )
    return edges * (d @ n > 0)


def studio(ground: bool) -> np.ndarray:
    """Return the studio ``(H, 2 H, 3)``: a large box above to the left, a strip to the right.

    The wall behind the model is white, the side of the camera is dark, so that metal has something
    to show. Where a ground is in the way, no light comes from below: rays towards it would be lost.
    """
    d, angle = _directions()
    y, z = d[..., 1], d[..., 2]
    wall = _WHITE + (0.28 - _WHITE) * _smooth(z, 0.0, 0.75)
    light = wall + (0.62 - wall) * _smooth(y, 0.35, 0.85)
    below = 0.0 if ground else np.where(z < 0.0, _WHITE, 0.5)
    light = np.where(y < 0, below, light)
    light = light + 1.7 * _box(d, (1.0, 0.25, 0.25), 9, 34)
    light = light + 0.9 * _box(d, (-0.45, 0.35, 1.0), 26, 9)
    key = _box(d, (-0.62, 0.86, 0.42), 21, 17)
    down = np.maximum(y, 0.0) * angle
    needed = _WHITE * np.pi / GROUND - float((light * down).sum())
    light = light + key * needed / float((key * down).sum())
    tint = np.array([1.0, 0.985, 0.96]) ** (key[..., None] * 0.8)
    return (light[..., None] * tint).astype(np.float32)


def sky(ground: bool) -> np.ndarray:
    """Return a clear sky ``(H, 2 H, 3)`` with a soft sun at the left."""
    d, angle = _directions()
    y = d[..., 1]
    up = np.clip(y, 0.0, 1.0)[..., None] ** 0.55
    colour = (1 - up) * np.array([0.92, 0.96, 1.0]) + up * np.array([0.16, 0.34, 0.78])
    colour = np.where(y[..., None] < 0, np.array([0.42, 0.4, 0.37]) * (not ground), colour)
    sun_at = np.array([-0.6, 0.72, 0.5])
    cosine = d @ (sun_at / np.linalg.norm(sun_at))
    sun = 1 - _smooth(np.degrees(np.arccos(np.clip(cosine, -1, 1))), 3.0, 4.5)
    flux = float((sun * np.maximum(y, 0.0) * angle).sum())
    return (colour + (sun * 2.3 / flux)[..., None] * [1.0, 0.93, 0.8]).astype(np.float32)
