"""The buffers of exact leaves: groups that share a quadric, their members and inverses."""

from __future__ import annotations

import numpy as np

from ..geometry import bernstein
from ..leaves.closed_form.fits import matrices
from ..leaves.closed_form.inverted import margin_planes
from ..leaves.closed_form.plane_sections import edge_planes, shared_map
from ..leaves.closed_form.sectors import cone_planes
from ..leaves.records import DEVIATION, LEAST, SECTION, Leaves

__all__ = [
    "AXES",
    "CELLS",
    "FEW",
    "GROUP",
    "MEMBER",
    "TABLE",
    "axes_records",
    "cell_records",
    "group_records",
    "inverse_records",
    "member_records",
    "member_sides",
    "ranges",
    "section_records",
    "shared_section",
]

#: Float64 in a group: quadric 10, shift 3, first member, number of members, `DEVIATION`.
GROUP = 16
#: Float64 in the record of a group's `Leaves.axes`, row by row; seven are not used.
AXES = 16
#: Floats in a member of a group: rows of four for its three sides, leaf number as bits, `LEAST`,
#: `SECTION`.
MEMBER = 16
#: Before the members of each group, if one has at least `FEW` and no leaf is inverted, so many
#: records: a table of four bits for each of 8 x 8 x 8 cells about the group's origin, the member
#: that covers it most likely. The last float of the group's first member holds the three factors
#: that take lengths to cells.
TABLE = 4
FEW = 3
#: Where parameters tell whether a point is on a member, groups of at least `FEW` have another
#: table, of so many words: the factors that take lengths to cells, five that are not used, and for
#: each of 8 x 8 x 8 cells which members may have a point in it, as 16 bits. The sixth and
#: further bits of the number of members are the number of the group's table, from one on.
CELLS = 8 + 256
#: Cells are as much larger, in their own size, as tolerances of edges make points be off, and by
#: this of how far the group reaches, by rounding: of four float32 numbers of that size. Where the
#: group is thin, as in the direction of a plane's normal, that is more than the first; there a cell
#: is eight times as large.
_AROUND, _OFF = 0.05, 5e-7


