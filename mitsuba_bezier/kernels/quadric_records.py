"""Pack leaves with a closed form: groups that share a quadric, their members and inverses."""

from __future__ import annotations

import numpy as np

from ..geometry import bernstein
from ..leaves.closed_form.fits import matrices
from ..leaves.closed_form.kinds import bounding_planes
from ..leaves.closed_form.plane_sections import shared_map
from ..leaves.records import INVERTED_KINDS, ClosedFormLeaves, LeafKind
from .records import Record, bits

__all__ = [
    "AXES",
    "CELLS",
    "GROUP",
    "INVERSE",
    "MEMBER",
    "MIN_GROUP_FOR_TABLE",
    "TABLE",
    "axes_records",
    "cell_records",
    "group_records",
    "inverse_records",
    "member_records",
    "member_sides",
    "polynomial_degree",
    "polynomial_records",
    "ranges",
    "shared_section",
]

#: A group: its quadric on ``(axes (p - shift), 1)``, its first member and how many there are. The
#: sixth and further bits of `count` are the number of the group's table, see `CELLS`, from one on.
GROUP = Record(np.float64, quadric=(10,), shift=(3,), first=(), count=(), deviation=())
#: The axes of a group.
AXES = Record(np.float64, rows=(3, 3))
#: A member of a group, in units that make the rounding of its sides alike. `cells` are the factors
#: that take lengths to cells of the table, in the first member of a group that has one.
MEMBER = Record(np.float32, sides=(3, 4), leaf=bits(), least_sum=(), kind=bits(), cells=bits())
#: What gives the parameters at a point of a member, unscaled; the fourth row is zero if not used.
INVERSE = Record(np.float64, rows=(3, 4), fourth=(4,))
#: Groups of at least this many members have tables.
MIN_GROUP_FOR_TABLE = 3
#: Before the members of each group, if one has a table and no leaf is inverted, this many records:
#: four bits for each of 8 x 8 x 8 cells about the group's origin, the member that covers it most
#: likely.
TABLE = 4
#: Where parameters tell whether a point is on a member there is another table: the factors that
#: take lengths to cells, and for each of 8 x 8 x 8 cells which members may have a point in it, 16
#: bits each.
CELLS = Record(np.float32, scale=(3,), unused=(5,), members=bits((256,)))
#: Cells are as much larger, in their own size, as tolerances of edges make points be off, and by
#: this of how far the group reaches, by rounding: of four float32 numbers of that size. Where the
#: group is thin, as in the direction of a plane's normal, that is more than the first; there a cell
#: is eight times as large.
_CELL_MARGIN, _CELL_ROUNDING = 0.05, 5e-7


