"""Patches and rays of the conformance set, by family: easy ones, and those that break intersectors.

Random nets are float32 numbers. The others come from a *jet*: integer coefficients of the powers
of ``u - u0`` and ``v - v0`` at a point (u0, v0) with few binary digits. So a tangent ray is
exactly tangent, a cusp exactly a cusp, and a point at infinity exactly there; a common factor of
homogeneous coordinates makes the Bernstein coefficients integers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from fractions import Fraction
from math import comb, gcd, lcm
from typing import NamedTuple

import numpy as np

from ..geometry import bernstein
from ..geometry.triangles import BezierTriangles

__all__ = ["FAMILIES", "QUADRICS", "Case", "cases"]

Jet = dict[tuple[int, int], np.ndarray]


class Case(NamedTuple):
    """One patch and some rays.

    Attributes
    ----------
    family : str
    net : (K, 4) array
    origins, directions : (N, 3) arrays
    """

    family: str
    net: np.ndarray
    origins: np.ndarray
    directions: np.ndarray


def _single(values: np.ndarray) -> np.ndarray:
    return np.asarray(values, dtype=np.float32).astype(np.float64)


def _random_net(rng: np.random.Generator, n: int) -> np.ndarray:
    """Return a wavy patch over a triangle; every third has weights of both signs."""
    k = bernstein.size(n)
    net = np.ones((k, 4))
    net[:, :2] = bernstein.multi_indices(n)[:, :2] * 2 / n - 2 / 3
    net[:, 2] = 0
    net[:, :3] += rng.normal(size=(k, 3)) * 0.35 / np.sqrt(n)
    net *= np.exp(rng.uniform(np.log(0.3), np.log(3), k))[:, None]
    if rng.random() < 1 / 3:
        net *= rng.choice([1, -1], k, p=[0.8, 0.2])[:, None]
    return _single(net)


def _jet(rng: np.random.Generator, n: int, like_graph: bool = True) -> Jet:
    """Return integer coefficients; like a graph over its plane: x ~ u, y ~ v, w ~ 1."""
    jet = {}
    for a in range(n + 1):
        for b in range(n + 1 - a):
            jet[a, b] = rng.integers(-6, 7, 4)
            jet[a, b][3] = rng.integers(-2, 3)
    jet[0, 0] = np.array([*rng.integers(-4, 5, 3), 8])
    if like_graph:
        jet[1, 0][0] += 16
        jet[0, 1][1] += 16
    return jet


def _net(n: int, jet: Jet, at: tuple[Fraction, Fraction]) -> np.ndarray:
    """Return the Bernstein coefficients of a jet, as integers."""
    u0, v0 = at
    forms = [(1 - u0, -u0, -u0), (-v0, 1 - v0, -v0), (Fraction(1),) * 3]
    total: dict[tuple[int, int, int], list[Fraction]] = {}
    for (a, b), value in jet.items():
        terms = {(0, 0, 0): Fraction(1)}
        for form, power in zip(forms, (a, b, n - a - b)):
            for _ in range(power):
                longer: dict[tuple[int, int, int], Fraction] = {}
                for (i, j, k), c in terms.items():
                    for key, f in zip(((i + 1, j, k), (i, j + 1, k), (i, j, k + 1)), form):
                        longer[key] = longer.get(key, Fraction(0)) + c * f
                terms = longer
        for key, c in terms.items():
            row = total.setdefault(key, [Fraction(0)] * 4)
            for axis in range(4):
                row[axis] += c * int(value[axis])
    rows = []
    for i, j, k in bernstein.multi_indices(n).tolist():
        number = comb(n, i) * comb(n - i, j)
        rows.append([x / number for x in total.get((i, j, k), [Fraction(0)] * 4)])
    scale = lcm(*(x.denominator for row in rows for x in row))
    whole = [[int(x * scale) for x in row] for row in rows]
    common = gcd(*(x for row in whole for x in row)) or 1
    out = np.array([[x // common for x in row] for row in whole], dtype=np.float64)
    # a power of two more or less changes no digit, and float32 has no room for large ones
    return out / 2.0 ** np.floor(np.log2(np.abs(out).max()))


def _aimed(
    rng: np.random.Generator, net: np.ndarray, count: int, near: tuple[Fraction, Fraction] | None
) -> tuple[np.ndarray, np.ndarray]:
    """Return float32 rays to points of the patch; with `near`, some pass that point closely."""
    patch = BezierTriangles(net)
    weights = net[:, 3]
    finite = net[weights != 0]
    middle = np.median(finite[:, :3] / finite[:, 3:], axis=0)
    size = max(np.median(np.abs(finite[:, :3] / finite[:, 3:] - middle)), 0.1)
    origins: list[np.ndarray] = []
    directions: list[np.ndarray] = []
    while len(origins) < count:
        uv = rng.dirichlet([1, 1, 1])[:2]
        if near is not None and len(origins) % 2:
            uv = np.array([float(x) for x in near])
            uv = uv + 10.0 ** -rng.uniform(1, 4) * (rng.dirichlet([1, 1, 1])[:2] - uv)
        x = patch.evaluate(np.zeros(1, dtype=np.int64), uv[None])[0]
        if abs(x[3]) < 1e-3 * np.abs(weights).max():
            x = np.array([*middle, 1.0])
        d = rng.normal(size=3)
        o = x[:3] / x[3] - d / np.linalg.norm(d) * 4 * size
        if len(origins) % 5 == 4:
            o += rng.normal(size=3) * size
        origins.append(o)
        directions.append(d)
    return _single(np.array(origins)), _single(np.array(directions))


def _dyadic(rng: np.random.Generator, where: str = "inside") -> tuple[Fraction, Fraction]:
    """Return parameters in eighths: inside, on an edge, or a corner."""
    if where == "corner":
        i, j = [(8, 0), (0, 8), (0, 0)][rng.integers(3)]
    elif where == "edge":
        k = int(rng.integers(1, 8))
        i, j = [(0, k), (k, 0), (k, 8 - k)][rng.integers(3)]
    else:
        i = int(rng.integers(1, 7))
        j = int(rng.integers(1, 8 - i))
    return Fraction(int(i), 8), Fraction(int(j), 8)


def _through(
    rng: np.random.Generator, jet: Jet, directions: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return rays in integer directions through the point of the jet, exactly."""
    point = jet[0, 0][:3] / jet[0, 0][3]  # over 8 or 1: exact
    return point - directions * rng.choice([1.0, 2.0, 0.5], (len(directions), 1)), directions


