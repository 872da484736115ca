"""`BezierTriangles`: patches of one degree as homogeneous control nets."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np

from ..errors import NetError
from . import bernstein
from .areas import patch_areas
from .boxes import hull_boxes, surface_boxes
from .proper_nets import free_of_factor

__all__ = ["BezierTriangles", "Differential"]

#: Powers of two, either way, up to which factors of nets do no harm: products of a few do not leave
#: the range of float64.
_MODERATE = 200


class Differential(NamedTuple):
    """Affine point and true partial derivatives, each of shape ``(N, 3)``."""

    p: np.ndarray
    dp_du: np.ndarray
    dp_dv: np.ndarray
    d2p_duu: np.ndarray
    d2p_duv: np.ndarray
    d2p_dvv: np.ndarray


class BezierTriangles:
    """Rational Bézier triangles of one degree.

    A control point is homogeneous and weighted, ``(w x, w y, w z, w)``; weights may be negative.
    A row ``(x, y, z, 0)`` is a control vector, a point at infinity; a row of zeros takes no part.

    Parameters
    ----------
    control_points : (P, K, 4) array_like
        `P` nets of ``K = (n+1)(n+2)/2`` homogeneous control points each, rows in the order
        of `bernstein.multi_indices`. A single net ``(K, 4)`` is taken as ``P = 1``.

    Raises
    ------
    NetError
        If the shape is not of this form, a number is NaN or infinite, or all control points
        of one net are the zero vector.

    Examples
    --------
    >>> net = np.ones((6, 4))  # degree 2, all weights 1
    >>> net[:, :3] = [[1, 0, 0], [1, 1, 0], [0.5, 0, 0], [0, 1, 0], [0, 0.5, 0], [0, 0, 0]]
    >>> patches = mb.BezierTriangles(net)
    >>> len(patches), patches.degree
    (1, 2)
    >>> patches.points(0, [[0.5, 0.5]]).tolist()  # patch 0 at u = v = 1/2
    [[0.75, 0.75, 0.0]]
    >>> len(patches.split()), patches.elevate().degree
    (4, 3)
    """

    def __init__(self, control_points: Any) -> None:
        try:
            net = np.array(control_points, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise NetError.expected(
                "control_points", "an array of numbers of shape (P, K, 4)", f"{error}"
            ) from None
        given = net.shape
        if net.ndim == 2:
            net = net[None]
        if net.ndim != 3 or net.shape[-1] != 4:
            raise NetError.expected(
                "control_points",
                "shape (P, K, 4): homogeneous points (w x, w y, w z, w)",
                f"shape {given}",
            )
        if net.shape[0] == 0:
            raise NetError.expected("control_points", "at least one patch", "P = 0")
        self._degree = bernstein.degree_of(net.shape[1])
        if not np.isfinite(net).all():
            p, k, c = np.argwhere(~np.isfinite(net))[0]
            raise NetError.expected(
                "control_points", "finite numbers", f"{net[p, k, c]} at patch {p}, row {k}"
            )
        empty = ~net.any(axis=(1, 2))
        if empty.any():
            raise NetError.expected(
                "control_points",
                "nets with a point that is not the zero vector",
                f"only zero vectors in patch {int(np.argmax(empty))}",
            )
        net.setflags(write=False)
        self._net = net
        self._free: np.ndarray | None = None

    # ------------------------------------------------------------------ basic facts

    @property
    def control_points(self) -> np.ndarray:
        """The nets, ``(P, K, 4)`` float64, read-only."""
        return self._net

    @property
    def _free_net(self) -> np.ndarray:
        """The nets, freed of factors whose products would overflow."""
        if self._free is None:
            self._free = free_of_factor(self._net, _MODERATE)
        return self._free

    @property
    def degree(self) -> int:
        """The degree n."""
        return self._degree

    @property
    def weights(self) -> np.ndarray:
        """The weights, ``(P, K)``."""
        return self._net[..., 3]

    def __len__(self) -> int:
        return self._net.shape[0]

    def __getitem__(self, index: Any) -> BezierTriangles:
        """Return the patches selected by an integer, slice, mask or index array."""
        return BezierTriangles(self._net[index])

    def __iter__(self) -> Iterator[BezierTriangles]:
        return (self[p] for p in range(len(self)))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, BezierTriangles) and np.array_equal(self._net, other._net)

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return f"BezierTriangles({len(self)} patches of degree {self.degree})"

    # ------------------------------------------------------------------ evaluation

    def _arguments(self, patch: Any, uv: Any) -> tuple[np.ndarray, np.ndarray]:
        uv = np.atleast_2d(np.asarray(uv, dtype=np.float64))
        if uv.ndim != 2 or uv.shape[1] != 2:
            raise NetError.expected("uv", "shape (N, 2)", f"shape {uv.shape}")
        patch = np.broadcast_to(np.asarray(patch), uv.shape[:1])
        if not np.issubdtype(patch.dtype, np.integer):
            raise NetError.expected("patch", "integers of shape (N,)", f"dtype {patch.dtype}")
        if patch.size and (patch.min() < -len(self) or patch.max() >= len(self)):
            raise NetError.expected(
                "patch", f"numbers below {len(self)}", f"{patch.min()}..{patch.max()}"
            )
        return patch, uv

    def _combine(self, nets: np.ndarray, patch: np.ndarray, weights: np.ndarray) -> np.ndarray:
        if len(nets) == 1:
            return weights @ nets[0]
        return np.einsum("nk,nkc->nc", weights, nets[patch])

    def evaluate(self, patch: Any, uv: Any) -> np.ndarray:
        """Evaluate homogeneous surface points.

        Parameters
        ----------
        patch : int or (N,) int array
            Patch numbers.
        uv : (N, 2) array
            Parameters, not required to lie in the triangle.

        Returns
        -------
        (N, 4) array
            ``(w x, w y, w z, w)``; ``w = 0`` is a point at infinity.

        Examples
        --------
        >>> mb.sphere().evaluate(0, [[1, 0], [0.5, 0.5]])[0].tolist()
        [5.0717967697244895, 0.0, 0.0, 5.0717967697244895]
        """
        patch, uv = self._arguments(patch, uv)
        return self._combine(self._net, patch, bernstein.basis(self.degree, uv))

    def partials(self, patch: Any, uv: Any, order: int = 2) -> list[np.ndarray]:
        """Evaluate homogeneous partial derivatives.

        Returns
        -------
        list of (N, 4) arrays
            For ``order = 1``: value, d/du, d/dv; for ``order = 2`` also uu, uv, vv.

        Examples
        --------
        >>> value, du, dv = mb.quarter_plane().partials(0, [[0.25, 0.5]], order=1)
        >>> du.tolist(), dv.tolist()
        ([[1.0, 0.0, 0.0, -1.0]], [[0.0, 1.0, 0.0, -1.0]])
        """
        return self._partials(self._net, patch, uv, order)

    def _partials(self, nets: np.ndarray, patch: Any, uv: Any, order: int) -> list[np.ndarray]:
        patch, uv = self._arguments(patch, uv)
        n = self.degree
        du, dv = bernstein.partials_matrices(n)
        b0, b1 = bernstein.basis(n, uv), bernstein.basis(n - 1, uv)
        weights = [b0, b1 @ du, b1 @ dv]
        if order >= 2:
            if n >= 2:
                du1, dv1 = bernstein.partials_matrices(n - 1)
                b2 = bernstein.basis(n - 2, uv)
                weights += [b2 @ du1 @ du, b2 @ du1 @ dv, b2 @ dv1 @ dv]
            else:
                weights += [np.zeros_like(b0)] * 3
        return [self._combine(nets, patch, w) for w in weights]

    def differential(self, patch: Any, uv: Any) -> Differential:
        """Evaluate the affine point with first and second partials (quotient rule).

        Where the point is at infinity the result is not finite.

        Examples
        --------
        >>> at = mb.quarter_plane().differential(0, [[0.25, 0.5]])
        >>> at.p.tolist(), at.dp_du.tolist()
        ([[1.0, 2.0, 0.0]], [[8.0, 8.0, 0.0]])
        """
        h = self._partials(self._free_net, patch, uv, 2)
        with np.errstate(divide="ignore", invalid="ignore"):
            inv = 1.0 / h[0][:, 3:]
            p = h[0][:, :3] * inv
            pu = (h[1][:, :3] - p * h[1][:, 3:]) * inv
            pv = (h[2][:, :3] - p * h[2][:, 3:]) * inv

            def second(hab: np.ndarray, pa: Any, pb: Any, wa: Any, wb: Any) -> np.ndarray:
                return (hab[:, :3] - p * hab[:, 3:] - pa * wb - pb * wa) * inv

            wu, wv = h[1][:, 3:], h[2][:, 3:]
            return Differential(
                p,
                pu,
                pv,
                second(h[3], pu, pu, wu, wu),
                second(h[4], pu, pv, wu, wv),
                second(h[5], pv, pv, wv, wv),
            )

    def points(self, patch: Any, uv: Any) -> np.ndarray:
        """Evaluate affine surface points ``(N, 3)``.

        Examples
        --------
        >>> mb.sphere().points([0, 7], [[1, 0], [0, 1]]).tolist()
        [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]
        """
        patch, uv = self._arguments(patch, uv)
        h = self._combine(self._free_net, patch, bernstein.basis(self.degree, uv))
        with np.errstate(divide="ignore", invalid="ignore"):
            return h[:, :3] / h[:, 3:]

    def normals(self, patch: Any, uv: Any) -> np.ndarray:
        """Evaluate unit normals ``(N, 3)``, along ``dp_du x dp_dv``.

        Where the cross product vanishes (collapsed edge or corner), the limit from the
        inside of the triangle is taken, by stepping towards the centroid.

        Examples
        --------
        >>> ball = mb.sphere(radius=2)
        >>> np.allclose(ball.normals(0, [[0.3, 0.3]]), ball.points(0, [[0.3, 0.3]]) / 2)
        True
        """
        patch, uv = self._arguments(patch, uv)
        uv = uv.copy()
        out = np.zeros((len(uv), 3))
        todo = np.arange(len(uv))
        for step in (0.0, 1e-6, 1e-4, 1e-2):
            moved = uv[todo] + step * (1 / 3 - uv[todo])
            d = self.differential(patch[todo], moved)
            n = np.cross(d.dp_du, d.dp_dv)
            length = np.linalg.norm(n, axis=1)
            scale = np.linalg.norm(d.dp_du, axis=1) * np.linalg.norm(d.dp_dv, axis=1)
            # 1e-9: far above the rounding of the cross product, far below any real angle
            good = length > 1e-9 * np.maximum(scale, np.finfo(float).tiny)
            out[todo[good]] = n[good] / length[good, None]
            todo = todo[~good]
            if not len(todo):
                break
        return out

    def de_casteljau(self, patch: int, uv: Any) -> list[np.ndarray]:
        """Return de Casteljau's scheme of one patch at one parameter.

        Parameters
        ----------
        patch : int
            Patch number.
        uv : (2,) array_like
            Parameters, not required to lie in the triangle.

        Returns
        -------
        list of (K_r, 4) arrays
            The nets of degree ``n, n - 1, ..., 0``. The last one is the point, and the three points
            before it span the tangent plane.

        Examples
        --------
        >>> scheme = mb.sphere().de_casteljau(0, (0.25, 0.25))
        >>> [len(level) for level in scheme]
        [15, 10, 6, 3, 1]
        """
        number, at = self._arguments(patch, uv)
        if len(at) != 1:
            raise NetError.expected("uv", "one pair of parameters", f"shape {at.shape}")
        return bernstein.de_casteljau(self._net[number[0]], np.append(at[0], 1 - at[0].sum()))

    def blossom(self, patch: int, *arguments: Any) -> np.ndarray:
        """Return a value of the blossom of one patch, ``(4,)``.

        Parameters
        ----------
        patch : int
            Patch number.
        *arguments : (2,) or (3,) array_like
            Exactly n of them, in any order: ``(u, v)``, or barycentric coordinates of any sum, of
            which 0 stands for a direction: ``(1, -1, 0)`` is along the first edge.

        Raises
        ------
        NetError
            If they are not of this form.

        Examples
        --------
        >>> patch = mb.hyperbolic_paraboloid()
        >>> patch.blossom(0, (1, 0), (1, 0)).tolist() == patch.control_points[0, 0].tolist()
        True
        """
        if len(arguments) != self.degree:
            raise NetError.expected("arguments", f"{self.degree} of them", f"{len(arguments)}")
        net = self._net[self._arguments(patch, (0, 0))[0][0]]
        for value in arguments:
            x = np.asarray(value, dtype=np.float64)
            if x.shape not in ((2,), (3,)) or not np.isfinite(x).all():
                raise NetError.expected(
                    "arguments", "(u, v) or three barycentric coordinates", f"{value}"
                )
            net = bernstein.blossom_step(net, np.append(x, 1 - x.sum()) if len(x) == 2 else x)
        return net[0]

    # ------------------------------------------------------------------ new nets

    def subtriangle(self, corners: Any) -> BezierTriangles:
        """Return the nets over one domain triangle, by blossoming.

        Parameters
        ----------
        corners : (3, 3) array_like
            Barycentric coordinates of the new corners, one a row.

        Examples
        --------
        >>> saddle = mb.hyperbolic_paraboloid()
        >>> halves = saddle.subtriangle([[1, 0, 0], [0, 1, 0], [0.5, 0, 0.5]])
        >>> len(halves), halves.degree
        (2, 2)
        """
        corners = np.asarray(corners, dtype=np.float64)
        if corners.shape != (3, 3) or not np.isfinite(corners).all():
            raise NetError.expected(
                "corners", "finite barycentric coordinates of shape (3, 3)", f"{corners.tolist()}"
            )
        if abs(np.linalg.det(corners)) < 1e-300:
            raise NetError.expected("corners", "three independent points", f"{corners.tolist()}")
        return BezierTriangles(bernstein.subdivision_matrix(self.degree, corners) @ self._net)

    def split(self) -> BezierTriangles:
        """Return the midpoint split: patch ``p`` becomes ``4p .. 4p + 3``.

        The order is: at corner A, at B, at C, the middle one; orientation is kept.

        Examples
        --------
        >>> len(mb.sphere().split())
        32
        """
        parts = np.einsum("ekl,plc->pekc", bernstein.split_matrices(self.degree), self._net)
        return BezierTriangles(parts.reshape(-1, *self._net.shape[1:]))

    def elevate(self, times: int = 1) -> BezierTriangles:
        """Return the same surfaces as nets of degree ``n + times``.

        Examples
        --------
        >>> plane = mb.quarter_plane()
        >>> cubic = plane.elevate(2)
        >>> cubic.degree, np.allclose(cubic.points(0, [[0.2, 0.3]]), plane.points(0, [[0.2, 0.3]]))
        (3, True)
        """
        if times < 0:
            raise NetError.expected("times", "a number of elevations >= 0", times)
        return BezierTriangles(bernstein.elevated(self._net, self.degree, self.degree + times))

    def transform(self, matrix: Any) -> BezierTriangles:
        """Return the image under a collineation.

        Parameters
        ----------
        matrix : (4, 4) array_like
            Any regular matrix, acting on homogeneous columns.

        Raises
        ------
        NetError
            If the matrix is not of this form, not finite, or singular.

        Examples
        --------
        >>> flat = mb.sphere().transform(np.diag([1.0, 1, 0.5, 1]))
        >>> flat.bounds()[:, 1].max(axis=0).tolist()
        [1.0, 1.0, 0.5]
        """
        m = np.asarray(matrix, dtype=np.float64)
        if m.shape != (4, 4) or not np.isfinite(m).all():
            raise NetError.expected("matrix", "a finite 4x4 matrix", f"shape {m.shape}")
        sigma = np.linalg.svd(m, compute_uv=False)
        if not sigma[-1] > 1e-14 * sigma[0]:
            raise NetError.expected(
                "matrix", "a regular matrix", f"condition {sigma[0]:.3g}/{sigma[-1]:.3g}"
            )
        return BezierTriangles(self._free_net @ m.T)

    def reverse(self) -> BezierTriangles:
        """Return the same surfaces with the other orientation (corners B and C exchanged).

        Examples
        --------
        >>> inside, uv = mb.sphere().reverse(), [[0.3, 0.3]]
        >>> np.allclose(inside.normals(0, uv), -inside.points(0, uv))
        True
        """
        return BezierTriangles(self._net[:, bernstein.permutation(self.degree, (0, 2, 1))])

    @staticmethod
    def join(parts: Sequence[BezierTriangles]) -> BezierTriangles:
        """Return all patches in one object, elevated to the highest degree among them.

        Examples
        --------
        >>> both = mb.BezierTriangles.join([mb.disk(), mb.sphere()])
        >>> len(both), both.degree
        (11, 4)
        """
        if not parts:
            raise NetError.expected("parts", "at least one BezierTriangles", "none")
        top = max(p.degree for p in parts)
        return BezierTriangles(
            np.concatenate([p.elevate(top - p.degree).control_points for p in parts])
        )

    #: What draws it in notebooks; the package sets it.
    draw: ClassVar[Callable[[Any], bytes | None] | None] = None

    def _repr_png_(self) -> bytes | None:
        draw = type(self).draw
        return None if draw is None else draw(self)

    # ------------------------------------------------------------------ measures

    def bounds(self) -> np.ndarray:
        """Return axis-aligned boxes of the patches ``(P, 2, 3)``: lower and upper corner.

        They hold the surface, whatever its weights, and are larger by at most a thousandth of
        its size. Sides where a patch reaches infinity are infinite. `hulls` is quicker.

        Examples
        --------
        >>> mb.sphere().bounds()[0].tolist()
        [[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]]
        """
        return surface_boxes(self._free_net)

    def hulls(self) -> np.ndarray:
        """Return the boxes of the control points ``(P, 2, 3)``: lower and upper corner.

        They hold the surface where weights have one sign; a control vector opens the box to
        infinity on its side. A net whose weights change sign has the whole space as box.

        Examples
        --------
        >>> wide, narrow = mb.sphere().hulls()[0], mb.sphere().bounds()[0]
        >>> bool((wide[0] <= narrow[0]).all() and (wide[1] >= narrow[1]).all())
        True
        """
        return hull_boxes(self._free_net)

    def area(self, tolerance: float = 1e-10) -> np.ndarray:
        """Return the area of each patch ``(P,)``, infinite if it reaches infinity.

        Gauss-Legendre on the triangle collapsed to the square, on midpoint splits: each part is
        split until it and its four parts agree to `tolerance` of the patch, at most eight times.

        Examples
        --------
        >>> (mb.sphere().area().sum() / np.pi).round(9).item()
        4.0
        """
        return patch_areas(self._free_net, tolerance)

    def tessellate(self, resolution: int) -> tuple[np.ndarray, np.ndarray]:
        """Return a triangle mesh: vertices ``(V, 3)`` and faces ``(F, 3)``.

        Each patch gets ``resolution**2`` triangles; vertices of different patches are not
        merged.

        Examples
        --------
        >>> vertices, faces = mb.sphere().tessellate(4)
        >>> len(faces)  # 16 for each of eight patches
        128
        """
        if resolution < 1:
            raise NetError.expected("resolution", "a number of subdivisions >= 1", resolution)
        r = resolution
        uv = bernstein.multi_indices(r)[:, :2] / r
        row = bernstein.row
        faces = [
            (row(r, i + 1, j), row(r, i, j + 1), row(r, i, j))
            for i, j, _k in bernstein.multi_indices(r - 1).tolist()
        ]
        if r >= 2:  # the triangles turned by half a turn between them
            faces += [
                (row(r, i + 1, j + 1), row(r, i, j + 1), row(r, i + 1, j))
                for i, j, _k in bernstein.multi_indices(r - 2).tolist()
            ]
        count = len(uv)
        patch = np.repeat(np.arange(len(self)), count)
        vertices = self.points(patch, np.tile(uv, (len(self), 1)))
        offset = count * np.arange(len(self))[:, None, None]
        return vertices, (np.array(faces)[None] + offset).reshape(-1, 3)
