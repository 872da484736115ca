"""All Bézier shapes of a scene as one structure, and what a hit means to Mitsuba."""

from __future__ import annotations

import gc
import weakref
from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..errors import BezierError, VariantError
from ..geometry.contours import open_edges
from ..geometry.trim_cells import trim_cells
from ..geometry.trims import Trims
from ..kernels.arrays import types_of, upload
from ..kernels.float64_use import uses_pairs
from ..kernels.patch import pack, scaled
from ..kernels.patch_nets import lay_out
from ..kernels.query import Hit
from ..kernels.structure import Structure, build_structure
from ..kernels.trim_table import TrimTable, build_table
from ..kernels.wavefront import query
from ..leaves.builder import build_leaves, rebuild_leaves
from ..leaves.local_nets import local_nets
from ..leaves.records import ClosedFormLeaves, GraphLeaves, LeafSettings, Leaves
from ..leaves.revolution import revolution_leaf
from .asphere_tables import AsphereTables
from .attached import attached_tables
from .frozen import contents, is_bezier
from .instances import InstanceTables
from .interaction import Met, PatchTables, Preliminary, meet
from .offsets import position_error
from .projections import Projections
from .section import Section
from .surface_sampling import SurfaceSampling

__all__ = [
    "NO_PATCH",
    "SceneData",
    "check_variant",
    "data_for_scene",
    "data_for_shapes",
    "known_data",
]


#: In place of the number of a patch where there is none.
NO_PATCH = 0xFFFFFFFF


