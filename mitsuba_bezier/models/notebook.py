"""Show models: a quick picture in notebooks, and `mb.show`, the exact one."""

from __future__ import annotations

import sys
import tempfile
import webbrowser
from pathlib import Path
from typing import Any

import numpy as np

from .materials import PALETTE
from .quick import TooMuch, drawn, png_of
from .scene import models_of

__all__ = ["Picture", "quick_png", "show"]


def quick_png(model: Any) -> bytes | None:
    """Return a small PNG of a model or a net, drawn with NumPy from points of the surface.

    None if there is nothing finite to see, or more than a second's work: `show` renders these.
    """
    parts = [part for one in models_of(model) for part in one.parts if part.visible]
    coloured = any(part.colour is not None or part.paints for part in parts)
    colours = [
        part.colour or ((0.55, 0.56, 0.58) if coloured else PALETTE[k % len(PALETTE)])
        for k, part in enumerate(parts)
    ]
    try:
        pixels = drawn(parts, colours)
    except TooMuch:
        return None
    return None if pixels is None else png_of(pixels)


class Picture:
    """A rendered picture, which notebooks show.

    Attributes
    ----------
    pixels : (H, W, 3) array
        uint8, sRGB.
    """

    def __init__(self, pixels: np.ndarray) -> None:
        self.pixels = pixels

    def __repr__(self) -> str:
        height, width = self.pixels.shape[:2]
        return f"<Picture of {width} x {height} pixels>"

    def _repr_png_(self) -> bytes:
        return png_of(self.pixels)

    def save(self, path: Any) -> None:
        """Write it as PNG."""
        from .._files import write_file

        write_file(path, self._repr_png_(), "path")


def show(model: Any, **look: Any) -> Picture:
    """Render a model and show it: in a notebook there, else in the system's viewer of pictures.

    Parameters
    ----------
    model : Model, BezierTriangles, path, or list of these
    **look
        Those of `scene`; by default 640 x 480 pixels and 32 samples.

    Returns
    -------
    Picture

    Raises
    ------
    BezierError
        As `scene`, or if no variant is set.

    Examples
    --------
    >>> mi.set_variant("llvm_ad_rgb")
    >>> mb.show(mb.torus(), size=(32, 24), spp=1)
    <Picture of 32 x 24 pixels>
    """
    import mitsuba as mi

    from .. import _runtime
    from .scene import scene

    _runtime.check(mi.variant())
    look = {"size": (640, 480), "spp": 32, **look}
    image = np.array(mi.render(mi.load_dict(scene(model, **look)), spp=look["spp"]))
    white = image[..., :3] + (1.0 - image[..., 3:].clip(0, 1))
    bitmap = mi.Bitmap(np.ascontiguousarray(np.nan_to_num(white), dtype=np.float32))
    kinds = mi.Bitmap.PixelFormat
    shown = bitmap.convert(kinds.RGB, mi.Struct.Type.UInt8, srgb_gamma=True)
    picture = Picture(np.array(shown))
    if "IPython" not in sys.modules and hasattr(sys, "ps1"):  # at a plain prompt
        with tempfile.NamedTemporaryFile(suffix=".png", delete=False) as file:
            file.write(picture._repr_png_())
        webbrowser.open(Path(file.name).as_uri())
    return picture
