"""Render the pictures of the site's pages again: ``python docs/pictures.py [NAME ...]``.

Each is what the code of its page makes, larger and without noise (the extra ``[denoise]``).
"""

from __future__ import annotations

import io
import re
import sys
import tempfile
from contextlib import chdir
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).parent
PICTURES = HERE / "pictures"
WIDTH = 1600


def page_code(page: str, upto: int | None = None) -> dict[str, Any]:
    """Run the code of a page with few samples, and return its names."""
    text = (HERE / page).read_text(encoding="utf-8")
    namespace: dict[str, Any] = {"__name__": "__page__"}
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        for block in re.findall(r"^```python\n(.*?)^```$", text, re.S | re.M)[:upto]:
            exec(re.sub(r"spp=\d+", "spp=1", block), namespace)
    return namespace


def save(name: str, image: Any, limit: int = 300_000) -> None:
    """Write linear colours as a WebP file below a number of bytes."""
    import mitsuba as mi
    from PIL import Image

    bitmap = mi.Bitmap(np.ascontiguousarray(image[..., :3], np.float32))
    shown = bitmap.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.UInt8, srgb_gamma=True)
    picture = Image.fromarray(np.array(shown))
    PICTURES.mkdir(exist_ok=True)
    for quality in (90, 85, 80, 75, 70, 60):
        data = io.BytesIO()
        picture.save(data, "WEBP", quality=quality, method=6)
        if data.tell() < limit:
            break
    (PICTURES / f"{name}.webp").write_bytes(data.getvalue())
    print(f"{name}.webp: {picture.size}, {data.tell() / 1000:.0f} kB")


def render(scene: dict[str, Any], spp: int, width: int = WIDTH) -> np.ndarray:
    """Render a scene dictionary at a width, and denoise it."""
    import mitsuba as mi

    import mitsuba_bezier as mb

    (key,) = (k for k, v in scene.items() if isinstance(v, dict) and "film" in v)
    film = dict(scene[key]["film"])
    height = round(width * film["height"] / film["width"])
    film |= {"width": width, "height": height, "rfilter": {"type": "box"}}
    loaded = mi.load_dict({**scene, key: {**scene[key], "film": film}})
    passes = [np.array(mi.render(loaded, spp=16, seed=i)) for i in range(max(1, spp // 16))]
    aovs = mi.load_dict({"type": "bezieraov", "aovs": "albedo:albedo,normal:sh_normal"})
    guides = np.array(mi.render(loaded, integrator=aovs, spp=32, seed=1))
    image = np.mean(passes, axis=0)[..., :3].astype(np.float32)
    return np.asarray(mb.denoise(image, guides[..., -6:]))


def quickstart() -> None:
    """The ring of the quick start."""
    save("quickstart", render(page_code("quickstart.md", 3)["scene"], 96))


PAGES = {"quickstart": quickstart}


def main() -> None:
    """Run the command."""
    for name in sys.argv[1:] or PAGES:
        PAGES[name]()


if __name__ == "__main__":
    main()
