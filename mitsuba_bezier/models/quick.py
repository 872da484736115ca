"""Draw a model with NumPy alone, in a second or so: what notebooks show of it.

Each patch is sampled about as finely as pixels are, and the nearest sample colours a pixel. No
variant is needed and nothing is compiled; `mb.show` and ``render`` give the exact picture.
"""

from __future__ import annotations

import struct
import time
import zlib
from typing import Any

import numpy as np

from ..geometry import bernstein
from ..geometry.boxes import reaches_infinity
from ..geometry.triangles import BezierTriangles
from ..geometry.trims import Trims
from ..io.parts import Part
from .camera import View, fitted, read_up, read_view, view_frame

__all__ = ["TooMuch", "drawn", "png_of"]

#: Width and height.
SIZE = (320, 240)
#: Samples in all, and divisions of a patch's side; what takes more is not drawn.
_MOST, _DIVISIONS = 600_000, 256
#: The same for seconds of the processor.
_SECONDS = 1.2
#: Pixels without a sample are filled if so many of their eight neighbours have one, so often.
_NEIGHBOURS, _FILLS = 4, 3
#: Directions of light, right, up and towards the camera, and their strengths.
_LIGHTS = (((-0.5, 0.7, 0.5), 0.75), ((0.8, 0.1, 0.4), 0.2))
_AMBIENT = 0.22


class TooMuch(Exception):
    """A model that cannot be drawn in so short a time."""


def drawn(parts: list[Part], colours: list[Any]) -> np.ndarray | None:
    """Return a picture ``(H, W, 3)``, uint8, of parts; None if nothing of them is finite.

    Parameters
    ----------
    parts : list of Part
    colours : list of (3,) sequences
        Linear colours of the parts.

    Raises
    ------
    TooMuch
        If it would take too long.
    """
    from . import bounds

    parts = [_finite(part) for part in parts]
    if not any(len(part) for part in parts):
        return None
    points = bounds.surface_points([part for part in parts if len(part)])
    if not len(points) or not np.ptp(points, axis=0).any():
        return None
    width, height = SIZE
    end = time.process_time() + _SECONDS
    view = fitted(points, view_frame(*read_view("iso"), read_up("z")), 24.0, width / height)
    depth = np.full(width * height, np.inf)
    shade = np.ones((width * height, 3))
    budget = _MOST
    for part, colour in zip(parts, colours):
        for number, (group, trims) in enumerate(zip(part.groups, part.trims)):
            paint = part.paint_of(number)
            table = np.array([*part.paints, colour])[paint]  # -1 is the last
            for matrix in part.placements:
                budget -= _group(group, trims, matrix, view, table, depth, shade, budget, end)
    picture = _filled(shade.reshape(height, width, 3), np.isfinite(depth).reshape(height, width))
    encoded = np.where(
        picture <= 0.0031308, 12.92 * picture, 1.055 * picture.clip(1e-9) ** (1 / 2.4) - 0.055
    )
    return np.rint(255 * encoded.clip(0, 1)).astype(np.uint8)


def _finite(part: Part) -> Part:
    """Return a part without patches that reach infinity."""
    from dataclasses import replace

    groups, sources, painted = [], [], []
    trims: list[Trims | None] = []
    for k, group in enumerate(part.groups):
        rows = np.flatnonzero(~reaches_infinity(group.control_points))
        if len(rows):
            groups.append(group[rows])
            sources.append(part.sources[k][rows])
            own = part.trims[k]
            trims.append(None if own is None else own[rows])
            painted.append(part.paint_of(k)[rows])
    return replace(part, groups=groups, sources=sources, trims=trims, painted=painted)


