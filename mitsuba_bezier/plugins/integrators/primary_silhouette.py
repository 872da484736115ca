"""Derivatives of an image by the motion of the silhouettes that the camera sees."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...errors import BezierError
from ..attached import attached_tables, is_attached
from ..interaction import Preliminary
from ..scene import SceneRays
from ..silhouette import Discrete, SilhouetteCurves
from .path_tracing import trace

__all__ = ["FilmMap", "primary_silhouette_image", "splatted", "surface_at"]

#: How far to the side of a curve the background is looked up, in pixels: far above the rounding
#: of film positions in float32, far below what an image shows.
_ASIDE = 2e-3
#: Cosine at which a contour is seen instead of 0, where no BSDF is defined.
_GRAZING = 1e-3


class FilmMap:
    """The projection of a perspective camera onto its film, in pixels of the crop window."""

    def __init__(self, sensor: Any) -> None:
        if not str(sensor).startswith("PerspectiveCamera"):
            raise BezierError.expected(
                "sensor", "a perspective camera for derivatives of silhouettes", str(sensor)
            )
        self.sensor = sensor
        self.size = mi.Vector2f(mi.ScalarVector2f(sensor.film().crop_size()))
        to_world = sensor.world_transform()
        self.matrix = mi.Matrix4f(sensor.projection_transform().matrix) @ mi.Matrix4f(
            to_world.inverse().matrix
        )
        self.eye = np.array(to_world @ mi.Point3f(0), dtype=np.float64).reshape(3)

    def position(self, p: Any) -> tuple[Any, Any]:
        """Return film position, and whether the point is in front of the camera and seen."""
        h = self.matrix @ mi.Vector4f(p.x, p.y, p.z, 1)
        ndc = mi.Vector2f(h.x, h.y) / h.w
        seen = (h.w > 0) & (ndc.x >= 0) & (ndc.x <= 1) & (ndc.y >= 0) & (ndc.y <= 1)
        return ndc * self.size, seen

    def differential(self, p: Any, d: Any) -> Any:
        """Return how the film position of `p` changes along `d`."""
        h = self.matrix @ mi.Vector4f(p.x, p.y, p.z, 1)
        dh = self.matrix @ mi.Vector4f(d.x, d.y, d.z, 0)
        ndc = mi.Vector2f(h.x, h.y) / h.w
        return (mi.Vector2f(dh.x, dh.y) - ndc * dh.w) / h.w * self.size

    def lengths(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Return the lengths on the film of the chords from `a` to `b`, 0 where none is seen."""
        matrix = np.array(self.matrix, dtype=np.float64).reshape(4, 4, -1)[..., 0]
        size = np.array(self.size, dtype=np.float64).reshape(2)
        h = [np.concatenate([x, np.ones((len(x), 1))], axis=1) @ matrix.T for x in (a, b)]
        with np.errstate(divide="ignore", invalid="ignore"):
            xy = [x[:, :2] / x[:, 3:] * size for x in h]
            length = np.linalg.norm(xy[1] - xy[0], axis=1)
        front = (h[0][:, 3] > 0) & (h[1][:, 3] > 0)
        # a curve leaves its chord by less than the chord's length
        room = length[:, None] + 1
        outside = ((np.maximum(*xy) < -room) | (np.minimum(*xy) > size + room)).any(axis=1)
        # behind the camera at one end: some weight, since nothing is known
        length = np.where(front, length, np.where((h[0][:, 3] > 0) | (h[1][:, 3] > 0), 1.0, 0.0))
        return np.where((front & outside) | ~np.isfinite(length), 0.0, length)

    def ray(self, sampler: Any, film: Any, wavelength_sample: Any) -> tuple[Any, Any]:
        """Return the camera's ray through a film position, and its weight."""
        time = self.sensor.shutter_open()
        ndc = mi.Point2f(film / self.size)
        return self.sensor.sample_ray(time, wavelength_sample, ndc, mi.Point2f(0.5))


