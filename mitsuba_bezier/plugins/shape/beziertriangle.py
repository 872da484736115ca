"""The shape plugin ``beziertriangle``."""

from __future__ import annotations

import itertools
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ... import _runtime
from ...errors import BezierError, NetError
from ...geometry.boxes import surface_boxes
from ...geometry.proper_nets import free_of_factor, spans_area
from ...geometry.surface_area import surface_area
from ...geometry.triangles import BezierTriangles
from ...geometry.trims import Trims
from ..copies import copy_boxes, read_copies
from ..interaction import Preliminary
from ..native.sensors import watch
from ..projections import read_projection
from ..section import read_section
from ..surface_sampling import direction_sample
from .attributes import check_attribute, check_texcoords, is_attribute, make_attribute_class
from .mesh_base import make_mesh_base
from .parameters import read_affine, read_patches, read_tables
from .silhouette_methods import METHODS

__all__ = ["make_shape_class"]

#: Powers of two, either way, up to which factors of nets do no harm in float32: what is computed of
#: them has products of three.
_MODERATE = 24
#: Relative rounding of float32, and some more: numbers that lose more have left its range.
_DIGITS = 2.0**-20
#: Numbers of a box are at most this: Mitsuba squares its size in float32.
_FAR = 1e18
_versions = itertools.count(1)


class _State:
    """Numbers that change with a shape, where frozen functions do not see them; see `frozen`."""

    version = 0
    updates = -1