def _joined(*parts: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    return np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts])


def _directions(rng: np.random.Generator, count: int) -> np.ndarray:
    out = rng.integers(-9, 10, (count, 3)).astype(np.float64)
    out[~out.any(axis=1)] = [0, 0, 1]
    return out


def _random(rng: np.random.Generator, n: int, count: int) -> Case:
    net = _random_net(rng, n)
    return Case("random", net, *_aimed(rng, net, count, None))


def _grazing(rng: np.random.Generator, n: int, count: int) -> Case | None:
    """Return rays that are tangent: the first ones exactly, the others up to 1e-2 to 1e-9."""
    if n == 1:
        return None  # a plane has no tangents that cross it
    at, jet = _dyadic(rng), _jet(rng, n)
    net = _net(n, jet, at)
    x, xu, xv = (jet[k].astype(float) for k in ((0, 0), (1, 0), (0, 1)))
    du, dv = (x[3] * y[:3] - y[3] * x[:3] for y in (xu, xv))  # w^2 times the affine partials
    mix = rng.integers(-4, 5, (count, 2)).astype(np.float64)
    mix[~mix.any(axis=1)] = [1, 2]
    o, d = _through(rng, jet, (mix[:, :1] * du + mix[:, 1:] * dv) / 64)
    normal = np.cross(du, dv)
    normal /= max(np.linalg.norm(normal), 1e-300)
    size = np.linalg.norm(d, axis=1)
    off = rng.choice([1, -1], count) * 10.0 ** -rng.uniform(2, 9, count) * size
    off[: count // 3] = 0
    o[count // 3 :] = _single((o + off[:, None] * normal)[count // 3 :])
    return Case("grazing", net, o, d)


def _base_point(rng: np.random.Generator, n: int, count: int) -> Case | None:
    """Return a net whose four coordinates vanish at one point of the triangle."""
    if n == 1:
        return None  # a linear net with a base point is a line
    at = _dyadic(rng, ["inside", "edge", "corner"][rng.integers(3)])
    jet = _jet(rng, n)
    jet[0, 0] = np.zeros(4, dtype=np.int64)
    for key in ((1, 0), (0, 1)):
        jet[key][3] = rng.choice([4, 8])
    net = _net(n, jet, at)
    return Case("base point", net, *_aimed(rng, net, count, at))


def _cusp(rng: np.random.Generator, n: int, count: int) -> Case | None:
    """Return a net without a normal at one point, and rays through it and past it."""
    if n == 1:
        return None
    at, jet = _dyadic(rng, ["inside", "edge"][rng.integers(2)]), _jet(rng, n)
    jet[1, 0] = np.zeros(4, dtype=np.int64)
    if n > 2 and rng.random() < 0.5:  # a cuspidal edge: second order along the other direction
        jet[1, 1] = np.zeros(4, dtype=np.int64)
    net = _net(n, jet, at)
    third = count // 3
    rays = _joined(_through(rng, jet, _directions(rng, third)), _aimed(rng, net, count - third, at))
    return Case("cusp", net, *rays)


def _infinite(rng: np.random.Generator, n: int, count: int) -> Case:
    """Return a patch with a point at infinity, and rays that go to it or elsewhere."""
    if rng.random() < 0.4:  # control vectors
        net = _random_net(rng, n)
        net[rng.choice(len(net), 1 + int(rng.integers(0, n)), replace=False), 3] = 0
        return Case("infinite", net, *_aimed(rng, net, count, None))
    at, jet = _dyadic(rng, ["inside", "edge"][rng.integers(2)]), _jet(rng, n)
    jet[0, 0] = np.array([*_directions(rng, 1)[0].astype(int), 0])
    jet[1, 0][3] += 8
    net = _net(n, jet, at)
    o, d = _aimed(rng, net, count, at)
    d[: count // 3] = jet[0, 0][:3] * rng.choice([1.0, -1.0])
    return Case("infinite", net, o, d)


def _edge(rng: np.random.Generator, n: int, count: int) -> Case:
    """Return rays that meet an edge or a corner exactly, and rays beside it."""
    at, jet = _dyadic(rng, ["edge", "corner"][rng.integers(2)]), _jet(rng, n)
    net = _net(n, jet, at)
    third = count // 3
    rays = _joined(_through(rng, jet, _directions(rng, third)), _aimed(rng, net, count - third, at))
    return Case("edge", net, *rays)


#: Quadrics with a rational point: sphere, one sheet, saddle, cone, cylinder, paraboloid.
QUADRICS = (
    (np.diag([1, 1, 1, -1]), [0, 0, 1, 1]),
    (np.diag([1, 1, -1, -1]), [1, 0, 0, 1]),
    (np.array([[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, -1], [0, 0, -1, 0]]), [0, 0, 0, 1]),
    (np.diag([1, 1, -1, 0]), [1, 0, 1, 1]),
    (np.diag([1, 1, 0, -1]), [1, 0, 0, 1]),
    (np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, -1], [0, 0, -1, 0]]), [0, 0, 0, 1]),
)