class SceneData:
    """Structure, nets and tables of a list of Bézier shapes.

    Parameters
    ----------
    shapes : list of BezierTriangle
    indices : list of int, optional
        Their places in the scene's shape list; needed with `scene`.
    scene : mi.Scene, optional
    """

    def __init__(self, shapes: list[Any], indices: list[int], scene: Any = None) -> None:
        # A structure does not keep its shapes alive: when their scene goes, it goes.
        self._shapes = [weakref.ref(shape) for shape in shapes]
        #: The tables while an integrator tracks derivatives
        self.attached: PatchTables | None = None
        #: Whether `scene_methods.prepare` was here
        self.prepared = False
        #: Whether others than our integrators have preliminary hits of it
        self.handed_out = False
        self._sampling: dict[tuple[int, ...], SurfaceSampling] = {}
        self._open_edges: Any = None
        self._made: dict[str, Any] = {}
        self._kept: dict[tuple[str, bytes], Any] = {}
        self.scene_has_others = scene is not None and len(scene.shapes()) > len(shapes)
        parts, patch_shape, patch_first = [], [], []
        # who changes a shape once will do so again
        remember = any(shape.updates for shape in shapes)
        first = 0
        for number, shape in enumerate(shapes):
            leaves = _leaves_of(shape, remember)
            parts.append(leaves.of_patches(first + np.arange(len(shape.patches))))
            patch_shape += [number] * len(shape.patches)
            patch_first += [first] * len(shape.patches)
            first += len(shape.patches)
        leaves = Leaves.join(parts)
        #: The plane that cuts the shapes, or None; caps are not met as other patches are.
        self.section = Section.of(shapes, [patch_shape.index(k) for k in range(len(shapes))])
        if self.section is not None:
            caps = np.isin(np.array(patch_shape)[leaves.patch], self.section.caps)
            leaves = leaves.select(~caps)
        trims = [s.trims or Trims.none(len(s.patches)) for s in shapes]
        #: The tables of the trims, None if no patch has any; its first cells are the patches.
        self.trim: TrimTable | None = None
        table = None
        if any(s.trims is not None for s in shapes):
            cells, cell, keep = trim_cells(Trims.join(trims), leaves.patch, leaves.corners())
            self.trim = build_table(cells, mi.Float)
            leaves, table = leaves.select(keep), (self.trim, cell[keep])
        #: The patches that are where they are, and those with instances; None if there are none.
        self.structure: Structure | None = None
        self.instances: InstanceTables | None = None
        self._build(leaves, np.array(patch_shape)[leaves.patch], table)
        layout = lay_out([(s.patches.degree, len(s.patches)) for s in shapes], mi.Float)
        nets = []
        for shape, (degree, _first) in zip(shapes, layout.shapes):
            own = shape.patches.degree
            net, origin = local_nets(shape.patches.elevate((degree or own) - own).control_points)
            nets.append((pack(net if degree else scaled(net)).ravel(), origin))
        self.patch_shape = upload(mi.UInt32, np.array(patch_shape))
        self.patch_first = upload(mi.UInt32, np.array(patch_first))
        #: What the patches are, for `interaction`.
        self.tables = PatchTables(
            nets=upload(mi.Float, np.concatenate([net for net, _origin in nets])),
            origins=upload(mi.Float, np.concatenate([origin for _net, origin in nets])),
            layout=layout,
            shape_of=self.patch_shape,
            orientation=upload(mi.Float, np.array([s.orientation for s in shapes])),
            texcoords=_texcoords(shapes),
            projections=Projections.of(shapes),
            aspheres=AsphereTables.of(shapes, [origin for _net, origin in nets]),
            places=None if self.instances is None else self.instances.matrices,
            pairs=uses_pairs(mi.Float),
        )
        if scene is not None:
            pointers = scene.shapes_dr()
            self.pointers = dr.gather(mi.ShapePtr, pointers, mi.UInt32(indices))
        else:
            self.pointers = mi.ShapePtr(shapes[0])
        dr.make_opaque(self.pointers)  # a literal would make each shape its own kernels
        #: First patch of each shape by Mitsuba's number of it, `NO_PATCH` for shapes not ours.
        self.first_patch = _by_number(self.pointers, patch_first, patch_shape)
        self._name = " ".join(str(x) for x in (scene is not None, *(s.serial for s in shapes)))
        self._show()

    @property
    def shapes(self) -> list[Any]:
        """The shapes of the structure, those that still exist."""
        return [shape for shape in (reference() for reference in self._shapes) if shape is not None]

    @property
    def bytes(self) -> int:
        """Memory of leaves and nets, nearly all there is."""
        nets = dr.width(self.tables.nets) * dr.itemsize_v(self.tables.nets)
        return int(nets) + sum(s.bytes for s in (self.structure, self.instances) if s is not None)

    @property
    def is_alive(self) -> bool:
        """Whether all shapes of the structure still exist."""
        return len(self.shapes) == len(self._shapes)

    def _show(self) -> None:
        """Let frozen functions find the arrays."""
        found = contents(self)
        for shape in self.shapes:
            shape.device_arrays[self._name] = found

    def _build(self, leaves: Leaves, shape: np.ndarray, trims: Any) -> None:
        """Build the structures of leaves, given their shapes and trims."""
        placed = [k for k, s in enumerate(self.shapes) if s.instances is not None]
        if not placed:
            self.structure = build_structure(leaves, mi.Float, trims)
            return
        here = ~np.isin(shape, placed)

        def cells(mask: np.ndarray) -> Any:
            return None if trims is None else (trims[0], trims[1][mask])

        if here.any() or here.all():  # also of nothing at all
            self.structure = build_structure(leaves.select(here), mi.Float, cells(here))
        if not here.all():
            objects = np.searchsorted(placed, shape[~here])
            shapes = [self.shapes[k] for k in placed]
            self.instances = InstanceTables(leaves.select(~here), objects, shapes, cells(~here))

    # ------------------------------------------------------------------ queries

    def _nearest(
        self, ray: Any, t_max: Any, active: Any, any_hit: bool, coherent: bool
    ) -> tuple[Hit, Any]:
        """Return the hit of the kernels, and 1 + the number of the instance, 0 for none."""
        ty = types_of(mi.Float)
        o = [ty.Float(dr.detach(ray.o[i], False)) for i in range(3)]
        d = [ty.Float(dr.detach(ray.d[i], False)) for i in range(3)]
        t_max, active = dr.detach(mi.Float(t_max), False), dr.detach(mi.Bool(active), False)
        if self.section is not None:
            return self.section.nearest(self, o, d, t_max, active, any_hit), None
        if self.instances is None:
            assert self.structure is not None
            return query(self.structure, o, d, t_max, active, any_hit, coherent), None
        if self.structure is None:
            hit, instance = self.instances.intersect(o, d, t_max, active, any_hit)
            return hit, dr.select(hit.valid, instance + 1, 0)
        first = query(self.structure, o, d, t_max, active, any_hit, coherent)
        if any_hit:
            active = active & ~first.valid
        hit, instance = self.instances.intersect(o, d, dr.minimum(t_max, first.t), active, any_hit)
        both = Hit(
            first.valid | hit.valid,
            *(dr.select(hit.valid, y, x) for x, y in zip(first[1:], hit[1:])),
        )
        return both, dr.select(hit.valid, instance + 1, 0)

    def preliminary(
        self, ray: Any, active: Any = True, pi: Any = None, coherent: bool = False
    ) -> Preliminary:
        """Return the nearest hit, of `pi` (Mitsuba's own, if given) and of our patches."""
        with _recorded():
            ray_maxt = mi.Float(ray.maxt) if pi is None else dr.minimum(ray.maxt, pi.t)
            hit, instance = self._nearest(ray, ray_maxt, active, False, coherent)
            valid = mi.Bool(hit.valid)
            patch = mi.UInt32(hit.patch)
            if pi is None:
                pi = dr.zeros(mi.PreliminaryIntersection3f, dr.width(valid))
                pi.t = dr.inf
            pi = mi.PreliminaryIntersection3f(pi)
            pi.valid = pi.valid | valid
            shape, index = self.owner(patch, valid)
            pi.t = dr.select(valid, mi.Float(hit.t), pi.t)
            pi.prim_uv = dr.select(valid, mi.Point2f(hit.u, hit.v), pi.prim_uv)
            pi.prim_index = dr.select(valid, index, pi.prim_index)
            pi.shape = dr.select(valid, shape, pi.shape)
            pi.instance = dr.select(valid, dr.zeros(mi.ShapePtr), pi.instance)
            if instance is not None:
                pi.shape_index = dr.select(valid, mi.UInt32(instance), pi.shape_index)
            return Preliminary(pi, valid, patch)

    def owner(self, patch: Any, active: Any) -> tuple[Any, Any]:
        """Return the shape (`mi.ShapePtr`) of a patch, and the patch's number in it."""
        number, first = mi.UInt32(0), mi.UInt32(0)
        if len(self.shapes) > 1:
            number = dr.gather(mi.UInt32, self.patch_shape, patch, active)
            first = dr.gather(mi.UInt32, self.patch_first, patch, active)
        return dr.gather(mi.ShapePtr, self.pointers, number, active), patch - first

    def patch_of(self, record: Any, active: Any) -> tuple[Any, Any]:
        """Find the patch of a record by its shape and the number there; return it, and where."""
        shape = dr.reinterpret_array(mi.UInt32, record.shape)
        ours = mi.Bool(active) & record.is_valid() & (shape < dr.width(self.first_patch))
        place = dr.gather(mi.UInt32, self.first_patch, shape, ours)
        ours = ours & (place != NO_PATCH)
        return dr.select(ours, place + record.prim_index, 0), ours

    def error_of(self, si: Any, active: Any) -> Any:
        """Return `Met.p_err` of an interaction as well as it is known without parameters.

        0 where the point is not on a patch.
        """
        if not isinstance(si, mi.SurfaceInteraction3f):
            return mi.Float(0.0)
        si = dr.detach(si)
        patch, ours = self.patch_of(si, active)
        pu, pv = si.dp_du, si.dp_dv
        if self.tables.texcoords is not None:
            _uv, du, dv = self.tables.texture(patch, mi.Float(0.0), mi.Float(0.0), ours)
            pu, pv = pu * du.x + pv * du.y, pu * dv.x + pv * dv.y
        # an interaction without partials was made by hand
        known = ours & (dr.squared_norm(pu) + dr.squared_norm(pv) > 0)
        return dr.select(known, position_error(si.p, si.n, pu, pv), 0.0)

    def test(self, ray: Any, active: Any = True) -> Any:
        """Return whether a ray hits any patch before ``ray.maxt``."""
        with _recorded():
            hit, _copy = self._nearest(ray, ray.maxt, active, True, False)
            return mi.Bool(hit.valid)

    def surface_interaction(self, hit: Preliminary, ray: Any, flags: Any, active: Any) -> Any:
        """Return `mi.SurfaceInteraction3f` for hits on patches; invalid elsewhere."""
        return self.meet(hit, ray, flags, active).si

    def meet(self, hit: Preliminary, ray: Any, flags: Any, active: Any) -> Met:
        """Return the same, and the error of its point."""
        tables = self.tables
        if not mi.has_flag(flags, mi.RayFlags.DetachShape):
            tables = self.attached or attached_tables(tables, self.shapes)
        return meet(tables, hit, ray, flags, active)

    @contextmanager
    def attach(self, mode: Any) -> Iterator[None]:
        """Make the nets carry derivatives once, for all interactions within.

        Parameters
        ----------
        mode : dr.ADMode
            ``Forward`` brings the derivatives of the parameters to the nets now: inside of a
            recorded loop they could not come from outside.
        """
        if self.attached is not None:  # within a render that has done so
            yield
            return
        with dr.resume_grad():
            self.attached = attached_tables(self.tables, self.shapes)
            if mode == dr.ADMode.Forward and dr.grad_enabled(*self.attached.sources):
                projections, aspheres = self.attached.projections, self.attached.aspheres
                if projections is not None:
                    projections = replace(projections, rows=_brought(projections.rows))
                if aspheres is not None:
                    aspheres = replace(aspheres, values=_brought(aspheres.values))
                nets = _brought(self.attached.nets)
                places = self.attached.places
                self.attached = replace(
                    self.tables,
                    nets=nets,
                    projections=projections,
                    aspheres=aspheres,
                    places=None if places is None else _brought(places),
                )
        try:
            yield
        finally:
            self.attached = None

    def surface_sampling(
        self, numbers: tuple[int, ...], by_emission: bool = False, instanced: bool = False
    ) -> SurfaceSampling:
        """Return the sampling of these shapes, made at its first use; see `SurfaceSampling`."""
        key = (by_emission, instanced, *numbers)
        if key not in self._sampling:
            self._sampling[key] = SurfaceSampling(self, list(numbers), by_emission, instanced)
            self._show()
        return self._sampling[key]

    def kept(self, array_type: Any, values: np.ndarray) -> Any:
        """Upload a small table, or return the one that was uploaded for the same values."""
        key = (array_type.__name__, values.tobytes())
        if key not in self._kept:
            self._kept[key] = upload(array_type, values)
            self._show()
        return self._kept[key]

    def made_once(self, name: str, make: Callable[[], Any], again: bool = False) -> Any:
        """Return what was made of this structure under a name, made now if it is the first time."""
        if again or name not in self._made:
            self._made[name] = make()
            self._show()
        return self._made[name]

    def instance_numbers(self, number: int) -> range:
        """Return 1 + the numbers of the instances of a shape, in all of `instances`; 0 for none."""
        counts = [0 if s.instances is None else len(s.instances) for s in self.shapes]
        first = 1 + sum(counts[:number])
        return range(first, first + counts[number]) if counts[number] else range(1)

    def open_edges(self) -> Any:
        """Return for each patch which edges have no neighbour in their shape.

        Returns
        -------
        UInt
            Bits 0 to 2 for the edges AB, BC, CA.
        """
        if self._open_edges is None:
            masks = []
            for shape in self.shapes:
                bits = np.zeros(3 * len(shape.patches), dtype=np.uint32)
                if shape.asphere is None:  # its rim is no edge of a patch
                    bits[open_edges(shape.patches, creases=False)] = 1
                masks.append(bits.reshape(-1, 3) @ np.array([1, 2, 4], dtype=np.uint32))
            self._open_edges = upload(mi.UInt32, np.concatenate(masks))
            self._show()
        return self._open_edges


