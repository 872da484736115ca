"""The shape plugin ``asphere``."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...errors import BezierError
from ...geometry.aspheres import LEG, START, EvenAsphere
from ...leaves.revolution import asphere_box, make_profile
from ..interaction import Preliminary
from .beziertriangle import make_shape_class
from .parameters import read_affine
from .state import PatchState, one_of_each_size

__all__ = ["make_asphere_class"]

#: Parameters of the triangle that holds the disk, and where their corners are, in apertures.
_CORNERS = np.array([[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]])
_PLACES = _CORNERS * LEG - START


def make_asphere_class() -> type:
    """Return the class for the variant that is set now."""

    class Asphere(make_shape_class()):  # type: ignore[misc]
        r"""
        .. _shape-asphere:

        Even asphere (:monosp:`asphere`)
        --------------------------------

        .. pluginparameters::

         * - radius, curvature
           - |float|
           - Radius of the conic at the vertex, positive if its centre is at positive z; or its
             reciprocal `c` (Default: curvature 0, |exposed| as `curvature`, |differentiable|).
         * - conic
           - |float|
           - Conic constant `k`: 0 a sphere, -1 a paraboloid, below -1 a hyperboloid
             (Default: 0, |exposed|, |differentiable|).
         * - coefficients
           - |string| or |tensor|
           - :math:`a_1, a_2, \ldots`: as many numbers as there are
             (Default: none, |exposed|, |differentiable|).
         * - aperture
           - |float|
           - Radius of the rim (Default: 1).
         * - inner_radius
           - |float|
           - Radius of a hole around the axis (Default: 0).
         * - to_world
           - |transform|
           - Affine map from object to world space (Default: none, |exposed|, |differentiable|).
         * - instances, instances_filename, section, body, cap
           - |tensor|, |string|, |int|
           - As for :monosp:`beziertriangle`.
         * - flip_normals
           - |bool|
           - Turn the normals, which are towards positive z (Default: |false|).
         * - (Nested plugin)
           - |bsdf|, |emitter|, |medium|
           - As for Mitsuba's own shapes.

        The surface over a disk or ring around the z axis with the sag
        :math:`z = c r^2 / (1 + \sqrt{1 - (1 + k) c^2 r^2}) + a_1 r^2 + a_2 r^4 + a_3 r^6 + \ldots`,
        as optical design programs have it. Rays meet it itself, within proved bounds; no
        approximation by patches or facets takes part. Its ``prim_index`` is 0, and its ``uv`` are
        those of a rectangle around the disk: ``u = 0.5 + x / (2 aperture)``, ``v`` of y.
        """

        def __init__(self, props: mi.Properties) -> None:
            surface = _read(props)
            self.asphere = surface
            self._shown = _numbers(surface)
            self._set_parameters()
            place = _PLACES * surface.aperture
            net = np.column_stack([place, np.zeros(3), np.ones(3)])
            props["control_points"] = mi.TensorXd(net.ravel(), shape=(1, 3, 4))
            texcoords = 0.5 + 0.5 * _PLACES
            props["texcoords"] = mi.TensorXd(texcoords.ravel(), shape=(1, 3, 2))
            super().__init__(props)

        def _state(self, *args: Any) -> PatchState:
            return _AsphereState(self.asphere, *args)

        def _set_parameters(self) -> None:
            curvature, conic, coefficients = self._shown
            self.curvature, self.conic = mi.Float(curvature), mi.Float(conic)
            self.coefficients = _tensor(coefficients)

        @property
        def sag_parameters(self) -> tuple[Any, ...]:
            """Curvature, conic and coefficients, as users see them."""
            return self.curvature, self.conic, self.coefficients

        # ------------------------------------------------------------ mi.Object

        def _traverse(self, cb: Any) -> None:
            edges = mi.ParamFlags.Differentiable | mi.ParamFlags.Discontinuous
            for name in ("curvature", "conic", "coefficients", "to_world"):
                cb.put(name, getattr(self, name), edges)
            self._traverse_children(cb)

        def _changed(self, keys: Any) -> None:
            own = {"curvature", "conic", "coefficients", "to_world"}
            if keys and not own & set(keys):
                return
            old = self.asphere
            # float64 numbers stay as long as nobody changed what float32 shows of them
            shown = [float(np.array(x).ravel()[0]) for x in (self.curvature, self.conic)]
            given = [
                b if np.float32(b) == np.float32(a) else a
                for a, b in zip(shown, (old.curvature, old.conic))
            ]
            terms = np.array(self.coefficients, dtype=np.float64).ravel().tolist()
            known = [*old.coefficients, *[0.0] * len(terms)]
            terms = [b if np.float32(b) == np.float32(a) else a for a, b in zip(terms, known)]
            try:
                surface = EvenAsphere(given[0], old.aperture, given[1], terms, old.inner)
                matrix = read_affine(self.to_world)
            except BezierError:
                self._restore()
                raise
            if np.array_equal(matrix, self.state.object_to_world.astype(np.float32)):
                matrix = self.state.object_to_world
            self.asphere, self._shown = surface, _numbers(surface)
            self.state.surface = surface
            self.state.place(self.state.object_patches, matrix)
            self._commit()

        def _restore(self) -> None:
            """Give all parameters their last valid values."""
            super()._restore()
            curvature, conic, coefficients = self._shown
            mi.set_property(self.curvature, mi.Float(curvature))
            mi.set_property(self.conic, mi.Float(conic))
            mi.set_property(self.coefficients, _tensor(coefficients))

        def to_string(self) -> str:
            s = self.asphere
            return (
                f"Asphere[\n  curvature = {s.curvature},\n  conic = {s.conic},\n"
                f"  coefficients = {list(s.coefficients)},\n  aperture = {s.aperture},\n"
                f"  inner_radius = {s.inner},\n  bbox = {self.bbox()},\n  bsdf = {self.bsdf()}\n]"
            )

        __repr__ = to_string

        # ------------------------------------------------------------ mi.Shape

        def bbox(self, index: Any = None, clip: Any = None) -> Any:
            """Return the box of the shape, clipped to another box if given."""
            if index is not None and int(index) != 0:
                raise BezierError.expected("index", "0", repr(index))
            box = mi.ScalarBoundingBox3f(*self.state.box.tolist())
            if clip is not None:
                box.clip(clip)
            return box

        def write_ply(self, filename: Any) -> None:
            """Refuse: an asphere is no set of patches."""
            raise BezierError.expected("write_ply", "a beziertriangle", "an asphere")

        def add_attribute(self, name: str, size: int, buffer: Any) -> None:
            """Refuse: attributes belong to patches."""
            raise BezierError.expected("add_attribute", "a beziertriangle", "an asphere")

        def eval_parameterization(self, uv: Any, flags: Any = None, active: Any = True) -> Any:
            """Return the interaction at texture coordinates; invalid beyond the rims."""
            flags = mi.RayFlags.All if flags is None else flags
            uv = mi.Point2f(uv)
            x, y = 2.0 * uv.x - 1.0, 2.0 * uv.y - 1.0
            r = dr.sqrt(dr.fma(x, x, y * y))
            inside = mi.Bool(active) & (r <= 1) & (r >= self.asphere.inner / self.asphere.aperture)
            pi = dr.zeros(mi.PreliminaryIntersection3f, dr.width(uv))
            pi.prim_uv, pi.valid = mi.Point2f((x + START) / LEG, (y + START) / LEG), inside
            pi.shape = mi.ShapePtr(self)
            ray = dr.zeros(mi.Ray3f, dr.width(uv))
            ray.o = mi.Point3f(dr.largest(mi.Float))  # no ray knows the point better
            hit = Preliminary(pi, inside, mi.UInt32(0))
            si = self._alone().surface_interaction(hit, ray, flags, inside)
            si.t = dr.select(inside, 0.0, dr.inf)
            return si

    return Asphere


class _AsphereState(PatchState):
    """Where an asphere is."""

    def __init__(self, surface: EvenAsphere, *args: Any) -> None:
        self.surface = surface
        super().__init__(*args)

    def place(self, patches: Any, matrix: np.ndarray) -> None:
        """Take over where it is."""
        super().place(patches, matrix)
        profile, size = make_profile(self.surface), self.surface.aperture
        self.box = asphere_box(profile, size, matrix)
        if self.instances is not None:
            boxes = np.array([asphere_box(profile, size, m @ matrix) for m in self.instances])
            self.instance_boxes = boxes
            self.box = np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])

    def area(self) -> float:
        """Return the area of all."""
        linear = self.object_to_world[:3, :3]
        if self.instances is None:
            return self.surface.area(linear)
        maps, count = one_of_each_size(self.instances)
        return float(np.dot([self.surface.area(m[:3, :3] @ linear) for m in maps], count))


def _tensor(coefficients: tuple[float, ...]) -> Any:
    # tensors of no numbers are none, so an empty list is one zero
    return mi.TensorXf(np.array(coefficients or (0.0,), dtype=np.float32))


def _numbers(surface: EvenAsphere) -> tuple[float, float, tuple[float, ...]]:
    return surface.curvature, surface.conic, tuple(surface.coefficients)


def _read(props: mi.Properties) -> EvenAsphere:
    """Take the asphere out of the properties."""

    def number(name: str, default: float) -> float:
        value = props.get(name, default)
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise BezierError.expected(name, "a number", repr(value))
        return float(value)

    if "radius" in props and "curvature" in props:
        raise BezierError.expected("asphere", "at most one of radius and curvature", "both")
    curvature = number("curvature", 0.0)
    if "radius" in props:
        radius = number("radius", np.inf)
        if radius == 0 or np.isnan(radius):
            raise BezierError.expected("radius", "a number other than 0", radius)
        curvature = 1 / radius
    if "control_points" in props or "filename" in props:
        raise BezierError.expected(
            "asphere", "no net (that is beziertriangle)", "control_points or filename"
        )
    surface = EvenAsphere(
        curvature,
        number("aperture", 1.0),
        number("conic", 0.0),
        _read_coefficients(props),
        number("inner_radius", 0.0),
    )
    for name in ("curvature", "radius", "aperture", "conic", "coefficients", "inner_radius"):
        if name in props:
            del props[name]
    return surface


def _read_coefficients(props: mi.Properties) -> list[float]:
    if "coefficients" not in props:
        return []
    value = props["coefficients"]
    try:
        if isinstance(value, str):
            return [float(word) for word in value.replace(",", " ").split()]
        if isinstance(value, (int, float)):
            return [float(value)]
        return np.array(value, dtype=np.float64).ravel().tolist()
    except (TypeError, ValueError):
        raise BezierError.expected("coefficients", "numbers", repr(value)[:80]) from None
