"""The frames of a film of models, each of which whoever has the models can make by itself."""

from __future__ import annotations

import argparse
from typing import Any

from . import _model

__all__ = ["FRAMES", "Film"]

#: Frames of a weight that runs, by default.
FRAMES = 48


class Film:
    """The frames of a film, from the arguments of ``render``.

    Attributes
    ----------
    notes : list of str
        What the user is told.
    """

    def __init__(self, args: argparse.Namespace) -> None:
        self._args, self._prepared = args, _model.prepared(args)
        self._made = _frames(args, self._prepared)
        self.notes = self._prepared.notes

    def __len__(self) -> int:
        return len(self._made)

    def digest(self, number: int) -> str:
        """Return the fingerprint of a frame."""
        more = {"frame": f"{number} of {len(self)}"}
        return _model.digest_of(self._args, self._prepared, more)

    def load(self, number: int) -> Any:
        """Return the scene of a frame, as `_scene.load` does."""
        from ..models.scene import describe

        frame, found = self._made[number], self._prepared
        node = describe(frame.models, frame.look, found.appearance, None, frame.framing)
        return _model.loaded(self._args, found, node, self.digest(number))


def _frames(args: argparse.Namespace, prepared: _model.Prepared) -> list[Any]:
    from ..models import frames

    models, look = prepared.models, prepared.look
    if args.turntable is not None:
        return frames.turntable(models, look, args.turntable)
    if args.animate is not None:
        wish = frames.read_animation(args.animate)
        return frames.animated(models, look, wish, args.frames or FRAMES)
    return frames.steps(models, look)
