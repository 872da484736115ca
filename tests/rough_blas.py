"""Another BLAS, for tests: what `numpy.linalg` returns is as wrong as any kernel may make it.

Kernels differ by how they round, and each returns the exact result of a matrix that differs from
the one it was given by some roundings. So does this one, by more of them and at random; singular
vectors have either sign, and those of a null space are turned in it. Where a pivot could have been
zero it raises, as some kernel would.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

EPS = np.finfo(float).eps
#: Roundings of an entry, relative to the largest of its matrix, or of its row for `inv`, `solve`.
ROUNDINGS = 4
#: From this condition on, of matrices with columns of unit length, a pivot may be zero.
SINGULAR = 1e14


@contextmanager
def rough_blas(seed: int) -> Iterator[None]:
    """Let `numpy.linalg` be rough."""
    rng = np.random.default_rng(seed)
    exact = {
        name: getattr(np.linalg, name)
        for name in ("inv", "solve", "svd", "eigh", "eigvalsh", "det", "pinv", "lstsq", "cond")
    }

    def near(a: Any, by_rows: bool = False) -> np.ndarray:
        a = np.asarray(a)
        scale = np.abs(a).max(axis=-1 if by_rows else (-2, -1), keepdims=True, initial=0.0)
        noise = rng.uniform(-1, 1, a.shape)
        if np.iscomplexobj(a):
            noise = noise + 1j * rng.uniform(-1, 1, a.shape)
        return a + ROUNDINGS * EPS * scale * noise

    def signs(shape: tuple[int, ...]) -> np.ndarray:
        return rng.choice([-1.0, 1.0], shape)

    def refuse_singular(a: Any) -> None:
        a = np.asarray(a, dtype=float)
        with np.errstate(all="ignore"):
            unit = a / np.abs(a).max(axis=-2, keepdims=True)
            unit = unit / np.linalg.norm(unit, axis=-2, keepdims=True)
        known = np.isfinite(unit).all(axis=(-2, -1), keepdims=True)
        s = exact["svd"](np.where(known, unit, np.eye(a.shape[-1])), compute_uv=False)
        if (s[..., -1] * SINGULAR < s[..., 0]).any() or not known.all():
            raise np.linalg.LinAlgError("Singular matrix")

    def inv(a: Any) -> np.ndarray:
        refuse_singular(a)
        return exact["inv"](near(a, by_rows=True))

    def solve(a: Any, b: Any) -> np.ndarray:
        refuse_singular(a)
        return exact["solve"](near(a, by_rows=True), b)

    def svd(a: Any, full_matrices: bool = True, compute_uv: bool = True) -> Any:
        if not compute_uv:
            return exact["svd"](near(a), compute_uv=False)
        u, s, vt = exact["svd"](near(a), full_matrices=full_matrices)
        k = s.shape[-1]
        sign = signs(s.shape)
        u, vt = u.copy(), vt.copy()
        u[..., :k] *= sign[..., None, :]
        vt[..., :k, :] *= sign[..., None]
        for rest in (u[..., k:], np.swapaxes(vt[..., k:, :], -2, -1)):
            m = rest.shape[-1]
            if m:
                rest[...] = rest @ np.linalg.qr(rng.normal(size=(*rest.shape[:-2], m, m)))[0]
        return u, s, vt

    def eigh(a: Any) -> Any:
        values, vectors = exact["eigh"](symmetric(a))
        return values, vectors * signs(values.shape)[..., None, :]

    def symmetric(a: Any) -> np.ndarray:
        a = near(a)
        return (a + np.swapaxes(a, -2, -1)) / 2

    rough = {
        "inv": inv,
        "solve": solve,
        "svd": svd,
        "eigh": eigh,
        "eigvalsh": lambda a: exact["eigvalsh"](symmetric(a)),
        "det": lambda a: exact["det"](near(a, by_rows=True)),
        "pinv": lambda a, **options: exact["pinv"](near(a), **options),
        "lstsq": lambda a, b, **options: exact["lstsq"](near(a), b, **options),
        "cond": lambda a, **options: exact["cond"](near(a), **options),
    }
    with pytest.MonkeyPatch.context() as patch:
        for name, function in rough.items():
            patch.setattr(np.linalg, name, function)
        yield
