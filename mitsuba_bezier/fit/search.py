"""`Search`: the state of a search, Adam and L-BFGS on it, and its checkpoint."""

from __future__ import annotations

import os
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from .._files import check_target
from ..errors import BezierError, FileFormatError
from . import checkpoint as checkpoints
from .optimizers import Adam, Moments
from .parametrization import Parametrization
from .problem import Problem

__all__ = ["Search"]

#: A step that is not valid is halved so many times; then the search stops.
_HALVINGS = 12

#: Adam's rate falls to this part of it at the end, which averages over the noise of images.
_FALL = 0.05


@dataclass(frozen=True)
class _State:
    """All that a search knows after a step; replaced as a whole, so that Ctrl-C finds it whole.

    Attributes
    ----------
    x : array
        The last vector whose loss is known.
    pending : array
        The change that the next step begins with.
    """

    x: np.ndarray
    pending: np.ndarray
    moments: Moments
    losses: tuple[float, ...] = ()
    halved: int = 0
    refined: int = 0

    @staticmethod
    def at(x: np.ndarray) -> _State:
        return _State(x, np.zeros_like(x), Moments.zero(len(x)))


@dataclass
class Search:
    """Steps from the start of a problem, or from a checkpoint, to the end.

    Parameters
    ----------
    problem : Problem
    steps, rate, method, refine, seed, checkpoint, every
        As in `minimize`.
    """

    problem: Problem
    steps: int
    rate: float
    method: str
    refine: dict[int, str]
    seed: int
    checkpoint: Any
    every: float
    state: _State = field(init=False)
    reason: str = field(default="steps", init=False)
    seconds: float = field(default=0.0, init=False)

    def __post_init__(self) -> None:
        self.state = _State.at(self.problem.start)
        self.began = self.saved = time.perf_counter()
        self.first = self.problem.start.copy()
        self._warned = False
        if self.checkpoint is not None:
            check_target(self.checkpoint, "checkpoint")
            if os.path.lexists(self.checkpoint):
                self._resume()

    def elapsed(self) -> float:
        """Return the seconds taken, with those of earlier runs."""
        return self.seconds + time.perf_counter() - self.began

    # ------------------------------------------------------------ checkpoint

    def _about(self) -> dict[str, Any]:
        """Return what a checkpoint must have in common with a search that goes on from it."""
        return {
            "method": self.method,
            "seed": self.seed,
            "unknowns": {k: type(p).__name__ for k, p in self.problem.unknowns.items()},
            "smoothing": self.problem.smoothing,
            "refine": {str(k): v for k, v in sorted(self.refine.items())},
        }

    def _resume(self) -> None:
        """Take over the checkpoint."""
        about, arrays = checkpoints.read(self.checkpoint)
        name = os.fspath(self.checkpoint)
        for key, value in self._about().items():
            if about.get(key) != value:
                raise BezierError.expected(
                    "checkpoint",
                    f"one of this search ({key}: {value})",
                    f"{name} ({about.get(key)})",
                )
        try:
            self._take_over(about, arrays)
        except (KeyError, TypeError, AttributeError) as error:
            raise FileFormatError.expected(
                "checkpoint", "a file of mitsuba_bezier.fit", f"{name} (damaged: {error})"
            ) from None

    def _take_over(self, about: dict[str, Any], arrays: dict[str, np.ndarray]) -> None:
        name = os.fspath(self.checkpoint)
        first, seen = arrays["first start"], arrays["wanted"]
        # starts and photographs may have been computed anew, on another machine
        if first.shape != self.first.shape or not np.allclose(first, self.first, 1e-4, 1e-6):
            raise BezierError.expected(
                "checkpoint", "one of this search (with the start of its unknowns)", name
            )
        wanted = self.problem.wanted
        if seen.shape != wanted.shape or not np.allclose(seen, wanted, 0.05, 0.05 * _size(wanted)):
            raise BezierError.expected("checkpoint", "one of this search (with its targets)", name)
        if about["refined"]:
            restored = {}
            for i, (key, item) in enumerate(self.problem.unknowns.items()):
                prefix = f"base.{i}."
                own = {k[len(prefix) :]: v for k, v in arrays.items() if k.startswith(prefix)}
                restored[key] = item.restored(own)
            self.problem.take(restored)
        for part in ("x", "pending", "first", "second"):
            if arrays[part].shape != self.problem.start.shape:
                raise BezierError.expected(
                    "checkpoint",
                    f"one with {len(self.problem.start)} unknowns",
                    f"{name} with {arrays[part].size}",
                )
            if not np.isfinite(arrays[part]).all():
                raise FileFormatError.expected("checkpoint", "finite numbers", f"others in {name}")
        moments = Moments(arrays["first"], arrays["second"], about["count"])
        losses = tuple(arrays["losses"].tolist())
        self.state = _State(
            arrays["x"], arrays["pending"], moments, losses, about["halved"], about["refined"]
        )
        self.seconds = about["seconds"]

    def save(self) -> None:
        """Write the checkpoint, if one is wanted; one that cannot be written is no end."""
        if self.checkpoint is None:
            return
        state = self.state
        arrays = {
            "x": state.x,
            "pending": state.pending,
            "losses": np.array(state.losses),
            "first": state.moments.first,
            "second": state.moments.second,
            "first start": self.first,
            "wanted": self.problem.wanted,
        }
        for i, item in enumerate(self.problem.unknowns.values()):
            arrays |= {f"base.{i}.{name}": value for name, value in item.state().items()}
        about = self._about() | {
            "halved": state.halved,
            "seconds": self.elapsed(),
            "count": state.moments.count,
            "refined": state.refined,
        }
        self.saved = time.perf_counter()
        try:
            checkpoints.write(self.checkpoint, about, arrays)
        except FileFormatError as error:  # the disk is full: the search is worth more
            warnings.warn(f"fit.minimize goes on without writing: {error}", stacklevel=5)

    def _save_sometimes(self) -> None:
        if time.perf_counter() - self.saved > self.every:
            self.save()

    # ------------------------------------------------------------ Adam

    def adam(self, show: Callable[[int, float], None]) -> None:
        """Take steps of Adam until all are taken or one fails."""
        adam = Adam(self.problem.blocks)
        try:
            while (step := len(self.state.losses)) < self.steps:
                due = [at for at in sorted(self.refine) if at <= step][self.state.refined :]
                for at in due:
                    self._refine(self.refine[at])
                    adam = Adam(self.problem.blocks)
                found = self._try(step)
                if found is None:
                    break
                x, loss, gradient, halved = found
                change, moments = adam.step(
                    self.state.moments, gradient, self.rate * _FALL ** (step / self.steps)
                )
                losses = (*self.state.losses, loss)
                self.state = _State(x, change, moments, losses, halved, self.state.refined)
                show(len(losses), loss)
                self._save_sometimes()
            else:
                self._settle()
        finally:
            self._end()

    def _end(self) -> None:
        """Write the checkpoint and give the scene the last good state, at Ctrl-C as well."""
        self.save()
        if len(self.state.losses):
            self.problem.set(self.state.x)

    def _try(self, step: int) -> tuple[np.ndarray, float, np.ndarray, int] | None:
        """Return vector, loss, gradient and halved steps after the pending change.

        The change is halved until what it leads to is valid.
        """
        state = self.state
        moved = bool(state.pending.any())
        for halving in range(_HALVINGS + 1):
            x = state.x + state.pending / 2**halving
            try:
                loss, gradient = self.problem.evaluate(x, self.seed + step)
            except BezierError as error:
                if not moved:
                    raise
                why = error
                self._say_halved(step, error)
                continue
            if not np.isfinite(loss) or not np.isfinite(gradient).all():
                self._stop(f"the loss or its gradient is not finite at step {step}")
                return None
            if step == 0:
                self._need_derivatives(gradient)
            return x, loss, gradient, state.halved + bool(halving)
        self._stop(f"no valid step at step {step}: {why}")
        return None

    def _settle(self) -> None:
        """Take the pending change over without an image, halved until it is valid."""
        state = self.state
        for halving in range(_HALVINGS + 1):
            x = state.x + state.pending / 2**halving
            try:
                self.problem.set(x)
            except BezierError:
                continue
            self.state = replace(
                state, x=x, pending=np.zeros_like(x), halved=state.halved + bool(halving)
            )
            return

    def _refine(self, how: str) -> None:
        """Give the parametrizations more unknowns, at the same surfaces."""
        self._settle()
        arrays = self.problem.arrays(self.state.x)
        finer: dict[str, Parametrization] = {}
        kept = {}
        for key, item in self.problem.unknowns.items():
            if item.can_refine:
                finer[key] = item.refined(arrays[key], how)
            else:
                finer[key] = item
                kept[key] = arrays[key]
        coarse = self.problem.unknowns
        try:
            self.problem.take(finer)
            x = self.problem.vector(kept)
            self.state = replace(
                _State.at(x),
                losses=self.state.losses,
                halved=self.state.halved,
                refined=self.state.refined + 1,
            )
        except BaseException:  # Ctrl-C: problem and state have as many unknowns
            if len(self.state.x) != len(self.problem.start):
                self.problem.take(coarse)
            raise

    # ------------------------------------------------------------ L-BFGS

    def bfgs(self, show: Callable[[int, float], None]) -> None:
        """Let SciPy's L-BFGS-B take the steps left."""
        from scipy.optimize import minimize as scipy_minimize

        best_x, best_loss, last = self.state.x, np.inf, np.inf

        def value(x: np.ndarray) -> tuple[float, np.ndarray]:
            nonlocal best_x, best_loss, last
            try:
                loss, gradient = self.problem.evaluate(x, self.seed)
            except BezierError as error:
                if np.isinf(best_loss):
                    raise
                self._say_halved(len(self.state.losses), error)
                loss, gradient = np.nan, x
            if np.isfinite(loss) and np.isfinite(gradient).all():
                if np.isinf(best_loss):
                    self._need_derivatives(gradient)
                last = loss
                if loss < best_loss:
                    best_x, best_loss = x.copy(), loss
                return loss, gradient
            if np.isinf(best_loss):
                raise BezierError.expected("unknowns", "a start whose loss is finite", loss)
            # a wall, quadratic around the best state, from which the line search turns back
            self.state = replace(self.state, halved=self.state.halved + 1)
            away = x - best_x
            high = 10 * abs(best_loss) + 1e-30
            return best_loss + high * (1 + away @ away), 2 * high * away

        def stepped(x: np.ndarray) -> None:
            self.state = replace(self.state, x=x.copy(), losses=(*self.state.losses, last))
            show(len(self.state.losses), last)
            self._save_sometimes()

        try:
            left = self.steps - len(self.state.losses)
            if left > 0:
                found = scipy_minimize(
                    value,
                    self.state.x,
                    jac=True,
                    method="L-BFGS-B",
                    callback=stepped,
                    options={"maxiter": left},
                )
                if found.status == 0:
                    self.reason = "converged"
                elif found.status != 1:  # 1: all steps are taken
                    self._stop(str(found.message))
        finally:
            if np.isfinite(best_loss):
                self.state = replace(self.state, x=best_x)
            self._end()

    # ------------------------------------------------------------ both

    def _say_halved(self, step: int, why: BezierError) -> None:
        """Tell of the first step that is halved; all are counted."""
        if not self._warned:
            self._warned = True
            warnings.warn(
                f"fit.minimize halves steps to nets that are not valid, at first step {step}: "
                f"{why}",
                stacklevel=6,
            )

    def _need_derivatives(self, gradient: np.ndarray) -> None:
        """Raise an error that names a parameter that has no derivative."""
        for key in self.problem.unknowns:
            parts = [place for k, _n, place, _s, _c in self.problem.places if k == key]
            if not any(gradient[place].any() for place in parts):
                raise BezierError.expected(
                    key,
                    f"a parameter by which the loss has a derivative ({which_integrator(key)})",
                    "a gradient of exactly zero",
                )

    def _stop(self, reason: str) -> None:
        self.reason = reason
        warnings.warn(f"fit.minimize stopped: {reason}; the state before it is kept", stacklevel=5)


def which_integrator(key: str) -> str:
    """Return what has derivatives by a parameter, by its name."""
    names = set(key.split("."))
    if names & {"curvatures", "thicknesses", "conics", "coefficients", "nd", "vd"}:
        return "the sensor `lens` has them in Mitsuba's direct"
    if names & {"sigma_t", "albedo", "phase_function"}:
        return "media have them in beziervolpath"
    return "is it seen? outlines need bezier_direct_projective or bezier_prb_projective"


def _size(values: np.ndarray) -> float:
    return float(np.abs(values).max(initial=0.0))
