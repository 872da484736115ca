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
        The loss of each step: by Adam before it was taken, by L-BFGS where it led to.
    reason : str
        Why the search ended: "steps", "converged", or what went wrong.
    halved : int
        How many steps were halved, since the net they led to was not valid.
    seconds : float
        Time, with that of earlier runs of the same checkpoint.
    parametrizations : dict of str to Parametrization
        The last ones, refined.

    Examples
    --------
    >>> import mitsuba as mi
    >>> mi.set_variant("llvm_ad_rgb")
    >>> from mitsuba_bezier import fit
    >>> def away(params, seed):
    ...     return (params["x"].array - 3) ** 2
    >>> found = fit.minimize(None, {"x": fit.Values([0.0])}, objective=away, method="l-bfgs")
    >>> found.values["x"].round(6).tolist(), found.reason
    ([3.0], 'converged')
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
        from it. One by Adam ends where an uninterrupted one does, but for the order in which
        threads add; L-BFGS learns curvatures anew.
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
        checkpoint keep the last state that was good. At the first step that is halved. If a
        checkpoint cannot be written, without which the search goes on.

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
    if "_ad_" not in (variant := import_mitsuba().variant() or "none"):
        raise BezierError.expected("variant", "one with derivatives (llvm_ad_rgb)", variant)
    if not isinstance(unknowns, Mapping):
        raise BezierError.expected(
            "unknowns", "a dict of names to parametrizations", type(unknowns).__name__
        )
    for at, how in (refine or {}).items():
        if not isinstance(at, (int, np.integer)) or at < 0 or how not in ("elevate", "split"):
            raise BezierError.expected(
                "refine", 'steps with "elevate" or "split" each', f"{at!r}: {how!r}"
            )
    if refine and method != "adam":
        raise BezierError.expected("refine", 'none with method "l-bfgs"', refine)
    if refine and not any(getattr(item, "can_refine", False) for item in unknowns.values()):
        raise BezierError.expected("refine", "an unknown Net among the parameters", "none")
    for name, number in (("steps", steps), ("spp", spp)):
        if isinstance(number, bool) or not isinstance(number, (int, np.integer)) or number < 1:
            raise BezierError.expected(name, "a whole number above zero", repr(number))
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)):
        raise BezierError.expected("seed", "a whole number", repr(seed))
    for name, real in (("rate", rate), ("every", every)):
        if not isinstance(real, (int, float, np.number)) or not 0 < real < np.inf:
            raise BezierError.expected(name, "a number above zero", repr(real))
    if not isinstance(smoothing, (int, float, np.number)) or not 0 <= smoothing < np.inf:
        raise BezierError.expected("smoothing", "zero or more", repr(smoothing))
    if views is not None and (
        method != "adam" or not isinstance(views, (int, np.integer)) or views < 1
    ):
        raise BezierError.expected("views", 'one or more, and method "adam"', views)
    if scene is not None and not isinstance(scene, import_mitsuba().Scene):
        raise BezierError.expected("scene", "a scene of mi.load_dict", type(scene).__name__)
    if checkpoint is not None and not isinstance(checkpoint, (str, os.PathLike)):
        raise BezierError.expected("checkpoint", "the name of a file", repr(checkpoint))
    for name, function in (("objective", objective), ("callback", callback)):
        if function is not None and not callable(function):
            raise BezierError.expected(name, "a function", repr(function))
    images, wanted = _images(scene, targets, objective, integrator, loss, spp, views)
    problem = Problem(scene, unknowns, images, terms, smoothing, wanted)
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
) -> tuple[Callable[[Any, int], Iterator[Any]], np.ndarray | None]:
    """Return the function that yields the losses of a step, one by one, and small targets."""
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

        return own, None
    if isinstance(loss, str):
        if loss not in LOSSES:
            raise BezierError.expected("loss", '"l2", "l1" or a function', repr(loss))
        loss, plain = LOSSES[loss], True
    elif not callable(loss):
        raise BezierError.expected("loss", '"l2", "l1" or a function', repr(loss))
    else:
        plain = False
    integrator = _integrator(integrator)
    if not isinstance(targets, (Mapping, list, tuple)):
        got = f"shape {targets.shape}" if hasattr(targets, "shape") else type(targets).__name__
        if not (hasattr(targets, "ndim") and targets.ndim == 4):
            raise BezierError.expected("targets", "a list of images, or a dict", got)
    items = targets.items() if isinstance(targets, Mapping) else enumerate(targets)
    wanted = {}
    for index, image in items:
        if not isinstance(index, (int, np.integer)) or not 0 <= index < len(scene.sensors()):
            raise BezierError.expected(
                "targets", f"images of sensors 0 to {len(scene.sensors()) - 1}", f"sensor {index}"
            )
        if not isinstance(image, mi.TensorXf):
            # Dr.Jit does not come back from a name of a file
            numbers = np.asarray(image)
            if numbers.dtype.kind not in "fiub" or numbers.ndim < 2:
                raise BezierError.expected(
                    f"targets[{index}]", "an image (rows, columns, channels)", repr(image)[:60]
                )
            image = mi.TensorXf(numbers.astype(np.float32))
        wanted[index] = image
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
            if plain and tuple(image.shape) != tuple(target.shape):
                raise BezierError.expected(
                    f"targets[{index}]", f"shape {tuple(image.shape)}", tuple(target.shape)
                )
            yield loss(image, target)

    return rendered, np.concatenate([_small(image) for image in wanted.values()])


def _integrator(given: Any) -> Any:
    """Return the integrator that is named or described."""
    mi = import_mitsuba()
    if isinstance(given, str):
        given = {"type": given}
    if isinstance(given, Mapping):
        try:
            given = mi.load_dict(dict(given))
        except RuntimeError as error:
            last = str(error).strip().split("\n")[-1].strip()
            raise BezierError.expected("integrator", "one of Mitsuba's or ours", last) from None
    if not isinstance(given, mi.Integrator):
        raise BezierError.expected("integrator", "a name, dict or integrator", repr(given))
    return given


def _small(image: Any) -> np.ndarray:
    """Return an image of at most 8 x 8 means, as one row of numbers."""
    values = np.array(image, dtype=np.float64)
    values = values.reshape(*values.shape[:2], -1).mean(axis=2)
    for axis in (0, 1):
        parts = np.array_split(values, min(8, values.shape[axis]), axis=axis)
        values = np.stack([part.mean(axis=axis) for part in parts], axis=axis)
    return values.ravel()


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
