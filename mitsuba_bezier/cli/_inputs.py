"""Load what ``render`` is to render: a scene, or models with a scene around them."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ..errors import BezierError
from . import _model, _scene

__all__ = ["chosen_sensor", "load"]


def load(args: argparse.Namespace, variant: str) -> _scene.Loaded:
    """Return the scene of the arguments of ``render``, see `_scene.load`."""
    if _model.is_model(args.scene):
        loaded: _scene.Loaded = _model.load(args)
        return loaded
    return _scene.load(
        Path(args.scene), variant, dict(args.define), args.append, args.allow_plugins, args.denoise
    )


def chosen_sensor(scene: Any, index: int) -> Any:
    """Return a sensor of a scene."""
    sensors = scene.sensors()
    if index >= len(sensors):
        expected = f"a number below {len(sensors)}" if sensors else "a scene with a sensor"
        raise BezierError.expected("--sensor", expected, index if sensors else "none")
    return sensors[index]