def _quadric(rng: np.random.Generator, n: int, count: int) -> Case | None:
    """Return a patch that lies exactly on a quadric: projected from a point of it."""
    if n not in (2, 4):
        return None
    positive = rng.random() < 0.5  # weights of one sign: no point at infinity
    for _ in range(200):
        net = _projected(rng)
        if not positive or (net[:, 3] > 0).all() or (net[:, 3] < 0).all():
            break
    net *= np.sign(net[:, 3].sum()) or 1.0
    if n == 4:
        # other parameters: squares u^2, v^2, w^2 and products put for the three
        twist = rng.integers(1, 4, (3, 3))
        net = _composed(net, twist)
    if np.linalg.matrix_rank(net) < 4:
        return None
    net /= 2.0 ** np.floor(np.log2(np.abs(net).max()))
    return Case("quadric", net, *_aimed(rng, net, count, None))


def _projected(rng: np.random.Generator) -> np.ndarray:
    """Return a quadratic net on a quadric: a triangle projected onto it from a point of it."""
    a, point = QUADRICS[rng.integers(len(QUADRICS))]
    s = np.array(point)
    p = rng.integers(-4, 5, (3, 4))
    p[:, 3] = rng.integers(1, 5, 3)
    forms = s @ a @ p.T
    rows = []
    for i, j, _k in bernstein.multi_indices(2).tolist():
        one, two = [c for c, times in enumerate((i, j, 2 - i - j)) for _ in range(times)]
        rows.append(forms[one] * p[two] + forms[two] * p[one] - (p[one] @ a @ p[two]) * s)
    return np.array(rows, dtype=np.float64)


def _composed(net: np.ndarray, twist: np.ndarray) -> np.ndarray:
    """Return a quadratic net after ``u_c -> u_c (twist u)_c``: of degree 4, in integers."""
    total = {tuple(x): np.zeros(4) for x in bernstein.multi_indices(4).tolist()}
    for (i, j, k), row in zip(bernstein.multi_indices(2).tolist(), net):
        one, two = [c for c, times in enumerate((i, j, k)) for _ in range(times)]
        for a in range(3):
            for b in range(3):
                key = [0, 0, 0]
                for c in (one, two, a, b):
                    key[c] += 1
                number = 2 if one != two else 1
                total[tuple(key)] += number * twist[one, a] * twist[two, b] * row
    rows = []
    for i, j, k in bernstein.multi_indices(4).tolist():
        rows.append(total[i, j, k] * (12 // (comb(4, i) * comb(4 - i, j))))
    return np.array(rows)


Family = Callable[[np.random.Generator, int, int], "Case | None"]

#: The families, by name.
FAMILIES: dict[str, Family] = {
    "random": _random,
    "grazing": _grazing,
    "base point": _base_point,
    "cusp": _cusp,
    "infinite": _infinite,
    "edge": _edge,
    "quadric": _quadric,
}


def cases(
    seed: int = 0,
    degrees: tuple[int, ...] = (1, 2, 3, 4, 5),
    patches: int = 6,
    rays: int = 6,
    families: tuple[str, ...] = tuple(FAMILIES),
) -> Iterator[Case]:
    """Yield patches of every family and degree; equal arguments give equal numbers.

    Parameters
    ----------
    seed : int
    degrees : tuple of int
        Not all families have patches of all degrees.
    patches, rays : int
        How many patches a family and degree, and how many rays each.
    families : tuple of str
        Names among `FAMILIES`.
    """
    for number, family in enumerate(FAMILIES):
        for n in degrees:
            rng = np.random.default_rng([seed, number, n])
            for _ in range(patches if family in families else 0):
                case = FAMILIES[family](rng, n, rays)
                if case is not None and case.net.any():
                    yield case
