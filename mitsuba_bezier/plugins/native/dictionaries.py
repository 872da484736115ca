"""Nets, NumPy arrays and lists as values of scene dictionaries.

Mitsuba's `load_dict` takes tensors of Dr.Jit only. Here it also takes what people have, as
parameters of a `beziertriangle`: they become tensors on the way.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import wraps
from typing import Any

import mitsuba as mi
import numpy as np

from ... import errors
from ..._threads import thread_for_files
from ...errors import NetError
from ...geometry.fields import BezierField
from ...geometry.triangles import BezierTriangles
from ...geometry.trims import Trims
from ...io.trim_arrays import trims_to_numbers
from ..frozen import is_bezier

__all__ = ["install", "shape", "with_tensors"]

SHAPE = "beziertriangle"
SHAPES = (SHAPE, "asphere")
TEXTURE = "bezierfield"


def with_tensors(scene: Any) -> Any:
    """Return a scene dictionary whose nets are tensors; the given one if there is nothing to do.

    Parameters
    ----------
    scene : dict
        As for `mi.load_dict`, of any depth.

    Raises
    ------
    NetError
        If a list is not an array of numbers.
    """
    if not isinstance(scene, Mapping):
        return scene
    ours = scene.get("type") in (*SHAPES, TEXTURE)
    changed: dict[str, Any] = {}
    if scene.get("type") == TEXTURE and isinstance(field := scene.get("ordinates"), BezierField):
        changed["ordinates"] = _tensor("ordinates", field.ordinates)
        scene = {"field": field.name, **scene}
        if field.weights is not None:
            changed["weights"] = _tensor("weights", field.weights)
    for key, value in scene.items():
        if key in changed:
            continue
        if isinstance(value, Mapping):
            new = with_tensors(value)
        else:
            new = _value(key, value) if ours else value
        if new is not value:
            changed[key] = new
    return {**scene, **changed} if changed else scene


def _value(key: str, value: Any) -> Any:
    if key == "to_world" and isinstance(value, np.ndarray) and value.shape == (4, 4):
        return mi.ScalarTransform4f(value.tolist())
    return _tensor(key, value)


def _tensor(key: str, value: Any) -> Any:
    if isinstance(value, BezierTriangles):
        value = value.control_points
    if isinstance(value, Trims):
        value = trims_to_numbers(value)
    if not isinstance(value, (np.ndarray, list, tuple)):
        return value
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise NetError.expected(key, "an array of numbers", repr(value)[:80]) from None
    # Mitsuba takes three of anything for a point first, and complains on standard error
    three = key == "control_points" and array.ndim == 3 and len(array) == 3
    return mi.TensorXd(array.ravel(), shape=(1, *array.shape) if three else array.shape)


def _has_ours(scene: Any) -> bool:
    if not isinstance(scene, Mapping):
        return is_bezier(scene)
    return scene.get("type") in SHAPES or any(_has_ours(value) for value in scene.values())


def _plain(message: str) -> str | None:
    """Return what an error of ours says, without what Mitsuba's parser puts before it.

    That begins with an "unknown plugin", since the type of a plugin in Python is not known
    there, and holds a traceback. None if it is no error of ours.
    """
    found = re.search(r"^(?:\[\S+\] )?(At [^\n]*?): failed to instantiate [^\n]*Traceback", message)
    last = message.strip().splitlines()[-1]
    if found and re.match(rf"(?:{'|'.join(errors.__all__)}): ", last):
        return f"{found[1]}: {last}"
    return None


def install() -> None:
    """Let `mi.load_dict` take nets; once is enough."""
    own = getattr(mi, "load_dict", None)  # not there before a variant is set
    if own is None or getattr(own, "takes_nets", False):
        return

    @wraps(own)
    def load_dict(dict: Any, *args: Any, **kwargs: Any) -> Any:
        if not args and "optimize" not in kwargs and _has_ours(dict):
            # Mitsuba merges meshes in an order that differs from load to load, and with it the
            # numbers of emitters: equal seeds would give other images
            kwargs["optimize"] = False
        try:
            with thread_for_files():
                return own(with_tensors(dict), *args, **kwargs)
        except RuntimeError as error:
            message = _plain(str(error))
            if message is None:
                raise
            raise RuntimeError(message) from None

    load_dict.takes_nets = True  # type: ignore[attr-defined]
    mi.load_dict = load_dict


def shape(net: Any, **parameters: Any) -> dict[str, Any]:
    """Return the dictionary of a `beziertriangle`.

    Parameters
    ----------
    net : BezierTriangles, array ``(P, K, 4)``, or path
        The patches, their control points, or a file of them.
    **parameters
        Those of the shape: ``to_world``, ``bsdf``, ``emitter``, ``flip_normals``, ...

    Returns
    -------
    dict
        For `mi.load_dict`, by itself or in a scene.

    Examples
    --------
    >>> ball = shape(mb.sphere(), bsdf={"type": "dielectric"})
    >>> ball["type"]
    'beziertriangle'
    """
    from os import PathLike, fspath

    if isinstance(net, (str, PathLike)):
        return {"type": SHAPE, "filename": fspath(net), **parameters}
    return with_tensors({"type": SHAPE, "control_points": net, **parameters})
