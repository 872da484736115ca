"""The picture behind: the exact surface of a net, at once as normals, and refined as light."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np

from ..errors import GeometryError
from ..geometry.camera import Camera
from ..geometry.triangles import BezierTriangles
from ..plugins.native.dictionaries import shape

__all__ = ["MODES", "Painter"]

#: What the page shows while nothing moves; normals while something does.
MODES = ("normals", "depth", "light")

BACKGROUND = np.array([236, 236, 238], dtype=np.uint8)


class Painter:
    """Renders one net; a scene is built once, and its net replaced.

    Parameters
    ----------
    patches : BezierTriangles
        What is shown first.
    """

    def __init__(self, patches: BezierTriangles) -> None:
        self._scene: Any = None
        self._net: np.ndarray = np.zeros(0)
        self._kept: tuple[Any, np.ndarray, Any] | None = None
        self.show(patches)

    def show(self, patches: BezierTriangles) -> None:
        """Replace the net; of another degree, with another scene."""
        net = patches.control_points
        if self._scene is not None and net.shape == self._net.shape:
            if not np.array_equal(net, self._net):
                params = mi.traverse(self._scene)
                params["patch.control_points"] = mi.TensorXf(net.astype(np.float32))
                params.update()
                self._net = net
            return
        clay = {
            "type": "twosided",
            "bsdf": {"type": "plastic", "diffuse_reflectance": {"type": "rgb", "value": 0.55}},
        }
        self._scene = mi.load_dict(
            {
                "type": "scene",
                "patch": shape(patches, bsdf=clay),
                "sky": {"type": "constant", "radiance": {"type": "rgb", "value": 0.8}},
                "lamp": {
                    "type": "directional",
                    "direction": [0.4, 0.6, -1.0],
                    "irradiance": {"type": "rgb", "value": 1.4},
                },
            }
        )
        self._net = net

    def paint(self, camera: Camera, mode: str = "normals", spp: int = 1) -> np.ndarray:
        """Return a picture ``(h, w, 3)`` of bytes as a camera sees the surface.

        Parameters
        ----------
        camera : Camera
            Its film tells the size.
        mode : {"normals", "depth", "light"}
            Of one ray a pixel; "light" of `spp` paths a pixel.

        Raises
        ------
        GeometryError
            If there is no such mode.
        """
        if mode not in MODES:
            raise GeometryError.expected("mode", "one of " + ", ".join(MODES), repr(mode))
        if mode == "light":
            return self._light(camera, spp)
        from ..plugins.scene import ray_intersect

        w, h = (int(n) for n in camera.film_size)
        d, ray = self._rays(camera, w, h)
        si = ray_intersect(self._scene, ray)
        hit = np.flatnonzero(np.array(si.is_valid()))
        out = np.broadcast_to(BACKGROUND, (h * w, 3)).copy()
        if len(hit):
            if mode == "normals":
                n = np.array(si.n).T[hit]
                n[np.einsum("ij,ij->i", n, d[hit]) > 0] *= -1
                axes = camera.to_world[:3, :3] * [-1.0, 1.0, -1.0]  # right, up, to the eye
                out[hit] = (127.5 + 127.5 * (n @ axes.astype(np.float32))).clip(0, 255)
            else:
                t = np.array(si.t)[hit]
                near, far = t.min(), t.max()
                out[hit] = (235 - 200 * (t - near) / max(far - near, 1e-9))[:, None]
        return out.reshape(h, w, 3)

    def _rays(self, camera: Camera, w: int, h: int) -> tuple[np.ndarray, Any]:
        """Return directions and rays of a camera's pixels; those of the last camera are kept."""
        key = (camera.matrix.tobytes(), w, h)
        if self._kept is None or self._kept[0] != key:
            y, x = np.mgrid[0:h, 0:w] + 0.5
            d = camera.direction(np.stack([x.ravel(), y.ravel()], axis=1))
            d = (d / np.linalg.norm(d, axis=1)[:, None]).astype(np.float32)
            o = camera.to_world[:3, 3]
            ray = mi.Ray3f(mi.Point3f(*o.tolist()), mi.Vector3f(np.ascontiguousarray(d.T)))
            self._kept = key, d, ray
        return self._kept[1], self._kept[2]

    def _light(self, camera: Camera, spp: int) -> np.ndarray:
        w, h = (int(n) for n in camera.film_size)
        sensor = mi.load_dict(
            {
                "type": "perspective",
                "fov": camera.x_fov,
                "fov_axis": "x",
                "to_world": mi.ScalarTransform4f(camera.to_world),
                "film": {"type": "hdrfilm", "width": w, "height": h, "rfilter": {"type": "box"}},
                "sampler": {"type": "independent"},
            }
        )
        integrator = mi.load_dict({"type": "bezierpath", "max_depth": 3})
        image = mi.render(self._scene, sensor=sensor, integrator=integrator, spp=spp)
        byte = mi.Bitmap(image).convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.UInt8, True)
        return np.array(byte)
