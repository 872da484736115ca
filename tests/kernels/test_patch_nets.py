"""Points and partials of patches of many degrees, and derivatives by nets and parameters."""

from __future__ import annotations

import numpy as np
import pytest
from backend_cases import ad

import drjit as dr  # isort: skip
from mitsuba_bezier.geometry import bernstein
from mitsuba_bezier.kernels import patch_nets
from mitsuba_bezier.kernels.arrays import upload
from mitsuba_bezier.kernels.patch import pack, scaled
from mitsuba_bezier.kernels.patch_nets import lay_out
from mitsuba_bezier.kernels.rolled import partials_up_to, rolled_partials

DEGREES = [1, 2, 3, 6, 9, 16, 20]


def nets_of(n: int, count: int = 2, seed: int = 0) -> np.ndarray:
    """Random control points, numbers of float32."""
    net = np.random.default_rng(seed + n).normal(size=(count, bernstein.size(n), 4))
    return net.astype(np.float32).astype(np.float64)


def expected(net: np.ndarray, uv: np.ndarray, p: int, q: int) -> np.ndarray:
    """Return ``d^(p+q) / du^p dv^q`` of points of one net, in float64, by differences of points."""
    n = bernstein.degree_of(len(net))
    if p + q > n:
        return np.zeros((len(uv), 4))
    for by, times in ((0, p), (1, q)):
        for _ in range(times):
            net = bernstein.partials_matrices(n)[by] @ net
            n -= 1
    return bernstein.basis(n, uv) @ net


def parameters(count: int, seed: int = 1) -> np.ndarray:
    uv = np.random.default_rng(seed).dirichlet([1, 1, 1], count)[:, :2]
    uv[:3] = [[1, 0], [0, 1], [0, 0]]
    return uv


