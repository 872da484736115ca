"""The patches of a shape and what follows from them, without Mitsuba."""

from __future__ import annotations

import numpy as np

from ...errors import NetError
from ...geometry.boxes import instance_boxes, surface_boxes
from ...geometry.proper_nets import free_of_factor, spans_area
from ...geometry.surface_area import surface_area
from ...geometry.triangles import BezierTriangles
from ...geometry.trims import Trims

__all__ = ["PatchState", "finite_bounds", "one_of_each_size", "representable"]

#: Powers of two, either way, up to which factors of nets do no harm in float32: what is computed of
#: them has products of three.
_MODERATE = 24
#: Relative rounding of float32, and some more: numbers that lose more have left its range.
_DIGITS = 2.0**-20
#: Numbers of a box are at most this: Mitsuba squares its size in float32.
_FAR = 1e18


class PatchState:
    """Patches in space, with trims and maps of instances, and how they got there.

    Parameters
    ----------
    patches : BezierTriangles
        In object space.
    matrix : (4, 4) array
        Affine map from object to world space.
    flip : bool
        Whether normals are turned.
    trims : Trims, optional
    instances : (N, 4, 4) array, optional
        Maps of the instances, applied after `matrix`.

    Raises
    ------
    BezierError
        If patches with instances run to infinity.
    """

    def __init__(
        self,
        patches: BezierTriangles,
        matrix: np.ndarray,
        flip: bool = False,
        trims: Trims | None = None,
        instances: np.ndarray | None = None,
    ) -> None:
        self.flip, self.trims, self.instances = flip, trims, instances
        #: What users see of the nets, in float32
        self.exposed = representable(patches.control_points)
        self.place(patches, matrix)

    def place(self, patches: BezierTriangles, matrix: np.ndarray) -> None:
        """Take over patches, and where they are."""
        nets = free_of_factor(patches.control_points, _MODERATE)
        proper = patches if nets is patches.control_points else BezierTriangles(nets)
        world = proper.transform(matrix)
        box = finite_bounds(world)
        #: Boxes (N, 2, 3) of the instances, or None
        self.instance_boxes: np.ndarray | None = None
        if self.instances is not None:
            boxes = instance_boxes(world.control_points, self.instances)
            self.instance_boxes = boxes
            box = np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])
        #: The patches in object space, and in space
        self.object_patches, self.patches = patches, world
        self.object_to_world, self.box = matrix, box
        mirrored = np.linalg.det(matrix[:3, :3]) < 0
        #: Sign of the normal along dp_du x dp_dv: a mirror image keeps its outside out
        self.orientation = -1.0 if mirrored != self.flip else 1.0

    def changed(
        self, values: np.ndarray, matrix: np.ndarray
    ) -> tuple[BezierTriangles, np.ndarray, np.ndarray]:
        """Return patches, map and `exposed` that new values stand for, checked.

        Numbers in float64, of a file or a builder, stay as long as nobody changed what float32
        shows of them.

        Parameters
        ----------
        values : (P, K, 4) array
            Of `control_points`, as float32 has them.
        matrix : (4, 4) array
            Of `to_world`, alike.

        Raises
        ------
        NetError
        """
        same = np.array_equal(values.astype(np.float32), self.exposed)
        patches = self.object_patches if same else BezierTriangles(values)
        if np.array_equal(matrix, self.object_to_world.astype(np.float32)):
            matrix = self.object_to_world
        if self.trims is not None and len(patches) != len(self.trims):
            raise NetError.expected(
                "control_points", f"{len(self.trims)} patches, as the trims have", len(patches)
            )
        return patches, matrix, self.exposed if same else values.astype(np.float32)

    def area(self) -> float:
        """Return the area of all, infinite for surfaces that run to infinity."""
        if self.instances is None:
            return surface_area(self.patches, self.trims)
        maps, count = one_of_each_size(self.instances)
        areas = [surface_area(self.patches.transform(m), self.trims) for m in maps]
        return float(np.dot(areas, count))


def one_of_each_size(instances: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return maps ``(K, 4, 4)`` of all sizes, and how many there are of each.

    Rigid instances of one size have one area.
    """
    linear = instances[:, :3, :3]
    forms = np.einsum("nki,nkj->nij", linear, linear).reshape(-1, 9)
    _forms, first, count = np.unique(
        np.round(forms, 12), axis=0, return_index=True, return_counts=True
    )
    return instances[first], count


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


def representable(nets: np.ndarray) -> np.ndarray:
    """Return nets in float32, those freed of their factor whose digits would be lost with it."""
    with np.errstate(over="ignore", under="ignore"):
        rounded = nets.astype(np.float32)
        off = np.abs(rounded - nets).max(axis=(1, 2))
    lost = ~(off <= _DIGITS * np.abs(nets).max(axis=(1, 2)))
    if lost.any():
        rounded[lost] = free_of_factor(nets[lost])
    return rounded
