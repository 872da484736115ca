"""Cut shapes by a plane: rays see the half that is kept, and caps where bodies are cut.

Nothing is made into triangles. A ray is taken to the half space that is kept, and meets the patches
there. Where it meets the plane, two rays from that point into the kept half tell whether it lies
inside of a body: both leave it first, which the normals of a closed body say. Bodies touch and fill
each other's holes, so each is asked by itself: for that they stand apart, in a structure in which
nothing else is.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..errors import BezierError
from ..geometry.boxes import surface_boxes
from ..geometry.trim_cells import trim_cells
from ..geometry.trims import Trims
from ..kernels.arrays import gather_packets, types_of, upload
from ..kernels.query import Hit
from ..kernels.structure import build_structure
from ..kernels.trim_table import build_table
from ..kernels.wavefront import query
from ..leaves.builder import build_leaves
from ..leaves.records import LeafSettings, Leaves

__all__ = ["Section", "read_section"]

#: The two directions in which bodies are left: along two axes of the plane, and into the kept half.
#: Aslant, so that no ray runs along faces and edges of bodies made of right angles.
_DIRECTIONS = ((0.31, 0.17, 0.93), (-0.23, -0.41, 0.87))
#: Distance between the places of bodies, in sizes of all of them together.
_APART = 4.0
#: Numbers a body in the tables: bounds in the plane and the sign of its normals; parameters of the
#: cap and its patch.
_ROW = 8


def read_section(props: mi.Properties) -> tuple[np.ndarray | None, int, int]:
    """Take ``section``, ``body`` and ``cap`` out of the properties.

    Returns
    -------
    plane : (4,) array or None
        ``(a, b, c, d)``: what is kept has ``a x + b y + c z <= d``.
    body : int
        Shapes of one number are one body.
    cap : int
        1 for the cap of a body whose normals point outwards, -1 inwards, 0 for what is none.

    Raises
    ------
    BezierError
        If one of them is none.
    """
    plane = None
    if "section" in props:
        text = props["section"]
        try:
            plane = np.array([float(word) for word in str(text).replace(",", " ").split()])
        except ValueError:
            plane = np.zeros(0)
        length = np.linalg.norm(plane[:3]) if plane.shape == (4,) else 0.0
        if not (np.isfinite(plane).all() and length > 0):
            raise BezierError.expected(
                "section", "four numbers a b c d: a x + b y + c z <= d is kept", repr(text)
            )
        plane = plane / length
    body, cap = (int(props.get(name, 0)) for name in ("body", "cap"))
    if cap not in (-1, 0, 1) or (cap and plane is None):
        raise BezierError.expected("cap", "-1, 0 or 1, on a shape with a section", cap)
    for name in ("section", "body", "cap"):
        if name in props:
            del props[name]
    return plane, body, cap


class Section:
    """The section of a list of shapes.

    Parameters
    ----------
    shapes : list of BezierTriangle
    first : list of int
        The number of the first patch of each.
    """

    @staticmethod
    def of(shapes: list[Any], first: list[int]) -> Section | None:
        """Return the section of shapes, None if they have none.

        Raises
        ------
        BezierError
            If they have different ones.
        """
        planes = [s.section for s in shapes]
        if all(plane is None for plane in planes):
            return None
        kept = next(plane for plane in planes if plane is not None)
        if any(plane is None or not np.array_equal(plane, kept) for plane in planes):
            raise BezierError.expected("section", "the same on all Bézier shapes", "others")
        if any(s.instances is not None for s in shapes):
            raise BezierError.expected("section", "shapes without instances", "some with")
        return Section(shapes, first)

    def __init__(self, shapes: list[Any], first: list[int]) -> None:
        plane = shapes[0].section
        self.normal, self.offset = plane[:3].tolist(), float(plane[3])
        axis = np.eye(3)[int(np.argmin(np.abs(plane[:3])))]
        x = np.cross(axis, plane[:3])
        x /= np.linalg.norm(x)
        y = np.cross(plane[:3], x)
        self.axes = [x.tolist(), y.tolist()]
        #: Shapes that are caps.
        self.caps = [k for k, s in enumerate(shapes) if s.cap]
        frame = np.stack([x, y, -plane[:3]])
        self.directions = []
        for local in _DIRECTIONS:
            w = np.array(local) @ frame
            self.directions.append((w / np.linalg.norm(w)).tolist())
        self.count = 0
        self._build(shapes, first, np.stack([x, y]))

    def _build(self, shapes: list[Any], first: list[int], axes: np.ndarray) -> None:
        """Make the structure in which bodies stand apart, and the table of the caps."""
        members = {
            shapes[cap].body: [
                k for k, s in enumerate(shapes) if not s.cap and s.body == shapes[cap].body
            ]
            for cap in self.caps
        }
        bodies = [cap for cap in self.caps if members[shapes[cap].body]]
        if not bodies:
            return
        boxes = {}
        for cap in bodies:
            nets = [shapes[k].patches for k in members[shapes[cap].body]]
            found = np.stack([surface_boxes(n.control_points, together=True)[0] for n in nets])
            boxes[cap] = np.stack([found[:, 0].min(axis=0), found[:, 1].max(axis=0)])
        every = np.stack(list(boxes.values()))
        low, high = every[:, 0].min(axis=0), every[:, 1].max(axis=0)
        self.size = float(np.linalg.norm(high - low))
        step = _APART * self.size * axes[0]
        self.step = step.tolist()
        rows = np.zeros((len(bodies), _ROW))
        table = np.zeros((len(bodies), _ROW))
        leaves, trims = [], []
        own: list[int] = []
        for number, cap in enumerate(bodies):
            corners = np.stack(np.meshgrid(*boxes[cap].T, indexing="ij"), axis=-1).reshape(-1, 3)
            flat = corners @ axes.T
            rows[number, :4] = [*flat.min(axis=0), *flat.max(axis=0)]
            rows[number, 4] = float(shapes[cap].cap)
            table[number] = [*_parameters(shapes[cap].patches, axes), first[cap], 0.0]
            move = np.eye(4)
            move[:3, 3] = number * step
            for k in members[shapes[cap].body]:
                settings = LeafSettings(sections=shapes[k].trims is None)
                moved = shapes[k].patches.transform(move)
                own_leaves = build_leaves(moved, settings, shapes[k].trims)
                leaves.append(own_leaves.of_patches(len(own) + np.arange(len(moved))))
                trims.append(shapes[k].trims or Trims.none(len(moved)))
                own += range(first[k], first[k] + len(moved))
        joined, cells = Leaves.join(leaves), None
        if any((t.region >= 0).any() for t in trims):
            found_cells, cell, keep = trim_cells(Trims.join(trims), joined.patch, joined.corners())
            joined, cells = joined.select(keep), (build_table(found_cells, mi.Float), cell[keep])
        self.structure = build_structure(joined, mi.Float, cells)
        #: Numbers of its patches among all.
        self.patch = upload(mi.UInt32, np.array(own, dtype=np.uint32))
        own_float = types_of(mi.Float).Float
        self.rows = upload(own_float, rows)
        self.table = upload(own_float, table)
        self.count = len(bodies)

    def nearest(
        self, data: Any, o: list[Any], d: list[Any], t_max: Any, active: Any, any_hit: bool
    ) -> Hit:
        """Return the nearest hit of what is kept and of the caps, as `batch.query` does."""
        ty = types_of(o[0])
        s = _dot(self.normal, o) - self.offset
        r = _dot(self.normal, d)
        at_plane = dr.select(r != 0, -s / dr.select(r != 0, r, 1.0), dr.inf)
        start = dr.select(r < 0, dr.maximum(at_plane, 0.0), 0.0)
        end = dr.select(r > 0, dr.minimum(at_plane, t_max), t_max)
        kept = active & (end > start) & ((r != 0) | (s <= 0))
        moved = [dr.fma(start, b, a) for a, b in zip(o, d)]
        hit = query(data.structure, moved, d, end - start, kept, any_hit, False)
        hit = hit._replace(t=hit.t + start)
        if not self.count:
            return hit
        t = dr.select(hit.valid, hit.t, t_max)
        try_ = active & (r != 0) & (at_plane > 0) & (at_plane < t)
        if any_hit:
            try_ = try_ & ~hit.valid
        p = [dr.fma(at_plane, b, a) for a, b in zip(o, d)]
        found, body = self._body(data, ty, p, try_)
        row = gather_packets(self.table, body, _ROW, found)
        x, y = (_dot(axis, p) for axis in self.axes)
        u, v = (dr.fma(row[3 * k], x, dr.fma(row[3 * k + 1], y, row[3 * k + 2])) for k in (0, 1))
        return Hit(
            hit.valid | found,
            dr.select(found, at_plane, hit.t),
            dr.select(found, ty.UInt(row[6]), hit.patch),
            dr.select(found, u, hit.u),
            dr.select(found, v, hit.v),
        )

    def _body(self, data: Any, ty: Any, p: list[Any], active: Any) -> tuple[Any, Any]:
        """Return whether points of the plane are inside of a body, and the first such."""
        x, y = (_dot(axis, p) for axis in self.axes)

        def body(run: Any, k: Any, found: Any) -> Any:
            row = [ty.Float(x) for x in gather_packets(self.rows, k, _ROW, run)]
            inside = run & (x >= row[0]) & (y >= row[1]) & (x <= row[2]) & (y <= row[3])
            shift = ty.Float(k)
            q = [dr.fma(shift, b, a) for a, b in zip(p, self.step)]
            for w in self.directions:
                inside = inside & self._leaves(data, ty, q, w, row[4], inside)
            found = found | inside
            k = dr.select(inside, k, k + 1)
            return run & ~inside & (k < self.count), k, found

        _run, k, found = dr.while_loop(
            (ty.Bool(active), dr.zeros(ty.UInt, dr.width(x)), ty.Bool(False)),
            cond=lambda *state: state[0],
            body=body,
            labels=("run", "body", "found"),
            label="bezier section",
        )
        return found, dr.select(found, k, 0)

    def _leaves(self, data: Any, ty: Any, q: list[Any], w: Any, sign: Any, active: Any) -> Any:
        """Return whether rays from points leave the first surface of their body that they meet."""
        direction = [ty.Float(c) for c in w]
        limit = ty.Float(2 * self.size)
        hit = query(self.structure, q, direction, limit, active, False, True)
        valid = mi.Bool(hit.valid)
        patch = dr.gather(mi.UInt32, self.patch, mi.UInt32(hit.patch), valid)
        _p, pu, pv = data.tables.partials(patch, hit.u, hit.v, valid)
        shape = dr.gather(mi.UInt32, data.tables.shape_of, patch, valid)
        turned = dr.gather(mi.Float, data.tables.orientation, shape, valid)
        facing = dr.dot(dr.cross(pu, pv), mi.Vector3f(*w)) * turned * mi.Float(sign)
        return ty.Bool(dr.detach(valid & (facing > 0)))


def _dot(a: list[float], b: list[Any]) -> Any:
    return dr.fma(a[0], b[0], dr.fma(a[1], b[1], a[2] * b[2]))


def _parameters(patches: Any, axes: np.ndarray) -> list[float]:
    """Return u and v of a plane triangle as functions of the coordinates in its plane."""
    net = patches.control_points
    if net.shape != (1, 3, 4):
        raise BezierError.expected("cap", "one plane triangle", f"{len(net)} patches")
    corners = net[0, :, :3] / net[0, :, 3:] @ axes.T
    matrix = np.linalg.inv(np.column_stack([corners, np.ones(3)]).T)
    return [*matrix[0].tolist(), *matrix[1].tolist()]
