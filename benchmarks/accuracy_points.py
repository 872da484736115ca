"""The row of the accuracy suite for what a hit is: point, normal, partials and parameters."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from accuracy_aspheres import asphere_parameters
from accuracy_rows import scaled
from accuracy_tools import Line, describe, toward, unit

import mitsuba_bezier as mb
from mitsuba_bezier.geometry.aspheres import EvenAsphere
from mitsuba_bezier.oracles.aspheres import first_hits

__all__ = ["points"]

Rng = np.random.Generator
VARIANT = "llvm_ad_rgb"

#: Where balls are, and their radii.
PLACES = (
    ((0.0, 0.0, 0.0), 1.0),
    ((0.0, 0.0, 0.0), 1e-3),
    ((0.0, 0.0, 0.0), 1e3),
    ((1e3, 0.0, 0.0), 1.0),
    ((278.0, 273.0, -5400.0), 250.0),
    ((1e5, 0.0, 0.0), 1.0),
    ((8e5, 0.0, 0.0), 1e3),
)
#: How far from the origin, in their sizes, surfaces without a closed form keep all digits.
_FAR = 1e4
#: A lens of size 1, steep at its rim, to r^16.
ASPHERE = EvenAsphere(0.8, 1.0, -0.4, (0, 0.05, -0.1, 0.07, 0, -0.02, 0, 0.01))
#: What is measured, in this order.
NAMES = ("t", "p", "n", "dp_du", "uv")


def _columns(a: np.ndarray) -> list[Any]:
    return [mi.Float(np.ascontiguousarray(a[:, k])) for k in range(3)]


def _numbers(value: Any) -> np.ndarray:
    return np.array(value).T.astype(float)


def _hits(o: np.ndarray, d: np.ndarray, center: np.ndarray, radius: float) -> tuple:
    """Return ray parameter and normal of the first hits of a ball, in float64."""
    o, d = o.astype(float) - center, d.astype(float)
    d2 = np.einsum("ni,ni->n", d, d)
    along = -np.einsum("ni,ni->n", o, d) / d2
    foot = o + along[:, None] * d
    with np.errstate(invalid="ignore"):
        half = np.sqrt((radius**2 - np.einsum("ni,ni->n", foot, foot)) / d2)
    return along - half, (foot - half[:, None] * d) / radius


def _off(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.linalg.norm(a - b, axis=1)


def _parameters(patches: mb.BezierTriangles, patch: np.ndarray, uv: np.ndarray, n: np.ndarray):
    """Return the parameters in float64 of points of the unit sphere with normals `n`."""
    for _step in range(4):
        at = patches.differential(patch, uv)
        gap, across = n - at.p, np.cross(at.dp_du, at.dp_dv)
        with np.errstate(divide="ignore", invalid="ignore"):
            across /= np.einsum("ni,ni->n", across, across)[:, None]
            step = [np.cross(at.dp_dv, across), np.cross(across, at.dp_du)]
            step = np.stack([np.einsum("ni,ni->n", s, gap) for s in step], axis=1)
        uv = uv + np.nan_to_num(step)  # the point of a collapsed edge has any parameter there
    return uv


def _native(si: Any, n: np.ndarray) -> list[np.ndarray]:
    """Return what partials and parameters of Mitsuba's sphere of radius 1 are off."""
    du = 2 * np.pi * np.stack([-n[:, 1], n[:, 0], np.zeros(len(n))], axis=1)
    angle = np.arctan2(n[:, 1], n[:, 0]) / (2 * np.pi)
    u, v = _numbers(si.uv).T
    turn = u - angle
    turn -= np.round(turn)
    polar = v - np.arccos(np.clip(n[:, 2], -1, 1)) / np.pi
    moved = np.hypot(turn * np.linalg.norm(du, axis=1), polar * np.pi)
    return [du, moved]


