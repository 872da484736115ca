"""Try an installed package: ``python tests/smoke.py``, in a fresh environment, from any folder.

It needs no more than the wheel and what that depends on; pytest does not collect it.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path

import numpy as np


def main() -> None:
    """Import, trace, render, and run the program."""
    import mitsuba_bezier as mb

    assert (files("mitsuba_bezier") / "py.typed").is_file()
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    scene = mi.load_dict(mb.scene(mb.sphere(), size=(16, 16), spp=4))
    image = np.array(mi.render(scene))
    assert image.shape[:2] == (16, 16) and np.isfinite(image).all() and image[..., :3].std() > 0.01
    hit = scene.ray_intersect(mi.Ray3f([0, -5, 0], [0, 1, 0]))
    assert abs(float(np.asarray(hit.t).ravel()[0]) - 4) < 1e-5  # rounding of float32 at 5
    with tempfile.TemporaryDirectory() as folder:
        net = Path(folder) / "torus.vtu"
        mb.save(mb.torus(), net)
        program = [sys.executable, "-m", "mitsuba_bezier.cli.main"]
        subprocess.run([*program, "info", str(net)], check=True)
        subprocess.run(
            [*program, "render", str(net), "--size", "16x16", "--spp", "2", "-q"], check=True
        )
        assert net.with_suffix(".exr").is_file()
        subprocess.run([*program, "doctor"], check=True)
    print(f"mitsuba-bezier {version('mitsuba-bezier')}, Python {sys.version.split()[0]}: works")


if __name__ == "__main__":
    main()
