"""Read the outlines of a font's letters as Bézier curves, by fontTools.

TrueType outlines are quadratic, those of PostScript (OpenType, CFF) cubic: letters are regions that
Bézier curves bound, and stay so at any size.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FileFormatError, GeometryError, RuntimeSetupError

__all__ = ["default_font", "text_outlines"]

_HINT = "pip install 'mitsuba-bezier[figures]'"


def default_font() -> str:
    """Return the path of DejaVu Sans, which matplotlib brings along.

    Raises
    ------
    RuntimeSetupError
        If it is not installed.
    """
    try:
        import matplotlib
    except ImportError as error:
        raise RuntimeSetupError.expected(
            "font", "the path of one, or matplotlib's", f"none ({error}): {_HINT}"
        ) from None
    return str(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf")


def text_outlines(
    text: str, font: str | os.PathLike[str] | None = None
) -> tuple[list[list[np.ndarray]], np.ndarray]:
    """Return the outlines of one line of text, with a size of 1 from line to line.

    Parameters
    ----------
    text : str
        Characters; spaces make room.
    font : path, optional
        A file .ttf or .otf; `default_font` if not given.

    Returns
    -------
    contours : list of lists of (n+1, 2) arrays
        Closed outlines, curves of degree 1 to 3. The first letter begins at x = 0 on the line
        y = 0.
    size : (2,) array
        Width of the text, and height of a capital letter.

    Raises
    ------
    GeometryError
        If the text is none or has a character that the font has not.
    FileFormatError
        If the file is no font.
    RuntimeSetupError
        Without fontTools.
    """
    if not isinstance(text, str) or not text.strip():
        raise GeometryError.expected("text", "characters to draw", repr(text))
    try:
        from fontTools.pens.basePen import BasePen
        from fontTools.pens.boundsPen import BoundsPen
        from fontTools.ttLib import TTFont, TTLibError
    except ImportError as error:
        raise RuntimeSetupError.expected(
            "text", "fontTools, which reads fonts", f"none ({error}): {_HINT}"
        ) from None

    class Pen(BasePen):
        """Collect the curves as they are, not converted."""

        def __init__(self, glyphs: Any, shift: float, scale: float) -> None:
            super().__init__(glyphs)
            self.shift, self.scale = shift, scale
            self.contours: list[list[np.ndarray]] = []
            self.start: Any = None

        def _add(self, *points: Any) -> None:
            x = np.array([self._getCurrentPoint(), *points], dtype=np.float64)
            x[:, 0] += self.shift
            self.contours[-1].append(self.scale * x)

        def _moveTo(self, pt: Any) -> None:
            self.contours.append([])
            self.start = pt

        def _lineTo(self, pt: Any) -> None:
            self._add(pt)

        def _curveToOne(self, pt1: Any, pt2: Any, pt3: Any) -> None:
            self._add(pt1, pt2, pt3)

        def _qCurveToOne(self, pt1: Any, pt2: Any) -> None:
            self._add(pt1, pt2)

        def _closePath(self) -> None:
            if self._getCurrentPoint() != self.start:
                self._add(self.start)

    path = default_font() if font is None else os.fspath(font)
    try:
        with TTFont(path, lazy=True, fontNumber=0) as file:
            known = file.getBestCmap() or {}
            glyphs = file.getGlyphSet()
            scale = 1.0 / file["head"].unitsPerEm
            x, contours = 0.0, []
            for character in text:
                if ord(character) not in known:
                    raise GeometryError.expected(
                        "text",
                        f"characters of the font {os.path.basename(path)}",
                        f"{character!r} (U+{ord(character):04X}), which it has not",
                    )
                glyph = glyphs[known[ord(character)]]
                pen = Pen(glyphs, x, scale)
                glyph.draw(pen)
                contours += [c for c in pen.contours if len(c) > 1]
                x += glyph.width
            box = BoundsPen(glyphs)  # what tables say of the height of capitals may be missing
            glyphs[known.get(ord("H"), known[ord(text.strip()[0])])].draw(box)
            capital = scale * box.bounds[3] if box.bounds else 0.7
    except (OSError, TTLibError, KeyError, AssertionError) as error:
        raise FileFormatError.expected("font", "a font, .ttf or .otf", f"{path}: {error}") from None
    return contours, np.array([x * scale, capital])