def ranges(labels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return first index and length of the runs of equal labels."""
    if not len(labels):
        return np.zeros(0, dtype=int), np.zeros(0, dtype=int)
    first = np.flatnonzero(np.diff(labels, prepend=labels[0] - 1))
    return first, np.diff(first, append=len(labels))


def group_records(leaves: ClosedFormLeaves, first: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Return the records of groups, each with `size` of the leaves from `first` on."""
    largest = np.maximum.reduceat(leaves.deviation, first) if len(first) else 0.0
    return GROUP.pack(
        len(first),
        quadric=leaves.quadric[first],
        shift=leaves.shift[first],
        first=first,
        count=size,
        deviation=largest,
    )


def axes_records(leaves: ClosedFormLeaves) -> np.ndarray | None:
    """Return the axes of groups, of their first leaves; None if all are those of space."""
    if (leaves.axes == np.eye(3)).all():
        return None
    return AXES.pack(len(leaves), rows=leaves.axes)


def inverse_records(leaves: ClosedFormLeaves) -> np.ndarray:
    """Return the rows of leaves, unscaled."""
    return INVERSE.pack(len(leaves), rows=leaves.rows[:, :3], fourth=leaves.rows[:, 3])


def member_records(
    leaves: ClosedFormLeaves, sides: np.ndarray, first_leaf: int
) -> tuple[np.ndarray, bool]:
    """Return the records of members, and whether there are tables, of leaves in groups.

    The leaves have the numbers from `first_leaf` on, and the sides `member_sides`.
    """
    scale = _scale(leaves, sides)
    out = MEMBER.pack(
        len(leaves),
        sides=sides / scale[:, None, None],
        leaf=first_leaf + np.arange(len(leaves)),
        least_sum=leaves.least_sum / scale,
        kind=leaves.kind,
    )
    first, size = ranges(leaves.group)
    inverted = leaves.is_one_of(INVERTED_KINDS).any()  # then `cell_records` has more
    if inverted or size.max(initial=0) < MIN_GROUP_FOR_TABLE:
        return out, False
    return _with_tables(leaves, out, first, size), True


def _scale(leaves: ClosedFormLeaves, sides: np.ndarray) -> np.ndarray:
    """Return what `sides` give at the leaves, so that an error of float32 has one size."""
    reach = np.linalg.norm(_half_size(leaves.span), axis=1)
    scale = np.linalg.norm(sides[..., :3], axis=(1, 2)) * reach
    scale += np.linalg.norm(sides[..., 3], axis=1)
    section = leaves.kind == LeafKind.PLANE_SECTIONS
    scale[section] = scale[section].max(initial=0.0)  # all alike, for `shared_section`
    return scale


def member_sides(leaves: ClosedFormLeaves) -> np.ndarray:
    """Return the rows ``(L, 3, 4)`` whose values are not negative on a leaf.

    Where the leaf has no such planes they are its barycentrics, up to a common factor.
    """
    return bounding_planes(leaves)[0]


def _with_tables(
    leaves: ClosedFormLeaves, members: np.ndarray, first: np.ndarray, size: np.ndarray
) -> np.ndarray:
    """Put a table before the members of each group; see `TABLE`."""
    out = np.zeros((len(members) + TABLE * len(first), MEMBER.size), dtype=np.float32)
    cells = _cells() / 4
    for number, (start, count) in enumerate(zip(first, size)):
        mine = members[start : start + count]
        if count >= MIN_GROUP_FOR_TABLE:
            half = _reach(leaves.span[start : start + count])
            # three floats of ten bits: exponent and two of the mantissa, rounded down
            factors = (4 / half).astype(np.float32).view(np.uint32) >> np.uint32(21)
            half = 4 / (factors << np.uint32(21)).view(np.float32)
            factors = factors << np.arange(0, 30, 10, dtype=np.uint32)
            mine[0, MEMBER.first["cells"]] = factors.sum(dtype=np.uint32).view(np.float32)
            rows = mine[:, :12].reshape(-1, 4)
            points = _onto_quadric(leaves.quadric[start], cells * half)
            value = rows[:, :3] @ points.T + rows[:, 3:]
            value = value.reshape(count, 3, -1)
            total = value.sum(axis=1)
            # planes have sides, barycentrics have not
            linear = leaves.kind[start : start + count, None] == LeafKind.LINEAR
            sign = np.where(linear, np.sign(total), 1.0)
            lowest = (value * sign[:, None]).min(axis=1) / np.maximum(np.abs(total), 1e-30)
            likely = lowest.argmax(axis=0).astype(np.uint32).reshape(-1, 8)
            words = (likely << np.arange(0, 32, 4, dtype=np.uint32)).sum(axis=1, dtype=np.uint32)
            out[start + TABLE * number :][:TABLE] = words.view(np.float32).reshape(
                TABLE, MEMBER.size
            )
        out[start + TABLE * (number + 1) :][:count] = mine
    return out


def cell_records(leaves: ClosedFormLeaves, sides: np.ndarray, groups: np.ndarray) -> np.ndarray:
    """Return the tables of possible members, and write their numbers into the `groups`' records.

    A member may have points in a cell that meets its box, unless one of its sides, where it has
    such, has all of the cell beyond it.
    """
    first, size = ranges(leaves.group)
    # no table has room for a group that reaches infinity: all its members are tried
    finite = np.logical_and.reduceat(np.isfinite(leaves.span).all(axis=(1, 2)), first)
    large = np.flatnonzero((size >= MIN_GROUP_FOR_TABLE) & finite)
    if not leaves.is_one_of(INVERTED_KINDS).any() or not len(large):
        return CELLS.pack(0)
    groups[large, GROUP.first["count"]] += 32 * (1 + np.arange(len(large)))
    # barycentrics have signs only up to a common factor
    bounded = leaves.kind != LeafKind.LINEAR
    box = leaves.span
    place = _cells()
    scale = np.zeros((len(large), 3))
    masks = np.zeros((len(large), 256), dtype=np.uint32)
    for number, g in enumerate(large):
        mine = slice(first[g], first[g] + size[g])
        reach = _reach(box[mine])
        off = _CELL_ROUNDING * np.linalg.norm(reach)
        cell = np.maximum(reach * (1 + _CELL_MARGIN / 4) + off, 32 * off) / 4
        half = cell * (0.5 + _CELL_MARGIN) + off
        centre = place * cell
        may = (centre + half >= box[mine, None, 0]) & (centre - half <= box[mine, None, 1])
        may = may.all(axis=2)
        value = np.einsum("mrc,sc->mrs", sides[mine, :, :3], centre) + sides[mine, :, 3:]
        value += (np.abs(sides[mine, :, :3]) @ half)[..., None]
        may &= (value >= 0).all(axis=1) | ~bounded[mine, None]
        mask = (may << np.arange(size[g])[:, None]).sum(axis=0).astype(np.uint32)
        scale[number] = 1 / cell
        masks[number] = mask[::2] | (mask[1::2] << np.uint32(16))
    return CELLS.pack(len(large), scale=scale, members=masks)


def _cells() -> np.ndarray:
    """Return the middles ``(512, 3)`` of a table's cells, in cells; x runs fastest."""
    place = np.stack(np.meshgrid(*[np.arange(8)] * 3, indexing="ij"), axis=-1) - 3.5
    return place.transpose(2, 1, 0, 3).reshape(-1, 3)


def _reach(boxes: np.ndarray) -> np.ndarray:
    """Return how far boxes ``(M, 2, 3)`` reach from the origin, along each axis; never zero."""
    reach = np.where(np.isfinite(boxes), np.abs(boxes), 0.0).max(axis=(0, 1))
    return np.maximum(reach, 1e-6 * reach.max() + 1e-30)


def _onto_quadric(quadric: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return where the lines to `points` from the origin meet the quadric, near them."""
    matrix = matrices(quadric[None])[0]
    q = np.einsum("si,ij,sj->s", points, matrix[:3, :3], points)
    b, c = points @ matrix[:3, 3], matrix[3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        root = np.sqrt(b * b - q * c)
        scale = np.stack([(-b - root) / q, (-b + root) / q])
    scale = np.where(np.isfinite(scale), scale, 1.0)
    near = np.abs(scale - 1.0).argmin(axis=0)
    return points * np.clip(np.take_along_axis(scale, near[None], axis=0), 0.5, 2.0).T


def polynomial_records(leaves: ClosedFormLeaves) -> np.ndarray:
    """Return the polynomials of leaves; nothing if none has any."""
    if not leaves.polynomials.any():
        return np.zeros((0, 8), dtype=np.float32)
    return _polynomials(leaves.polynomials)


def polynomial_degree(leaves: ClosedFormLeaves) -> int:
    """Return the degree that all polynomials of leaves need."""
    nets = leaves.polynomials
    powers = bernstein.multi_indices(bernstein.degree_of(nets.shape[1]))[:, :2]
    return int(powers[nets.any(axis=(0, 2))].sum(axis=1).max(initial=0))


def _polynomials(nets: np.ndarray) -> np.ndarray:
    """Return records of nets, of the degree that is needed."""
    powers = bernstein.multi_indices(bernstein.degree_of(nets.shape[1]))[:, :2]
    degree = int(powers[nets.any(axis=(0, 2))].sum(axis=1).max())
    kept = nets[:, powers.sum(axis=1) <= degree].reshape(len(nets), -1)
    return np.pad(kept, ((0, 0), (0, -kept.shape[1] % 8))).astype(np.float32)


def shared_section(leaves: ClosedFormLeaves, sides: np.ndarray) -> list[float] | None:
    """Return what finds the parameters on all leaves alike, if they are congruent sections.

    That is the matrix of `plane_sections.shared_map`, from the sides as members have them, row by
    row, and the record of `polynomial_records`.
    """
    if not len(leaves) or not (leaves.kind == LeafKind.PLANE_SECTIONS).all():
        return None
    shared = shared_map(leaves, sides)
    if shared is None:
        return None
    matrix, net = shared
    matrix[:, :3] *= _scale(leaves, sides)[0]
    return [*matrix.reshape(-1).tolist(), *_polynomials(net[None])[0].tolist()]


def _half_size(box: np.ndarray) -> np.ndarray:
    half = (box[:, 1] - box[:, 0]) / 2
    return np.where(np.isfinite(half), half, 0.0)