@contextmanager
def _recorded() -> Iterator[None]:
    """Let kernels have no derivatives, and record their loops whatever the flags say.

    Evaluated loops, for finding mistakes in one's own, would launch a kernel for each of ours'
    steps. While a function is frozen no garbage is collected: a scene of Mitsuba's that is freed
    then ends the process ("enqueue_host_func(): this function cannot be recorded").
    """
    recorded = (dr.JitFlag.SymbolicLoops, dr.JitFlag.SymbolicConditionals)
    loops, conditionals = (dr.scoped_set_flag(flag, True) for flag in recorded)
    paused = dr.flag(dr.JitFlag.FreezingScope) and gc.isenabled()
    if paused:
        gc.disable()
    try:
        with dr.suspend_grad(), loops, conditionals:
            yield
    finally:
        if paused:
            gc.enable()


def _brought(values: Any) -> Any:
    """Return values with their derivatives, brought to them from the parameters now."""
    if not dr.grad_enabled(values):
        return values
    dr.forward_to(values, flags=dr.ADFlag.ClearNone)
    result = type(values)(dr.detach(values))
    dr.enable_grad(result)
    dr.set_grad(result, dr.grad(values))
    return result


def _leaves_of(shape: Any, remember: bool) -> Leaves:
    """Return the leaves of a shape, with those it remembers, and let it remember them."""
    if shape.asphere is not None:
        leaf = revolution_leaf(shape.asphere, shape.object_to_world)
        return Leaves(GraphLeaves.zeros(), ClosedFormLeaves.zeros(), leaf)
    settings = LeafSettings(sections=shape.trims is None)
    if shape.kept_leaves is None:
        leaves = build_leaves(shape.patches, settings, shape.trims)
    else:
        before, known = shape.kept_leaves
        leaves = rebuild_leaves(shape.patches, settings, before, known, shape.trims)
    shape.kept_leaves = (shape.patches, leaves) if remember else None
    return leaves


