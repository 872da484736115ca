"""Scenes and central differences that the tests of derivatives share."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from mitsuba_cases import tensor

from mitsuba_bezier.geometry import bernstein

__all__ = [
    "BENT",
    "KEY",
    "attach",
    "central",
    "central_by",
    "film",
    "forward",
    "front_camera",
    "inner",
    "lens",
    "picture",
    "reverse",
    "set_net",
    "weights",
]

KEY = "surface.control_points"

#: A quadratic patch that is on no quadric: so are nets during an optimisation.
BENT = np.array(
    [
        [
            [1.0, -0.5, 0.0, 1.0],
            [0.6, 0.6, 0.3, 1.2],
            [0.5, -0.6, 0.4, 1.0],
            [-0.7, 1.0, 0.2, 1.0],
            [-0.6, 0.5, 0.5, 0.9],
            [-0.8, -0.6, 0.0, 1.0],
        ]
    ]
)


def film(side: int) -> dict[str, Any]:
    """Return film and sampler of a camera; the sampler's noise is small."""
    return {
        "film": {
            "type": "hdrfilm",
            "width": side,
            "height": side,
            "rfilter": {"type": "box"},
            "pixel_format": "rgb",
        },
        "sampler": {"type": "multijitter"},
    }


def front_camera(side: int) -> dict[str, Any]:
    """Return a camera a little beside the z axis: its view has no symmetry."""
    return {
        "type": "perspective",
        "fov": 40,
        "to_world": mi.ScalarTransform4f().look_at([0.3, 0.4, 5], [0, 0, 0], [0, 1, 0]),
        **film(side),
    }


def picture() -> dict[str, Any]:
    """Return a texture that is smooth over the steps of the differences."""
    x = np.linspace(0, 1, 32)
    values = [np.add.outer(np.sin(7 * x + k), np.cos(9 * x - k)) / 4 + 0.5 for k in range(3)]
    data = np.stack(values, axis=-1).astype(np.float32)
    # spectral variants take colours for those of sRGB, not for numbers
    return {"type": "bitmap", "bitmap": mi.Bitmap(data), "raw": not mi.is_spectral}


def lens(bend: float) -> np.ndarray:
    """Return two cubics, bent by about as much, wider than what a test lets pass through them."""
    nets = []
    for z, phase, order in ((0.5, 0.0, [0, 1]), (-0.5, 2.0, [1, 0])):
        x, y = (3 * np.array(bernstein.multi_indices(3))[:, order] - 3.0).T
        wave = np.sin(1.3 * (x + y) + phase) + 0.5 * np.cos(x - phase)
        nets.append(np.c_[x, y, z + bend * wave, np.ones(len(x))])
    return np.array(nets)


def weights(side: int) -> np.ndarray:
    """Return weights of pixels: a loss that no symmetry hides an error from."""
    values = np.random.default_rng(0).uniform(0.2, 1.8, (side, side, 3))
    return (values / values.size).astype(np.float32)


def set_net(params: Any, net: np.ndarray) -> None:
    """Give the surface new control points, without derivatives."""
    params[KEY] = tensor(net)
    params.update()


def attach(params: Any, net: np.ndarray) -> Any:
    """Give the surface control points with derivatives; return them."""
    params[KEY] = tensor(net)
    dr.enable_grad(params[KEY])
    params.update()
    return params[KEY]


def inner(image: Any, w: np.ndarray) -> float:
    """Return the loss of an image, or the change of the loss of a derivative image."""
    return float((np.array(image, dtype=np.float64) * w).sum())


def reverse(render: Callable[[Any], Any], w: np.ndarray) -> float:
    """Return the derivative of the loss of ``render(e)`` at 0, in reverse mode."""
    e = mi.Float(0)
    dr.enable_grad(e)
    dr.backward(dr.sum(render(e) * mi.TensorXf(w), axis=None))
    return float(dr.grad(e)[0])


def forward(render: Callable[[Any], Any], w: np.ndarray) -> float:
    """Return the same in forward mode."""
    e = mi.Float(0)
    dr.enable_grad(e)
    image = render(e)
    dr.forward(e)
    return inner(dr.grad(image), w)


def central(
    render: Callable[[], Any],
    params: Any,
    net: np.ndarray,
    change: np.ndarray,
    w: np.ndarray,
    e: float,
) -> float:
    """Return the central difference of the loss along a change of the net."""
    out = []
    for sign in (1, -1):
        set_net(params, net + sign * e * change)
        out.append(inner(render(), w))
    return (out[0] - out[1]) / (2 * e)


def central_by(
    scene: Any, key: str, change: np.ndarray, w: Any, spp: int, e: float, depth: int
) -> float:
    """Return the central difference of the loss along a change of any parameter of a scene."""
    path = mi.load_dict({"type": "bezierpath", "max_depth": depth})
    params = mi.traverse(scene)
    values = np.array(dr.detach(params[key])).reshape(change.shape)
    out = []
    for sign in (1, -1):
        params[key] = tensor(values + sign * e * change)
        params.update()
        out.append(inner(mi.render(scene, integrator=path, spp=spp, seed=1), w))
    params[key] = tensor(values)
    params.update()
    return (out[0] - out[1]) / (2 * e)
