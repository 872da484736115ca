"""
A part, cut open
================

A valve body as a CAD system wrote it, faces trimmed by curves, cut by a plane. Nothing is made into triangles.
"""

from pathlib import Path

import mitsuba as mi
import mitsuba_bezier as mb

mi.set_variant("llvm_ad_rgb")

# %%
# Any file will do that ``mitsuba-bezier convert`` reads; this one comes with the package.

here = Path.cwd().resolve()
root = next(p for p in (here, *here.parents) if (p / "scenes" / "models").is_dir())
part = root / "scenes" / "models" / "cad_part.vtu"
scene = mb.scene(part, section="y<50%", view="155,25", size=(640, 420), spp=64)
mi.util.write_bitmap("section.png", mi.render(mi.load_dict(scene)), write_async=False)
