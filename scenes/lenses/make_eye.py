"""Write the eye, cut in half, with rays through it: ``python scenes/lenses/make_eye.py``.

The prescription is eye.csv. Cornea, lens and retina are exact patches of its conics and of a sphere
of 12 mm; the rays are the float64 trace. Sclera and iris are there to be looked at. Lengths in
millimetres; light runs along +x.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import mitsuba_bezier as mb
from mitsuba_bezier._files import write_file
from mitsuba_bezier.geometry.bernstein import permutation
from mitsuba_bezier.geometry.revolution import band, cap
from mitsuba_bezier.geometry.triangles import BezierTriangles
from mitsuba_bezier.optics import beam, load, surface_patches, trace
from mitsuba_bezier.optics.patches import annulus_patches, rim_patches

HERE = Path(__file__).resolve().parent

#: Radii of the edges of cornea (front, back) and lens.
CORNEA, LENS = (5.6, 5.2), 4.6
#: The retina's sphere, and how thick the wall of the eye is.
RETINA, WALL = 12.0, 0.7
#: Radii of the edges of the wall, inside and outside, and their heights.
INSIDE, OUTSIDE = (5.3, 3.2), (5.75, 2.2)
FIELDS = {"straight": 0.0, "up": 20.0, "down": -20.0}
RAYS, THICK, AHEAD = 9, 0.055, 9.0

#: From the lens's axis z to the scene's x; its y is up.
TO_SCENE = np.array([[0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1.0]])


def moved(z: float) -> np.ndarray:
    """Return the shift along the axis."""
    matrix = np.eye(4)
    matrix[2, 3] = z
    return matrix


def turned(net: BezierTriangles) -> BezierTriangles:
    """Return patches with their normals on the other side."""
    return BezierTriangles(net.control_points[:, permutation(net.degree, (0, 2, 1))])


def ellipsoid(radius: float, along: float, middle: float) -> np.ndarray:
    """Return the quadric of revolution with a middle on the axis."""
    matrix = np.diag([radius**-2, radius**-2, along**-2, middle**2 / along**2 - 1])
    matrix[2, 3] = matrix[3, 2] = -middle / along**2
    return matrix


def wall(radius: float, rim: tuple[float, float], middle: float) -> BezierTriangles:
    """Return a sphere behind the equator, and an ellipsoid from there to a rim."""
    r, z = rim
    front = ellipsoid(radius, (middle - z) / np.sqrt(1 - (r / radius) ** 2), middle)
    back = ellipsoid(radius, radius, middle)
    near = (0.6 * radius, middle + 0.8 * radius)
    nets = [
        *band(front, rim, (radius, middle)),
        *band(back, (radius, middle), near),
        *cap(back, *near),
    ]
    return BezierTriangles(np.array(nets))


def bodies() -> dict[str, BezierTriangles]:
    """Return bodies around the x axis, normals outwards; sclera and retina are one body."""
    lens = load(HERE / "eye.csv")
    at = lens.frames()[:, 2, 3]
    retina = at[-1] - RETINA

    def element(i: int, j: int, radii: tuple[float, float]) -> BezierTriangles:
        front, back = lens.surfaces[i], lens.surfaces[j]
        rims = [(r, at[k] + float(lens.surfaces[k].sag(r))) for k, r in zip((i, j), radii)]
        return BezierTriangles.join(
            [
                surface_patches(front, radii[0]).transform(moved(at[i])),
                turned(surface_patches(back, radii[1])).transform(moved(at[j])),
                rim_patches(*rims),
            ]
        )

    pupil = lens.surfaces[lens.stop].semi_diameter
    iris = [(pupil, 4.9), (3.25, 3.55)]
    (r0, r1), (z0, z1) = iris
    parts = {
        "cornea": element(0, 1, CORNEA),
        "lens": element(3, 4, (LENS, LENS)),
        "sclera": BezierTriangles.join(
            [wall(RETINA + WALL, OUTSIDE, retina), turned(rim_patches(INSIDE, OUTSIDE))]
        ),
        "retina": turned(wall(RETINA, INSIDE, retina)),
        "iris": BezierTriangles.join(
            [
                annulus_patches(r0, r1).transform(moved(z0)),
                turned(annulus_patches(r0, r1)).transform(moved(z1)),
                rim_patches((r1, z0), (r1, z1)),
                turned(rim_patches((r0, z0), (r0, z1))),
            ]
        ),
    }
    return {name: net.transform(TO_SCENE) for name, net in parts.items()}


def cut() -> BezierTriangles:
    """Return the triangle in the plane of the cut, around everything, with its normal along -y."""
    corners = np.array([[-60, 0, -60, 1], [90, 0, -60, 1], [15, 0, 90, 1]], float)
    return BezierTriangles(corners[None])


def rays() -> dict[str, str]:
    """Return the rays of each field, as text for Mitsuba's linear curves."""
    lens = load(HERE / "eye.csv")
    middle = lens.frames()[-1][2, 3] - RETINA
    fan = np.stack([np.zeros(RAYS), np.linspace(-0.96, 0.96, RAYS)], axis=1)
    found = {}
    for name, field in FIELDS.items():
        o, d = beam(lens, (0.0, field), fan)
        result = trace(lens, o, d)
        o = o + d * ((-AHEAD - o[:, 2]) / d[:, 2])[:, None]
        # to the retina instead of the plane of the prescription
        last, along = result.points[-2], result.directions[-2]
        from_middle = last - [0, 0, middle]
        b = (from_middle * along).sum(axis=1)
        t = -b + np.sqrt(b * b - (from_middle**2).sum(axis=1) + RETINA**2)
        path = np.concatenate([o[None], result.points[:-1], (last + t[:, None] * along)[None]])
        blocks = []
        for j in np.flatnonzero(result.valid):
            points = path[:, j] @ TO_SCENE[:3, :3].T
            keep = np.concatenate([[True], np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-6])
            rows = [" ".join(f"{v:.6f}" for v in [*p, THICK]) for p in points[keep]]
            blocks.append("\n".join(rows))
        found[name] = "\n\n".join(blocks) + "\n"
    return found


def main() -> None:
    """Write all files."""
    for name, net in bodies().items():
        mb.save(net, HERE / f"eye_{name}.vtu")
    mb.save(cut(), HERE / "eye_cap.vtu")
    for name, text in rays().items():
        write_file(HERE / f"eye_rays_{name}.txt", text.encode())


if __name__ == "__main__":
    main()
