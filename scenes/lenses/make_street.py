"""Write the lamps and houses of street.xml: ``python scenes/lenses/make_street.py``."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mitsuba_bezier._files import write_file

HERE = Path(__file__).resolve().parent

#: Posts with a globe: its place, radius and radiance. The first is bright enough for ghosts, and
#: so large that rays find it through them.
POSTS = (
    (-1.27, 4.8, 2.84, 0.32, (75, 46, 21)),
    (2.6, 11.5, 3.72, 0.16, (9, 6.0, 3.0)),
    (-2.3, 17.0, 3.72, 0.16, (9, 5.6, 2.7)),
    (2.6, 23.5, 3.72, 0.16, (9, 6.0, 3.0)),
    (-2.3, 31.0, 3.72, 0.16, (9, 5.6, 2.7)),
    (2.6, 40.0, 3.72, 0.16, (9, 6.0, 3.0)),
)
#: Houses: x from and to, y from and to, height.
HOUSES = (
    (-11, -4.2, 9, 20, 6.2),
    (-12, -4.6, 20.4, 34, 8.0),
    (-11, -4.2, 34.5, 60, 6.8),
    (4.4, 11, 12, 25, 7.2),
    (4.8, 12, 25.5, 42, 5.8),
    (4.4, 11, 42.5, 60, 7.6),
)


def shape(kind: str, moves: str, inside: str) -> str:
    """Return the XML of a shape."""
    return (
        f'    <shape type="{kind}">\n        <transform name="to_world">{moves}</transform>\n'
        f"        {inside}\n    </shape>"
    )


def parts() -> list[str]:
    """Return everything."""
    found = []
    for x, y, z, radius, radiance in POSTS:
        light = ", ".join(f"{v:.1f}" for v in radiance)
        found.append(
            '    <shape type="sphere">\n'
            f'        <point name="center" x="{x}" y="{y}" z="{z}"/> '
            f'<float name="radius" value="{radius}"/>\n'
            f'        <emitter type="area"><rgb name="radiance" value="{light}"/></emitter>\n'
            "    </shape>"
        )
        post = f'<scale x="0.06" y="0.06" z="{z}"/> <translate x="{x}" y="{y}"/>'
        name = '<string name="filename" value="../models/cylinder.vtu"/> <ref id="iron"/>'
        found.append(shape("beziertriangle", post, name))
    rng = np.random.default_rng(3)
    for x0, x1, y0, y1, top in HOUSES:
        moves = (
            f'<scale x="{(x1 - x0) / 2:.3f}" y="{(y1 - y0) / 2:.3f}" z="{top / 2}"/> '
            f'<translate x="{(x0 + x1) / 2:.3f}" y="{(y0 + y1) / 2:.3f}" z="{top / 2}"/>'
        )
        found.append(shape("cube", moves, '<ref id="plaster"/>'))
        wall, out = (x1, 1) if x1 < 0 else (x0, -1)
        for y in np.arange(y0 + 1.2, y1 - 0.8, 2.2):
            for z in np.arange(1.7, top - 0.8, 2.1):
                if rng.random() < 0.7:
                    continue
                moves = (
                    f'<scale x="0.42" y="0.62"/> <rotate y="1" angle="{90 * out}"/> '
                    f'<rotate x="1" angle="90"/> '
                    f'<translate x="{wall + 0.01 * out:.3f}" y="{y:.3f}" z="{z:.3f}"/>'
                )
                warm = 0.35 + 0.5 * rng.random()
                light = ", ".join(f"{warm * c:.2f}" for c in (1.0, 0.62, 0.28))
                glow = f'<emitter type="area"><rgb name="radiance" value="{light}"/></emitter>'
                found.append(shape("rectangle", moves, glow))
    return found


def scene() -> str:
    """Return the file with its lamps and houses made anew."""
    text = (HERE / "street.xml").read_text(encoding="utf-8")
    begin, end = (text.index(f"    <!-- {word}: ") for word in ("begin", "end"))
    begin = text.index("\n", begin) + 1
    return text[:begin] + "".join(f"{part}\n" for part in parts()) + text[end:]


def main() -> None:
    """Write the file."""
    write_file(HERE / "street.xml", scene().encode())


if __name__ == "__main__":
    main()