def _crossing(
    patches: mb.BezierTriangles, patch: np.ndarray, uv: np.ndarray, o: np.ndarray, d: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return parameters and ray parameter in float64 of hits near `uv`, by Newton's method."""
    for _step in range(4):
        at = patches.differential(patch, uv)
        matrix = np.stack([at.dp_du, at.dp_dv, -d], axis=2)
        # t starts at the point's foot on the ray, and is solved for with the others
        t = np.einsum("ni,ni->n", at.p - o, d) / np.einsum("ni,ni->n", d, d)
        step = np.linalg.solve(matrix, (o + t[:, None] * d - at.p)[..., None])[..., 0]
        uv = uv + step[:, :2]
    return uv, t + step[:, 2]


@dataclass
class Truth:
    """What hits on a surface of size 1 should be, in its own coordinates."""

    t: np.ndarray  #: over the radius
    p: np.ndarray
    n: np.ndarray
    dp_du: np.ndarray
    moved: np.ndarray  #: how far the parameters that were found are from the right ones, in space
    judged: np.ndarray

    def errors(self, si: Any, center: np.ndarray, radius: float) -> np.ndarray:
        """Return the errors ``(5, N)`` of `NAMES`, zero for hits that are not judged."""
        size = np.linalg.norm(self.dp_du, axis=1)[self.judged].max()
        errors = [
            np.abs(np.array(si.t) / radius - self.t),
            _off(_numbers(si.p), center + radius * self.p) / radius,
            _off(_numbers(si.n), self.n),
            _off(_numbers(si.dp_du) / radius, self.dp_du) / size,
            self.moved,
        ]
        return np.where(self.judged & np.array(si.is_valid()), errors, 0.0)


def _ball(patches: mb.BezierTriangles, pi: Any, si: Any, truth: Truth) -> Truth:
    """Return the truth of a cover of the ball."""
    patch, uv = np.array(pi.prim_index).astype(int), _numbers(si.uv)
    right = _parameters(patches, patch, uv, truth.n)
    at = patches.differential(patch, right)
    du, dv = (right - uv).T[..., None]
    moved = np.linalg.norm(du * at.dp_du + dv * at.dp_dv, axis=1)
    return replace(truth, dp_du=at.dp_du, moved=moved)


def _torus(patches: mb.BezierTriangles, pi: Any, si: Any, o: np.ndarray, d: np.ndarray) -> Truth:
    """Return the truth of the crossings of rays in the torus' own coordinates."""
    patch, uv = np.array(pi.prim_index).astype(int), _numbers(si.uv)
    hit = np.array(si.is_valid())
    right, t = uv.copy(), np.full(len(uv), np.nan)
    right[hit], t[hit] = _crossing(patches, patch[hit], uv[hit], o[hit], d[hit])
    at = patches.differential(patch, right)
    du, dv = (right - uv).T[..., None]
    n = unit(np.cross(at.dp_du, at.dp_dv))
    judged = hit & (np.abs(np.einsum("ni,ni->n", n, d)) > 0.1)
    moved = np.linalg.norm(du * at.dp_du + dv * at.dp_dv, axis=1)
    return Truth(t, at.p, n, at.dp_du, moved, judged)


def _asphere(surface: EvenAsphere, si: Any, o: np.ndarray, d: np.ndarray) -> Truth:
    """Return the truth of an asphere in its own coordinates; `uv` are those of its square."""
    t = first_hits(surface, o, d).t
    hit = np.isfinite(t)
    p = o + np.where(hit, t, 0.0)[:, None] * d
    s = np.minimum(np.sum(p[:, :2] ** 2, axis=1), surface.aperture**2)
    slope = 2 * surface.derivatives(s)[1]
    zero, one = np.zeros(len(p)), np.ones(len(p))
    n = unit(np.stack([-slope * p[:, 0], -slope * p[:, 1], one], axis=1))
    du = 2 * surface.aperture * np.stack([one, zero, slope * p[:, 0]], axis=1)
    dv = 2 * surface.aperture * np.stack([zero, one, slope * p[:, 1]], axis=1)
    off = _numbers(si.uv) - (0.5 + p[:, :2] / (2 * surface.aperture))
    moved = np.linalg.norm(off[:, :1] * du + off[:, 1:] * dv, axis=1)
    within = np.abs(np.sqrt(s) / surface.aperture - 1) > 1e-4
    judged = hit & within & (np.abs(np.einsum("ni,ni->n", n, unit(d))) > 0.1)
    return Truth(t, p, n, du, moved, judged)


def points(rng: Rng, scale: float, places: tuple = ()) -> Iterator[Line]:
    """Surfaces near and far, small and large, beside Mitsuba's own ball in the same places.

    Errors are relative to the size of the surface.
    """
    mi.set_variant(VARIANT)
    surfaces = {cover: mb.sphere(cover=cover) for cover in ("tetrahedral", "octants", "lunes")}
    surfaces["torus"] = mb.torus(radius=0.7, tube=0.3)
    surfaces["asphere"] = ASPHERE
    for place, radius in places or PLACES:
        center = np.array(place)
        count = scaled(200_000, scale)
        start = center + 3 * radius * unit(rng.normal(size=(count, 3)))
        inner = 0.95 * np.cbrt(rng.random((count, 1))) * unit(rng.normal(size=(count, 3)))
        o, d = toward(start.astype(np.float32).astype(float), center + radius * inner)
        ray = mi.Ray3f(mi.Point3f(*_columns(o)), mi.Vector3f(*_columns(d)))
        to_world = mi.ScalarTransform4d().translate(center.tolist()).scale(radius)
        ball = mi.load_dict({"type": "scene", "ball": {"type": "sphere", "to_world": to_world}})
        si = ball.ray_intersect(ray)
        t, n = _hits(o, d, center, radius)
        # of float32 rays to a small ball far away some miss it, or nearly so
        judged = np.isfinite(t) & (np.abs(np.einsum("ni,ni->n", n, d)) > 0.1)
        truth = Truth(t / radius, n, n, *_native(si, n), judged)
        native = truth.errors(si, center, radius)
        for name, patches in surfaces.items():
            if name == "torus" and np.abs(center).max() > _FAR * radius:
                continue  # see "not met" in docs/intersection.md
            if name == "asphere":
                shape = mi.load_dict({**asphere_parameters(ASPHERE), "to_world": to_world})
            else:
                net = mi.TensorXd(patches.control_points)
                shape = mi.load_dict(
                    {"type": "beziertriangle", "control_points": net, "to_world": to_world}
                )
            pi, si = shape.ray_intersect_preliminary(ray), shape.ray_intersect(ray)
            local = (o.astype(float) - center) / radius
            if name == "asphere":
                right = _asphere(ASPHERE, si, local, d.astype(float))
            elif name == "torus":
                right = _torus(patches, pi, si, local, d.astype(float))
            else:
                right = _ball(patches, pi, si, truth)
            errors = right.errors(si, center, radius)
            lost = right.judged & ~np.array(si.is_valid())
            worst, theirs = errors.max(axis=1), native.max(axis=1)
            bad = lost | (errors > 2 * theirs[:, None]).any(axis=0)
            numbers = zip(NAMES, worst, theirs)
            yield Line(
                f"{name} at {np.abs(center).max():g}, radius {radius:g}",
                int(right.judged.sum()),
                "t, p, n, dp_du, uv: max <= 2 x that of the native ball",
                ", ".join(f"{what} {a:.1e} ({b:.1e})" for what, a, b in numbers),
                not bad.any(),
                {
                    "lost": int(lost.sum()),
                    **{f"max {what}": float(a) for what, a in zip(NAMES, worst)},
                    **{f"native max {what}": float(a) for what, a in zip(NAMES, theirs)},
                    **_means("mean", errors, right.judged),
                    **_means("native mean", native, judged),
                },
                describe(o, d, bad, *errors),
            )
            dr.sync_thread()


def _means(what: str, errors: np.ndarray, judged: np.ndarray) -> dict[str, float]:
    return {f"{what} {name}": float(e[judged].mean()) for name, e in zip(NAMES, errors)}