def _by_number(pointers: Any, patch_first: list[int], patch_shape: list[int]) -> Any:
    """Return the table `SceneData.first_patch`."""
    numbers = np.array(dr.reinterpret_array(mi.UInt32, pointers))
    table = np.full(int(numbers.max()) + 1, NO_PATCH, dtype=np.uint32)
    shapes, at = np.unique(np.array(patch_shape), return_index=True)
    table[numbers[shapes]] = np.array(patch_first, dtype=np.uint32)[at]
    return upload(mi.UInt32, table)


def _texcoords(shapes: list[Any]) -> Any:
    """Return texture coordinates of all patches, or None if no shape has any."""
    if all(shape.texture_corners is None for shape in shapes):
        return None
    own = np.array([[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]])
    corners = [
        np.broadcast_to(own, (len(s.patches), 3, 2))
        if s.texture_corners is None
        else s.texture_corners
        for s in shapes
    ]
    return upload(mi.Float, np.concatenate(corners))


# ---------------------------------------------------------------------- cache

_cache: OrderedDict[tuple[Any, ...], SceneData] = OrderedDict()
#: Structures of shapes that are alive are kept, so that scenes can be rendered in turn, as long as
#: they are few or take less than this many bytes.
_MAX_KEPT, _CACHE_BYTES = 8, 2**30


