"""`minimize`: search the unknowns of a scene until its images are those wanted."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .._runtime import import_mitsuba
from ..errors import BezierError
from ..geometry.triangles import BezierTriangles
from .parametrization import Parametrization
from .problem import LOSSES, Problem
from .search import Search

__all__ = ["Fit", "minimize"]


@dataclass
class Fit:
    """What `minimize` has found.

    Attributes
    ----------
    unknowns : dict of str to dict of str to array
        Where the search ended, by parameter and name.
    values : dict of str to array
        The parameters of the scene, which has them as well.
    losses : list of float
        The loss of each step, before it was taken.
    reason : str
        Why the search ended: "steps", "converged", or what went wrong.
    halved : int
        How many steps were halved, since the net they led to was not valid.
    seconds : float
        Time, with that of earlier runs of the same checkpoint.
    parametrizations : dict of str to Parametrization
        The last ones, refined.
    """

    unknowns: dict[str, dict[str, np.ndarray]]
    values: dict[str, np.ndarray]
    losses: list[float]
    reason: str
    halved: int
    seconds: float
    parametrizations: dict[str, Parametrization] = field(repr=False)

    def patches(self, key: str) -> BezierTriangles:
        """Return the control points that were found for a parameter as patches."""
        return BezierTriangles(self.values[key])


def minimize(
    scene: Any,
    unknowns: Mapping[str, Parametrization],
    targets: Sequence[Any] | Mapping[int, Any] | None = None,
    *,
    objective: Callable[[Any, int], Any] | None = None,
    integrator: Any = "bezier_direct_projective",
    loss: str | Callable[[Any, Any], Any] = "l2",
    terms: Sequence[tuple[float, str, Callable[[Any], Any]]] = (),
    spp: int = 16,
    views: int | None = None,
    steps: int = 100,
    rate: float = 0.02,
    method: str = "adam",
    smoothing: float = 0.0,
    refine: Mapping[int, str] | None = None,
    seed: int = 0,
    checkpoint: str | os.PathLike[str] | None = None,
    every: float = 30.0,
    progress: bool | None = None,
    callback: Callable[[int, float], None] | None = None,
) -> Fit:
    """Search parameters of a scene whose images are `targets`, or whose `objective` is least.

    Parameters
    ----------
    scene : mi.Scene or None
        It is changed, and has the parameters found at the end. None where an objective needs no
        scene: then nothing is built, and `unknowns` have names of your own.
    unknowns : dict of str to Parametrization
        By the names of `mi.traverse(scene)`.
    targets : sequence of (H, W, C) array, or dict of int to array
        The image wanted of each sensor.
    objective : callable
        In place of targets: ``objective(params, seed)`` returns a number of Dr.Jit.
    integrator : str, dict or mi.Integrator
        What renders the images; the default has derivatives of outlines.
    loss : {"l2", "l1"} or callable
        ``loss(image, target)``: mean of squares, of absolute values, or your own.
    terms : sequence of (float, str, callable)
        Added to the loss: a weight, the name of a parameter, and a function of its value,
        for example `Joins`.
    spp : int
        Samples of a pixel.
    views : int, optional
        How many of the targets a step of Adam looks at, in turn; by default all.
    steps : int
        How many; a step of L-BFGS may take several evaluations.
    rate : float
        Of Adam, at the beginning, in scales of the unknowns (a part of the surface's size). It
        falls to a twentieth.
    method : {"adam", "l-bfgs"}
        L-BFGS (SciPy's) takes the same seed in all steps, so that the loss is a function; it
        suits objectives with little noise.
    smoothing : float
        Strength of the net's Laplacian as preconditioner of Adam: 0 none, 10 much.
    refine : dict of int to str
        At which steps to "elevate" or "split" the nets: coarse to fine. Adam only.
    seed : int
        Equal seeds give equal searches.
    checkpoint : path-like, optional
        Written every `every` seconds, at the end and at Ctrl-C. If it is there, the search goes on
        from it, and ends where an uninterrupted one does, but for the order in which threads add.
    progress : bool, optional
        Show step, loss and time left; by default on a terminal.
    callback : callable, optional
        ``callback(step, loss)`` after each step, with the scene as it was rendered.

    Returns
    -------
    Fit

    Warns
    -----
    UserWarning
        If the search stopped early: a loss that is not finite, or no valid step. The scene and the
        checkpoint keep the last state that was good.

    Raises
    ------
    BezierError
        If an argument is not valid, the parameters of the start are not, or a parameter has no
        derivative in the integrator.

    Examples
    --------
    >>> import mitsuba_bezier as mb, mitsuba as mi, numpy as np
    >>> mi.set_variant("llvm_ad_rgb")
    >>> from mitsuba_bezier import fit
    >>> scene = mi.load_dict({"type": "scene", "ball": mb.shape(mb.sphere())})
    >>> def away(params, seed):
    ...     net = params["ball.control_points"].array
    ...     return (dr.mean(net) - 1) ** 2
    >>> import drjit as dr
    >>> found = fit.minimize(scene, {"ball.control_points": fit.Sphere(radius=2)},
    ...                      objective=away, steps=2)
    >>> len(found.losses)
    2
    """
    if method not in ("adam", "l-bfgs"):
        raise BezierError.expected("method", '"adam" or "l-bfgs"', repr(method))
    if refine and method != "adam":
        raise BezierError.expected("refine", 'none with method "l-bfgs"', refine)
    if refine and not any(getattr(item, "can_refine", False) for item in unknowns.values()):
        raise BezierError.expected("refine", "an unknown Net among the parameters", "none")
    for name, number in (("steps", steps), ("spp", spp)):
        if not isinstance(number, (int, np.integer)) or number < 1:
            raise BezierError.expected(name, "a whole number above zero", number)
    for name, real in (("rate", rate), ("every", every)):
        if not real > 0:
            raise BezierError.expected(name, "a number above zero", real)
    if not smoothing >= 0:
        raise BezierError.expected("smoothing", "zero or more", smoothing)
    if views is not None and (method != "adam" or views < 1):
        raise BezierError.expected("views", 'one or more, and method "adam"', views)
    images = _images(scene, targets, objective, integrator, loss, spp, views)
    problem = Problem(scene, unknowns, images, terms, smoothing)
    search = Search(problem, int(steps), rate, method, dict(refine or {}), seed, checkpoint, every)
    with _display(progress, steps, callback) as show:
        if method == "adam":
            search.adam(show)
        else:
            search.bfgs(show)
    return Fit(
        problem.arrays(search.state.x),
        {key: _numbers(problem.params[key]) for key in problem.unknowns},
        list(search.state.losses),
        search.reason,
        search.state.halved,
        search.elapsed(),
        problem.unknowns,
    )


def _numbers(value: Any) -> np.ndarray:
    """Return a parameter of a scene as an array of float64."""
    return np.array(
        value.matrix if hasattr(value, "inverse_transpose") else value, dtype=np.float64
    )


def _images(
    scene: Any,
    targets: Any,
    objective: Any,
    integrator: Any,
    loss: Any,
    spp: int,
    views: int | None,
) -> Callable[[Any, int], Iterator[Any]]:
    """Return the function that yields the losses of a step, one by one."""
    mi = import_mitsuba()
    if (targets is None) == (objective is None):
        raise BezierError.expected(
            "targets, objective", "one of them", "none" if targets is None else "both"
        )
    if scene is None and objective is None:
        raise BezierError.expected("scene", "a scene that images are rendered of", "None")
    if objective is not None:

        def own(params: Any, seed: int) -> Iterator[Any]:
            yield objective(params, seed)

        return own
    if isinstance(loss, str):
        if loss not in LOSSES:
            raise BezierError.expected("loss", '"l2", "l1" or a function', repr(loss))
        loss = LOSSES[loss]
    if isinstance(integrator, str):
        integrator = {"type": integrator}
    if isinstance(integrator, Mapping):
        integrator = mi.load_dict(dict(integrator))
    items = targets.items() if isinstance(targets, Mapping) else enumerate(targets)
    wanted = {}
    for index, image in items:
        if not 0 <= index < len(scene.sensors()):
            raise BezierError.expected(
                "targets", f"images of sensors 0 to {len(scene.sensors()) - 1}", f"sensor {index}"
            )
        wanted[index] = image = mi.TensorXf(image)
        width, height = scene.sensors()[index].film().crop_size()
        if tuple(image.shape[:2]) != (height, width):
            raise BezierError.expected(
                f"targets[{index}]", f"{height} rows of {width} pixels", f"shape {image.shape}"
            )
        if not np.isfinite(np.array(image)).all():
            raise BezierError.expected(f"targets[{index}]", "finite numbers", "NaN or infinity")
    if not wanted:
        raise BezierError.expected("targets", "at least one image", "none")

    def rendered(params: Any, seed: int) -> Iterator[Any]:
        count = min(views or len(wanted), len(wanted))
        items = list(wanted.items())
        for i in range(count):
            index, target = items[(seed * count + i) % len(items)]
            base = 2 * (seed * count + i)
            image = mi.render(
                scene,
                params,
                integrator=integrator,
                sensor=index,
                spp=spp,
                seed=base % 2**32,
                seed_grad=(base + 1) % 2**32,
            )
            yield loss(image, target)

    return rendered


@contextmanager
def _display(
    progress: bool | None, steps: int, callback: Callable[[int, float], None] | None
) -> Iterator[Callable[[int, float], None]]:
    """Show step, loss and time left on stderr, and call who wants to know."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    shown = sys.stderr.isatty() if progress is None else progress
    bar = Progress(
        TextColumn("fit"),
        BarColumn(),
        TextColumn("{task.completed:.0f}/{task.total:.0f}"),
        TextColumn("loss {task.fields[loss]:.3e}"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        disable=not shown,
    )
    with bar:
        task = bar.add_task("fit", total=steps, loss=float("nan"))

        def show(step: int, loss: float) -> None:
            bar.update(task, completed=step, loss=loss)
            if callback is not None:
                callback(step, loss)

        yield show
