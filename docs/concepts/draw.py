"""Draw the figures of the pages on concepts into this folder: ``python docs/concepts/draw.py``.

They need the extra ``figures``. All numbers in them are computed, none is drawn by hand.
"""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np

import mitsuba_bezier as mb
from mitsuba_bezier._files import write_file
from mitsuba_bezier.figures import Drawing, plane
from mitsuba_bezier.geometry.bernstein import univariate

HERE = Path(__file__).resolve().parent

#: A rational cubic that rays meet in the drawings.
NET = mb.BezierCurve.from_points([[0, 0.2], [1.1, 2.6], [2.9, 2.9], [4.4, 0.4]], [1, 1.4, 0.9, 1])


def crossings(curve: mb.BezierCurve, y0: float, slope: float) -> np.ndarray:
    """Return the points of a curve on the line ``y = y0 + slope x``, found by bisection."""
    t = np.linspace(0, 1, 2001)
    x, y = curve.points(t).T
    f = y - y0 - slope * x
    found = []
    for k in np.flatnonzero(f[1:] * f[:-1] < 0):
        low, high = t[k], t[k + 1]
        for _ in range(50):
            middle = (low + high) / 2
            p = curve.points(middle)
            same = (p[1] - y0 - slope * p[0]) * f[k] > 0
            low, high = (middle, high) if same else (low, middle)
        found.append(curve.points(low))
    return np.array(found)


def exact() -> Drawing:
    """A curve, a polyline of it, and where a ray meets each."""
    d = plane((-0.6, 5.2), (0.0, 3.1))
    corners = NET.points(np.linspace(0, 1, 6))
    d.curve(NET)
    d.polyline(corners, "second", linewidth=1.6)
    d.points(corners, kind="second point", markersize=5.0)
    y0, slope = 2.62, -0.25
    d.arrow([-0.5, y0 + slope * -0.5], [4.9, y0 + slope * 4.9])
    hit = crossings(NET, y0, slope)[0]
    pieces = [mb.BezierCurve.from_points([a, b]) for a, b in itertools.pairwise(corners)]
    chords = [p for piece in pieces for p in crossings(piece, y0, slope)]
    d.point(hit, "on the surface", (-92, 14), markersize=8.0)
    d.point(chords[0], "on the mesh", (4, -22), kind="second point", markersize=8.0)
    off = np.linalg.norm(chords[0] - hit)
    d.title(f"The ray meets curve and mesh at points {off:.2f} apart, on a figure 4.4 wide.")
    return d


def weights() -> Drawing:
    """One net, and what the weight of its middle point does."""
    d = plane((-0.9, 4.9), (-1.75, 2.75))
    net = np.array([[0, 0], [2, 2.2], [4, 0]])
    d.polyline(net)
    d.points(net, kind="second point")
    for weight, kind in ((0.25, "third"), (1.0, "curve"), (3.0, "second"), (-0.4, "construction")):
        curve = mb.BezierCurve.from_points(net, [1, weight, 1])
        d.curve(curve, kind)
        x, y = curve.points(0.5)
        d.label([x, y], f"$w = {weight:g}$", (8, 7) if weight > 0 else (8, -16))
    d.title("The same three points. The weight of the middle one draws the curve, or pushes it.")
    return d


def leaves() -> Drawing:
    """A curve cut into leaves, their boxes in a tree, and a ray that meets few of them."""
    d = plane((-0.6, 5.2), (-0.35, 2.85))
    y0, slope = 0.55, 0.29
    level = [NET]
    for depth, kind in ((1, "hidden"), (2, "thin"), (3, "second")):
        level = [half for piece in level for half in piece.split(0.5)]
        for piece in level:
            (x0, y_low), (x1, y_high) = box = bounds(piece)
            met = meets(box, y0, slope)
            if depth < 3 or met:
                corners = [[x0, y_low], [x1, y_low], [x1, y_high], [x0, y_high]]
                look = {"linewidth": 1.6} if depth == 3 else {}
                d.polyline(corners, kind, closed=True, **look)
    d.curve(NET)
    for piece in level:
        d.point(piece.points(0.0), None, markersize=4.0)
    d.arrow([-0.5, y0 - 0.5 * slope], [4.9, y0 + 4.9 * slope])
    d.points(crossings(NET, y0, slope), kind="second point", markersize=8.0)
    count = sum(meets(bounds(piece), y0, slope) for piece in level)
    assert count == 2
    d.title("Eight leaves in a tree of boxes. The ray enters the boxes of two, and meets both.")
    return d


def bounds(curve: mb.BezierCurve) -> np.ndarray:
    """Return the box of a curve, lower and upper corner, from dense points."""
    x = curve.points(np.linspace(0, 1, 200))
    return np.array([x.min(axis=0), x.max(axis=0)])


def meets(box: np.ndarray, y0: float, slope: float) -> bool:
    """Return whether the line enters a box."""
    ends = y0 + slope * box[:, 0]
    return bool(ends.min() <= box[1, 1] and ends.max() >= box[0, 1])


def march() -> Drawing:
    """The height of a ray over a leaf, and the parabolas below it that bound each step."""
    x = np.linspace(0, 1, 401)
    g = np.polynomial.Polynomial([0.40, -1.56, 3.2, -3.4, 0.85])
    slope, second = g.deriv(), g.deriv(2)
    least = second(x).min() - 0.5  # a bound: it lies below what it bounds
    t = np.linspace(0, 1, 5)
    heights = np.linalg.solve(univariate(4, t), g(t))
    d = plane((-0.05, 1.03), (-0.12, 0.5))
    d.arrow([0, 0], [1.0, 0], "line")
    d.label([1.0, 0], "$\\tau$", (-10, -18))
    d.curve(mb.BezierCurve.from_points(np.stack([t, heights], axis=1)))
    d.label([0.05, g(0.05)], "$g(\\tau)$: how far the ray is above the leaf", (10, 6))
    root = min(r.real for r in g.roots() if abs(r.imag) < 1e-9 and 0 < r.real < 1)
    tau = 0.0
    for _ in range(4):
        below = np.polynomial.Polynomial([g(tau), slope(tau), least / 2])
        step = min(r.real for r in below.roots() if abs(r.imag) < 1e-12 and r.real > 0)
        middle = [tau + step / 2, g(tau) + slope(tau) * step / 2]
        d.curve(mb.BezierCurve.from_points([[tau, g(tau)], middle, [tau + step, 0]]), "second")
        d.segment([tau, 0], [tau, g(tau)], "hidden")
        d.point([tau, g(tau)], kind="second point")
        d.point([tau + step, 0], None, markersize=4.0)
        tau += step
    assert tau < root
    d.point([root, 0], "the first root", (12, 12), markersize=8.0)
    d.title("Each dashed parabola lies below the curve: its root is a step that passes no other.")
    return d


FIGURES = {"exact": exact, "weights": weights, "leaves": leaves, "march": march}


def main() -> None:
    """Draw all figures."""
    for name, figure in FIGURES.items():
        data = figure().encoded(".svg")
        write_file(HERE / f"{name}.svg", data)
        print(f"{name}.svg  {len(data) / 1000:.0f} kB")


if __name__ == "__main__":
    main()
