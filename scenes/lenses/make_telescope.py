"""Write the star test of a Cassegrain telescope: ``python scenes/lenses/make_telescope.py``.

A paraboloid of 200 mm and f/3 with a hole, and a hyperboloid that magnifies four times: 2400 mm,
f/12. The mirrors are exact patches, three bands or a cap of a quadric each. Lengths in
millimetres, light runs along +z, the primary's vertex is the origin.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import mitsuba_bezier as mb
from mitsuba_bezier._files import write_file
from mitsuba_bezier.geometry.revolution import band, cap
from mitsuba_bezier.geometry.triangles import BezierTriangles

HERE = Path(__file__).resolve().parent

#: Focal length of the primary, its radius and that of its hole.
PRIMARY, OUTER, HOLE = 600.0, 100.0, 33.5
#: From the primary to the secondary, the magnification of that, its radius, that of its baffle.
DISTANCE, MAGNIFICATION, SECONDARY, BAFFLE = 450.0, 4.0, 32.5, 40.5
#: Thickness and depth of the four vanes.
VANE, DEPTH = 3.0, 25.0
FOCAL = PRIMARY * MAGNIFICATION
#: From the primary's vertex to the focus behind it.
FOCUS = (PRIMARY - DISTANCE) * MAGNIFICATION - DISTANCE

#: From the exit pupil, the picture of the primary in the secondary, to the focus: heights of a
#: picture out of focus grow from there.
_HALF = (PRIMARY - DISTANCE) * MAGNIFICATION / (MAGNIFICATION - 1)
PUPIL = FOCUS + DISTANCE + 1 / (1 / _HALF + 1 / DISTANCE)

#: Strips of ground glass: their middles, how far they are behind the focus, where the stars are.
COLUMNS = (
    (-26.4, -120.0, -25.2),
    (-13.2, -60.0, -13.2),
    (0.0, 0.0, 0.0),
    (13.2, 60.0, 13.2),
    (26.4, 120.0, 26.4),
)
ROWS = (-12.2, 0.0, 12.2)
WIDE, HIGH = 13.2, 38.0
#: Colours of stars of the classes B, A, G, K, M.
STARS = (
    (0.72, 0.82, 1.0),
    (0.86, 0.91, 1.0),
    (1.0, 0.96, 0.88),
    (1.0, 0.83, 0.64),
    (1.0, 0.70, 0.48),
)


def quadric(radius: float, conic: float) -> np.ndarray:
    """Return the matrix of a mirror with its vertex in the origin and its centre at -radius."""
    c = -1 / radius
    matrix = np.diag([c, c, c * (1 + conic), 0.0])
    matrix[2, 3] = matrix[3, 2] = -1.0
    return matrix


def sag(radius: float, conic: float, r: float) -> float:
    """Return z of that mirror at a distance from the axis."""
    c = -1 / radius
    return c * r * r / (1 + np.sqrt(1 - (1 + conic) * (c * r) ** 2))


def mirrors() -> dict[str, BezierTriangles]:
    """Return the two mirrors in their places."""
    big = 2 * PRIMARY
    rims = [(r, sag(big, -1, r)) for r in (HOLE, OUTER)]
    near = (PRIMARY - DISTANCE) * 2 * MAGNIFICATION / (MAGNIFICATION - 1)
    conic = -(((MAGNIFICATION + 1) / (MAGNIFICATION - 1)) ** 2)
    small = BezierTriangles(
        np.array(cap(quadric(near, conic), SECONDARY, sag(near, conic, SECONDARY)))
    )
    shift = np.eye(4)
    shift[2, 3] = -DISTANCE
    return {
        "telescope_primary": BezierTriangles(np.array(band(quadric(big, -1), *rims))),
        "telescope_secondary": small.transform(shift),
    }


def magnitude(behind: float) -> float:
    """Return the irradiance of a star: fainter ones nearer to the focus, where light is denser."""
    return 0.0040 * (0.04 if not behind else (behind / 120.0) ** 2)


def lights() -> str:
    """Return the stars: as many directions as there are places on the ground glass."""
    parts = []
    for i, (_middle, behind, x) in enumerate(COLUMNS):
        for j, y in enumerate(ROWS):
            full = FOCAL * (1 + behind / PUPIL)
            direction = ", ".join(f"{v:.6f}" for v in (x / full, y / full, 1.0))
            star = magnitude(behind) * np.array(STARS[(2 * i + 3 * j + 1) % 5])
            colour = ", ".join(f"{v:.6f}" for v in star)
            parts.append(
                '    <emitter type="directional">\n'
                f'        <vector name="direction" value="{direction}"/>\n'
                f'        <rgb name="irradiance" value="{colour}"/>\n'
                "    </emitter>"
            )
    return "\n".join(parts)


def glasses() -> str:
    """Return the strips of ground glass."""
    parts = []
    for x, behind, _star in COLUMNS:
        parts.append(
            '    <shape type="rectangle">\n'
            '        <transform name="to_world">\n'
            f'            <scale x="{WIDE / 2}" y="{HIGH / 2}"/>'
            f' <translate x="{x}" z="{FOCUS + behind}"/>\n'
            "        </transform>\n"
            '        <ref id="ground"/>\n'
            "    </shape>"
        )
    return "\n".join(parts)


def vanes() -> str:
    """Return the spider: four vanes between the secondary's cell and the tube."""
    parts = []
    middle, half = (BAFFLE + OUTER + 6) / 2 - 1, (OUTER + 6 - BAFFLE) / 2 + 1
    for angle in (45, 135, 225, 315):
        parts.append(
            '    <shape type="cube">\n'
            '        <transform name="to_world">\n'
            f'            <scale x="{half}" y="{VANE / 2}" z="{DEPTH / 2}"/>'
            f' <translate x="{middle}" z="{-DISTANCE - DEPTH / 2}"/>\n'
            f'            <rotate z="1" angle="{angle}"/>\n'
            "        </transform>\n"
            '        <ref id="black"/>\n'
            "    </shape>"
        )
    return "\n".join(parts)


def scene() -> str:
    """Return the file with vanes, ground glass and stars made anew."""
    text = (HERE / "startest.xml").read_text(encoding="utf-8")
    begin, end = (text.index(f"    <!-- {word}: ") for word in ("begin", "end"))
    begin = text.index("\n", begin) + 1
    return text[:begin] + "\n".join([vanes(), glasses(), lights(), ""]) + text[end:]


def main() -> None:
    """Write the mirrors and the scene."""
    for name, patches in mirrors().items():
        mb.save(patches, HERE / f"{name}.vtu")
    write_file(HERE / "startest.xml", scene().encode())


if __name__ == "__main__":
    main()