def test_partials_row_by_row():
    # lanes of all degrees in one packet
    nets = [nets_of(n) for n in DEGREES]
    uv = parameters(40)
    for plain in (False, True):
        stored = [pack(net if plain else scaled(net)) for net in nets]
        widths = [len(s[0]) // 4 for s in stored]
        starts = np.cumsum([0, *(2 * w for w in widths)])
        which = np.arange(40 * len(DEGREES)) % len(DEGREES)
        place = np.arange(len(which)) // len(DEGREES)
        first = starts[which] + (place % 2) * np.array(widths)[which]
        rows = upload(ad.Float64, np.concatenate([s.ravel() for s in stored]))
        found = rolled_partials(
            rows,
            ad.UInt(first.astype(np.uint32)),
            ad.UInt(np.array(DEGREES)[which].astype(np.uint32)),
            *(ad.Float64(uv[place, k].copy()) for k in range(2)),
            ad.Bool(True),
            3,
            ad.Bool(True) if plain else None,
        )
        assert list(found) == [*partials_up_to(3)]
        for (p, q), values in found.items():
            got = np.array([np.array(x) for x in values]).T
            for k, n in enumerate(DEGREES):
                mine = which == k
                for half in range(2):
                    those = mine & (place % 2 == half)
                    right = expected(nets[k][half], uv[place[those]], p, q)
                    # a hundred roundings of the n^m times control points whose differences they are
                    np.testing.assert_allclose(got[those], right, atol=1e-14 * n ** (p + q) * 4)


def mixed(like: type) -> tuple[patch_nets.Layout, np.ndarray, list[np.ndarray]]:
    """Return a layout of shapes of some degrees, what is stored, and the nets."""
    nets = [nets_of(n, 3) for n in (2, 9, 5, 14)]
    layout = lay_out([(bernstein.degree_of(x.shape[1]), 3) for x in nets], like)
    parts = []
    for net, (degree, _first) in zip(nets, layout.shapes):
        for n in range(bernstein.degree_of(net.shape[1]), degree or 0):
            net = bernstein.elevated(net, n)
        parts.append(pack(net if degree else scaled(net)).ravel())
    return layout, np.concatenate(parts), nets


def test_patches_of_many_degrees():
    layout, stored, nets = mixed(ad.Float)
    assert layout.degrees == [2, 5, None] or layout.degrees == [5, None]
    uv, patch = parameters(240), np.arange(240) % 12
    u, v = (ad.Float64(uv[:, k].copy()) for k in range(2))
    active = np.arange(240) % 5 != 0
    found = layout.second(
        upload(ad.Float, stored), ad.UInt(patch.astype(np.uint32)), u, v, ad.Bool(active)
    )
    for (p, q), values in zip(partials_up_to(2), found):
        got = np.array([np.array(x) for x in values]).T
        for k in range(12):
            those = (patch == k) & active
            right = expected(nets[k // 3][k % 3], uv[those], p, q)
            # the stored nets are rounded to float32
            np.testing.assert_allclose(got[those], right, atol=4e-7 * 14.0 ** (p + q))


def weights_for(count: int) -> list[list[np.ndarray]]:
    rng = np.random.default_rng(5)
    return [[rng.normal(size=count) for _ in range(4)] for _ in range(6)]


@pytest.mark.parametrize("degrees", ["mixed", "one"])
def test_derivatives_by_nets_and_parameters(degrees, monkeypatch):
    """A weighted sum of all partials, differentiated backwards and forwards."""
    if degrees == "mixed":
        layout, stored, _nets = mixed(ad.Float)
        patches = 12
    else:
        layout = lay_out([(5, 3)], ad.Float)
        assert layout.only == 5
        stored, patches = pack(nets_of(5, 3)).ravel(), 3
    count = 60
    uv, patch = parameters(count), np.arange(count) % patches
    active = np.arange(count) % 5 != 0
    weights = weights_for(count)
    rng = np.random.default_rng(8)
    along = rng.normal(size=len(stored)), rng.normal(size=count), rng.normal(size=count)

    def inputs():
        arrays = upload(ad.Float, stored), *(ad.Float64(uv[:, k].copy()) for k in range(2))
        return arrays

    def total(nets, u, v):
        found = layout.second(nets, ad.UInt(patch.astype(np.uint32)), u, v, ad.Bool(active))
        mask = ad.Bool(active)
        return sum(
            dr.select(mask, x * ad.Float64(w), 0.0)
            for values, ws in zip(found, weights)
            for x, w in zip(values, ws)
        )

    nets, u, v = inputs()
    dr.enable_grad(nets, u, v)
    dr.backward(dr.sum(total(nets, u, v)))
    gradient = [np.array(dr.grad(x), dtype=float) for x in (nets, u, v)]
    assert all(np.isfinite(g).all() for g in gradient)

    nets, u, v = inputs()
    step = dr.opaque(ad.Float, 0.0)
    dr.enable_grad(step)
    moved = [
        nets + step * ad.Float(along[0]),
        u + ad.Float64(step) * ad.Float64(along[1]),
        v + ad.Float64(step) * ad.Float64(along[2]),
    ]
    out = total(*moved)
    dr.forward(step)
    tangent = np.array(dr.grad(out), dtype=float)

    # the value is linear in nets, and a polynomial in u, v: central differences of it
    def value(h: float) -> np.ndarray:
        nets, u, v = inputs()
        return np.array(total(nets, u + h * ad.Float64(along[1]), v + h * ad.Float64(along[2])))

    h = 1e-5
    by_parameters = (value(h) - value(-h)) / (2 * h)
    own = np.array(total(upload(ad.Float, along[0]), *inputs()[1:]))
    right = by_parameters + own
    scale = np.abs(right).max()
    # 1e-6: differences of a polynomial of degree 14 over h, rounded to float32 by nets
    np.testing.assert_allclose(tangent, right, atol=1e-5 * scale)
    both = sum((g * a).sum() for g, a in zip(gradient, along))
    assert abs(both - right.sum()) < 1e-5 * np.abs(right).sum()
    assert np.abs(gradient[1][~active]).max() == 0


@pytest.mark.parametrize("degrees", ["mixed", "one"])
@pytest.mark.parametrize("order", [1, 2])
def test_first_partials_with_derivatives(degrees, order):
    """They are those of all partials, and the second ones have none."""
    if degrees == "mixed":
        layout, stored, _nets = mixed(ad.Float)
    else:
        layout, stored = lay_out([(3, 12)], ad.Float), pack(nets_of(3, 12)).ravel()
    count = 60
    uv, patch = parameters(count), np.arange(count, dtype=np.uint32) % 12
    weights = weights_for(count)[:3]
    found = []
    for evaluate in (layout.second, lambda *args: layout.jet(*args, order)):
        nets = upload(ad.Float, stored)
        u, v = (ad.Float64(uv[:, k].copy()) for k in range(2))
        dr.enable_grad(nets, u, v)
        h = evaluate(nets, ad.UInt(patch), u, v, ad.Bool(True))
        total = sum(x * ad.Float64(w) for xs, ws in zip(h, weights) for x, w in zip(xs, ws))
        dr.backward(dr.sum(total))
        found.append([np.array(dr.grad(x), dtype=float) for x in (nets, u, v)])
        found[-1].extend(np.array(x) for xs in h[:3] for x in xs)
    assert len(h) == (6 if order == 2 else 3)
    assert not any(dr.grad_enabled(x) for xs in h[3:] for x in xs)
    for right, got in zip(*found):
        # gradients of nets are sums in float32
        np.testing.assert_allclose(got, right, atol=2e-6 * np.abs(right).max())


def operations(layout: patch_nets.Layout, stored: np.ndarray) -> int:
    """Return how large the kernels are that differentiate points."""
    nets = upload(ad.Float, stored)
    u = dr.opaque(ad.Float64, 0.3, 4)
    dr.enable_grad(nets)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        h = layout.jet(nets, ad.UInt([0, 1, 2, 0]), u, u, ad.Bool(True), 2)
        dr.backward(dr.sum(h[0][0] + h[1][1] + h[2][2]))
        dr.eval(dr.grad(nets))
        return sum(k.get("operation_count", 0) for k in dr.kernel_history())


def test_derivatives_of_many_degrees_take_the_code_of_one():
    layout, stored, _nets = mixed(ad.Float)
    one = operations(lay_out([(14, 3)], ad.Float), pack(scaled(nets_of(14, 3))).ravel())
    # where a net begins, and whether it has its multinomials: some operations more
    assert operations(layout, stored) < 1.2 * one
