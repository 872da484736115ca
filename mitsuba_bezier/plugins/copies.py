"""Many copies of the patches of a shape, under affine maps, that share its nets and leaves."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..errors import BezierError, FileFormatError
from ..geometry.boxes import finite_parts, reaches_infinity
from ..geometry.leaves import Leaves
from ..geometry.triangles import BezierTriangles
from ..kernels.arrays import upload
from ..kernels.copies import build_copies, intersect_copies
from ..kernels.structure import build_structure
from ..kernels.traverse import Hit

__all__ = ["CopyTables", "copy_boxes", "read_copies"]

#: Control points transformed at a time.
_CHUNK = 2**18


def read_copies(props: mi.Properties) -> np.ndarray | None:
    """Take the maps ``(N, 4, 4)`` of the copies from ``copies`` or ``copies_filename``.

    Raises
    ------
    BezierError
        If they are not regular affine maps.
    """
    has = [key for key in ("copies", "copies_filename") if key in props]
    if not has:
        return None
    if len(has) == 2:
        raise BezierError.expected("copies", "at most one of copies and copies_filename", "both")
    value = props[has[0]]
    del props[has[0]]
    if has == ["copies_filename"]:
        if not isinstance(value, str):
            raise BezierError.expected("copies_filename", "the name of a file", repr(value))
        values = _load(str(mi.file_resolver().resolve(value)))
    elif hasattr(value, "shape"):
        values = np.array(value, dtype=np.float64).reshape(value.shape)
    else:
        raise BezierError.expected("copies", "a tensor of shape (N, 3, 4) or (N, 4, 4)", value)
    if values.ndim != 3 or values.shape[1:] not in ((3, 4), (4, 4)) or len(values) == 0:
        raise BezierError.expected(
            has[0], "at least one map, of shape (N, 3, 4) or (N, 4, 4)", f"shape {values.shape}"
        )
    matrices = np.broadcast_to(np.eye(4), (len(values), 4, 4)).copy()
    matrices[:, : values.shape[1]] = values
    bad = ~np.isfinite(matrices).all(axis=(1, 2)) | (matrices[:, 3] != (0, 0, 0, 1)).any(axis=1)
    sigma = np.linalg.svd(np.where(bad[:, None, None], np.eye(4), matrices)[:, :3, :3])[1]
    bad |= ~(sigma[:, 2] > 1e-7 * sigma[:, 0])  # what float32 can invert
    if bad.any():
        k = int(np.flatnonzero(bad)[0])
        raise BezierError.expected(
            has[0], "finite, regular, affine maps", f"map {k}: {matrices[k].tolist()}"
        )
    return matrices


def _load(path: str) -> np.ndarray:
    """Read ``.npy``, or text with the twelve numbers of a map in each line."""
    try:
        if path.endswith(".npy"):
            return np.load(path, allow_pickle=False).astype(np.float64)
        return np.loadtxt(path, ndmin=2).reshape(-1, 3, 4)
    except (OSError, ValueError, EOFError) as error:
        raise FileFormatError.expected(
            "copies_filename", "a .npy file, or text with twelve numbers a line", f"{path}: {error}"
        ) from None


def copy_boxes(patches: BezierTriangles, matrices: np.ndarray) -> np.ndarray:
    """Return boxes ``(N, 2, 3)`` around copies of patches.

    They are those of the control points of parts whose weights have one sign.

    Raises
    ------
    BezierError
        If the patches run to infinity.
    """
    if reaches_infinity(patches.control_points).any():
        raise BezierError.expected("copies", "patches of finite size", "points at infinity")
    net = finite_parts(patches.control_points)[0].reshape(-1, 4)
    points = net[:, :3] / net[:, 3:]
    # the extreme points in some directions, and the boxes of patches, would do; all are few
    out = np.empty((len(matrices), 2, 3))
    step = max(_CHUNK // len(points), 1)
    for first in range(0, len(matrices), step):
        m = matrices[first : first + step]
        moved = np.einsum("nij,kj->nki", m[:, :3, :3], points) + m[:, None, :3, 3]
        out[first : first + step, 0] = moved.min(axis=1)
        out[first : first + step, 1] = moved.max(axis=1)
    return out


class CopyTables:
    """The copies of all shapes of a scene that have some.

    Parameters
    ----------
    leaves : Leaves
        Of these shapes.
    objects : (L,) int array
        The shape of each leaf, numbered among `shapes`.
    shapes : list of BezierTriangle
        Shapes with copies.
    trims : pair, optional
        See `build_structure`.
    """

    def __init__(self, leaves: Leaves, objects: np.ndarray, shapes: list[Any], trims: Any) -> None:
        matrices = np.concatenate([s.copies for s in shapes])
        which = np.repeat(np.arange(len(shapes)), [len(s.copies) for s in shapes])
        boxes = np.concatenate([s.copy_boxes for s in shapes])
        structure = build_structure(leaves, mi.Float, trims, objects)
        self.kernel = build_copies(structure, boxes, which, matrices, mi.Float)
        self.matrices = upload(mi.Float, matrices[:, :3].reshape(-1, 12))
        self.bytes = self.kernel.bytes + structure.bytes + matrices[:, :3].size * 4

    def intersect(
        self, o: Any, d: Any, t_max: Any, active: Any, any_hit: bool = False
    ) -> tuple[Hit, Any]:
        """Return the hit, and the number of the copy."""
        return intersect_copies(self.kernel, o, d, t_max, active, any_hit)

    def matrix(self, copy: Any, active: Any) -> tuple[Any, Any]:
        """Return the linear part and the translation of the map of a copy."""
        rows = [dr.gather(mi.Float, self.matrices, 12 * copy + k, active) for k in range(12)]
        a = mi.Matrix3f(*(rows[4 * i + j] for i in range(3) for j in range(3)))
        return a, mi.Vector3f(rows[3], rows[7], rows[11])

    def local_ray(self, copy: Any, ray: Any, active: Any) -> Any:
        """Return the ray in the object's space, with the same parameter."""
        a, b = self.matrix(copy, active)
        inverse = dr.rcp(a)
        local = mi.Ray3f(ray)
        local.o = dr.select(active, mi.Point3f(inverse @ (mi.Vector3f(ray.o) - b)), ray.o)
        local.d = dr.select(active, inverse @ ray.d, ray.d)
        return local

    def to_world(self, si: Any, copy: Any, ray: Any, active: Any) -> Any:
        """Take an interaction from the object's space to that of a copy; return it."""
        from .interaction import shading_frame

        a, b = self.matrix(copy, active)
        normals = dr.rcp(a).T
        g = normals @ mi.Vector3f(si.n)
        inv = dr.rcp(dr.norm(g))
        n = mi.Normal3f(g * inv)

        def turned(dn: Any) -> Any:
            dg = normals @ dn
            return (dg - mi.Vector3f(n) * dr.dot(n, dg)) * inv

        dn_du, dn_dv = turned(si.dn_du), turned(si.dn_dv)
        si.p = dr.select(active, mi.Point3f(a @ mi.Vector3f(si.p) + b), si.p)
        si.n = dr.select(active, n, si.n)
        si.dp_du = dr.select(active, a @ si.dp_du, si.dp_du)
        si.dp_dv = dr.select(active, a @ si.dp_dv, si.dp_dv)
        si.dn_du = dr.select(active, dn_du, si.dn_du)
        si.dn_dv = dr.select(active, dn_dv, si.dn_dv)
        si.sh_frame = shading_frame(si.n, si.dp_du)
        valid = si.is_valid()
        si.wi = dr.select(valid, si.to_local(-ray.d), -ray.d)
        return si
