"""Options of ``render MODEL`` for fields: colours, their bar, displaced surfaces."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import BezierError
from ._model import Extra

__all__ = ["add_options", "prepare"]


def _range(text: str) -> tuple[float | None, float | None]:
    words = text.split(",")
    try:
        ends = [float(word) if word.strip() else None for word in words]
    except ValueError:
        ends = []
    numbers = [x for x in ends if x is not None]
    if len(ends) != 2 or not numbers or not np.isfinite(numbers).all():
        raise argparse.ArgumentTypeError(f"expected A,B (or A, or ,B), got {text!r}")
    if len(numbers) == 2 and not numbers[0] < numbers[1]:
        raise argparse.ArgumentTypeError(f"expected A,B with A < B, got {text!r}")
    return ends[0], ends[1]


def _levels(text: str) -> int:
    from ..plugins.field_parameters import MAX_LEVELS

    if not text.isdecimal() or len(text) > 9 or not 1 <= int(text) <= MAX_LEVELS:
        raise argparse.ArgumentTypeError(f"expected a number from 1 to {MAX_LEVELS}, got {text!r}")
    return int(text)


def add_options(add: Callable[..., Any]) -> None:
    """Add the options."""
    add(
        "--color-by",
        metavar="NAME",
        help="colours by a field of the model, which 'info' lists, or a grid function's file (.gf)",
    )
    add("--component", metavar="C", help="a number, x, y, z or magnitude (the only one, or that)")
    add("--colormap", metavar="MAP", help="a colour map of matplotlib's (viridis)")
    add("--range", metavar="A,B", type=_range, help="values of the first and the last colour")
    add("--levels", metavar="N", type=_levels, help="bands of one colour each (colours run)")
    add("--isolines", action="store_true", default=None, help="lines between levels (of 12)")
    add("--edges", action="store_true", default=None, help="lines at the sides of elements")
    add("--no-bar", action="store_true", default=None, help="no bar of colours beside the picture")
    add("--warp", metavar="NAME", help="move points by a field of vectors, exactly")
    add("--factor", metavar="F", type=float, help="what these vectors are multiplied by (1)")


def _with_functions(model: Any, given: dict[str, Any]) -> Any:
    """Return a mesh of MFEM with the grid functions that options name by their files."""
    files = {
        str(given[name])
        for name in ("color_by", "warp")
        if str(given.get(name, "")).lower().endswith(".gf")
    }
    path = model.report.path
    if not files or Path(path).suffix.lower() != ".mesh":
        return model
    from ..io import read

    return read(path, trims=True, fields=sorted(files))


def prepare(args: argparse.Namespace, models: list[Any]) -> Extra | None:
    """Return what the options ask for, None if nothing."""
    from ..models.colorbar import beside, check_library, color_bar
    from ..models.fields import FieldLook, coloring, warped_models

    names = ("color_by", "component", "colormap", "range", "levels", "isolines", "edges")
    given = {
        name: getattr(args, name)
        for name in (*names, "warp", "factor")
        if getattr(args, name) is not None
    }
    if not given:
        if args.no_bar:
            raise BezierError.expected("--no-bar", "with --color-by NAME", "without")
        return None
    for name, other in (("factor", "warp"), *((n, "color_by") for n in (*names[1:], "no_bar"))):
        if getattr(args, name) is not None and getattr(args, other) is None:
            flag, needs = (f"--{x.replace('_', '-')}" for x in (name, other))
            raise BezierError.expected(flag, f"with {needs} NAME", "without")
    models = [_with_functions(model, given) for model in models]
    for name in ("color_by", "warp"):
        if str(given.get(name, "")).lower().endswith(".gf"):
            given[name] = Path(given[name]).stem
    look = FieldLook(**given)
    if look.warp is not None:
        models = warped_models(models, look.warp, look.factor)
    if look.color_by is None:
        return Extra(models)
    colors = coloring(models, look)
    if args.no_bar:
        return Extra(models, colors)
    check_library()

    def finish(picture: np.ndarray) -> np.ndarray:
        bar = color_bar(
            len(picture),
            colors.limits,
            look.colormap,
            colors.label,
            look.levels,
            (look.levels or 12) if look.isolines else 0,
            picture.shape[2] == 4,
        )
        return beside(picture, bar)

    low, high = colors.limits
    return Extra(models, colors, finish, [f"{colors.label}: {low:.6g} to {high:.6g}"])