def make_shape_class() -> type:
    """Return the class for the variant that is set now."""
    attribute_class = make_attribute_class()

    base = make_mesh_base()

    class BezierTriangle(base):  # type: ignore[misc, valid-type]
        r"""
        .. _shape-beziertriangle:

        Rational Bézier triangles (:monosp:`beziertriangle`)
        ----------------------------------------------------

        .. pluginparameters::

         * - control_points
           - |tensor|
           - Homogeneous control points :math:`(wx, wy, wz, w)` of shape ``(P, K, 4)`` with
             ``K = (n+1)(n+2)/2`` (|exposed|, |differentiable|, |discontinuous|). Weights may
             be negative; ``(x, y, z, 0)`` is a point at infinity.
         * - filename
           - |string|
           - A file of Bézier triangles instead; see `mitsuba_bezier.load`. A ``.vtu`` file may
             hold texture coordinates and attributes too.
         * - to_world
           - |transform|
           - Affine map from object to world space (Default: none, |exposed|).
         * - copies
           - |tensor|
           - Affine maps of shape ``(N, 3, 4)`` or ``(N, 4, 4)``: the surface appears `N` times,
             each map applied after `to_world`, and takes the memory of one (Default: once, as it
             is). Shapes with copies cannot carry an emitter.
         * - copies_filename
           - |string|
           - A ``.npy`` file of these maps instead, or a text file with twelve numbers a line.
         * - section
           - |string|
           - Four numbers ``a b c d``: only what has :math:`ax + by + cz \le d` is there (Default:
             all of it). All Bézier shapes of a scene have the same.
         * - body, cap
           - |int|
           - Shapes of one number ``body`` are one closed body; ``cap`` marks the plane triangle
             that closes it where it is cut, 1 if its normals point outwards, -1 inwards.
         * - flip_normals
           - |bool|
           - Turn the normals, which follow :math:`\partial_u p \times \partial_v p`
             (Default: |false|).
         * - texcoords
           - |tensor|
           - Texture coordinates at the corners A, B, C of each patch, of shape ``(P, 3, 2)``;
             they are affine in :math:`(u, v)` over the patch (Default: :math:`(u, v)`
             itself, |exposed|).
         * - uv
           - |string|
           - Texture coordinates and partials of Mitsuba's own shapes instead, of the point in
             object space: :monosp:`spherical` those of `sphere` of radius 1 around the origin,
             :monosp:`cylindrical` of `cylinder`, :monosp:`planar` of `rectangle`,
             :monosp:`polar` of `disk` (Default: none).
         * - face_*NAME*
           - |tensor|
           - An attribute per patch, of shape ``(P,)``, ``(P, 1)`` or ``(P, 3)`` (|exposed|,
             |differentiable|).
         * - vertex_*NAME*
           - |tensor|
           - An attribute given by the ordinates of a Bernstein polynomial on each patch, of
             shape ``(P, K)``, ``(P, K, 1)`` or ``(P, K, 3)`` with ``K = (m+1)(m+2)/2`` for any
             degree ``m >= 1``: one a control point, or ``K = 3``, one a corner (|exposed|,
             |differentiable|).
         * - (Nested plugin)
           - |bsdf|, |emitter|, |medium|, |texture|
           - As for Mitsuba's own shapes.

        Rays meet the patches themselves. Mitsuba's C++ integrators do not see them: use
        `bezierpath`.

        A hit's ``prim_index`` is the patch. Its ``uv`` are the texture coordinates, and
        ``dp_du``, ``dn_du``, ... are partials by them; the barycentric parameters remain in
        ``prim_uv`` of the preliminary intersection. The texture `mesh_attribute` gives
        attributes to BSDFs and emitters; `add_attribute` adds them later.
        """

        def __init__(self, props: mi.Properties) -> None:
            _runtime.check(mi.variant())
            #: Trims of the patches, or None.
            self.trims: Trims | None
            patches, self.trims = read_patches(props)
            self._object_to_world = read_affine(props.get("to_world", mi.ScalarTransform4f()))
            flip = props.get("flip_normals", False)
            if not isinstance(flip, bool):
                raise BezierError.expected("flip_normals", "true or false", repr(flip))
            #: Maps (N, 4, 4) of the copies, or None.
            self.copies = read_copies(props)
            #: The plane that cuts it, the number of its body, and whether it is that body's cap.
            self.section, self.body, self.cap = read_section(props)
            #: Name of the projection that texture coordinates come from, or None.
            self.projection = read_projection(props)
            texcoords, attributes = read_tables(props, len(patches))
            if self.projection is not None:
                texcoords = None  # a file's
                for name in attributes:
                    self._need_parameters(name)
            for key in ("control_points", "filename", "to_world", "flip_normals", "texcoords"):
                if key in props:
                    del props[key]
            super().__init__(props)
            emitter = self.emitter()
            if emitter is not None and not mi.has_flag(emitter.flags(), mi.EmitterFlags.Surface):
                raise BezierError.expected(
                    "emitter",
                    "one that sits on a surface, as area does",
                    f"{emitter.class_name()}; put it beside the shape",
                )
            if emitter is not None and self.copies is not None:
                raise BezierError.expected("emitter", "none on a shape with copies", "one")
            if self.sensor() is not None:
                if self.copies is not None:
                    raise BezierError.expected("sensor", "none on a shape with copies", "one")
                watch(self.sensor(), "irradiancemeter", self)
            self._flip = flip
            self._need_area(patches)
            #: What `control_points` holds, in float32.
            self._exposed = representable(patches.control_points)
            self.control_points = _tensor(self._exposed)
            self.to_world = mi.Transform4f(mi.Matrix4f(self._object_to_world.tolist()))
            self._object = patches
            #: Texture coordinates at the corners (P, 3, 2), or None.
            self.texture_corners = texcoords
            self.texcoords = None if texcoords is None else _tensor(texcoords)
            self._attributes: dict[str, Any] = {}
            #: Patches and leaves of the last structure, for the next, once there were updates.
            self.kept_leaves: tuple[BezierTriangles, Any] | None = None
            self._state = _State()
            self.serial = next(_versions)
            #: The variant in which it can be used.
            self.variant = mi.variant()
            #: Degree elevations on the device, by their degrees; see `attached`.
            self.elevations: dict[str, Any] = {}
            self._keep_apart()
            self._commit(patches, self._object_to_world)
            for name, ordinates in attributes.items():
                self._add(name, ordinates)

        @property
        def version(self) -> int:
            """A number that no other state of any shape has."""
            return self._state.version

        @property
        def updates(self) -> int:
            """How often the shape was changed."""
            return self._state.updates

        def _commit(self, patches: BezierTriangles, matrix: np.ndarray) -> None:
            """Take over a new valid state."""
            world = _free(patches).transform(matrix)
            self._object, self._object_to_world, self.patches = patches, matrix, world
            mirrored = np.linalg.det(matrix[:3, :3]) < 0
            #: Sign of the normal along dp_du x dp_dv: a mirror image keeps its outside out.
            self.orientation = -1.0 if mirrored != self._flip else 1.0
            box = finite_bounds(world)
            if self.copies is not None:
                #: Boxes (N, 2, 3) of the copies.
                self.copy_boxes = copy_boxes(world, self.copies)
                box = np.stack(
                    [self.copy_boxes[:, 0].min(axis=0), self.copy_boxes[:, 1].max(axis=0)]
                )
            self._state.version = next(_versions)
            #: Arrays of the structures that this state is a part of; see `frozen`.
            self.device_arrays: dict[str, dict[str, Any]] = {}
            self._state.updates += 1
            self._set_box(box)

        @property
        def object_to_world(self) -> np.ndarray:
            """The matrix ``(4, 4)`` of ``to_world``, in float64."""
            return self._object_to_world

        @property
        def object_patches(self) -> BezierTriangles:
            """The patches before ``to_world``."""
            return self._object

        def _need_parameters(self, name: str) -> None:
            """Refuse an attribute that is found by what `uv` replaces."""
            if self.projection is not None and name.startswith("vertex_"):
                raise BezierError.expected(
                    name,
                    "a shape without uv, for this attribute is found by the parameters of patches "
                    "or by texcoords (face_... is for any shape)",
                    f'uv "{self.projection}"',
                )

        def _need_area(self, patches: BezierTriangles) -> None:
            """Refuse nets that are no surface where there is to be an emitter on it."""
            if self.emitter() is not None and not spans_area(patches.control_points).any():
                raise NetError.expected(
                    "control_points", "a surface, for it carries an emitter", "points or curves"
                )

        # ------------------------------------------------------------ mi.Object

        def _traverse(self, cb: Any) -> None:
            edges = mi.ParamFlags.Differentiable | mi.ParamFlags.Discontinuous
            cb.put("control_points", self.control_points, edges)
            cb.put("to_world", self.to_world, edges)
            if self.texcoords is not None:
                cb.put("texcoords", self.texcoords, mi.ParamFlags.NonDifferentiable)
            for name, (values, _texture) in self._attributes.items():
                cb.put(name, values, mi.ParamFlags.Differentiable)
            for name, child in (
                ("bsdf", self.bsdf()),
                ("emitter", self.emitter()),
                ("interior_medium", self.interior_medium()),
                ("exterior_medium", self.exterior_medium()),
            ):
                if child is not None:
                    cb.put(name, child, mi.ParamFlags.Differentiable)

        def _changed(self, keys: Any) -> None:
            own = {"control_points", "to_world", "texcoords"}
            if keys and not (own | set(self._attributes)) & set(keys):
                return
            tensor = self.control_points
            values = np.array(tensor, dtype=np.float64).reshape(tensor.shape)
            try:
                # float64 values from a file or a builder stay, as long as nobody changed them
                same = np.array_equal(values.astype(np.float32), self._exposed)
                patches = self._object if same else BezierTriangles(values)
                self._need_area(patches)
                matrix, count = read_affine(self.to_world), len(patches)
                if np.array_equal(matrix, self._object_to_world.astype(np.float32)):
                    matrix = self._object_to_world
                if self.trims is not None and count != len(self.trims):
                    raise NetError.expected(
                        "control_points", f"{len(self.trims)} patches, as the trims have", count
                    )
                corners = self.texture_corners
                if self.texcoords is not None:
                    corners = check_texcoords(self.texcoords, count)
                ordinates = {
                    name: check_attribute(name, values, count)
                    for name, (values, _texture) in self._attributes.items()
                }
                for _values, texture in self._attributes.values():
                    texture.place_by(corners)
            except BezierError:
                self._restore()
                raise
            for name, (values, texture) in self._attributes.items():
                texture.set(ordinates[name], values.array)
            self.texture_corners = corners
            self._exposed = self._exposed if same else values.astype(np.float32)
            if not keys or own & set(keys):
                self._commit(patches, matrix)

        def _restore(self) -> None:
            """Give all parameters their last valid values, in the objects that users hold."""
            matrix = mi.Matrix4f(self._object_to_world.tolist())
            mi.set_property(self.control_points, _tensor(self._exposed))
            mi.set_property(self.to_world, mi.Transform4f(matrix))
            if self.texture_corners is not None:
                mi.set_property(self.texcoords, _tensor(self.texture_corners))
            for values, texture in self._attributes.values():
                texture.place_by(self.texture_corners)
                mi.set_property(values, _tensor(texture.public))

        def to_string(self) -> str:
            return (
                f"BezierTriangle[\n  patches = {len(self.patches)},\n"
                f"  degree = {self.patches.degree},\n  bbox = {self.bbox()},\n"
                f"  bsdf = {self.bsdf()}\n]"
            )

        __repr__ = to_string

        # ------------------------------------------------------------ mi.Shape

        def primitive_count(self) -> int:
            return len(self.patches)

        effective_primitive_count = primitive_count

        def bbox(self, index: Any = None, clip: Any = None) -> Any:
            """Return the box of the shape, or of one patch, clipped to another box if given."""
            if index is None:
                return super().bbox()
            if not 0 <= int(index) < len(self.patches):
                raise BezierError.expected("index", f"0 to {len(self.patches) - 1}", repr(index))
            low, high = finite_bounds(self.patches[[int(index)]])
            box = mi.ScalarBoundingBox3f(low.tolist(), high.tolist())
            if clip is not None:
                box.clip(clip)
            return box

        def eval_parameterization(self, uv: Any, flags: Any = None, active: Any = True) -> Any:
            """Return the interaction at parameters of the patch.

            Raises
            ------
            BezierError
                If the shape has several patches, or texture coordinates of its own: the same
                coordinates may be anywhere then, or nowhere.
            """
            placed = self.texture_corners is not None or self.projection is not None
            if len(self.patches) > 1 or placed:
                raise BezierError.expected(
                    "eval_parameterization",
                    "a shape of one patch without texcoords and uv (elsewhere evaluate "
                    "`shape.patches`)",
                    f"{len(self.patches)} patches"
                    + (" with texcoords" if self.texture_corners is not None else "")
                    + (" with uv" if self.projection is not None else ""),
                )
            flags = mi.RayFlags.All if flags is None else flags
            uv, active = mi.Point2f(uv), mi.Bool(active)
            inside = active & (uv.x >= 0) & (uv.y >= 0) & (uv.x + uv.y <= 1)
            pi = dr.zeros(mi.PreliminaryIntersection3f, dr.width(uv))
            pi.t, pi.prim_uv, pi.valid = mi.Float(0.0), uv, inside
            pi.shape = mi.ShapePtr(self)
            hit = Preliminary(pi, inside, mi.UInt32(0))
            ray = dr.zeros(mi.Ray3f, dr.width(uv))
            ray.o = mi.Point3f(dr.largest(mi.Float))  # no ray tells the point better than the patch
            si = self._alone().surface_interaction(hit, ray, flags, inside)
            si.t = dr.select(inside, 0.0, dr.inf)
            return si

        def write_ply(self, filename: Any) -> None:
            """Write triangles to a file, within a thousandth of the shape's size."""
            from ...io import save

            low, high = finite_bounds(self.patches)
            error = 1e-3 * float(np.linalg.norm(high - low))
            mi.Log(
                mi.LogLevel.Info,
                f"write_ply: the patches become triangles within {error:.3g} of the surface; "
                "mitsuba_bezier.io.save has an option for it",
            )
            save(self.patches, str(filename), chord_error=error)

        def add_attribute(self, name: str, size: int, buffer: Any) -> None:
            """Add an attribute, as `mi.Mesh` does.

            Parameters
            ----------
            name : str
                ``face_...`` for one entry a patch, ``vertex_...`` for Bernstein ordinates.
            size : int
                Numbers of an entry: 1 or 3.
            buffer : sequence of float
                All numbers, patch by patch.
            """
            if not is_attribute(name):
                raise BezierError.expected(
                    "name", 'an attribute "face_..." or "vertex_..."', repr(name)
                )
            if self.has_attribute(name):
                raise BezierError.expected("name", "the name of a new attribute", repr(name))
            self._need_parameters(name)
            values = np.array(buffer, dtype=np.float64).ravel()
            count = len(self.patches)
            if size not in (1, 3) or len(values) == 0 or len(values) % (count * size):
                raise BezierError.expected(
                    name,
                    f"size 1 or 3 and a multiple of {count} * size numbers, for {count} patches",
                    f"size {size} and {len(values)} numbers",
                )
            face = name.startswith("face_")
            shape = (len(values) // size, size) if face else (count, -1, size)
            self._add(name, check_attribute(name, values.reshape(shape), count))

        def remove_attribute(self, name: str) -> None:
            """Remove an attribute."""
            super().remove_attribute(name)
            self._attributes.pop(name, None)

        def _add(self, name: str, ordinates: np.ndarray) -> None:
            texture = attribute_class(name, ordinates)
            texture.place_by(self.texture_corners)
            self.add_texture_attribute(name, texture)
            self._attributes[name] = (_tensor(texture.public), texture)

        def surface_area(self) -> Any:
            """Return the area, to about 1e-3 where patches are trimmed.

            It is infinite for a surface that runs to infinity.
            """
            if self.copies is None:
                return mi.Float(surface_area(self.patches, self.trims))
            # rigid copies of one size have one area
            linear = self.copies[:, :3, :3]
            forms = np.einsum("nki,nkj->nij", linear, linear).reshape(-1, 9)
            _forms, first, count = np.unique(
                np.round(forms, 12), axis=0, return_index=True, return_counts=True
            )
            areas = [
                surface_area(self.patches.transform(m), self.trims) for m in self.copies[first]
            ]
            return mi.Float(float(np.dot(areas, count)))

        def sample_position(self, time: Any, sample: Any, active: Any = True) -> Any:
            """Sample the surface nearly by area; return `mi.PositionSample3f`."""
            return self.sample_point(time, sample, active)[0]

        def sample_point(self, time: Any, sample: Any, active: Any = True) -> tuple[Any, Any]:
            """Return what `sample_position` does, and the error of the point along the normal."""
            sampling, active = self._alone().surface_sampling((0,)), mi.Bool(active)
            place = sampling.sample_parameters(mi.UInt32(0), mi.Point2f(sample), active)
            ps, p_err = sampling.position_and_error(*place, active)
            ps.time = time
            return ps, p_err

        def pdf_position(self, ps: Any, active: Any = True) -> Any:
            """Return the density of `sample_position`; reads ``ps.p`` and ``ps.n``."""
            sampling = self._alone().surface_sampling((0,))
            return sampling.pdf_at(mi.UInt32(0), ps.p, ps.n, active)

        def sample_direction(self, it: Any, sample: Any, active: Any = True) -> Any:
            """Sample a direction towards the surface; return `mi.DirectionSample3f`."""
            return direction_sample(self.sample_position(it.time, sample, active), it)

        def pdf_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
            """Return the density of `sample_direction` by solid angle."""
            cosine = dr.abs(dr.dot(ds.d, ds.n))
            pdf = self.pdf_position(ds, active) * dr.square(ds.dist) / cosine
            return dr.select(cosine > 0, pdf, 0.0)

        def _alone(self) -> Any:
            from ..scene_data import data_for_shapes

            return data_for_shapes([self])

        def ray_intersect_preliminary(self, ray: Any, active: Any = True) -> Any:
            """Return the nearest hit as `mi.PreliminaryIntersection3f`."""
            data = self._alone()
            data.handed_out = True
            return data.preliminary(ray, active).pi

        def ray_intersect(self, ray: Any, flags: Any = None, active: Any = True) -> Any:
            """Return the nearest hit as `mi.SurfaceInteraction3f`."""
            data = self._alone()
            hit = data.preliminary(ray, active)
            flags = mi.RayFlags.All if flags is None else flags
            return data.surface_interaction(hit, ray, flags, active)

        def compute_surface_interaction(
            self, ray: Any, pi: Any, flags: Any = None, active: Any = True
        ) -> Any:
            """Return the `mi.SurfaceInteraction3f` of what `ray_intersect_preliminary` found."""
            flags = mi.RayFlags.All if flags is None else flags
            hit = Preliminary(pi, pi.is_valid(), pi.prim_index)
            return self._alone().surface_interaction(hit, ray, flags, active)

        def ray_test(self, ray: Any, active: Any = True) -> Any:
            """Return whether the ray hits."""
            return self._alone().test(ray, active)

    for method in METHODS:
        setattr(BezierTriangle, method.__name__, method)
    return BezierTriangle


def finite_bounds(patches: BezierTriangles) -> np.ndarray:
    """Return one box ``(2, 3)``, of the finite control points where patches run to infinity.

    Patches that are no surface only count if there are no others.
    """
    seen = spans_area(patches.control_points)
    if seen.any() and not seen.all():
        patches = patches[seen]
    box = surface_boxes(patches.control_points, together=True)[0]
    if not np.isfinite(box).all():
        net = patches.control_points.reshape(-1, 4)
        net = net[net[:, 3] != 0]
        points = net[:, :3] / net[:, 3:] if len(net) else np.array([[-1.0] * 3, [1.0] * 3])
        box = np.where(np.isfinite(box), box, [points.min(axis=0), points.max(axis=0)])
    return np.clip(box, -_FAR, _FAR)


def _free(patches: BezierTriangles) -> BezierTriangles:
    """Return patches whose nets have no factors that float32 could not bear."""
    nets = free_of_factor(patches.control_points, _MODERATE)
    return patches if nets is patches.control_points else BezierTriangles(nets)


def representable(nets: np.ndarray) -> np.ndarray:
    """Return nets in float32, those freed of their factor whose digits would be lost with it."""
    with np.errstate(over="ignore", under="ignore"):
        rounded = nets.astype(np.float32)
        off = np.abs(rounded - nets).max(axis=(1, 2))
    lost = ~(off <= _DIGITS * np.abs(nets).max(axis=(1, 2)))
    if lost.any():
        rounded[lost] = free_of_factor(nets[lost])
    return rounded


def _tensor(values: np.ndarray) -> Any:
    return mi.TensorXf(values.astype(np.float32).ravel(), shape=values.shape)
