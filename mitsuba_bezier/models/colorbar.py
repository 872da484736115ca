"""Draw the bar of a colour scale, beside a picture (the extra ``[plot]``)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..errors import BezierError
from ..plugins.colormaps import banded, color_table

__all__ = ["beside", "check_library", "color_bar", "tick_labels", "tick_values"]


def check_library() -> None:
    """Raise `BezierError` with what to install, if matplotlib is not there."""
    try:
        import matplotlib  # noqa: F401
    except ImportError as error:
        raise BezierError.expected(
            "color-by",
            "matplotlib, which draws the bar: pip install 'mitsuba-bezier[plot]' (or --no-bar)",
            f"none ({error})",
        ) from None


def tick_values(low: float, high: float, levels: int = 0, most: int = 7) -> list[float]:
    """Return values for ticks, rising: both ends, and round numbers between, or ends of levels.

    Parameters
    ----------
    low, high : float
        The ends.
    levels : int
        Number of bands; 0: round numbers.
    most : int
        How many there may be.
    """
    size = high - low
    if levels:
        step = -(-levels // max(most - 1, 1))
        inner = [low + size * k / levels for k in range(step, levels, step)]
    else:
        from matplotlib.ticker import MaxNLocator

        inner = [float(x) for x in MaxNLocator(max(most - 2, 1)).tick_values(low, high)]
    gap = 0.6 * size / max(most - 1, 1)
    return [low, *(x for x in inner if low + gap < x < high - gap), high]


def tick_labels(values: Sequence[float]) -> list[str]:
    """Return texts with as many digits as tell the values apart, off by 1/500 of the scale at most.

    All have the same number of decimals; large and small numbers have exponents.
    """
    size = abs(values[-1] - values[0])
    largest = max(abs(x) for x in values)
    decimals = max(0, math.ceil(-math.log10(2e-3 * size)))
    if largest >= 1e6 or largest < 1e-3 or decimals > 9:
        digits = max(1, math.ceil(math.log10(largest / (2e-3 * size))))
        texts = [f"{x:.{min(digits, 16)}e}" for x in values]
        texts = [f"{t.split('e')[0]}e{int(t.split('e')[1])}" for t in texts]
    else:
        texts = [f"{x:.{decimals}f}" for x in values]
        while all("." in t and t[-1] in "0." for t in texts):
            texts = [t[:-1] for t in texts]
    texts = [t.removeprefix("-") if float(t) == 0 else t for t in texts]
    return [t.replace("-", "\N{MINUS SIGN}") for t in texts]


def color_bar(
    height: int,
    limits: tuple[float, float],
    colormap: str = "viridis",
    label: str = "",
    levels: int = 0,
    isolines: int = 0,
    alpha: bool = False,
) -> np.ndarray:
    """Return the picture of a bar: colours, ticks whose first and last are the limits, a label.

    Parameters
    ----------
    height : int
        In pixels.
    limits : (float, float)
        Values of the first and the last colour.
    colormap, label : str
    levels : int
        Bands of one colour each; 0: colours run.
    isolines : int
        Intervals between lines; 0: none.
    alpha : bool
        Whether what is behind it can be seen.

    Returns
    -------
    (height, W, 3 or 4) array
        Of uint8.

    Raises
    ------
    BezierError
        If matplotlib is missing.
    """
    check_library()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    low, high = limits
    # letters of a fiftieth of the height, but such as can be read
    dpi = 100.0
    points = float(np.clip(height / 50, 8.0, 30.0)) * 72 / dpi
    values = tick_values(low, high, levels, most=int(np.clip(height / (4 * points), 2, 9)))
    texts = tick_labels(values)
    em = points * dpi / 72
    width = round(em * (5.0 + 0.65 * max(map(len, texts)) + 2.2 * bool(label)))
    figure = Figure(figsize=(width / dpi, height / dpi), dpi=dpi)
    canvas = FigureCanvasAgg(figure)
    figure.patch.set_alpha(0.0 if alpha else 1.0)
    axes = figure.add_axes((2 * em / width, 0.08, 1.6 * em / width, 0.84))
    colors = banded(colormap, levels) if levels else np.asarray(color_table(colormap))
    axes.imshow(
        colors[:, None],
        origin="lower",
        aspect="auto",
        extent=(0, 1, 0, 1),
        interpolation="nearest" if levels else "bilinear",
    )
    places = [(x - low) / (high - low) for x in values]
    axes.set_xticks([])
    axes.yaxis.tick_right()
    axes.set_yticks(places, texts, fontsize=points)
    axes.tick_params(length=0.35 * em, width=0.08 * points, pad=0.3 * points)
    axes.set_ylim(0, 1)
    for k in range(1, isolines):
        axes.axhline(k / isolines, color="black", linewidth=0.09 * points)
    for side in axes.spines.values():
        side.set_linewidth(0.08 * points)
    if label:
        text: Any = axes.set_ylabel(label, fontsize=points)
        axes.yaxis.set_label_position("right")
        canvas.draw()
        room = 0.84 * height
        long = text.get_window_extent().height
        if long > room:  # a long name in smaller letters, and at last cut
            text.set_fontsize(max(points * room / long, 0.45 * points))
    canvas.draw()
    picture = np.asarray(canvas.buffer_rgba()).copy()
    picture = _of_size(picture, height, width)
    return picture if alpha else picture[..., :3]


def _of_size(picture: np.ndarray, height: int, width: int) -> np.ndarray:
    """Return a picture of a size that rounding may have missed by a pixel."""
    padded = np.pad(
        picture,
        ((0, max(height - len(picture), 0)), (0, max(width - picture.shape[1], 0)), (0, 0)),
        mode="edge",
    )
    return padded[:height, :width]


def beside(picture: np.ndarray, bar: np.ndarray) -> np.ndarray:
    """Return a picture with a bar at its right."""
    if picture.shape[2] == 4 and bar.shape[2] == 3:
        bar = np.concatenate([bar, np.full((*bar.shape[:2], 1), 255, np.uint8)], axis=2)
    return np.concatenate([picture, bar[..., : picture.shape[2]]], axis=1)
