"""Sample lenses as ``tests/optics/record_optiland.py`` has recorded them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import mitsuba_bezier as mb
from mitsuba_bezier.optics import (
    AIR,
    Abbe,
    Constant,
    Lens,
    Surface,
    beam,
    pupil_grid,
    surface_shape,
    used_semi_diameters,
)
from mitsuba_bezier.optics.trace import refract


def recorded() -> dict[str, dict[str, Any]]:
    """Return the records by the names of the lenses."""
    path = Path(__file__).with_name("optics") / "optiland.json"
    return json.loads(path.read_text())["lenses"]


def lens_of(record: dict[str, Any]) -> Lens:
    """Return the recorded lens, with the indices of its glass; its field is the largest one."""
    rows = record["surfaces"]
    surfaces = [
        Surface(
            curvature=row["curvature"],
            thickness=rows[i + 1]["z"] - row["z"],
            medium=AIR if row["mirror"] else Constant(row["n"]),
            conic=row["conic"],
            mirror=row["mirror"],
            stop=row["stop"],
        )
        for i, row in enumerate(rows[1:-1], start=1)
    ]
    kind, value = record["aperture"]
    return Lens(
        surfaces,
        aperture=({"EPD": "diameter", "imageFNO": "f_number"}[kind], value),
        wavelengths=[record["wavelength"]],
        fields=[(0, record["field"])],
    )


def lens_at(record: dict[str, Any], row: dict[str, Any]) -> Lens:
    """Return the recorded lens with its indices at one of its three wavelengths, and three fields.

    `row` is one of ``record["spectrum"]``.
    """
    lens = lens_of(record)
    # the aperture as the size of the beam: an f-number would be another at each wavelength
    surfaces = [
        replace(s, medium=AIR if s.mirror else Constant(n))
        for s, n in zip(lens.surfaces, row["n"][1:-1], strict=True)
    ]
    return replace(
        lens,
        surfaces=surfaces,
        wavelengths=[row["wavelength"]],
        fields=[(0.0, share * record["field"]) for share in (0, 0.7, 1.0)],
    )


def recorded_beam(record: dict[str, Any], field: tuple[float, float]) -> tuple[Any, Any]:
    """Return the rays of which spots are recorded: through the paraxial pupil at d."""
    return beam(lens_of(record), field, pupil_grid(4), aim=False)


def rms(points: np.ndarray) -> float:
    """Return the root mean square distance of points ``(N, 2)`` from their centroid."""
    return float(np.sqrt(((points - points.mean(axis=0)) ** 2).sum(axis=1).mean()))


def phone_lens() -> Lens:
    """Three aspheres in plastic to r^16, as in telephones: the fields are 0 and 25 degrees."""
    plastic, dense = Abbe(1.5445, 55.9), Abbe(1.6398, 23.3)
    return Lens(
        [
            Surface(1 / 1.62, 0.72, plastic, 0.95, -0.6, (0, 8e-3, 2e-2, -3e-2, 4e-2, -3e-2)),
            Surface(1 / 11.5, 0.16, semi_diameter=0.9, coefficients=(0, -2e-2, 5e-2, -8e-2)),
            Surface(-1 / 22.0, 0.3, dense, 0.88, 0.0, (0, -9e-2, 2.1e-1, -2e-1, 1.2e-1)),
            Surface(1 / 5.2, 0.55, semi_diameter=0.9, conic=-3, coefficients=(0, -5e-2, 2e-1)),
            Surface(-1 / 8.5, 0.62, plastic, 1.2, 0.0, (0, -8e-2, 3e-2, -1e-2, 0, 0, 0, 1e-3)),
            Surface(-1 / 1.9, 1.5, semi_diameter=1.35, conic=-4.0, coefficients=(0, -6e-2, 1e-2)),
        ],
    )


def by_kernels(
    lens: Lens, o: np.ndarray, d: np.ndarray, wavelength: float, met_as: str = "cap"
) -> np.ndarray:
    """Return points ``(N, 3)`` on the image plane; NaN for rays that miss a surface.

    See `rays_by_kernels`.
    """
    o, d = rays_by_kernels(lens, o, d, wavelength, met_as)
    frame = lens.frames()[-1]
    local, along = (o - frame[:3, 3]) @ frame[:3, :3], d @ frame[:3, :3]
    return local - along * (local[:, 2:] / along[:, 2:])


def rays_by_kernels(
    lens: Lens, o: np.ndarray, d: np.ndarray, wavelength: float, met_as: str = "cap"
) -> tuple[np.ndarray, np.ndarray]:
    """Return points on the last surface and directions behind it; NaN for rays that miss one.

    Rays go from shape to shape by `shape.ray_intersect` in float32; refraction is in float64, with
    the kernel's points and normals. Surfaces are the patches of `surface_patches` (``cap``),
    aspheres (``asphere``), or, if they are spheres, whole ones by a cover (``octants``,
    ``tetrahedral``).
    """
    import mitsuba as mi

    radii = np.array([s.semi_diameter for s in lens.surfaces])
    if not np.isfinite(radii).all():
        reach = [0.999 * s.reach() for s in lens.surfaces]
        radii = np.minimum(1.2 * used_semi_diameters(lens), reach)
    index = lens.indices(wavelength)
    frames = lens.frames()
    for i, (surface, radius) in enumerate(zip(lens.surfaces, radii)):
        # built in the surface's own frame: `to_world` is carried in float64
        shape = surface_shape(surface, float(radius))
        turned = 2 * radius
        if met_as in ("octants", "tetrahedral") and surface.curvature and not surface.conic:
            r = 1 / surface.curvature
            net = mb.sphere((0, 0, r), abs(r), cover=met_as)
            shape = {"type": "beziertriangle", "control_points": net}
            # from inside, if that is where light comes from: the other side stays behind
            if r * lens.directions()[i] < 0:
                turned = 1.05 * abs(float(surface.sag(radius)))
        elif met_as == "asphere":
            shape = {
                "type": "asphere",
                "curvature": surface.curvature,
                "conic": surface.conic,
                "coefficients": " ".join(map(repr, surface.coefficients)),
                "aperture": float(radius),
                "flip_normals": True,
            }
        shape = mi.load_dict({**shape, "to_world": frames[i]})
        # from a radius in front of the vertex, so that t is small in float32
        vertex, axis = frames[i][:3, 3], frames[i][:3, 2]
        start = ((vertex - o) @ axis - turned * lens.directions()[i]) / (d @ axis)
        start = o + start[:, None] * d
        ray = mi.Ray3f(mi.Point3f(start.T), mi.Vector3f(d.T))
        si = shape.ray_intersect(ray)
        p, n = np.array(si.p).T.astype(float), np.array(si.n).T.astype(float)
        p[~np.array(si.is_valid())] = np.nan
        if surface.mirror:
            d = d - 2 * np.sum(d * n, axis=1, keepdims=True) * n
        else:
            d = refract(d, n, np.full(len(d), index[i]), np.full(len(d), index[i + 1]))
        d = d / np.linalg.norm(d, axis=1, keepdims=True)
        o = p
    return o, d
