"""Frames of a film, or a series of pictures, by the same machinery as one picture.

A frame that is there is not rendered again, one that was interrupted goes on, and all are rendered
by the same workers, if there are any: whatever ends the command, it is just given again.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable
from contextlib import nullcontext
from pathlib import Path

from . import _inputs, _many, _passes

__all__ = ["render_frames"]


def render_frames(
    frames: Iterable[tuple[argparse.Namespace, Path]],
    variant: str,
    say: Callable[[str], None],
) -> list[Path]:
    """Render frames that are not there yet.

    Parameters
    ----------
    frames : iterable of (argparse.Namespace, Path)
        For each frame the arguments of ``render``, from `main.parse`, and the EXR file. All have
        the same ``workers`` and ``scheduler``; what differs may be models, views, defines, seeds.
    variant : str
        The variant that is set.
    say : callable
        Tells the user something.

    Returns
    -------
    list of Path
        The files of all frames, in their order.
    """
    todo = list(frames)
    if not todo:
        return []
    first = todo[0][0]
    many = first.workers or first.scheduler
    with _many.connected(first) if many else nullcontext() as client:
        for number, (args, output) in enumerate(todo, 1):
            loaded = _inputs.load(args, variant)
            sensor = _inputs.chosen_sensor(loaded.scene, args.sensor)
            shot = _passes.Shot(args, loaded, sensor, variant, output)
            if not args.fresh and shot.finished():
                say(f"mitsuba-bezier: frame {number} of {len(todo)} is there")
                continue
            say(f"mitsuba-bezier: frame {number} of {len(todo)}")
            _passes.render(shot, say, client)
    return [output for _args, output in todo]
