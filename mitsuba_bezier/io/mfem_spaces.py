"""Finite element spaces of MFEM: what the header of a grid function says, and its values."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache

import numpy as np

from .files import damaged
from .text import Tokens

__all__ = ["Space", "read_space"]

#: Names of collections of fixed order: kind, order, basis.
_FIXED = {
    "Linear": ("H1", 1, "G"),
    "Quadratic": ("H1", 2, "G"),
    "QuadraticPos": ("H1", 2, "P"),
    "Cubic": ("H1", 3, "U"),
    "Const2D": ("L2", 0, "g"),
    "Const3D": ("L2", 0, "g"),
    "LinearDiscont2D": ("none", 1, ""),
}
#: Numbers of bases in the names of L2.
_L2 = {"0": "g", "1": "G", "2": "P", "3": "u", "4": "U"}


@cache
def _places(basis: str, order: int) -> tuple[float, ...]:
    """Return the nodes of an edge, from 0 to 1."""
    if order == 0:
        return (0.5,)
    legendre = np.polynomial.legendre
    if basis == "G":  # Gauss-Lobatto: the ends, and the extrema of the Legendre polynomial
        inner = legendre.Legendre.basis(order).deriv().roots()
        x = np.concatenate([[-1.0], np.sort(inner.real), [1.0]])
    elif basis == "g":
        x = legendre.leggauss(order + 1)[0]
    elif basis == "u":
        x = 2 * (np.arange(order + 1) + 1) / (order + 2) - 1
    else:
        x = 2 * np.arange(order + 1) / order - 1
    return tuple(((x + 1) / 2).tolist())


@dataclass
class Space:
    """A space and the values of a grid function in it.

    Attributes
    ----------
    kind : str
        ``"H1"``, ``"L2"``, ``"NURBS"``, or another that is not read.
    order : int
        0 for NURBS of the order of the mesh.
    dimension : int
        Of the elements.
    basis : str
        ``G`` Gauss-Lobatto, ``g`` Gauss-Legendre, ``U`` and ``u`` equal distances with and without
        the ends, ``P`` Bernstein.
    components : int
    values : (N, components) array
    name : str
    """

    kind: str
    order: int
    dimension: int
    basis: str
    components: int
    values: np.ndarray
    name: str = "H1"

    def spacing(self, _kind: str) -> tuple[float, ...] | None:
        """Return the nodes of an edge; None: they are no nodes, or one."""
        return None if self.basis == "P" or self.order < 1 else _places(self.basis, self.order)


def read_space(tokens: Tokens, file: bool = False) -> Space:
    """Read a grid function: ``FiniteElementSpace`` and its values, to the end if it is a `file`.

    Raises
    ------
    FileFormatError
        If it is damaged.
    """
    if tokens.word("FiniteElementSpace") != "FiniteElementSpace":
        raise tokens.error("FiniteElementSpace", "another word", back=1)
    facts: dict[str, str] = {}
    for key in ("FiniteElementCollection:", "VDim:", "Ordering:"):
        if tokens.word(key) != key:
            raise tokens.error(key, "another word", back=1)
        facts[key] = tokens.word(key)
    name = facts["FiniteElementCollection:"]
    if not re.fullmatch(r"[0-9]{1,4}", facts["VDim:"]) or facts["VDim:"] == "0":
        raise tokens.error("a number of components", repr(facts["VDim:"][:40]))
    if facts["Ordering:"] not in ("0", "1"):
        raise tokens.error("Ordering: 0 or 1", repr(facts["Ordering:"][:40]))
    components = int(facts["VDim:"])
    kind, order, basis = _collection(name)
    rows = values_of(tokens, components, facts["Ordering:"] == "1", not file)
    return Space(kind, order, 0, basis, components, rows, name[:60])


def _collection(name: str) -> tuple[str, int, str]:
    if name in _FIXED:
        return _FIXED[name]
    if m := re.fullmatch(r"H1(?:@([A-Za-z]))?_[123]D_P(\d{1,2})", name):
        return "H1", int(m[2]), m[1] or "G"
    if m := re.fullmatch(r"H1Pos_[123]D_P(\d{1,2})", name):
        return "H1", int(m[1]), "P"
    if m := re.fullmatch(r"L2(?:_T([0-4]))?_[123]D_P(\d{1,2})", name):
        return "L2", int(m[2]), _L2[m[1] or "0"]
    if m := re.fullmatch(r"NURBS(\d{0,2})", name):
        return "NURBS", int(m[1] or 0), "P"
    return "none", 0, ""


def values_of(tokens: Tokens, components: int, by_vector: bool, partly: bool) -> np.ndarray:
    """Return the numbers that follow, up to a word that is none if they are only a part."""
    count = len(tokens)
    if partly:
        count = tokens.numbers_ahead()
    if count % components:
        raise tokens.error(f"a number of values that {components} divides", count)
    flat = tokens.numbers(count, "values")
    return flat.reshape(-1, components) if by_vector else flat.reshape(components, -1).T


def check_kind(path: object, space: Space, kinds: tuple[str, ...]) -> None:
    """Raise `FileFormatError` if a space is of no such kind."""
    if space.kind not in kinds:
        raise damaged(str(path), f"a space of {' or '.join(kinds)}", space.name)
