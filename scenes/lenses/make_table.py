"""Write the scene of a table set under lamps: ``python scenes/lenses/make_table.py``.

Strings of lamps hang from a house to posts in catenaries; their places and colours are computed
here, the rest is text.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mitsuba_bezier._files import write_file

HERE = Path(__file__).resolve().parent

#: Ends of the strings of lamps, in metres: from, to, how far they sag, and how many hang there.
STRINGS = (
    ((-1.20, 1.6, 0.34), (0.5, 7.0, 0.95), 0.07, 9),
    ((1.30, 1.5, 0.36), (-0.9, 8.0, 1.00), 0.09, 9),
    ((-3.2, 7.5, 0.80), (3.2, 7.9, 0.95), 0.25, 12),
    ((-4.2, 9.0, 0.25), (4.2, 9.2, 0.45), 0.30, 14),
)
#: Lamps are like these; light of one is the same whatever its distance.
COLOURS = ((1.0, 0.56, 0.20), (1.0, 0.66, 0.30), (1.0, 0.46, 0.14), (1.0, 0.74, 0.42))
ODD = ((0.25, 0.62, 1.0), (1.0, 0.22, 0.12), (0.35, 1.0, 0.45))


def lamps() -> list[tuple[np.ndarray, float, np.ndarray]]:
    """Return centres, radii and radiances."""
    rng = np.random.default_rng(7)
    found = []
    for a, b, sag, count in STRINGS:
        for t in (np.arange(count) + 0.5) / count:
            centre = (1 - t) * np.array(a) + t * np.array(b) - [0, 0, 4 * sag * t * (1 - t)]
            centre += rng.normal(scale=0.015, size=3)
            odd = rng.random() < 0.18
            colour = np.array((ODD if odd else COLOURS)[rng.integers(3 if odd else 4)])
            # as large as they look the same, so that discs of all distances are as bright
            radius = 0.0030 * (centre[1] + 0.66)
            found.append((centre, radius, colour * rng.uniform(30, 60)))
    return found


def sphere(centre: object, radius: float, radiance: object) -> str:
    """Return the XML of a luminous sphere."""
    x, y, z = (f"{v:.3f}" for v in centre)
    light = ", ".join(f"{v:.1f}" for v in radiance)
    return (
        '    <shape type="sphere">\n'
        f'        <point name="center" x="{x}" y="{y}" z="{z}"/> '
        f'<float name="radius" value="{radius:.4f}"/>\n'
        f'        <emitter type="area"><rgb name="radiance" value="{light}"/></emitter>\n'
        "    </shape>"
    )


def scene() -> str:
    """Return the file with its lamps made anew."""
    text = (HERE / "table.xml").read_text(encoding="utf-8")
    begin, end = (text.index(f"    <!-- {word}: lamps") for word in ("begin", "end"))
    begin = text.index("\n", begin) + 1
    return text[:begin] + "".join(sphere(*lamp) + "\n" for lamp in lamps()) + text[end:]


def main() -> None:
    """Write the file."""
    write_file(HERE / "table.xml", scene().encode())


if __name__ == "__main__":
    main()
