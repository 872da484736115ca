"""Load what ``render`` is to render: a scene, or models with a scene around them."""

from __future__ import annotations

import argparse
from pathlib import Path

from . import _model, _scene

__all__ = ["load"]


def load(args: argparse.Namespace, variant: str) -> _scene.Loaded:
    """Return the scene of the arguments of ``render``, see `_scene.load`."""
    if _model.is_model(args.scene):
        loaded: _scene.Loaded = _model.load(args)
        return loaded
    return _scene.load(
        Path(args.scene), variant, dict(args.define), args.append, args.allow_plugins, args.denoise
    )
