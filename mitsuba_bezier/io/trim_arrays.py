"""Pack trims into a few plain arrays, for files."""

from __future__ import annotations

import numpy as np

from ..errors import GeometryError
from ..geometry.trims import Trims

__all__ = ["packed_trims", "trims_of_numbers", "trims_to_numbers", "unpacked_trims"]


def packed_trims(trims: Trims) -> dict[str, np.ndarray]:
    """Return trims as arrays.

    Returns
    -------
    dict
        ``region`` (P,) integers, -1 for whole patches; ``map`` (P, 12): M, place and arc of
        `Trims`, row by row; ``curves`` (S, 2) integers: region and number of points of each curve;
        ``points`` (N, 3): their homogeneous points.
    """
    count = len(trims)
    used = np.unique(trims.region[trims.region >= 0])
    number = np.full(len(trims.regions) + 1, -1)
    number[used] = np.arange(len(used))
    curves = [(k, c) for k, r in enumerate(used.tolist()) for c in trims.regions[r]]
    parts = [trims.square.reshape(count, 6), trims.place.reshape(count, 4), trims.arc]
    return {
        "region": number[trims.region],
        "map": np.concatenate(parts, axis=1),
        "curves": np.array([(k, len(c)) for k, c in curves], dtype=np.int64).reshape(-1, 2),
        "points": np.concatenate([c for _k, c in curves] or [np.zeros((0, 3))]),
    }


def unpacked_trims(arrays: dict[str, np.ndarray]) -> Trims:
    """Return the trims of the arrays of `packed_trims`.

    Raises
    ------
    GeometryError
        If the arrays do not fit each other, or what `Trims` objects to.
    """
    curves, points, maps = arrays["curves"], arrays["points"], arrays["map"]
    region = arrays["region"]
    sizes = curves[:, 1] if len(curves) else np.zeros(0, dtype=np.int64)
    if (sizes < 2).any() or int(sizes.sum()) != len(points) or maps.shape != (len(region), 12):
        raise GeometryError.expected(
            "trims", f"curves with {len(points)} points in all", f"{int(sizes.sum())}"
        )
    count = int(curves[:, 0].max()) + 1 if len(curves) else 0
    if len(curves) and (curves[:, 0].min() < 0 or count > len(curves)):
        raise GeometryError.expected(
            "trims", f"curves of regions below {len(curves)}", np.unique(curves[:, 0]).tolist()[:9]
        )
    regions: list[list[np.ndarray]] = [[] for _ in range(count)]
    for (number, size), stop in zip(curves.tolist(), np.cumsum(sizes).tolist()):
        regions[number].append(points[stop - size : stop])
    return Trims(
        regions,
        region,
        maps[:, :6].reshape(-1, 2, 3),
        maps[:, 6:10].reshape(-1, 2, 2),
        maps[:, 10:],
    )


def trims_to_numbers(trims: Trims) -> np.ndarray:
    """Return trims as one row of numbers ``(1, L)``, for where only one array may go."""
    parts = packed_trims(trims)
    head = [len(parts["region"]), len(parts["curves"]), len(parts["points"])]
    rows = [parts[name].ravel() for name in ("region", "map", "curves", "points")]
    return np.concatenate([head, *rows]).astype(np.float64)[None]


def trims_of_numbers(numbers: np.ndarray) -> Trims:
    """Return the trims of the row of `trims_to_numbers`.

    Raises
    ------
    GeometryError
        If it is no such row.
    """
    row = np.asarray(numbers, dtype=np.float64).ravel()
    head = row[:3]
    whole = len(head) == 3 and np.isfinite(head).all() and (head == np.floor(head)).all()
    if whole and (head >= 0).all() and len(row) == 3 + head @ [13, 2, 3]:
        patches, curves, points = (int(x) for x in head)
        cuts = np.cumsum([patches, 12 * patches, 2 * curves])
        region, maps, sizes, places = np.split(row[3:], cuts)
        whole_numbers = np.concatenate([region, sizes])
        if np.isfinite(row).all() and (whole_numbers == np.floor(whole_numbers)).all():
            return unpacked_trims(
                {
                    "region": region.astype(np.int64),
                    "map": maps.reshape(-1, 12),
                    "curves": sizes.astype(np.int64).reshape(-1, 2),
                    "points": places.reshape(points, 3),
                }
            )
    raise GeometryError.expected("trims", "a row of numbers of trims", f"{len(row)} others")
