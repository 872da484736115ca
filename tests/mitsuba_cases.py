"""Rays, nets and analytic answers that the tests of the plugins share."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np

import mitsuba_bezier as mb

__all__ = [
    "analytic_sphere",
    "ball_rays",
    "bezier",
    "camera_rays",
    "numbers",
    "ray_of",
    "sphere_net",
    "tensor",
]


def tensor(net: Any) -> Any:
    """Return control points as Mitsuba takes them, rounded to float32."""
    values = np.asarray(getattr(net, "control_points", net), dtype=np.float32)
    return mi.TensorXf(values.ravel(), shape=values.shape)


def sphere_net(cover: str = "octants", **keywords: Any) -> Any:
    """Return the control points of a sphere as a tensor."""
    return tensor(mb.sphere(cover=cover, **keywords))


def bezier(net: Any = None, **more: Any) -> dict[str, Any]:
    """Return the dictionary of a shape with these nets (default: the sphere's octants)."""
    values = sphere_net() if net is None else tensor(net)
    return {"type": "beziertriangle", "control_points": values, **more}


def ray_of(o: np.ndarray, d: np.ndarray, maxt: float | None = None) -> Any:
    """Return rays from arrays ``(N, 3)``."""
    o, d = np.broadcast_arrays(np.float32(o), np.float32(d))
    ray = mi.Ray3f(mi.Point3f(*o.T.copy()), mi.Vector3f(*d.T.copy()))
    if maxt is not None:
        ray.maxt = maxt
    return ray


def numbers(value: Any) -> np.ndarray:
    """Return a Dr.Jit array as NumPy, vectors as ``(N, 3)``."""
    return np.array(value).T


def camera_rays(
    origin: Any, side: int, half_width: float = 0.45, seed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Return ``side**2`` jittered rays of a pinhole camera that looks at the origin.

    They are float32; the directions have unit length up to rounding.
    """
    origin = np.asarray(origin, dtype=np.float64)
    forward = -origin / np.linalg.norm(origin)
    right = np.cross(forward, [0.31, 0.87, 0.38])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    rng = np.random.default_rng(seed)
    grid = np.arange(side, dtype=np.float32)
    x = (grid[None] + rng.random((side, side), dtype=np.float32)) * (2 / side) - 1
    y = (grid[:, None] + rng.random((side, side), dtype=np.float32)) * (2 / side) - 1
    d = forward + half_width * (x[..., None] * right + y[..., None] * up)
    d = d.reshape(-1, 3)
    d /= np.sqrt(np.einsum("ni,ni->n", d, d))[:, None]
    return np.broadcast_to(origin, d.shape).astype(np.float32), d.astype(np.float32)


def ball_rays(
    count: int, seed: int = 0, start: float = 2.5, target: float = 1.2
) -> tuple[np.ndarray, np.ndarray]:
    """Return float32 rays from a sphere of radius `start` into a ball of radius `target`."""
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(count, 3))
    a *= start / np.linalg.norm(a, axis=1, keepdims=True)
    b = rng.normal(size=(count, 3))
    b *= target * np.cbrt(rng.random((count, 1))) / np.linalg.norm(b, axis=1, keepdims=True)
    d = b - a
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    return a.astype(np.float32), d.astype(np.float32)


def analytic_sphere(
    o: np.ndarray, d: np.ndarray, center: Any = (0.0, 0.0, 0.0), radius: float = 1.0
) -> tuple[np.ndarray, np.ndarray]:
    """Intersect rays with a sphere in float64.

    Returns
    -------
    t : (N,) array
        Smallest positive ray parameter, infinite for a miss.
    distance : (N,) array
        Distance of the ray's line from the centre, in radii: 1 at the silhouette.
    """
    o = (np.asarray(o, dtype=np.float64) - center) / radius
    d = np.asarray(d, dtype=np.float64) / radius
    dd = np.einsum("ni,ni->n", d, d)
    along = -np.einsum("ni,ni->n", o, d) / dd
    foot = o + along[:, None] * d  # no cancellation: the ray's own nearest point
    square = np.einsum("ni,ni->n", foot, foot)
    half = np.sqrt(np.maximum(1.0 - square, 0.0) / dd)
    t = np.where(along - half > 0, along - half, along + half)
    return np.where((square <= 1.0) & (t > 0), t, np.inf), np.sqrt(square)