def _cached(key: tuple[Any, ...], make: Any) -> SceneData:
    if key in _cache:
        _cache.move_to_end(key)
        return _cache[key]
    if dr.flag(dr.JitFlag.SymbolicScope) or dr.flag(dr.JitFlag.FreezingScope):
        raise BezierError(
            "beziertriangle: expected a first ray query, and one after each change, outside of "
            "recorded loops and calls and of frozen functions, where the structure can be built; "
            "got it inside of one"
        )
    _forget()
    data = make()
    _cache[key] = data
    total = sum(kept.bytes for kept in _cache.values()) if len(_cache) > _MAX_KEPT else 0
    while len(_cache) > _MAX_KEPT and total > _CACHE_BYTES:
        total -= _cache.popitem(last=False)[1].bytes
    return data


def _forget() -> None:
    """Drop structures of shapes that are gone, and of states that a shape has left for good."""
    for key, data in list(_cache.items()):
        if not data.is_alive or any(s.version not in key for s in data.shapes):
            del _cache[key]


def clear_cache() -> None:
    """Drop all structures; their arrays belong to a variant."""
    _cache.clear()


def known_data() -> list[SceneData]:
    """Return the structures that a preliminary hit may be of, the one used last first."""
    _forget()
    variant = mi.variant()
    known = [data for key, data in reversed(_cache.items()) if key[0] == variant]
    # each is code in the kernels of those who ask; without any, the records are made by hand
    return [data for data in known if data.handed_out] or known


def check_variant(shapes: list[Any]) -> None:
    """Refuse shapes of another variant than the one that is set.

    Raises
    ------
    VariantError
    """
    for shape in shapes:
        if shape.variant != mi.variant():
            raise VariantError.expected(
                "variant",
                f"{shape.variant}, in which the shapes were loaded (set it, or load them again)",
                mi.variant(),
            )


def data_for_shapes(shapes: list[Any]) -> SceneData:
    """Return the structure of a list of shapes, built once for their present state."""
    check_variant(shapes)
    key = (mi.variant(), uses_pairs(mi.Float), *(s.version for s in shapes))
    return _cached(key, lambda: SceneData(shapes, list(range(len(shapes)))))


def data_for_scene(scene: Any) -> SceneData | None:
    """Return the structure of a scene's Bézier shapes, or None if it has none."""
    every = scene.shapes()
    indices = [i for i, s in enumerate(every) if is_bezier(s)]
    if not indices:
        return None
    shapes = [every[i] for i in indices]
    check_variant(shapes)
    # the scene's address would not do: a later scene may get it again
    others = len(every) > len(shapes)
    key = (mi.variant(), uses_pairs(mi.Float), others, *(s.version for s in shapes))
    return _cached(key, lambda: SceneData(shapes, indices, scene))
