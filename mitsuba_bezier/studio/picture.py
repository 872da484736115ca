"""The picture behind: the exact surface of a net, at once with one ray a pixel, then refined."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..errors import GeometryError
from ..geometry.camera import Camera
from ..geometry.triangles import BezierTriangles
from ..plugins.native.dictionaries import shape
from ..verification.preview import to_srgb8

__all__ = ["MODES", "Painter"]

#: What the page shows; "light" is path traced while nothing moves, and shaded without shadows else.
MODES = ("light", "normals", "depth")

#: Passes of one sample a pixel after which a picture is fine enough.
FINEST = {"light": 64, "normals": 8, "depth": 8}

BACKGROUND = np.array([240, 240, 242], dtype=np.uint8)

#: Colours of the two sides of a surface, and the light on them: of the sky, and of a lamp.
FRONT, BACK = (0.13, 0.30, 0.52), (0.62, 0.34, 0.13)
SKY, LAMP, LAMP_WAY = 0.55, 1.7, (0.4, 0.6, -1.0)


def _opaque(v: np.ndarray) -> Any:
    """Return a vector that a kernel takes as data: another one compiles no other kernel."""
    return mi.Vector3f(*(dr.opaque(mi.Float, float(x)) for x in v))


def _rays(camera: Camera, w: int, h: int, at: np.ndarray) -> Any:
    """Return the rays through a place in each of a camera's pixels, row by row."""
    # directions of depth 1 are linear in the pixel
    corner, right, down = camera.direction(np.array([[0.0, 0], [1, 0], [0, 1]]) + at)
    k, width = dr.arange(mi.UInt32, w * h), dr.opaque(mi.UInt32, w)
    x, y = mi.Float(k % width), mi.Float(k // width)
    d = _opaque(corner) + x * _opaque(right - corner) + y * _opaque(down - corner)
    return mi.Ray3f(mi.Point3f(_opaque(camera.to_world[:3, 3])), dr.normalize(d))


class Painter:
    """Renders one net; a scene is built once, and its net replaced.

    Parameters
    ----------
    patches : BezierTriangles or None
        What is shown first; None for nothing but the background.
    """

    def __init__(self, patches: BezierTriangles | None) -> None:
        self._scene: Any = None
        self._net: np.ndarray | None = None
        self._sum: tuple[Any, np.ndarray, int] | None = None
        self._nets = 0
        self.show(patches)

    def show(self, patches: BezierTriangles | None) -> None:
        """Replace the net; of another degree, with another scene."""
        if patches is None:
            self._net = None
            return
        net = patches.control_points
        if self._scene is not None and self._net is not None and net.shape == self._net.shape:
            if not np.array_equal(net, self._net):
                self._replace(net)
            return

        def side(colour: tuple[float, float, float]) -> dict[str, Any]:
            return {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(colour)}}

        self._scene = mi.load_dict(
            {
                "type": "scene",
                "patch": shape(
                    patches, bsdf={"type": "twosided", "front": side(FRONT), "rear": side(BACK)}
                ),
                "sky": {"type": "constant", "radiance": {"type": "rgb", "value": SKY}},
                "lamp": {
                    "type": "directional",
                    "direction": list(LAMP_WAY),
                    "irradiance": {"type": "rgb", "value": LAMP},
                },
            }
        )
        # a replaced net has other kernels than a loaded one: these are compiled now, not in a drag
        self._replace(net)

    def _replace(self, net: np.ndarray) -> None:
        params = mi.traverse(self._scene)
        params["patch.control_points"] = mi.TensorXf(net.astype(np.float32))
        params.update()
        self._net, self._nets = net, self._nets + 1

    def paint(self, camera: Camera, mode: str = "light", spp: int = 0) -> np.ndarray:
        """Return a picture ``(h, w, 3)`` of bytes as a camera sees the surface.

        Parameters
        ----------
        camera : Camera
            Its film tells the size.
        mode : {"light", "normals", "depth"}
        spp : int
            Samples a pixel; 0 for the quick picture, of one ray through the middle of each, and
            without shadows.

        Raises
        ------
        GeometryError
            If there is no such mode.
        """
        if spp == 0:
            return self._quick(camera, mode)
        self._sum = None
        for _ in range(spp):
            self.refine(camera, mode)
        return self.refined()

    def refine(self, camera: Camera, mode: str) -> int:
        """Add one sample a pixel to the fine picture, and return how many it has.

        It begins anew when net, camera or mode are others. One at a time, so that a drag that
        begins has not to wait for long.

        Raises
        ------
        GeometryError
            If there is no such mode.
        """
        w, h = self._size(camera, mode)
        key = (self._nets, self._net is None, camera.matrix.tobytes(), w, h, mode)
        total, done = None, 0
        if self._sum is not None and self._sum[0] == key:
            total, done = self._sum[1:]
        if self._net is None:
            new = np.broadcast_to(BACKGROUND.astype(np.float32), (h, w, 3))
        elif mode == "light":
            new = self._light(camera, w, h, done)
        else:
            # a low-discrepancy place in the pixel (Roberts' sequence)
            at = np.array([0.5, 0.5]) + np.array([0.7548776662, 0.5698402910]) * done
            new = self._looked(camera, mode, w, h, at % 1.0)
        self._sum = key, new if total is None else total + new, done + 1
        return done + 1

    def refined(self) -> np.ndarray:
        """Return the fine picture as it is now, ``(h, w, 3)`` of bytes.

        Raises
        ------
        GeometryError
            If `refine` has not been called.
        """
        if self._sum is None:
            raise GeometryError.expected("picture", "one that was refined", "none")
        key, total, done = self._sum
        mean = total / np.float32(done)
        if key[-1] == "light" and not key[1]:  # four numbers a pixel, linear, before nothing
            behind = (BACKGROUND.astype(np.float32) / 255) ** np.float32(2.2)
            return to_srgb8(mean[..., :3] + (1 - mean[..., 3:]) * behind)
        return np.asarray(mean.round().astype(np.uint8))

    def _size(self, camera: Camera, mode: str) -> tuple[int, int]:
        if mode not in MODES:
            raise GeometryError.expected("mode", "one of " + ", ".join(MODES), repr(mode))
        w, h = (int(n) for n in camera.film_size)
        return w, h

    def _quick(self, camera: Camera, mode: str) -> np.ndarray:
        w, h = self._size(camera, mode)
        if self._net is None:
            return np.broadcast_to(BACKGROUND, (h, w, 3)).copy()
        return self._looked(camera, mode, w, h, np.array([0.5, 0.5])).astype(np.uint8)

    def _looked(self, camera: Camera, mode: str, w: int, h: int, at: np.ndarray) -> np.ndarray:
        """Return a picture of one ray a pixel, from 0 to 255, ``(h, w, 3)``."""
        from ..plugins.scene import ray_intersect

        ray = _rays(camera, w, h, at)
        si = ray_intersect(self._scene, ray)
        hit = si.is_valid()
        behind = mi.Color3f(BACKGROUND.tolist())
        if mode == "depth":
            t = np.array(si.t)
            seen = t[np.isfinite(t)]
            near, far = (seen.min(), seen.max()) if len(seen) else (0.0, 1.0)
            grey = 225 - 200 * (t - near) / max(far - near, 1e-9)
            grey = np.where(np.isfinite(t)[:, None], grey[:, None], BACKGROUND)
            return np.asarray(grey, dtype=np.float32).reshape(h, w, 3)
        rear = dr.dot(si.n, ray.d) > 0
        n = dr.select(rear, -si.n, si.n)
        if mode == "normals":
            axes = camera.to_world[:3, :3] * [-1.0, 1.0, -1.0]  # right, up, to the eye
            shown = [127.5 + 127.5 * dr.dot(n, _opaque(axis)) for axis in axes.T]
            colour = mi.Color3f(*shown)
        else:
            lamp = -np.asarray(LAMP_WAY) / np.linalg.norm(LAMP_WAY)
            light = SKY + LAMP / np.pi * dr.maximum(dr.dot(n, mi.Vector3f(lamp.tolist())), 0)
            colour = dr.select(rear, mi.Color3f(*BACK), mi.Color3f(*FRONT)) * light
            low = 12.92 * colour
            high = 1.055 * dr.power(dr.maximum(colour, 0.003), 1 / 2.4) - 0.055
            colour = 255 * dr.select(colour <= 0.0031308, low, high)
        out = np.array(dr.ravel(dr.clip(dr.select(hit, colour, behind), 0, 255)))
        return out.reshape(h, w, 3)

    def _light(self, camera: Camera, w: int, h: int, seed: int) -> np.ndarray:
        """Return one path a pixel, linear, with alpha: ``(h, w, 4)``."""
        sensor = mi.load_dict(
            {
                "type": "perspective",
                "fov": camera.x_fov,
                "fov_axis": "x",
                "to_world": mi.ScalarTransform4f(camera.to_world),
                "film": {
                    "type": "hdrfilm",
                    "width": w,
                    "height": h,
                    "pixel_format": "rgba",
                    "rfilter": {"type": "box"},
                },
                "sampler": {"type": "independent"},
            }
        )
        integrator = mi.load_dict({"type": "bezierpath", "max_depth": 3, "hide_emitters": True})
        image = mi.render(self._scene, sensor=sensor, integrator=integrator, spp=1, seed=seed)
        return np.array(image)
