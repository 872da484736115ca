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


def small(shape: dict[str, Any], **more: Any) -> dict[str, Any]:
    """Return a scene with one shape on a floor, for a small picture."""
    import mitsuba as mi

    look_at = mi.ScalarTransform4f().look_at
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 6},
        "eye": {
            "type": "perspective",
            "fov": 29,
            "to_world": look_at([3, -6, 3.4], [0, 0, 0.85], [0, 0, 1]),
            "film": {"type": "hdrfilm", "width": 480, "height": 340},
        },
        "sky": {"type": "constant", "radiance": 0.55},
        "lamp": {
            "type": "rectangle",
            "to_world": look_at([-4, -4, 7], [0, 0, 0.5], [0, 0, 1]).scale(1.5),
            "emitter": {"type": "area", "radiance": 8.0},
        },
        "floor": {"type": "disk", "to_world": mi.ScalarTransform4f().scale(40)},
        "shape": shape,
        **more,
    }


def parameters() -> None:
    """A small picture for each parameter of a plugin that can be seen."""
    import mitsuba as mi

    import mitsuba_bezier as mb
    from mitsuba_bezier.geometry.bernstein import multi_indices

    mi.set_variant("llvm_ad_rgb")
    rng = np.random.default_rng(1)

    def paint(colour: Any, kind: str = "plastic") -> dict[str, Any]:
        key = "diffuse_reflectance" if kind == "plastic" else "reflectance"
        return {"type": kind, key: colour}

    def rgb(*value: float) -> dict[str, Any]:
        return {"type": "rgb", "value": list(value)}

    blue = paint(rgb(0.06, 0.25, 0.45))
    ball, can = mb.sphere((0, 0, 1)), mb.cylinder((0, 0, 0), 0.9, 1.5)
    heavy = ball.control_points.copy()
    heavy[:, [4, 7, 8]] *= 4.0  # the weights inside of each octant
    maps = np.zeros((40, 3, 4))
    maps[:, :, :3] = 0.16 * np.linalg.qr(rng.normal(size=(40, 3, 3)))[0]
    maps[:, :, 3] = rng.uniform([-1.4, -1.4, 0.2], [1.4, 1.4, 1.6], (40, 3))
    board = {"type": "checkerboard", "to_uv": mi.ScalarTransform4f().scale(4)}
    rings = {"type": "checkerboard", "to_uv": mi.ScalarTransform4f().scale([16, 8, 1])}
    corners = np.tile([[1, 0], [0, 1], [0, 0]], (len(ball), 1, 1))
    faces = mi.TensorXf(rng.uniform(0.05, 0.8, (len(ball), 3)))
    points = mi.TensorXf(rng.uniform(0.02, 0.9, (len(ball), 3, 3)))

    def attribute(name: str) -> dict[str, Any]:
        return paint({"type": "mesh_attribute", "name": name}, "diffuse")

    uv = multi_indices(3)[:, :2] / 3
    height = np.stack([ball.points(np.full(10, p), uv) for p in range(len(ball))])
    wave = (np.sin(3 * height[..., 0]) + height[..., 2])[..., None]
    camera = mb.Camera(
        np.array(mi.ScalarTransform4f().look_at([3, -6, 3.4], [0, 0, 0.85], [0, 0, 1]).matrix),
        fov=29,
        film_size=(480, 340),
    )
    pixels = " ".join(f"{x:.17g}" for x in camera.matrix.ravel())

    def field(**look: Any) -> dict[str, Any]:
        return mb.shape(
            ball,
            bsdf=paint({"type": "bezierfield", "ordinates": mi.TensorXf(wave), **look}, "diffuse"),
        )

    white = {"type": "twosided", "bsdf": paint(rgb(0.6, 0.3, 0.05))}
    shown = {
        "beziertriangle-control_points": mb.shape(mi.TensorXf(heavy), bsdf=blue),
        "beziertriangle-to_world": mb.shape(
            ball, bsdf=blue, to_world=mi.ScalarTransform4f().scale([1.3, 0.5, 0.7])
        ),
        "beziertriangle-instances": mb.shape(mb.torus(), bsdf=blue, instances=mi.TensorXf(maps)),
        "beziertriangle-section": mb.shape(ball, bsdf=white, section="0.4 -1 0.3 0.7"),
        "beziertriangle-flip_normals": mb.shape(can, bsdf=blue, flip_normals=True),
        "beziertriangle-texcoords": mb.shape(
            ball, bsdf=paint(board, "diffuse"), texcoords=mi.TensorXf(corners)
        ),
        "beziertriangle-uv": mb.shape(
            mb.sphere(),
            bsdf=paint(rings, "diffuse"),
            uv="spherical",
            to_world=mi.ScalarTransform4f().translate([0, 0, 1]),
        ),
        "beziertriangle-face_NAME": mb.shape(ball, bsdf=attribute("face_color"), face_color=faces),
        "beziertriangle-vertex_NAME": mb.shape(
            ball, bsdf=attribute("vertex_color"), vertex_color=points
        ),
        "bezierfield-colormap": field(colormap="coolwarm"),
        "bezierfield-levels": field(levels=8),
        "bezierfield-isolines": field(isolines=12, world_to_pixel=pixels),
        "bezierfield-edge_width": field(edge_width=3.0, world_to_pixel=pixels),
    }
    for name, shape in shown.items():
        save(name, render(small(shape), 32, width=480), limit=40_000)


def spectral() -> None:
    """The ball and the ring of the page on wavelengths."""
    save("spectral", render(page_code("howto/spectral.md")["scene"], 64))


PAGES = {"quickstart": quickstart, "parameters": parameters, "spectral": spectral}


def main() -> None:
    """Run the command."""
    for name in sys.argv[1:] or PAGES:
        PAGES[name]()


if __name__ == "__main__":
    main()
