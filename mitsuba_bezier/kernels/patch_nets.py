"""Control nets of patches, each of its own degree, and their points, partials and derivatives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from ..geometry import bernstein
from .arrays import gather_packets, upload
from .buckets import choose
from .curvature import evaluate_second, second_of_net
from .patch import padded_width
from .rolled import add_gradient, partials_up_to, rolled_partials
from .two_float import coarse

__all__ = ["Layout", "lay_out"]

#: Up to this degree points of patches have code of their own.
UNROLLED = 6
#: Derivatives of nets of one degree up to this are left to Dr.Jit.
_BY_DRJIT = 3

_SECOND = partials_up_to(2)


@dataclass
class Layout:
    """How nets are stored: those of low degree as they are, others times their multinomials.

    Attributes
    ----------
    degrees : list
        Those that have code of their own, rising, and None if there are others.
    shapes : list of (degree, first)
        Of each shape the one of `degrees` that its nets are raised to, and the number of its first
        row, of four floats.
    first, degree : UInt
        The same of each patch, but all degrees are numbers. None where `degrees` tells them.
    """

    degrees: list[int | None]
    shapes: list[tuple[int | None, int]]
    first: Any
    degree: Any

    @property
    def only(self) -> int | None:
        """The degree of all patches, if it has code of its own."""
        return self.degrees[0] if len(self.degrees) == 1 else None

    def second(self, nets: Any, patch: Any, u: Any, v: Any, active: Any) -> list[list[Any]]:
        """Evaluate homogeneous points, first and second partials; see `curvature.evaluate_second`.

        Parameters
        ----------
        nets : Float
            All of them, as they are stored; may have derivatives, as the next two.
        patch : UInt
        u, v : Float
            Their type is that of all arithmetic.
        active : Bool
        """
        return self._points(nets, patch, u, v, active, 2)

    def jet(
        self, nets: Any, patch: Any, u: Any, v: Any, active: Any, order: int = 1
    ) -> list[list[Any]]:
        """Do what `second` does, but only points and first partials have derivatives.

        Parameters
        ----------
        order : int
            Of the highest partials: 2, or 1, by a loop over the rows whatever the degree. So that
            is for what few rays want: it takes little code.
        """
        return self._points(nets, patch, u, v, active, 1, order)

    def _points(
        self, nets: Any, patch: Any, u: Any, v: Any, active: Any, moving: int, order: int = 2
    ) -> list[list[Any]]:
        attached = dr.grad_enabled(nets, u, v)
        by_drjit = self.only is not None and self.only <= _BY_DRJIT
        place = _Place(self, nets, patch, active, moving, order)
        if order == 2 and (by_drjit or not attached):
            found = self._value(nets, patch, u, v, active)
        elif attached:
            found = dr.custom(_Moving, nets, u, v, dr.grad_enabled(u, v), place)
        else:
            found = place.points(u, v)
        count = len(place.moving)
        return [*found[:count], *(dr.detach(x) for x in found[count:])]

    def place(self, patch: Any, active: Any) -> tuple[Any, Any]:
        """Return the first rows and the degrees of patches."""
        if self.first is None:
            assert self.only is not None
            degree = self.only
            return patch * (padded_width(degree) // 4), type(patch)(degree)
        return tuple(dr.gather(type(patch), x, patch, active) for x in (self.first, self.degree))

    def is_plain(self, degree: Any) -> Any:
        """Return a mask of the degrees that are stored as control points."""
        highest = max((d for d in self.degrees if d is not None), default=0)
        return degree <= highest

    def _value(self, nets: Any, patch: Any, u: Any, v: Any, active: Any) -> list[list[Any]]:
        if self.only is not None:
            return evaluate_second(nets, self.only, patch, u, v, active)
        first, degree = self.place(patch, active)
        return self._branch(self.degrees, nets, first, degree, u, v, dr.mask_t(coarse(u))(active))

    def _branch(
        self,
        degrees: list[int | None],
        nets: Any,
        first: Any,
        degree: Any,
        u: Any,
        v: Any,
        active: Any,
    ) -> list[list[Any]]:
        here, *others = degrees

        def task(first: Any, degree: Any, u: Any, v: Any, active: Any) -> list[list[Any]]:
            if here is None:
                found = rolled_partials(nets, first, degree, u, v, active)
                # as `second_of_net` has them
                return [
                    found[key] if sum(key) < 2 else [coarse(x) for x in found[key]]
                    for key in _SECOND
                ]
            net = gather_packets(nets, first >> 1, bernstein.size(here) * 4, active, stride=1)
            return second_of_net(net, here, u, v)

        if not others:
            return task(first, degree, u, v, active)
        return dr.if_stmt(
            args=(first, degree, u, v, active),
            cond=degree <= here,
            true_fn=task,
            false_fn=lambda *args: self._branch(others, nets, *args),
            label="bezier degree",
        )


def lay_out(counts: list[tuple[int, int]], like: Any) -> Layout:
    """Choose how the patches of some shapes are stored.

    Parameters
    ----------
    counts : list of (degree, count)
        The patches of each shape.
    like : Float
    """
    uint = dr.uint32_array_t(like)
    degree = np.repeat([d for d, _n in counts], [n for _d, n in counts])
    powers = np.repeat(degree[:, None], 3, axis=1)
    chosen = choose(powers, np.full(len(degree), 4), UNROLLED)
    to: dict[int, int | None] = {}
    for choice in chosen:
        to.update(dict.fromkeys(np.unique(degree[choice.numbers]).tolist(), choice.degree))
    row = 0
    shapes: list[tuple[int | None, int]] = []
    firsts, degrees = [], []
    for own, count in counts:
        width = padded_width(to[own] or own) // 4
        shapes.append((to[own], row))
        firsts.append(row + width * np.arange(count))
        degrees.append(np.full(count, to[own] or own))
        row += width * count
    layout = Layout([c.degree for c in chosen], shapes, None, None)
    if layout.only is None:
        layout.first = upload(uint, np.concatenate(firsts).astype(np.uint32))
        layout.degree = upload(uint, np.concatenate(degrees).astype(np.uint32))
    return layout


class _Place:
    """What `_Moving` needs beside its arguments: no dataclass, which Dr.Jit would detach."""

    def __init__(
        self, layout: Layout, nets: Any, patch: Any, active: Any, moving: int, order: int
    ) -> None:
        self.layout, self.nets, self.patch, self.active = layout, nets, patch, active
        self.moving = partials_up_to(moving)  #: what has derivatives
        self.order = order

    def points(self, u: Any, v: Any) -> list[list[Any]]:
        """Return points and partials up to `order`.

        Where patches have several degrees the code is that of any of them: what each would have of
        its own is as much again for each kernel with derivatives.
        """
        if self.order == 2 and self.layout.only is not None:
            return self.layout._value(self.nets, self.patch, u, v, self.active)
        found = self.partials(dr.detach(self.nets), u, v, self.order)
        return [found[key] for key in partials_up_to(self.order)]

    def partials(self, nets: Any, u: Any, v: Any, order: int) -> dict[tuple[int, int], list[Any]]:
        """Return partials up to an order, by a loop over the rows."""
        first, degree = self.layout.place(self.patch, self.active)
        plain = self.layout.is_plain(degree)
        return rolled_partials(nets, first, degree, u, v, self.active, order, plain)

    def add_gradient(self, u: Any, v: Any, gradient: dict[tuple[int, int], list[Any]]) -> None:
        """Bring the gradient by what is moving to the nets."""
        first, degree = self.layout.place(self.patch, self.active)
        plain = self.layout.is_plain(degree)
        add_gradient(self.nets, first, degree, u, v, self.active, gradient, plain)


class _Moving(dr.CustomOp):
    """Points and partials with derivatives, by loops over the rows in each direction.

    What Dr.Jit makes of code that is unrolled takes many times as long to compile as that code; and
    loops it differentiates forwards only.
    """

    def eval(self, nets: Any, u: Any, v: Any, slides: bool, place: _Place) -> Any:
        self.at, self.u, self.v, self.nets = place, u, v, nets
        self.moves, self.slides = dr.grad_enabled(place.nets), slides
        return place.points(u, v)

    def _slopes(self) -> dict[tuple[int, int], list[Any]]:
        """Return the partials by the parameters of all that is moving."""
        return self.at.partials(self.nets, self.u, self.v, max(map(sum, self.at.moving)) + 1)

    def forward(self) -> None:
        at = self.at
        tangent = [[type(self.u)(0.0)] * 4 for _ in partials_up_to(at.order)]
        if self.moves:
            order = max(map(sum, at.moving))
            found = at.partials(self.grad_in("nets"), self.u, self.v, order)
            tangent[: len(at.moving)] = [found[key] for key in at.moving]
        if self.slides:
            du, dv = self.grad_in("u"), self.grad_in("v")
            found = self._slopes()
            for row, (p, q) in zip(tangent, at.moving):
                for a in range(4):
                    row[a] = row[a] + du * found[p + 1, q][a] + dv * found[p, q + 1][a]
        self.set_grad_out(tangent)

    def backward(self) -> None:
        gradient = dict(zip(self.at.moving, self.grad_out()))
        if self.moves:
            self.at.add_gradient(self.u, self.v, gradient)
        if self.slides:
            found = self._slopes()
            for name, dp, dq in (("u", 1, 0), ("v", 0, 1)):
                total = sum(
                    g[a] * found[p + dp, q + dq][a]
                    for (p, q), g in gradient.items()
                    for a in range(4)
                )
                self.set_grad_in(name, total)

    def name(self) -> str:
        return "bezier points"
