"""Find whether a hit is trimmed away, by crossings of a ray in (s, t) with the boundary's pieces.

``geometry.trim_cells`` gives the tables and the argument. Everything is float32: coordinates
are those of a patch's unit square, so a point within `SLACK` of a curve, ten roundings, belongs
to the surface, and a point further away is judged as in exact arithmetic.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import drjit as dr

from ..geometry.trim_cells import CELL, HEAD, SLACK
from .arrays import Types, gather_packets, gather_row, reciprocal, types_of
from .structure import DOMAIN, Structure
from .trim_table import TrimTable

__all__ = ["keep", "leaf_test"]

#: Halvings of a piece; its chord then stands for what is left, 2^-12 of it, and leaves it by a
#: quarter of that squared at most.
STEPS = 12


def keep(table: TrimTable, cell: Any, u: Any, v: Any, active: Any = True) -> Any:
    """Return a mask of points that are on the surface.

    Parameters
    ----------
    table : TrimTable
    cell : UInt
        Of a leaf, or the number of a patch.
    u, v : Float
        Patch barycentrics; they may be outside of the triangle by a rounding.
    active : Bool

    Returns
    -------
    Bool
        For lanes that are not active, nothing is said.
    """
    ty = types_of(u)
    u, v, cell, active = ty.Float(u), ty.Float(v), ty.UInt(cell), ty.Bool(active)
    c = gather_packets(table.cells, cell, CELL, active)
    s = dr.fma(c[0], u, dr.fma(c[1], v, c[2]))
    t = dr.fma(c[3], u, dr.fma(c[4], v, c[5]))
    if table.arcs:
        s, t = _from_arc(s, c[6], c[7]), _from_arc(t, c[8], c[9])
    s, t = dr.clip(s, 0.0, 1.0), dr.clip(t, 0.0, 1.0)
    place, side = (dr.reinterpret_array(ty.UInt, c[k]) for k in (10, 11))
    column, row = (
        dr.minimum(ty.UInt(dr.maximum((x - low) * scale, 0.0)), side - 1)
        for x, low, scale in ((s, c[12], c[13]), (t, c[14], c[15]))
    )
    numbers = gather_row(table.lists, place + row * side + column, active)
    first, count, base = (dr.reinterpret_array(ty.UInt, x) for x in numbers[:3])
    last = first + count

    def body(run: Any, k: Any, inside: Any, near: Any) -> Any:
        crossed, touched = _meet(table, ty, k, s, t, run)
        inside = inside ^ crossed
        near = near | touched
        k = k + 1
        return run & (k < last) & ~near, k, inside, near

    _run, _k, inside, near = dr.while_loop(
        (active & (count > 0), first, base == 1, ty.Bool(False)),
        cond=lambda *st: st[0],
        body=body,
        labels=("run", "piece", "inside", "near"),
        label="bezier trims",
    )
    return inside | near


def leaf_test(s: Structure, leaf: Any) -> Any:
    """Return what masks the hits in leaves that are on the surface, None without trims.

    It takes leaf barycentrics and which lanes to look at; the others are said to be kept.
    """
    table = s.trim
    if table is None:
        return None
    ty = types_of(s.domain)

    def kept(u: Any, v: Any, active: Any) -> Any:
        m = DOMAIN.gather(s.domain, leaf, active, "cell")
        tested = active & (m.cell > 0)
        u, v = ty.Float(u), ty.Float(v)
        w = 1.0 - u - v
        bary = [dr.fma(row[0], u, dr.fma(row[1], v, row[2] * w)) for row in m.map]
        inv = reciprocal(bary[0] + bary[1] + bary[2])
        return ~tested | keep(table, m.cell - 1, bary[0] * inv, bary[1] * inv, tested)

    return kept


def _from_arc(x: Any, k: Any, scale: Any) -> Any:
    return dr.select(k > 0.0, dr.fma(scale, dr.atan(k * dr.fma(2.0, x, -1.0)), 0.5), x)


def _meet(table: TrimTable, ty: Types, k: Any, s: Any, t: Any, active: Any) -> tuple[Any, Any]:
    """Return whether the ray towards larger s crosses a piece, and whether the point is near it."""
    head = gather_packets(table.heads, k, HEAD, active)
    t0, t1, low, high, sigma, f0, g0, f1, g1 = head
    level = (t >= t0) & (t < t1)
    beside = (s >= low - SLACK) & (s <= high + SLACK) & (t >= t0 - SLACK) & (t <= t1 + SLACK)
    beside = beside & active
    f, g = dr.fma(sigma, s, t), dr.fma(-sigma, s, t)
    n = table.degree
    net = gather_packets(table.curves, k, 3 * (n + 1), beside)

    def body(run: Any, step: Any, a: Any, b: Any, fa: Any, ga: Any, fb: Any, gb: Any) -> Any:
        x = 0.5 * (a + b)
        fx, gx = _evaluate(net, n, x)
        right = f >= fx
        a, fa, ga = dr.select(right, x, a), dr.select(right, fx, fa), dr.select(right, gx, ga)
        b, fb, gb = dr.select(right, b, x), dr.select(right, fb, fx), dr.select(right, gb, gx)
        step = step + 1
        # the slope of g(f) is between -1 and 1, so here the side is certain
        open_ = dr.abs(g - ga) <= (fb - fa) + 2 * SLACK
        return run & open_ & (step < STEPS), step, a, b, fa, ga, fb, gb

    zero, one = dr.zeros(ty.Float), ty.Float(1)
    straight = dr.abs(g - g0) > dr.abs(f1 - f0) + 2 * SLACK
    _run, _step, _a, _b, fa, ga, fb, gb = dr.while_loop(
        (beside & ~straight, ty.UInt(0), zero, one, f0, g0, f1, g1),
        cond=lambda *st: st[0],
        body=body,
        labels=("run", "step", "a", "b", "fa", "ga", "fb", "gb"),
        label="bezier trim piece",
    )
    along = dr.clip((f - fa) / (fb - fa), 0.0, 1.0)
    along = dr.select(fb > fa, along, 0.0)
    off = g - dr.fma(along, gb - ga, ga)
    left = dr.select(beside, sigma * off > 0.0, s < low)
    # within the slack of the curve, or of its end where f is beyond it
    beyond = dr.maximum(dr.maximum(fa - f, f - fb), 0.0)
    near = beside & (dr.abs(off) + beyond <= 2 * SLACK)
    return active & level & left, near


def _evaluate(net: list[Any], n: int, x: Any) -> tuple[Any, Any]:
    """Return f and g of a piece at its parameter x, by de Casteljau's algorithm."""
    values = []
    for c in range(3):
        level = [net[3 * i + c] for i in range(n + 1)]
        while len(level) > 1:
            level = [dr.fma(x, q - p, p) for p, q in pairwise(level)]
        values.append(level[0])
    inv = reciprocal(values[2])
    return values[0] * inv, values[1] * inv