def primary_silhouette_image(integrator: Any, scene: Any, sensor: Any, seed: Any, spp: int) -> Any:
    """Return an image without values that has the derivatives of the silhouettes.

    Where a curve moves on the film, the pixel changes by the difference of the radiances on its
    two sides times its speed across; this is integrated along the curves by sampling them
    uniformly on the film. Difference and sampling have no derivatives, the speed is that of the
    point of the surface.

    Parameters
    ----------
    integrator : BezierPath
    scene : mi.Scene
    sensor : mi.Sensor
    seed : int
    spp : int
        Samples per pixel of the film.

    Returns
    -------
    TensorXf or None
        None if nothing moves that the camera can see.
    """
    rays = SceneRays(scene)
    data = rays.data
    numbers = [i for i, s in enumerate(data.shapes) if is_attached(s)] if data else []
    if not numbers:
        return None
    assert data is not None
    film = sensor.film()
    camera = FilmMap(sensor)
    curves = SilhouetteCurves(data, numbers, camera.eye)
    lengths = camera.lengths(*curves.ends())
    if not lengths.sum() > 0:
        return None
    choice = Discrete(lengths)

    with dr.suspend_grad():
        sampler, spp = integrator.prepare(sensor, 0xFFFFFFFF ^ seed, spp, [])
        index, s, pmf = choice.sample(sampler.next_1d(), mi.Bool(True))
        point = curves.point(index, s, mi.Bool(True))
        position, seen = camera.position(point.p)
        along = camera.differential(point.p, point.tangent)
        across = mi.Vector2f(along.y, -along.x)
        outwards = camera.differential(point.p, point.n)
        across = dr.select(dr.dot(across, outwards) < 0, -across, across)
        active = point.valid & seen & (pmf > 0)
        wavelength_sample = sampler.next_1d() if mi.is_spectral else mi.Float(0)
        difference, wavelengths, active = _difference(
            integrator, rays, camera, sampler, point, position, across, wavelength_sample, active
        )
        count = dr.prod(film.crop_size()) * spp  # a pixel has area 1
        scale = dr.select(active, point.weight / (pmf * count), 0.0)

    tables = attached_tables(data.tables, data.shapes)
    p = curves.moving(tables, point, active)
    moving, _seen = camera.position(dr.select(active, p, point.p))
    motion = dr.replace_grad(mi.Float(0), dr.dot(moving, across))
    value = difference * dr.select(active, motion * scale, 0.0)

    on_film = mi.Point2f(position + mi.Vector2f(mi.ScalarVector2f(film.crop_offset())))
    return splatted(film, on_film, wavelengths, value, spp, active)


def splatted(film: Any, position: Any, wavelengths: Any, value: Any, spp: int, active: Any) -> Any:
    """Return the image of values that are added to the film where they belong, without weight."""
    block = film.create_block(normalize=True)
    block.set_coalesce(block.coalesce() and spp >= 4)
    block.put(
        pos=position,
        wavelengths=wavelengths,
        value=value,
        weight=0,
        alpha=1,
        active=active,
    )
    film.put_block(block)
    return film.develop()


def surface_at(
    data: Any, point: Any, d: Any, distance: Any, ray: Any, active: Any
) -> tuple[Any, Preliminary]:
    """Return a ray in direction `d` that hits a contour from just above its tangent plane.

    Parameters
    ----------
    data : SceneData
    point : SilhouettePoint or BoundarySample
    d : Vector3f
    distance : Float
        Where the ray begins before the point.
    ray : mi.Ray3f
        From which wavelengths and time are taken.
    active : Bool

    Returns
    -------
    ray, hit
    """
    out = mi.Ray3f(ray)
    out.d = dr.select(point.is_edge, d, dr.normalize(d - _GRAZING * point.n))
    out.o = point.p - distance * out.d
    hit = Preliminary(dr.zeros(mi.PreliminaryIntersection3f), mi.Bool(active), point.patch)
    hit.pi.valid, hit.pi.t = mi.Bool(active), distance
    hit.pi.prim_uv = mi.Point2f(point.u, point.v)
    hit.pi.shape, hit.pi.prim_index = data.owner(point.patch, active)
    hit.pi.shape_index = point.instance
    return out, hit


def _difference(
    integrator: Any,
    rays: SceneRays,
    camera: FilmMap,
    sampler: Any,
    point: Any,
    position: Any,
    across: Any,
    wavelength_sample: Any,
    active: Any,
) -> tuple[Any, Any, Any]:
    """Return radiance of the surface less that of the background, wavelengths, whether seen."""
    data = rays.data
    assert data is not None
    aside = _ASIDE * dr.normalize(across)
    # where the curve is seen end-on, there is no side
    active = active & (dr.squared_norm(across) > 0)
    if integrator.hide_emitters:
        shape, _index = data.owner(point.patch, active)
        active = active & (shape.emitter() == None)  # noqa: E711
    outer, weight = camera.ray(sampler, position + aside, wavelength_sample)
    inner, _weight = camera.ray(sampler, position - aside, wavelength_sample)

    # hidden behind something else, which both rays would meet
    distance = dr.norm(point.p - outer.o)
    first = rays.preliminary(outer, True, active)
    second = rays.preliminary(inner, True, active & point.is_edge)
    near = distance * (1 - 1e-3)
    active = active & ~(dr.select(point.is_edge, second.pi.t, first.pi.t) < near)

    background, _valid = trace(integrator, rays.scene, sampler, outer, active, first)
    d = dr.normalize(point.p - outer.o)
    grazing, start = surface_at(data, point, d, distance, outer, active)
    # an edge from inside
    start = dr.select(point.is_edge, second, start)
    ray = dr.select(point.is_edge, inner, grazing)
    foreground, _valid = trace(integrator, rays.scene, sampler, ray, active, start)
    return (foreground - background) * weight, outer.wavelengths, active