def _group(
    group: BezierTriangles,
    trims: Trims | None,
    matrix: np.ndarray,
    view: View,
    table: np.ndarray,
    depth: np.ndarray,
    shade: np.ndarray,
    budget: int,
    end: float,
) -> int:
    """Draw a group at one place; return how many samples it took."""
    back = view.origin - view.target
    back = back / np.linalg.norm(back)
    rows = np.stack([np.cross(view.up, back), view.up, back])
    width, height = SIZE
    scale = height / 2 / np.tan(np.radians(float(view.fov or 24.0)) / 2)
    nets = group.control_points @ matrix.T
    with np.errstate(all="ignore"):
        hull = nets[..., :3] / nets[..., 3:]
    away = (view.origin - hull) @ back
    pixels = np.nan_to_num(np.ptp(hull, axis=1).max(axis=1) * scale / np.abs(away).min(axis=1))
    wanted = np.clip(np.ceil(pixels), 2, _DIVISIONS).astype(int)
    wanted = 2 ** np.ceil(np.log2(wanted)).astype(int)  # few kinds of lattices
    total = int((wanted * wanted / 2).sum())
    if total > budget:
        raise TooMuch
    taken = 0
    for divisions in np.unique(wanted).tolist():
        if time.process_time() > end:
            raise TooMuch
        mine = np.flatnonzero(wanted == divisions)
        uv = bernstein.multi_indices(divisions)[:, :2] / divisions
        patch, at = np.repeat(mine, len(uv)), np.tile(uv, (len(mine), 1))
        taken += len(patch)
        x, xu, xv = (h @ matrix.T for h in group.partials(patch, at, order=1))
        with np.errstate(all="ignore"):
            p = x[:, :3] / x[:, 3:]
            du, dv = (d[:, :3] - p * d[:, 3:] for d in (xu, xv))
            n = np.cross(du, dv)
            n /= np.linalg.norm(n, axis=1, keepdims=True)
        local = (p - view.origin) @ rows.T
        with np.errstate(all="ignore"):
            column = width / 2 + scale * local[:, 0] / -local[:, 2]
            line = height / 2 - scale * local[:, 1] / -local[:, 2]
        good = np.isfinite(column) & np.isfinite(line) & np.isfinite(n).all(axis=1)
        good &= (column >= 0) & (column < width) & (line >= 0) & (line < height)
        seen = np.full(len(good), -1)
        seen[good] = line[good].astype(int) * width + column[good].astype(int)
        good[good] &= -local[good, 2] < depth[seen[good]]
        if trims is not None and good.any():  # the slowest comes last
            good[good] &= trims.inside(patch[good], at[good])
        if not good.any():
            continue
        place = line[good].astype(int) * width + column[good].astype(int)
        normal = n[good] @ rows.T
        towards = -local[good] / np.linalg.norm(local[good], axis=1, keepdims=True)
        normal *= np.sign((normal * towards).sum(axis=1, keepdims=True))
        light = np.full(len(normal), _AMBIENT)
        for direction, strength in _LIGHTS:
            d = np.array(direction) / np.linalg.norm(direction)
            light += strength * np.maximum(normal @ d, 0.0)
        order = np.argsort(local[good, 2], kind="stable")  # the nearest last
        place, near = place[order], -local[good, 2][order]
        colour = (table[patch[good]] * light[:, None])[order]
        front = near < depth[place]
        # of several samples of a pixel the last written is the nearest
        depth[place[front]], shade[place[front]] = near[front], colour[front]
    return taken


def _filled(picture: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Return a picture whose small gaps have the mean of what is around them."""
    for _ in range(_FILLS):
        around = np.pad(known, 1).astype(float)
        colours = np.pad(picture * known[..., None], ((1, 1), (1, 1), (0, 0)))
        moves = [(i, j) for i in range(3) for j in range(3) if (i, j) != (1, 1)]
        h, w = known.shape
        count = np.sum([around[i : i + h, j : j + w] for i, j in moves], axis=0)
        total = np.sum([colours[i : i + h, j : j + w] for i, j in moves], axis=0)
        gap = ~known & (count >= _NEIGHBOURS)
        picture = np.where(gap[..., None], total / np.maximum(count, 1)[..., None], picture)
        known = known | gap
    return picture


def png_of(pixels: np.ndarray) -> bytes:
    """Return a PNG of ``(H, W, 3)`` bytes; Mitsuba may not be there."""
    height, width = pixels.shape[:2]
    rows = np.concatenate([np.zeros((height, 1), np.uint8), pixels.reshape(height, -1)], axis=1)

    def chunk(name: bytes, data: bytes) -> bytes:
        body = name + data
        return struct.pack(">I", len(data)) + body + struct.pack(">I", zlib.crc32(body))

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    data = zlib.compress(rows.tobytes(), 6)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", data) + chunk(b"IEND", b"")
