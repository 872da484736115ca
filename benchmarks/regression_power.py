"""How often the fixture is red without a change, and how small a change it finds.

    python benchmarks/regression_power.py                    # the table of docs/regression.md
    python benchmarks/regression_power.py --seeds 20 --runs 10 --scenes matte

Six scenes of 48 x 32 pixels and 16 samples, with the default limits: the Z-test against a reference
of 32 other seeds. *False red*: how many of `--seeds` renders of the unchanged scene fail. *Power*:
the smallest change of a colour (of its reflectance), a roughness, a position (in radii of the ball,
and pixels) that fails in 95 % of `--runs` renders, by bisection. Times are processor times.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mitsuba_bezier as mb

WIDTH, HEIGHT, SPP = 48, 32, 16
POWER = 0.95


def look(fov: float = 40.0) -> dict[str, Any]:
    import mitsuba as mi

    return {
        "type": "perspective",
        "fov": fov,
        "to_world": mi.ScalarTransform4f().look_at([0, -6, 2.2], [0, 0, 0.9], [0, 0, 1]),
        "film": {
            "type": "hdrfilm",
            "width": WIDTH,
            "height": HEIGHT,
            "rfilter": {"type": "box"},
        },
        "sampler": {"type": "independent", "sample_count": SPP},
    }


def base(ball: dict[str, Any], **more: Any) -> dict[str, Any]:
    """Return a ball on a floor below a lamp and a sky."""
    import mitsuba as mi

    at = mi.ScalarTransform4f
    floor = {"type": "rectangle", "to_world": at().scale(20)}
    lamp = {"type": "rectangle", "to_world": at().look_at([3, -3, 5], [0, 0, 0], [0, 0, 1])}
    lamp["emitter"] = {"type": "area", "radiance": {"type": "rgb", "value": 12.0}}
    path = {"type": "path", "max_depth": 6}
    sky = {"type": "constant", "radiance": {"type": "rgb", "value": 0.4}}
    scene = {"type": "scene", "integrator": path, "sensor": look(), "floor": floor}
    return scene | {"lamp": lamp, "sky": sky, "ball": ball} | more


def sphere(x: float, bsdf: dict[str, Any]) -> dict[str, Any]:
    return {"type": "sphere", "center": [x, 0, 1], "radius": 1.0, "bsdf": bsdf}


def rgb(value: float) -> dict[str, Any]:
    return {"type": "rgb", "value": [value, 0.3, 0.2]}


def matte(color: float, rough: float, x: float) -> dict[str, Any]:
    return base(sphere(x, {"type": "diffuse", "reflectance": rgb(color)}))


def plastic(color: float, rough: float, x: float) -> dict[str, Any]:
    bsdf = {"type": "roughplastic", "alpha": rough, "diffuse_reflectance": rgb(color)}
    return base(sphere(x, bsdf))


def metal(color: float, rough: float, x: float) -> dict[str, Any]:
    bsdf = {"type": "roughconductor", "alpha": rough, "specular_reflectance": rgb(color)}
    return base(sphere(x, bsdf))


def glass(color: float, rough: float, x: float) -> dict[str, Any]:
    bsdf = {"type": "roughdielectric", "alpha": rough, "specular_transmittance": rgb(color)}
    return base(sphere(x, bsdf))


def box(color: float, rough: float, x: float) -> dict[str, Any]:
    """A ball in a corner of three walls, most of whose light comes from other walls."""
    import mitsuba as mi

    at = mi.ScalarTransform4f
    wall = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.7, 0.7, 0.7]}}
    back = at().translate([0, 2.5, 0]).rotate([1, 0, 0], 90).scale(6)
    side = at().translate([-2.5, 0, 0]).rotate([0, 1, 0], 90).scale(6)
    walls = {
        "back": {"type": "rectangle", "to_world": back, "bsdf": wall},
        "side": {"type": "rectangle", "to_world": side, "bsdf": wall},
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": 0.02}},
    }
    bsdf = {"type": "roughplastic", "alpha": rough, "diffuse_reflectance": rgb(color)}
    return base(sphere(x, bsdf), **walls)


def torus(color: float, rough: float, x: float) -> dict[str, Any]:
    bsdf = {"type": "roughplastic", "alpha": rough, "diffuse_reflectance": rgb(color)}
    return base(mb.shape(mb.torus((x, 0, 0.6), 1.2, tube=0.5), bsdf=bsdf))


Scene = Callable[[float, float, float], dict[str, Any]]
SCENES: dict[str, Scene] = {f.__name__: f for f in (matte, plastic, metal, glass, box, torus)}
#: The unchanged scene: reflectance of red, roughness, position; and the largest change tried.
START = {"colour": 0.4, "roughness": 0.2, "position": 0.0}
LARGEST = {"colour": 0.5, "roughness": 0.6, "position": 1.0}
#: A radius of the ball in pixels: 6.14 from the eye, 40 degrees across the width.
PIXELS = WIDTH / 2 / 0.36397 / 6.14


class Trial:
    """A scene with its reference."""

    def __init__(self, make: Scene) -> None:
        self._make = make
        self._reference, _first = self._shot({}).render_reference(32, "", {})

    def _shot(self, change: dict[str, float]) -> Any:
        from mitsuba_bezier.regression.shot import Shot

        values = [START[key] + change.get(key, 0.0) for key in START]
        return Shot(self._make(*values))

    def red(self, change: dict[str, float], seeds: range, enough: int | None = None) -> int:
        """Return how many of the renders fail, or stop when more than `enough` do not."""
        from mitsuba_bezier.verification.comparison import compare_images
        from mitsuba_bezier.verification.thresholds import Thresholds

        shot, limits, count = self._shot(change), Thresholds(), 0
        for done, seed in enumerate(seeds):
            test = shot.render(seed)
            found = compare_images(self._reference, test, limits, "x", with_flip=False)
            count += found.state == "fail"
            if enough is not None and done + 1 - count > enough:
                break
        return count

    def smallest(self, key: str, runs: int) -> float | None:
        """Return the smallest change that is found, to 6 %; None if the largest is not."""
        seeds = range(10_000, 10_000 + runs)
        missed = int(runs * (1 - POWER))

        def found(size: float) -> bool:
            return self.red({key: size}, seeds, missed) >= runs - missed

        high = LARGEST[key]
        if not found(high):
            return None
        low = high / 2
        while found(low) and low > 1e-4:
            high, low = low, low / 2
        for _ in range(3):  # a sixteenth of an octave
            middle = (low * high) ** 0.5
            low, high = (low, middle) if found(middle) else (middle, high)
        return high


def main() -> int:
    """Measure, print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--runs", type=int, default=40)
    parser.add_argument("--scenes", nargs="*", choices=SCENES, default=list(SCENES))
    parser.add_argument("--variant", default="llvm_ad_rgb")
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    import mitsuba as mi

    mi.set_variant(args.variant)
    rows, red = [], 0
    print(f"| scene | false red of {args.seeds} | colour | roughness | position | seconds |")
    print("| --- | --- | --- | --- | --- | --- |", flush=True)
    for name in args.scenes:
        started = time.process_time()
        trial = Trial(SCENES[name])
        false = trial.red({}, range(args.seeds))
        red += false
        sizes = {
            key: trial.smallest(key, args.runs)
            for key in START
            if (name, key) != ("matte", "roughness")
        }
        row = {"scene": name, "false red": false, "seconds": time.process_time() - started, **sizes}
        rows.append(row)
        cells = [name, str(false)]
        for key in START:
            size = sizes.get(key)
            text = "" if key not in sizes else "none" if size is None else f"{size:.3g}"
            if size is not None and key == "position":
                text += f" ({size * PIXELS:.2g} px)"
            cells.append(text)
        print("| " + " | ".join([*cells, f"{row['seconds']:.0f}"]) + " |", flush=True)
    total = args.seeds * len(rows)
    print(f"false red: {red} of {total}, {100 * red / total:.2f} %")
    if args.json:
        args.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    return 0 if red < 0.005 * total else 1


if __name__ == "__main__":
    sys.exit(main())
