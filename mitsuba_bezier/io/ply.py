"""Tessellate to ``.ply`` at a chosen chord error, for programs that need triangles.

Each boundary curve is cut by its own error alone, so two patches that share a curve cut it alike
and leave no crack; inside, a patch is cut by its own error.
"""

from __future__ import annotations

from functools import cache, lru_cache
from os import PathLike

import numpy as np

from ..errors import FileFormatError
from ..geometry import bernstein
from ..geometry.triangles import BezierTriangles
from .files import write_bytes

__all__ = ["tessellate", "write"]

_MAX_RESOLUTION = 1024
_MAX_FACES = 50_000_000
_CHUNK = 100_000  # points evaluated together: keeps the memory for basis functions small

#: The three edges of a lattice triangle of resolution r, as rows of points: A to B, B to C, C to A.
_EDGES = ((0, 1), (1, 2), (2, 0))


@cache
def _lattice_edges(r: int) -> tuple[np.ndarray, np.ndarray]:
    """Return all edges of the lattice of resolution r, by rows of the lattice of 2r.

    Returns
    -------
    (E, 3) int array
        First point, second point, the point half way.
    (E,) int array
        The boundary edge it is part of, or 3 for edges inside.
    """
    cells = bernstein.multi_indices(r - 1)
    corners = cells[:, None] + np.eye(3, dtype=int)  # of the upright triangles: all edges
    edges, part = [], []
    for e, (a, b) in enumerate(_EDGES):
        p, q = corners[:, a], corners[:, b]
        edges.append(np.stack([_row(2 * r, 2 * p), _row(2 * r, 2 * q), _row(2 * r, p + q)], axis=1))
        zero = 3 - a - b  # the index that vanishes along this edge of the patch
        part.append(np.where(p[:, zero] == 0, e, 3))
    return np.concatenate(edges), np.concatenate(part)


def _row(r: int, index: np.ndarray) -> np.ndarray:
    """Return `bernstein.row` of multi-indices ``(..., 3)``."""
    level = r - index[..., 0]
    return level * (level + 1) // 2 + level - index[..., 1]


def _errors(triangles: BezierTriangles, r: int) -> np.ndarray:
    """Return the chord errors ``(P, 4)`` at resolution r: of the three edges, and inside."""
    points = _points(triangles, 2 * r)
    edges, part = _lattice_edges(r)
    a, b, half = (points[:, edges[:, c]] for c in range(3))
    chord = b - a
    length2 = np.maximum((chord**2).sum(axis=-1), 1e-300)
    t = np.clip(((half - a) * chord).sum(axis=-1) / length2, 0, 1)
    distance = np.linalg.norm(half - a - t[..., None] * chord, axis=-1)
    return np.stack([distance[:, part == e].max(axis=1, initial=0.0) for e in range(4)], axis=1)


@lru_cache(maxsize=4)
def _basis(n: int, r: int) -> np.ndarray:
    return bernstein.basis(n, bernstein.multi_indices(r)[:, :2] / r)


def _points(triangles: BezierTriangles, r: int) -> np.ndarray:
    """Return lattice points ``(P, K_r, 3)``."""
    h = _basis(triangles.degree, r) @ triangles.control_points
    with np.errstate(divide="ignore", invalid="ignore"):
        return h[..., :3] / h[..., 3:]


