"""The patchwork theorem: what closes the gaps between triangular patches on a quadric.

Put a quadratic triangle over each face of a triangulation of points on a quadric, every one
projected from a centre of its own. Two neighbours share two corners, and no more: their boundary
conics lie in two planes through the line of these. Between them is a four-sided gap with two
opposite sides that have shrunk to the corners, and a patch of bidegree (2, 2) fills it exactly:

* the conics that the pencil of planes cuts out of the quadric all end in the two corners A and B,
  and their tangents there meet on one line, the polar of the line AB;
* so the middle control point runs along that line, ``M(s) = (1-s) M_0 + s M_1``, and the corner's
  weight is a quadratic polynomial, ``-2 M(s)'Q M(s) / A'Q B``.

So any such patchwork closes without gap and overlap, whatever centres were chosen.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import GeometryError
from .bernstein import edge_rows
from .curves import BezierCurve
from .projective import TOLERANCE, norm
from .quadrics import quadric_matrix
from .tensor import tensor_to_triangles
from .triangles import BezierTriangles

__all__ = ["boundary_curve", "four_sided_net", "patchwork"]

#: Relative distance up to which control points count as those of arcs on the quadric.
NEAR = 1e-9


def boundary_curve(net: Any, edge: int) -> BezierCurve:
    """Return one of the three boundary conics of a quadratic net ``(6, 4)``, in its direction.

    Parameters
    ----------
    net : (6, 4) array_like
        Quadratic net.
    edge : int
        0 from the first corner to the second, 1 on to the third, 2 back to the first.

    Raises
    ------
    GeometryError
        If they are not of this form.
    """
    b = np.asarray(net, dtype=np.float64)
    if b.shape != (6, 4) or edge not in (0, 1, 2):
        raise GeometryError.expected(
            "net, edge", "a quadratic net (6, 4) and 0, 1 or 2", f"shape {b.shape}, {edge}"
        )
    return BezierCurve(b[edge_rows(2)[edge]])


def _arc(a: np.ndarray, name: str, arc: BezierCurve) -> np.ndarray:
    """Return the control points of an arc on the quadric, the last with a factor as given."""
    if arc.degree != 2 or arc.dimension != 3:
        raise GeometryError.expected(name, "a curve of degree 2 in space", f"{arc!r}")
    b = arc.control_points
    size = norm(b)
    if not size.all() or np.linalg.svd(b / size[:, None], compute_uv=False)[2] <= TOLERANCE:
        raise GeometryError.expected(name, "a conic", "dependent control points")
    # b0, b2 on the quadric, b1 conjugate to both, and the weights of a conic on it
    gram = b @ a @ b.T
    scale = np.abs(a).max() * np.outer(size, size)
    values = [gram[0, 0] / scale[0, 0], gram[2, 2] / scale[2, 2]]
    values += [gram[0, 1] / scale[0, 1], gram[1, 2] / scale[1, 2]]
    values += [(2 * gram[1, 1] + gram[0, 2]) / (scale[1, 1] + scale[0, 2])]
    if np.abs(values).max() > NEAR:
        raise GeometryError.expected(
            name,
            "an arc on the quadric",
            f"one off it (relative distance {max(map(abs, values)):.2g})",
        )
    return b


def four_sided_net(A: Any, first: BezierCurve, second: BezierCurve) -> np.ndarray:
    """Return the four-sided patch between two arcs of a quadric with the same ends.

    Parameters
    ----------
    A : (4, 4) array_like
        Symmetric matrix of the quadric.
    first, second : BezierCurve
        Conic arcs on it (degree 2, in space), from one corner to the other.

    Returns
    -------
    (3, 3, 4) array
        Net of bidegree (2, 2): row 0 is the first corner three times, row 2 the second,
        columns 0 and 2 are the arcs (up to factors of their control points).

    Raises
    ------
    GeometryError
        If an arc is not on the quadric, or they have not the same ends.
    """
    a = quadric_matrix(A)
    b, c = _arc(a, "first", first), _arc(a, "second", second)
    units = [x / norm(x)[:, None] for x in (b, c)]
    for k in (0, 2):
        x, y = units[0][k], units[1][k]
        if min(norm(x - y), norm(x + y)) > NEAR:
            raise GeometryError.expected("second", "an arc with the ends of the first", "others")
    # both arcs with the end B itself; a factor r^k of b_k is another parametrization only
    end = b[2]
    scale = float(c[2] @ end / (c[2] @ c[2]))
    c = c * scale
    inner = np.stack([b[1], (b[1] + c[1]) / 2, c[1]])
    # -2 M(s)'Q M(s) / A'Q B for A = b[0], in Bernstein form
    corner = b[0]
    below = corner @ a @ end
    gram = np.array([b[1] @ a @ b[1], b[1] @ a @ c[1], c[1] @ a @ c[1]])
    weights = -2 * gram / below
    middle = weights[1] * 2 / (np.sqrt(abs(weights[0] * weights[2])) + 1e-300)
    # a(s) has a zero in (0, 1) if both ends have one sign and the middle is below -1 of them
    if weights[0] * weights[2] > 0 and middle * np.sign(weights[0]) <= -2:
        raise GeometryError.expected(
            "first, second", "arcs with nothing between them but conics", "a plane that touches"
        )
    return np.stack([weights[:, None] * corner, inner, np.broadcast_to(end, (3, 4))])


def patchwork(A: Any, nets: Any, neighbours: Any) -> BezierTriangles:
    """Return the four-sided patches between quadratic triangles on a quadric, as triangles.

    Parameters
    ----------
    A : (4, 4) array_like
        Symmetric matrix of the quadric.
    nets : (P, 6, 4) array_like
        Quadratic nets on it.
    neighbours : sequence of ((p, e), (q, f))
        Edge `e` of patch `p` lies beside edge `f` of patch `q`; edges as in `boundary_curve`.

    Returns
    -------
    BezierTriangles
        Two of degree 4 for each pair; zero area where the two edges are one curve.

    Raises
    ------
    GeometryError
        If an edge is not on the quadric, or two neighbours do not share their ends.

    Examples
    --------
    >>> octahedron = np.vstack([np.eye(3), -np.eye(3)])
    >>> upper = [[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2]]
    >>> faces = upper + [[b, a, 5] for a, b, _ in upper]
    >>> nets = mb.triangulated(octahedron, faces).control_points[:8]
    >>> between = mb.patchwork(np.diag([1.0, 1, 1, -1]), nets, [((0, 1), (1, 2))])
    >>> len(between), between.degree
    (2, 4)
    """
    parts = []
    for (p, e), (q, f) in neighbours:
        one, two = boundary_curve(nets[p], e), boundary_curve(nets[q], f)
        if norm(_unit(one.evaluate(0.0)) - _unit(two.evaluate(0.0))) > 1e-6:
            two = two.reverse()  # neighbours of one orientation run through it the other way
        parts.append(tensor_to_triangles(four_sided_net(A, one, two)))
    if not parts:
        raise GeometryError.expected("neighbours", "at least one pair of edges", "none")
    return BezierTriangles.join(parts)


def _unit(x: np.ndarray) -> np.ndarray:
    lead = x[3] if abs(x[3]) > TOLERANCE * norm(x) else x[np.argmax(np.abs(x))]
    return x * np.sign(lead) / norm(x)
