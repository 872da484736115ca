"""How long the first frame of a drag in the studio takes, phase by phase.

    python benchmarks/studio_latency.py [--size 512x384] [--rounds 30]

A control point is moved by a small step and the picture that a browser would get is made: the net
goes to the scene, its leaves are built, rays are traced and shaded, lines before the picture are
made, bytes are encoded as JPEG. Prints the median over the rounds of wall time and of processor
time (of all threads), in milliseconds. The issue asks for 100 ms of wall time at 512 x 384 for one
patch on two idle cores.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from typing import Any

import mitsuba_bezier  # isort: skip  (first: it finds the LLVM that Mitsuba needs)
import imageio.v3
import mitsuba as mi
import numpy as np

from mitsuba_bezier.geometry.camera import Camera, look_at
from mitsuba_bezier.studio.front import front_of
from mitsuba_bezier.studio.picture import MODES, Painter
from mitsuba_bezier.studio.presets import PRESETS
from mitsuba_bezier.studio.state import State

#: Figures that are measured: of degree 2, 3 and 4.
NAMES = ("rational_triangle", "sphere_point", "triangle_net", "octant")


def encoded(image: np.ndarray) -> bytes:
    """Encode a picture, by what viser takes if there is no OpenCV."""
    return bytes(imageio.v3.imwrite("<bytes>", image, extension=".jpeg", quality=80))


def measured(name: str, mode: str, size: tuple[int, int], rounds: int) -> dict[str, Any]:
    """Return the median times of the phases of a frame, wall and processor, in milliseconds."""
    look = PRESETS[name]
    state = State(look())
    low, high = state.places.min(axis=0), state.places.max(axis=0)
    middle, reach = (low + high) / 2, float((high - low).max())
    eye = middle + reach * np.array([0.9, -1.6, 0.9])
    camera = Camera(look_at(eye, middle, [0, 0, 1]), 40, "y", size)
    painter = Painter(state.patches)
    times: dict[str, list[tuple[float, float]]] = {}

    def phase(what: str, action: Callable[[], Any]) -> Any:
        wall, cpu = time.perf_counter(), time.process_time()
        out = action()
        times.setdefault(what, []).append((time.perf_counter() - wall, time.process_time() - cpu))
        return out

    for k in range(rounds + 3):
        if k == 3:
            times.clear()  # kernels are compiled
        step = 0.02 * reach * np.array([np.sin(k), np.cos(k), 0])
        phase("move the point", lambda: state.move(look.row, state.places[look.row] + step, False))  # noqa: B023
        phase("lines in front", lambda: front_of(state, look.shows))
        phase("net to the scene", lambda: painter.show(state.patches))
        image = phase("rays and shading", lambda: painter.paint(camera, mode))
        phase("JPEG", lambda: encoded(image))  # noqa: B023
    total = [tuple(sum(x) for x in zip(*row)) for row in zip(*times.values())]
    times["all"] = total  # type: ignore[assignment]
    return {
        what: tuple(1000 * statistics.median(x) for x in zip(*rows)) for what, rows in times.items()
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", default="512x384", help="pixels (default: 512x384)")
    parser.add_argument("--rounds", type=int, default=30)
    parser.add_argument("-m", "--mode", default="llvm_ad_rgb", help="variant of Mitsuba")
    args = parser.parse_args()
    width, height = (int(x) for x in args.size.split("x"))
    mi.set_variant(args.mode)
    print(f"{mitsuba_bezier.__version__}, {args.mode}, {width} x {height}, medians of "
          f"{args.rounds} frames, ms: wall, processor")  # fmt: skip
    for name in NAMES:
        for mode in MODES:
            found = measured(name, mode, (width, height), args.rounds)
            parts = [f"{what} {wall:.1f}, {cpu:.1f}" for what, (wall, cpu) in found.items()]
            print(f"{name:18s} {mode:8s} {'; '.join(parts)}", flush=True)


if __name__ == "__main__":
    main()