def ranges(labels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return first index and length of the runs of equal labels."""
    if not len(labels):
        return np.zeros(0, dtype=int), np.zeros(0, dtype=int)
    first = np.flatnonzero(np.diff(labels, prepend=labels[0] - 1))
    return first, np.diff(first, append=len(labels))


def group_records(
    leaves: Leaves, exact: np.ndarray, first: np.ndarray, size: np.ndarray
) -> np.ndarray:
    """Return the records of groups, each with `size` of the `exact` leaves from `first` on."""
    out = np.zeros((len(first), GROUP))
    head = exact[first] if len(first) else exact
    out[:, :10] = leaves.form[head, :10]
    out[:, 10:13] = leaves.shift[head]
    out[:, 13], out[:, 14] = first, size
    if len(first):
        out[:, 15] = np.maximum.reduceat(leaves.form[exact, DEVIATION], first)
    return out


def axes_records(leaves: Leaves, first: np.ndarray) -> np.ndarray:
    """Return the axes of groups, of their first leaves; nothing if all are those of space."""
    axes = leaves.axes[first]
    if (axes == np.eye(3)).all():
        return np.zeros((0, AXES))
    return np.pad(axes.reshape(-1, 9), ((0, 0), (0, AXES - 9)))


def inverse_records(leaves: Leaves, exact: np.ndarray) -> np.ndarray:
    """Return the rows of exact leaves, unscaled."""
    return leaves.frame[exact].reshape(-1, MEMBER)


def member_records(
    leaves: Leaves, exact: np.ndarray, sides: np.ndarray, first_leaf: int
) -> np.ndarray:
    """Return the records of members, with tables, for `exact` leaves numbered from `first_leaf`."""
    out = np.zeros((len(exact), MEMBER), dtype=np.float32)
    scale = _scale(leaves, exact, sides)
    out[:, :12] = (sides / scale[:, None, None]).reshape(-1, 12)
    out[:, 13] = leaves.form[exact, LEAST] / scale
    out[:, 14] = leaves.form[exact, SECTION]
    out[:, 12] = (first_leaf + np.arange(len(exact), dtype=np.uint32)).view(np.float32)
    if leaves.are_inverted.any():  # then `cell_records` tells more
        return out
    return _with_tables(leaves, exact, out)


def _scale(leaves: Leaves, exact: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """Return what `sides` give at the leaves, so that an error of float32 has one size."""
    reach = np.linalg.norm(_half_size(leaves.span[exact]), axis=1)
    scale = np.linalg.norm(sides[..., :3], axis=(1, 2)) * reach
    scale += np.linalg.norm(sides[..., 3], axis=1)
    section = leaves.are_sections[exact]
    scale[section] = scale[section].max(initial=0.0)  # all alike, for `shared_section`
    return scale


def member_sides(leaves: Leaves, exact: np.ndarray) -> np.ndarray:
    """Return the rows ``(E, 3, 4)`` whose values are not negative on an exact leaf.

    Where the leaf is none of the kinds below, they are its barycentrics but for a common factor.
    """
    rows = leaves.frame[exact, :3]
    for which, planes in (
        (leaves.are_sections, edge_planes),
        (leaves.are_inverted, margin_planes),
        (leaves.are_cones, cone_planes),
    ):
        bounded = np.flatnonzero(which[exact])
        if len(bounded):
            rows[bounded] = planes(leaves.select(exact[bounded]))
    return rows


def _with_tables(leaves: Leaves, exact: np.ndarray, members: np.ndarray) -> np.ndarray:
    """Put a table before the members of each group; see `TABLE`."""
    first, size = ranges(leaves.group[exact])
    if size.max(initial=0) < FEW:
        return members
    out = np.zeros((len(members) + TABLE * len(first), MEMBER), dtype=np.float32)
    cells = _cells() / 4
    for number, (start, count) in enumerate(zip(first, size)):
        mine = members[start : start + count]
        if count >= FEW:
            half = _reach(leaves.span[exact[start : start + count]])
            # three floats of ten bits: exponent and two of the mantissa, rounded down
            bits = (4 / half).astype(np.float32).view(np.uint32) >> np.uint32(21)
            half = 4 / (bits << np.uint32(21)).view(np.float32)
            bits = bits << np.arange(0, 30, 10, dtype=np.uint32)
            mine[0, MEMBER - 1] = bits.sum(dtype=np.uint32).view(np.float32)
            rows = mine[:, :12].reshape(-1, 4)
            points = _onto_quadric(leaves.form[exact[start]], cells * half)
            value = rows[:, :3] @ points.T + rows[:, 3:]
            value = value.reshape(count, 3, -1)
            total = value.sum(axis=1)
            # planes have sides, barycentrics have not
            sign = np.where(mine[:, 14:15] != 0, 1.0, np.sign(total))
            lowest = (value * sign[:, None]).min(axis=1) / np.maximum(np.abs(total), 1e-30)
            likely = lowest.argmax(axis=0).astype(np.uint32).reshape(-1, 8)
            words = (likely << np.arange(0, 32, 4, dtype=np.uint32)).sum(axis=1, dtype=np.uint32)
            out[start + TABLE * number :][:TABLE] = words.view(np.float32).reshape(TABLE, MEMBER)
        out[start + TABLE * (number + 1) :][:count] = mine
    return out


def cell_records(
    leaves: Leaves, exact: np.ndarray, sides: np.ndarray, groups: np.ndarray
) -> np.ndarray:
    """Return the tables of possible members, and write their numbers into the `groups`' records.

    A member may have points in a cell that meets its box, unless one of its sides, where it has
    such, has all of the cell beyond it.
    """
    first, size = ranges(leaves.group[exact])
    large = np.flatnonzero(size >= FEW)
    if not leaves.are_inverted.any() or not len(large):
        return np.zeros((0, CELLS), dtype=np.float32)
    groups[large, 14] += 32 * (1 + np.arange(len(large)))
    # barycentrics have signs only up to a common factor
    bounded = (leaves.are_sections | leaves.are_inverted | leaves.are_cones)[exact]
    box = leaves.span[exact]
    place = _cells()
    out = np.zeros((len(large), CELLS), dtype=np.uint32)
    for number, g in enumerate(large):
        mine = slice(first[g], first[g] + size[g])
        reach = _reach(box[mine])
        off = _OFF * np.linalg.norm(reach)
        cell = np.maximum(reach * (1 + _AROUND / 4) + off, 32 * off) / 4
        half = cell * (0.5 + _AROUND) + off
        centre = place * cell
        may = (centre + half >= box[mine, None, 0]) & (centre - half <= box[mine, None, 1])
        may = may.all(axis=2)
        value = np.einsum("mrc,sc->mrs", sides[mine, :, :3], centre) + sides[mine, :, 3:]
        value += (np.abs(sides[mine, :, :3]) @ half)[..., None]
        may &= (value >= 0).all(axis=1) | ~bounded[mine, None]
        bits = (may << np.arange(size[g])[:, None]).sum(axis=0).astype(np.uint32)
        out[number, :3] = (1 / cell).astype(np.float32).view(np.uint32)
        out[number, 8:] = bits[::2] | (bits[1::2] << np.uint32(16))
    return out.view(np.float32)


def _cells() -> np.ndarray:
    """Return the middles ``(512, 3)`` of a table's cells, in cells; x runs fastest."""
    place = np.stack(np.meshgrid(*[np.arange(8)] * 3, indexing="ij"), axis=-1) - 3.5
    return place.transpose(2, 1, 0, 3).reshape(-1, 3)


def _reach(boxes: np.ndarray) -> np.ndarray:
    """Return how far boxes ``(M, 2, 3)`` reach from the origin, along each axis; never zero."""
    reach = np.where(np.isfinite(boxes), np.abs(boxes), 0.0).max(axis=(0, 1))
    return np.maximum(reach, 1e-6 * reach.max() + 1e-30)


def _onto_quadric(form: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return where the lines to `points` from the origin meet the quadric, near them."""
    matrix = matrices(form[None])[0]
    q = np.einsum("si,ij,sj->s", points, matrix[:3, :3], points)
    b, c = points @ matrix[:3, 3], matrix[3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        root = np.sqrt(b * b - q * c)
        scale = np.stack([(-b - root) / q, (-b + root) / q])
    scale = np.where(np.isfinite(scale), scale, 1.0)
    near = np.abs(scale - 1.0).argmin(axis=0)
    return points * np.clip(np.take_along_axis(scale, near[None], axis=0), 0.5, 2.0).T


def section_records(leaves: Leaves, exact: np.ndarray) -> np.ndarray:
    """Return the polynomials of exact leaves; nothing if none has any."""
    if not (leaves.are_sections | leaves.are_inverted)[exact].any():
        return np.zeros((0, 8), dtype=np.float32)
    return _polynomials(leaves.net[exact])


def _polynomials(nets: np.ndarray) -> np.ndarray:
    """Return records of nets, of the degree that is needed."""
    powers = bernstein.multi_indices(bernstein.degree_of(nets.shape[1]))[:, :2]
    degree = int(powers[nets.any(axis=(0, 2))].sum(axis=1).max())
    kept = nets[:, powers.sum(axis=1) <= degree].reshape(len(nets), -1)
    return np.pad(kept, ((0, 0), (0, -kept.shape[1] % 8))).astype(np.float32)


def shared_section(leaves: Leaves, exact: np.ndarray, sides: np.ndarray) -> list[float] | None:
    """Return what finds the parameters on all exact leaves alike, if they are congruent sections.

    That is the matrix of `section_leaves.shared_map`, from the sides as members have them, row by
    row, and the record of `section_records`.
    """
    if not len(exact) or not leaves.are_sections[exact].all():
        return None
    shared = shared_map(leaves.select(exact), sides)
    if shared is None:
        return None
    matrix, net = shared
    matrix[:, :3] *= _scale(leaves, exact, sides)[0]
    return [*matrix.reshape(-1).tolist(), *_polynomials(net[None])[0].tolist()]


def _half_size(box: np.ndarray) -> np.ndarray:
    half = (box[:, 1] - box[:, 0]) / 2
    return np.where(np.isfinite(half), half, 0.0)
