"""Count the rooms of three walks: a net to its structure, a ray to the march, a file to its nets.

    python docs/walks.py [CHECKOUT] [--step FILE] [--show]

A walk is the functions of the package in the order in which they are first called. A *room* is a
module, a *stay* what is called there before another module is; *carried* is how many arguments a
function takes. `architecture.md` has the figures; another checkout is counted in the same way.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any


class Walk:
    """A profiler that writes down which functions are called, until `last` is."""

    def __init__(self, package: str, last: tuple[str, ...] = ()) -> None:
        self.package, self.last, self.steps = package, last, []  # type: ignore[var-annotated]
        self.seen: set[Any] = set()

    def __call__(self, frame: Any, event: str, _argument: Any) -> None:
        code = frame.f_code
        known = code in self.seen or not code.co_filename.startswith(self.package)
        if event != "call" or known or code.co_name.startswith("<"):
            return
        self.seen.add(code)
        room = code.co_filename[len(self.package) :]
        if room.startswith("_"):  # what the package does on its own: variants, LLVM, signals
            return
        taken = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]
        self.steps.append((room, code.co_name, sum(n not in ("self", "cls") for n in taken)))
        if code.co_name in self.last:
            sys.setprofile(None)

    def follow(self, title: str, walk: Callable[[], object], show: bool) -> None:
        """Take the walk and print its counts."""
        sys.setprofile(self)
        try:
            walk()
        finally:
            sys.setprofile(None)
        stays = [
            s[0]
            for s, before in zip(self.steps, [None, *self.steps])
            if s[0] != (before or [""])[0]
        ]
        carried = [count for _room, _name, count in self.steps]
        print(
            f"| {title} | {len(self.steps)} | {len(set(stays))} | {len(stays) - len(set(stays))} "
            f"| {sum(carried) / len(carried):.1f} | {sum(c > 6 for c in carried)} |"
        )
        if show:
            print("\n".join(f"    {room}: {name}({count})" for room, name, count in self.steps))


def main() -> None:
    """Take the walks."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("checkout", nargs="?", default=str(Path(__file__).parents[1]))
    parser.add_argument("--step", metavar="FILE", help="a STEP file to read, too (extra `cad`)")
    parser.add_argument("--show", action="store_true", help="print every step")
    args = parser.parse_args()
    sys.path.insert(0, os.path.abspath(args.checkout))
    import mitsuba_bezier as mb  # isort: skip (before Dr.Jit, for which it finds LLVM)
    import mitsuba as mi
    import numpy as np

    package = os.path.dirname(mb.__file__) + os.sep
    mi.set_variant("llvm_ad_rgb")
    net = np.asarray(mb.torus().control_points, dtype=np.float32)
    look_at = mi.ScalarTransform4f().look_at([0, -6, 1], [0, 0, 0], [0, 0, 1])
    film = {"type": "hdrfilm", "width": 8, "height": 8}
    torus = {"type": "beziertriangle", "control_points": mi.TensorXf(net.ravel(), net.shape)}
    scene: Any = {"type": "scene", "integrator": {"type": "bezierpath"}, "torus": torus}
    scene["eye"] = {"type": "perspective", "to_world": look_at, "film": film}
    loaded = []

    def build() -> None:
        loaded.append(mi.load_dict(scene))
        mb.ray_intersect(loaded[0], mi.Ray3f([0, -6, 1], [0, 1, 0]))

    print("| walk | functions | rooms | returns | carried | more than six |")
    print("| --- | ---: | ---: | ---: | ---: | ---: |")
    Walk(package, ("intersect",)).follow("a net", build, args.show)
    march = ("march", "_march")
    Walk(package, march).follow("a ray", lambda: mi.render(loaded[0], spp=1), args.show)
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "sphere.vtu")
        if hasattr(mb, "save"):
            mb.save(mb.sphere(), path)
        else:  # before 0.2
            mb.sphere().save(path)  # type: ignore[attr-defined]
        Walk(package).follow("a file, `.vtu`", lambda: mb.load(path), args.show)
    if args.step:
        try:
            from mitsuba_bezier.io.cad import opencascade as cad
        except ImportError:  # before 0.2
            from mitsuba_bezier.io import cad  # type: ignore[no-redef]
        Walk(package).follow("a file, STEP", lambda: cad.read_here(args.step, False), args.show)


if __name__ == "__main__":
    main()
