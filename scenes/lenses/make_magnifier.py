"""Write what magnifier.xml is made of: ``python scenes/lenses/make_magnifier.py``.

The glass and the ring are exact patches. The page is a bitmap, set in the fonts that come with
matplotlib. Lengths in millimetres, z up.
"""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

import mitsuba_bezier as mb
from mitsuba_bezier._files import write_file
from mitsuba_bezier.geometry import shapes
from mitsuba_bezier.geometry.triangles import BezierTriangles
from mitsuba_bezier.optics import Surface, surface_patches
from mitsuba_bezier.optics.patches import rim_patches

HERE = Path(__file__).resolve().parent

#: Of the biconvex glass: radius of its spheres, of its edge, and the height of the edge.
RADIUS, EDGE, HEIGHT = 100.0, 40.0, 3.0
#: Pixels in a millimetre of the page, and its size.
DOTS, PAGE = 12, (150, 190)

#: Isaac Newton, Opticks (1704), the beginning.
TEXT = (
    ("title", "OPTICKS"),
    ("head", "DEFINITIONS"),
    ("head", "DEFIN. I."),
    (
        "italic",
        "By the Rays of Light I understand its least Parts, and those as well Successive in the "
        "same Lines, as Contemporary in several Lines.",
    ),
    (
        "text",
        "For it is manifest that Light consists of Parts, both Successive and Contemporary; "
        "because in the same place you may stop that which comes one moment, and let pass that "
        "which comes presently after; and in the same time you may stop it in any one place, and "
        "let it pass in any other. For that part of Light which is stopp'd cannot be the same "
        "with that which is let pass. The least Light or part of Light, which may be stopp'd "
        "alone without the rest of the Light, or propagated alone, or do or suffer any thing "
        "alone, which the rest of the Light doth not or suffers not, I call a Ray of Light.",
    ),
    ("head", "DEFIN. II."),
    (
        "italic",
        "Refrangibility of the Rays of Light, is their Disposition to be refracted or turned out "
        "of their Way in passing out of one transparent Body or Medium into another. And a "
        "greater or less Refrangibility of Rays, is their Disposition to be turned more or less "
        "out of their Way in like Incidences on the same Medium.",
    ),
    (
        "text",
        "Mathematicians usually consider the Rays of Light to be Lines reaching from the luminous "
        "Body to the Body illuminated, and the refraction of those Rays to be the bending or "
        "breaking of those lines in their passing out of one Medium into another. And thus may "
        "Rays and Refractions be considered, if Light be propagated in an instant.",
    ),
)


def glass() -> BezierTriangles:
    """Return the closed biconvex body around the origin."""
    sphere = Surface(1 / RADIUS, semi_diameter=EDGE)
    sag = float(sphere.sag(EDGE))
    low = np.eye(4)
    low[2, 3] = -sag - HEIGHT / 2
    # half a turn about x: the normals of both caps point outwards
    high = np.diag([1.0, -1.0, -1.0, 1.0]) @ low
    cap = surface_patches(sphere)
    rim = rim_patches((EDGE, -HEIGHT / 2), (EDGE, HEIGHT / 2))
    return BezierTriangles.join([cap.transform(low), cap.transform(high), rim])


def ring() -> BezierTriangles:
    """Return the brass ring, which covers the edge."""
    return shapes.torus((0, 0, 0), EDGE + 1.6, 2.6)


def page() -> bytes:
    """Return the page as a PNG of sixteen greys."""
    from matplotlib import get_data_path
    from PIL import Image, ImageDraw, ImageFont

    folder = Path(get_data_path()) / "fonts/ttf"
    width, height = PAGE[0] * DOTS, PAGE[1] * DOTS
    image = Image.new("L", (width, height), 255)
    draw = ImageDraw.Draw(image)
    sizes = {"title": 9.0, "head": 4.6, "italic": 4.6, "text": 4.6}
    files = {"italic": "STIXGeneralItalic.ttf"}
    margin, y = 17 * DOTS, 12 * DOTS
    for kind, words in TEXT:
        size = round(sizes[kind] * DOTS)
        font = ImageFont.truetype(str(folder / files.get(kind, "STIXGeneral.ttf")), size)
        if kind in ("title", "head"):
            spaced = " ".join(words) if kind == "title" else words
            draw.text(((width - draw.textlength(spaced, font)) / 2, y), spaced, fill=20, font=font)
            y += round(1.75 * size)
            continue
        lines: list[list[str]] = [[]]
        indent = 2 * size if kind == "text" else 0
        for word in words.split():
            room = width - 2 * margin - (indent if len(lines) == 1 else 0)
            if draw.textlength(" ".join([*lines[-1], word]), font) > room:
                lines.append([])
            lines[-1].append(word)
        for number, line in enumerate(lines):
            x = margin + (indent if number == 0 else 0)
            free = width - margin - x - sum(draw.textlength(w, font) for w in line)
            last = number == len(lines) - 1
            gap = draw.textlength(" ", font) if last else free / max(len(line) - 1, 1)
            for word in line:
                draw.text((x, y), word, fill=20, font=font)
                x += draw.textlength(word, font) + gap
            y += round(1.28 * size)
        y += round(0.5 * size)
    data = io.BytesIO()
    image.quantize(16).save(data, "PNG", optimize=True)
    return data.getvalue()


def main() -> None:
    """Write all files."""
    mb.save(glass(), HERE / "magnifier_glass.vtu")
    mb.save(ring(), HERE / "magnifier_ring.vtu")
    write_file(HERE / "magnifier_page.png", page())


if __name__ == "__main__":
    main()
