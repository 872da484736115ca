"""Even aspheres and rays that ask much of them."""

from __future__ import annotations

from typing import Any

import numpy as np

from mitsuba_bezier.geometry.aspheres import EvenAsphere

#: Nearly all that a prescription may hold: `wavy` and `gull` have rays with several meetings.
ASPHERES = {
    "plane": EvenAsphere(0, 3),
    "paraboloid": EvenAsphere(0.05, 12, -1),
    "deep sphere": EvenAsphere(0.1, 9.9),
    "deep hyperboloid": EvenAsphere(0.1, 300, -5),
    "oblate": EvenAsphere(0.05, 9, 3.0),
    "lens": EvenAsphere(1 / 50, 12.5, -1.2, (0, 1e-5, -3e-8, 1e-10)),
    "gull": EvenAsphere(0.2, 2, 0, (0.1, -0.3, 0.12, -0.015, 0, 1e-4)),
    "wavy": EvenAsphere(0, 1, 0, (4, -24, 40, -20)),
    "ring": EvenAsphere(-0.2, 2, -3, (0.1, -0.3, 0.12, -0.015), inner=0.9),
    "r^40": EvenAsphere(0, 1, 0, [0.0] * 19 + [0.5]),
    "Schmidt plate": EvenAsphere(0, 100, 0, (1e-5, -1e-9)),
}


def asphere_parameters(surface: EvenAsphere) -> dict[str, Any]:
    """Return an asphere as a dictionary for `mi.load_dict`."""
    return {
        "type": "asphere",
        "curvature": surface.curvature,
        "conic": surface.conic,
        "coefficients": " ".join(map(repr, surface.coefficients)),
        "aperture": surface.aperture,
        "inner_radius": surface.inner,
    }


def rays_at(surface: EvenAsphere, count: int, seed: int) -> tuple[np.ndarray, ...]:
    """Return origins and directions in float32, and the kind ``(N,)`` of each ray.

    0 at points of the surface, 1 beside them along tangents, 2 at them nearly along tangents, 3
    along the axis, 4 from far away, 5 close to the rims, 6 through the vertex, 7 beside it all, 8
    just inside of the rims and nearly along tangents.
    """
    rng = np.random.default_rng(seed)
    size, kind = surface.aperture, np.arange(count) % 9
    r = size * np.sqrt(rng.random(count))
    rim = np.where(rng.random(count) < 0.5, surface.inner or size, size)
    r = np.where(kind == 5, rim + size * 1e-4 * rng.normal(size=count), r)
    r = np.where(kind == 6, 0.0, r)
    r = np.where(
        kind == 8, rim + (rim != surface.inner) * -size * 10 ** -rng.uniform(4, 6, count), r
    )
    angle = rng.random(count) * 2 * np.pi
    sag, slope, _ = surface.derivatives(np.minimum(r, size) ** 2)
    target = np.stack([r * np.cos(angle), r * np.sin(angle), sag], axis=1)
    normal = np.append(-2 * slope[:, None] * target[:, :2], np.ones((count, 1)), axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    d = rng.normal(size=(count, 3))
    tangent = np.cross(normal, d)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    beside = size * rng.choice([-1, 1], count) * 10 ** -rng.uniform(1, 6, count)
    target = np.where((kind == 1)[:, None], target + beside[:, None] * normal, target)
    flat = tangent + 10 ** -rng.uniform(1, 4, (count, 1)) * normal
    grazes = (kind == 2) | (kind == 8)
    d = np.where((kind == 1)[:, None], tangent, np.where(grazes[:, None], flat, d))
    d = np.where((kind == 3)[:, None], [[0.0, 0.0, 1.0]] * rng.choice([-1, 1], (count, 1)), d)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    target = np.where((kind == 7)[:, None], size * rng.uniform(-1.3, 1.3, (count, 3)), target)
    distance = size * np.where(kind == 4, 10 ** rng.uniform(0, 4, count), rng.uniform(0, 3, count))
    o = target - distance[:, None] * d
    d = d * rng.uniform(0.5, 2, (count, 1))  # directions of any length
    return o.astype(np.float32), d.astype(np.float32), kind