def _resolutions(triangles: BezierTriangles, chord_error: float) -> np.ndarray:
    """Return resolutions ``(P, 4)``, powers of two: of the three edges, and of the patch.

    A resolution is accepted when the error is small there and at twice the resolution: a curve
    with a turning point half way shows no error in the first of the two.
    """
    n = triangles.degree
    out = np.full((len(triangles), 4), 0)
    levels: dict[int, np.ndarray] = {}
    todo = np.arange(len(triangles))
    r = 1
    while len(todo):
        both = []
        for level in (r, 2 * r):
            if level not in levels:
                levels[level] = np.full((len(triangles), 4), np.nan)
            missing = todo[np.isnan(levels[level][todo, 0])]
            step = max(1, _CHUNK // (2 * level + 1) ** 2)
            for at in range(0, len(missing), step):
                chunk = missing[at : at + step]
                levels[level][chunk] = _errors(triangles[chunk], level)
            both.append(levels[level][todo])
        error = np.maximum(*both)
        good = error <= chord_error
        # the error falls with the square of the resolution: tell early what cannot be reached
        if r >= 8 and (reach := error.max() * (r / _MAX_RESOLUTION) ** 2) > 2 * chord_error:
            raise FileFormatError.expected(
                "chord_error",
                f"an error that {_MAX_RESOLUTION} pieces an edge can reach (about {reach:.2g})",
                f"{chord_error:g}",
            )
        if n == 1:
            good[:] = True
        part = out[todo]
        part[good & (part == 0)] = r
        out[todo] = part
        todo = todo[(part == 0).any(axis=1)]
        r *= 2
    out[:, 3] = out.max(axis=1)
    return out


def tessellate(
    triangles: BezierTriangles, chord_error: float | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a triangle mesh that stays within a chord error of the surface.

    Parameters
    ----------
    triangles : BezierTriangles
        The patches; none may reach infinity.
    chord_error : float, optional
        Largest distance between the edges of the mesh and the surface, measured half way along
        each edge; by default 1/1000 of the diagonal of the bounding box.

    Returns
    -------
    vertices, normals : (V, 3) float64 arrays
        Not shared between patches, so that sharp edges keep their normals.
    faces : (F, 3) int array

    Raises
    ------
    FileFormatError
        If a patch reaches infinity or the mesh would have more than 50 million triangles.
    """
    sample = _points(triangles, 8)
    weights = (
        bernstein.basis(triangles.degree, bernstein.multi_indices(8)[:, :2] / 8)
        @ (triangles.control_points[..., 3:])
    )
    sign_changes = (weights.min(axis=(1, 2)) <= 0) & (weights.max(axis=(1, 2)) >= 0)
    if sign_changes.any() or not np.isfinite(sample).all():
        raise FileFormatError.expected(
            "triangles",
            "patches that do not reach infinity, to be cut into flat triangles",
            f"patch {int(np.argmax(sign_changes))}, which does",
        )
    if chord_error is None:
        flat = sample.reshape(-1, 3)
        chord_error = 1e-3 * float(np.linalg.norm(np.ptp(flat, axis=0)))
    if not chord_error > 0 or not np.isfinite(chord_error):
        raise FileFormatError.expected("chord_error", "a positive length", chord_error)
    resolutions = _resolutions(triangles, chord_error)
    total = int((resolutions[:, 3].astype(np.int64) ** 2).sum())
    if total > _MAX_FACES:
        raise FileFormatError.expected(
            "chord_error", f"at most {_MAX_FACES} triangles", f"{total}: use a larger one"
        )
    vertices, normals, faces = [], [], []
    offset = 0
    for key in np.unique(resolutions, axis=0):
        chosen = np.flatnonzero((resolutions == key).all(axis=1))
        r = int(key[3])
        points, pattern = _pattern(r, key[:3])
        uv = bernstein.multi_indices(r)[points, :2] / r
        step = max(1, _CHUNK // len(uv))
        for at in range(0, len(chosen), step):
            patch = np.repeat(chosen[at : at + step], len(uv))
            all_uv = np.tile(uv, (len(patch) // len(uv), 1))
            vertices.append(triangles.points(patch, all_uv))
            normals.append(triangles.normals(patch, all_uv))
        start = offset + len(uv) * np.arange(len(chosen))[:, None, None]
        faces.append((pattern[None] + start).reshape(-1, 3))
        offset += len(uv) * len(chosen)
    return np.concatenate(vertices), np.concatenate(normals), np.concatenate(faces)


def _pattern(r: int, edges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the lattice rows used and the faces of a patch whose edges are cut more coarsely.

    Boundary points between those of the coarser edge move to the nearest of them; triangles
    that lose their area are dropped.
    """
    unit = np.eye(3, dtype=int)
    upright = bernstein.multi_indices(r - 1)[:, None] + unit
    faces = [_row(r, upright)]
    if r >= 2:  # between them, those turned by half a turn
        faces.append(_row(r, bernstein.multi_indices(r - 2)[:, None] + (1 - unit)))
    target = np.arange(bernstein.size(r))
    for e, rows in enumerate(bernstein.edge_rows(r)):
        step = r // int(edges[e])
        target[rows] = rows[(np.arange(r + 1) + step // 2) // step * step]
    moved = target[np.concatenate(faces)]
    a, b, c = moved.T
    moved = moved[(a != b) & (b != c) & (c != a)]
    points, inverse = np.unique(moved, return_inverse=True)
    return points, inverse.reshape(-1, 3)


def write(
    triangles: BezierTriangles | list[BezierTriangles],
    path: str | PathLike[str],
    chord_error: float | None = None,
) -> None:
    """Write a binary ``.ply`` of flat triangles with exact normals at the vertices.

    Parameters
    ----------
    triangles : BezierTriangles or list of BezierTriangles
        The patches.
    path : path
        The file.
    chord_error : float, optional
        See `tessellate`.

    Raises
    ------
    FileFormatError
        As `tessellate`, or if the file cannot be written.
    """
    if not isinstance(triangles, BezierTriangles):
        triangles = BezierTriangles.join(list(triangles))
    vertices, normals, faces = tessellate(triangles, chord_error)
    rows = np.zeros(len(faces), dtype=[("count", "u1"), ("index", "<i4", 3)])
    rows["count"] = 3
    rows["index"] = faces
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"element vertex {len(vertices)}",
        *(f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz")),
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        "end_header\n",
    ]
    data = np.concatenate([vertices, normals], axis=1).astype("<f4")
    write_bytes(path, "\n".join(header).encode() + data.tobytes() + rows.tobytes())
