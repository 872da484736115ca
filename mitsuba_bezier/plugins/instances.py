"""Many instances of the patches of a shape, under affine maps, that share its nets and leaves."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..errors import BezierError, FileFormatError
from ..kernels.arrays import gather_packets, upload
from ..kernels.instances import build_instances, intersect_instances
from ..kernels.query import Hit
from ..kernels.structure import build_structure
from ..kernels.two_float import TwoFloat
from ..leaves.records import Leaves
from .wide_vectors import PairVector

__all__ = ["InstanceTables", "check_instances", "placed_by", "read_instances"]


def read_instances(props: mi.Properties) -> np.ndarray | None:
    """Take the maps ``(N, 4, 4)`` of the instances from ``instances`` or ``instances_filename``.

    Raises
    ------
    BezierError
        If they are not regular affine maps.
    """
    has = [key for key in ("instances", "instances_filename") if key in props]
    if not has:
        return None
    if len(has) == 2:
        raise BezierError.expected(
            "instances", "at most one of instances and instances_filename", "both"
        )
    value = props[has[0]]
    del props[has[0]]
    if has == ["instances_filename"]:
        if not isinstance(value, str):
            raise BezierError.expected("instances_filename", "the name of a file", repr(value))
        values = _load(str(mi.file_resolver().resolve(value)))
    elif hasattr(value, "shape"):
        values = np.array(value, dtype=np.float64).reshape(value.shape)
    else:
        raise BezierError.expected("instances", "a tensor of shape (N, 3, 4) or (N, 4, 4)", value)
    return check_instances(has[0], values)


def check_instances(name: str, values: np.ndarray) -> np.ndarray:
    """Return the maps ``(N, 4, 4)`` of a parameter; raise `BezierError` if they are none."""
    if values.ndim != 3 or values.shape[1:] not in ((3, 4), (4, 4)) or len(values) == 0:
        raise BezierError.expected(
            name, "at least one map, of shape (N, 3, 4) or (N, 4, 4)", f"shape {values.shape}"
        )
    matrices = np.broadcast_to(np.eye(4), (len(values), 4, 4)).copy()
    matrices[:, : values.shape[1]] = values
    bad = ~np.isfinite(matrices).all(axis=(1, 2)) | (matrices[:, 3] != (0, 0, 0, 1)).any(axis=1)
    sigma = np.linalg.svd(np.where(bad[:, None, None], np.eye(4), matrices)[:, :3, :3])[1]
    bad |= ~(sigma[:, 2] > 1e-7 * sigma[:, 0])  # what float32 can invert
    if bad.any():
        k = int(np.flatnonzero(bad)[0])
        raise BezierError.expected(
            name, "finite, regular, affine maps", f"map {k}: {matrices[k].tolist()}"
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
            "instances_filename",
            "a .npy file, or text with twelve numbers a line",
            f"{path}: {error}",
        ) from None


class InstanceTables:
    """The instances of all shapes of a scene that have some.

    Parameters
    ----------
    leaves : Leaves
        Of these shapes.
    objects : (L,) int array
        The shape of each leaf, numbered among `shapes`.
    shapes : list of BezierTriangle
        Shapes with instances.
    trims : pair, optional
        See `build_structure`.
    """

    def __init__(self, leaves: Leaves, objects: np.ndarray, shapes: list[Any], trims: Any) -> None:
        matrices = np.concatenate([s.instances for s in shapes])
        which = np.repeat(np.arange(len(shapes)), [len(s.instances) for s in shapes])
        boxes = np.concatenate([s.state.instance_boxes for s in shapes])
        structure = build_structure(leaves, mi.Float, trims, objects, len(shapes))
        self.kernel = build_instances(structure, boxes, which, matrices, mi.Float)
        #: Maps from object to space, in float64.
        self.maps = matrices
        rows = np.zeros((len(matrices), 16), dtype=np.float32)
        rows[:, :9] = matrices[:, :3, :3].reshape(-1, 9)
        rows[:, 9:12] = matrices[:, :3, 3]
        rows[:, 12:15] = matrices[:, :3, 3] - rows[:, 9:12]
        #: Linear parts, translations, and what float32 loses of these.
        self.matrices = upload(mi.Float, rows)
        self.bytes = self.kernel.bytes + structure.bytes + rows.nbytes

    def intersect(
        self, o: Any, d: Any, t_max: Any, active: Any, any_hit: bool = False
    ) -> tuple[Hit, Any]:
        """Return the hit, and the number of the copy."""
        return intersect_instances(self.kernel, o, d, t_max, active, any_hit)


def placed_by(matrices: Any, number: Any, active: Any, pairs: bool = False) -> tuple[Any, Any]:
    """Return maps: linear parts `mi.Matrix3d`, of pairs `mi.Matrix3f`; wide translations.

    Parameters
    ----------
    matrices : Float
        Those of `InstanceTables`.
    number : UInt
        1 + the number of the instance; 0 stands for none.
    active : Bool
    pairs : bool
        Whether wide numbers are pairs of float32.
    """
    placed = (number != 0) & active
    instance = dr.select(placed, number - 1, 0)
    rows = gather_packets(matrices, instance, 15, placed)
    if pairs:
        linear = dr.select(placed, mi.Matrix3f(*rows[:9]), dr.identity(mi.Matrix3f))
        return linear, PairVector(*(TwoFloat(rows[9 + k], rows[12 + k]) for k in range(3)))
    a = mi.Matrix3d(*(mi.Float64(x) for x in rows[:9]))
    # float32 numbers and what they are off: a translation may be long
    b = mi.Vector3d(*(mi.Float64(rows[9 + k]) + mi.Float64(rows[12 + k]) for k in range(3)))
    return dr.select(placed, a, dr.identity(mi.Matrix3d)), b
