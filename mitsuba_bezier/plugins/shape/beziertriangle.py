"""The shape plugin ``beziertriangle``."""

from __future__ import annotations

import itertools
from typing import Any

import mitsuba as mi
import numpy as np

from ... import _runtime
from ...errors import BezierError, GeometryError, NetError
from ...geometry.aspheres import EvenAsphere
from ...geometry.proper_nets import spans_area
from ...geometry.triangles import BezierTriangles
from ...geometry.trim_outlines import trim_points
from ...geometry.trims import Trims
from ..instances import check_instances, read_instances
from ..native.sensors import watch
from ..projections import read_projection
from ..section import read_section
from .attributes import check_attribute, check_texcoords, is_attribute, make_attribute_class
from .mesh_base import make_mesh_base
from .parameters import read_affine, read_patches, read_tables
from .query_methods import METHODS as QUERIES
from .silhouette_methods import METHODS as SILHOUETTES
from .state import PatchState, finite_bounds

__all__ = ["make_shape_class"]

_versions = itertools.count(1)


class _Counts:
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
         * - instances
           - |tensor|
           - Affine maps of shape ``(N, 3, 4)`` or ``(N, 4, 4)``: the surface appears `N` times,
             each map applied after `to_world`, and takes the memory of one (Default: once, as it
             is, |exposed| as ``(N, 3, 4)``, |differentiable|, |discontinuous|). Shapes with
             instances cannot carry an emitter.
         * - instances_filename
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

        #: What the shape is instead of its patches, which then only carry parameters.
        asphere: EvenAsphere | None = None
        #: Arrays of numbers of it that users may differentiate by.
        sag_parameters: tuple[Any, ...] = ()

        def __init__(self, props: mi.Properties) -> None:
            _runtime.check(mi.variant())
            patches, trims = read_patches(props)
            matrix = read_affine(props.get("to_world", mi.ScalarTransform4f()))
            flip = props.get("flip_normals", False)
            if not isinstance(flip, bool):
                raise BezierError.expected("flip_normals", "true or false", repr(flip))
            instances = read_instances(props)
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
            if emitter is not None and instances is not None:
                raise BezierError.expected("emitter", "none on a shape with instances", "one")
            if self.sensor() is not None:
                if instances is not None:
                    raise BezierError.expected("sensor", "none on a shape with instances", "one")
                watch(self.sensor(), "irradiancemeter", self)
            self._need_area(patches)
            #: The patches and what follows from them.
            self.state = self._state(patches, matrix, flip, trims, instances)
            self.control_points = _tensor(self.state.exposed)
            self.to_world = mi.Transform4f(mi.Matrix4f(matrix.tolist()))
            #: Control points (N, 3) of trimming curves as users see them, once they look, or None.
            self.trim_points: Any = None
            self._trim_rows: tuple[np.ndarray, list[np.ndarray]] | None = None
            #: Maps of instances (N, 3, 4) as users see them, or None.
            self.instance_maps: Any = None if instances is None else _tensor(instances[:, :3])
            #: Texture coordinates at the corners (P, 3, 2), or None.
            self.texture_corners = texcoords
            self.texcoords = None if texcoords is None else _tensor(texcoords)
            self._attributes: dict[str, Any] = {}
            #: Patches and leaves of the last structure, for the next, once there were updates.
            self.kept_leaves: tuple[BezierTriangles, Any] | None = None
            self._counts = _Counts()
            self.serial = next(_versions)
            #: The variant in which it can be used.
            self.variant = mi.variant()
            #: Degree elevations on the device, by their degrees; see `attached`.
            self.elevations: dict[str, Any] = {}
            self._keep_apart()
            self._commit()
            for name, ordinates in attributes.items():
                self._add(name, ordinates)

        def _state(self, *args: Any) -> PatchState:
            return PatchState(*args)

        @property
        def version(self) -> int:
            """A number that no other state of any shape has."""
            return self._counts.version

        @property
        def updates(self) -> int:
            """How often the shape was changed."""
            return self._counts.updates

        def _commit(self) -> None:
            """Begin with a new state."""
            self._counts.version = next(_versions)
            #: Arrays of the structures that this state is a part of; see `frozen`.
            self.device_arrays: dict[str, dict[str, Any]] = {}
            self._counts.updates += 1
            self._set_box(self.state.box)

        @property
        def patches(self) -> BezierTriangles:
            """The patches in space."""
            return self.state.patches

        @property
        def object_patches(self) -> BezierTriangles:
            """The patches before ``to_world``."""
            return self.state.object_patches

        @property
        def object_to_world(self) -> np.ndarray:
            """The matrix ``(4, 4)`` of ``to_world``, in float64."""
            return self.state.object_to_world

        @property
        def orientation(self) -> float:
            """Sign of the normal along dp_du x dp_dv."""
            return self.state.orientation

        @property
        def trims(self) -> Trims | None:
            """Trims of the patches, or None."""
            return self.state.trims

        @property
        def trim_rows(self) -> tuple[np.ndarray, list[np.ndarray]]:
            """Control points of trimming curves in float64, and which of them each curve has."""
            if self._trim_rows is None:
                self._trim_rows = trim_points(self.trims or Trims.none(1))
            return self._trim_rows

        @property
        def instances(self) -> np.ndarray | None:
            """Maps ``(N, 4, 4)`` of the instances, or None."""
            return self.state.instances

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
            if self.trims is not None and self.trims.regions:
                if self.trim_points is None:
                    self.trim_points = _tensor(self.trim_rows[0])
                cb.put("trim_points", self.trim_points, edges)
            if self.instance_maps is not None:
                cb.put("instances", self.instance_maps, edges)
            if self.texcoords is not None:
                cb.put("texcoords", self.texcoords, mi.ParamFlags.NonDifferentiable)
            for name, (values, _texture) in self._attributes.items():
                cb.put(name, values, mi.ParamFlags.Differentiable)
            self._traverse_children(cb)

        def _traverse_children(self, cb: Any) -> None:
            """Show what is nested in the shape."""
            for name, child in (
                ("bsdf", self.bsdf()),
                ("emitter", self.emitter()),
                ("interior_medium", self.interior_medium()),
                ("exterior_medium", self.exterior_medium()),
            ):
                if child is not None:
                    cb.put(name, child, mi.ParamFlags.Differentiable)

        def _changed(self, keys: Any) -> None:
            own = {"control_points", "to_world", "instances", "trim_points", "texcoords"}
            if keys and not (own | set(self._attributes)) & set(keys):
                return
            tensor = self.control_points
            values = np.array(tensor, dtype=np.float64).reshape(tensor.shape)
            try:
                patches, matrix, exposed = self.state.changed(values, read_affine(self.to_world))
                self._need_area(patches)
                instances = self._changed_instances()
                trims = self._changed_trims()
                count = len(patches)
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
            self.state.exposed = exposed
            if not keys or own & set(keys):
                self.state.instances = instances
                if trims is not self.state.trims:
                    self.state.trims, self.kept_leaves = trims, None
                self.state.place(patches, matrix)
                self._commit()

        def _changed_trims(self) -> Trims | None:
            """Return the trims that the points of their curves stand for, checked."""
            old = self.state.trims
            if old is None or self.trim_points is None:
                return old
            values = np.array(self.trim_points, dtype=np.float64).reshape(self.trim_points.shape)
            known, index = self.trim_rows
            if values.shape != known.shape:
                raise NetError.expected("trim_points", f"shape {known.shape}", f"{values.shape}")
            if np.array_equal(values.astype(np.float32), known.astype(np.float32)):
                return old
            # float64 numbers stay as long as nobody changed what float32 shows of them
            values = np.where(values == known.astype(np.float32), known, values)
            curves = iter([values[rows] for rows in index])
            regions = [[next(curves) for _curve in region] for region in old.regions]
            try:
                trims = Trims(regions, old.region, old.square, old.place, old.arc)
            except GeometryError as error:
                raise NetError(f"trim_points: {error}") from None
            self._trim_rows = values, index
            return trims

        def _changed_instances(self) -> np.ndarray | None:
            """Return the maps of instances that the parameter stands for, checked."""
            old = self.state.instances
            if old is None:
                return None
            values = np.array(self.instance_maps, dtype=np.float64)
            maps = check_instances("instances", values.reshape(self.instance_maps.shape))
            # float64 numbers stay as long as nobody changed what float32 shows of them
            same = np.array_equal(maps[:, :3].astype(np.float32), old[:, :3].astype(np.float32))
            return old if same else maps

        def _restore(self) -> None:
            """Give all parameters their last valid values, in the objects that users hold."""
            matrix = mi.Matrix4f(self.state.object_to_world.tolist())
            mi.set_property(self.control_points, _tensor(self.state.exposed))
            mi.set_property(self.to_world, mi.Transform4f(matrix))
            if self.trim_points is not None and self.trims is not None:
                mi.set_property(self.trim_points, _tensor(self.trim_rows[0]))
            if self.instances is not None:
                mi.set_property(self.instance_maps, _tensor(self.instances[:, :3]))
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
            return mi.Float(self.state.area())

        def _alone(self) -> Any:
            from ..scene_data import data_for_shapes

            return data_for_shapes([self])

    for method in (*QUERIES, *SILHOUETTES):
        setattr(BezierTriangle, method.__name__, method)
    return BezierTriangle


def _tensor(values: np.ndarray) -> Any:
    return mi.TensorXf(values.astype(np.float32).ravel(), shape=values.shape)
