"""Write the models of the scenes in this folder: ``python scenes/make_models.py``.

Every model is exact and has the z axis as its axis. They stand on the plane z = 0 at the origin,
but the spheres and the saddle, which have it as their centre. Spheres and cylinder have radius
one, for the scenes to scale.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import mitsuba_bezier as mb
from mitsuba_bezier.geometry import shapes
from mitsuba_bezier.geometry.tensor import tensor_to_triangles
from mitsuba_bezier.geometry.triangles import BezierTriangles

__all__ = ["FOLDER", "main", "models"]

FOLDER = Path(__file__).resolve().parent / "models"


def models() -> dict[str, BezierTriangles]:
    """Return the models by the name of their file, without suffix."""
    return {
        "sphere_octants": mb.sphere(cover="octants"),
        "sphere_tetrahedral": mb.sphere(cover="tetrahedral"),
        "ellipsoid": shapes.ellipsoid((0, 0, 0.4), (0.66, 0.5, 0.4)),
        "elliptic_paraboloid": shapes.elliptic_paraboloid((0, 0, 0), (0.72, 0.6), 0.55),
        "hyperbolic_paraboloid": shapes.hyperbolic_paraboloid((0, 0, 0), (0.6, 0.6), 0.42),
        "hyperboloid_one_sheet": shapes.hyperboloid_one_sheet((0, 0, 0.8), (0.3, 0.3, 0.42), 1.6),
        "hyperboloid_two_sheets": shapes.hyperboloid_two_sheets(
            (0, 0, 0.7), (0.17, 0.17, 0.2), 0.5, capped=True
        ),
        "cone": shapes.cone((0, 0, 0), (0.52, 0.52), 1.35, capped=True),
        "cylinder": shapes.cylinder(capped=True),
        "band": shapes.cylinder(),
        "torus": shapes.torus((0, 0, 0.2), 0.52, 0.2),
        "sweep": sweep(front=-14, back=10, bend=5, height=16, width=50),
    }


def sweep(front: float, back: float, bend: float, height: float, width: float) -> BezierTriangles:
    """Return a studio backdrop: floor, quarter of a cylinder, wall, oriented to the inside.

    The floor begins at ``y = front`` and bends up, with radius `bend`, into the wall at
    ``y = back``, which ends at `height`.
    """
    half = np.sqrt(0.5)  # weight of the middle control point of a quarter of a circle
    profile = [
        [(front, 0, 1), (back - bend, 0, 1)],
        [(back - bend, 0, 1), (back * half, 0, half), (back, bend, 1)],
        [(back, bend, 1), (back, height, 1)],
    ]
    parts = []
    for piece in profile:
        y, z, w = np.array(piece, dtype=float).T
        sides = [np.stack([x * w, y, z, w], axis=-1) for x in (-width / 2, width / 2)]
        parts.append(tensor_to_triangles(np.stack(sides)))
    return BezierTriangles.join(parts)


def main() -> None:
    """Write all files."""
    FOLDER.mkdir(exist_ok=True)
    for name, patches in models().items():
        mb.save(patches, FOLDER / f"{name}.vtu")


if __name__ == "__main__":
    main()
