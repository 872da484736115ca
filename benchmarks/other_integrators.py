"""An integrator that nobody here wrote: mitransient's transient path tracer on a Bézier sphere.

    pip install mitransient && python benchmarks/other_integrators.py

Renders a ball over a floor, once with Mitsuba's sphere and once with patches, and compares the
steady image and the histogram over path lengths.
"""

from __future__ import annotations

from typing import Any

import mitsuba_bezier as mb

import mitsuba as mi  # isort: skip
import numpy as np


def scene(ball: Any) -> Any:
    """Return the scene with this ball."""
    place = mi.ScalarTransform4f()
    film = {"type": "transient_hdr_film", "width": 64, "height": 64, "rfilter": {"type": "box"}}
    film |= {"temporal_bins": 60, "start_opl": 3.0, "bin_width_opl": 0.15}
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "transient_path", "max_depth": 4},
            "sensor": {
                "type": "perspective",
                "fov": 40,
                "to_world": place.look_at([0, -4, 1], [0, 0, 0], [0, 0, 1]),
                "film": film,
            },
            "lamp": {
                "type": "rectangle",
                "to_world": place.translate([0, -2, 3]).rotate([1, 0, 0], 180).scale(0.5),
                "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 9.0}},
            },
            "floor": {"type": "rectangle", "to_world": place.translate([0, 0, -1]).scale(3)},
            "ball": ball,
        }
    )


def main() -> int:
    """Print the figures; return 1 if the two differ by more than noise explains."""
    mi.set_variant("llvm_ad_rgb")
    import mitransient

    print(f"mitransient {mitransient.__version__}, Mitsuba {mi.__version__}")
    shapes = {"native": {"type": "sphere"}, "patches": mb.shape(mb.sphere())}
    batches = 8
    found = {}
    for name, ball in shapes.items():
        own = scene(ball)
        renders = [
            mi.render(own, spp=256, seed=k + 100 * (name != "native")) for k in range(batches)
        ]
        steady = np.array([float(np.array(r[0]).mean()) for r in renders])
        bins = np.array([np.array(r[1]).sum(axis=(0, 1, 3)) for r in renders])
        found[name] = steady, bins
        print(f"{name:8s} steady {steady.mean():.6f} +- {steady.std() / batches**0.5:.1e}")
    (_a, t), (_b, u) = found.values()
    error = np.sqrt((t.var(axis=0, ddof=1) + u.var(axis=0, ddof=1)) / batches)
    lit = t.mean(axis=0) > 0.01 * t.mean(axis=0).max()
    z = np.abs(t.mean(axis=0) - u.mean(axis=0))[lit] / error[lit]
    print(f"path lengths: {lit.sum()} bins with light, at most {z.max():.1f} standard errors apart")
    # Student's distribution with 14 degrees of freedom and some 40 bins: 5 is one in 200
    return int(z.max() > 5)


if __name__ == "__main__":
    raise SystemExit(main())
