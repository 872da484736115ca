"""Denoise a picture by Open Image Denoise, with exact albedo and normals.

A clean picture made of a noisy one is a guess: it is for looking at, never for measuring. Files of
such pictures say so in their header, and `compare`, `merge` and references refuse them.

The denoiser expects pixels whose errors have nothing to do with each other. Mitsuba's default
filter, and every other but `box`, spreads a sample over its neighbours, and then hardly anything
is removed.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from .._runtime import import_mitsuba
from ..errors import BezierError, RuntimeSetupError
from ..verification.merge import Accumulator
from .passes import render_pass
from .plan import make_plan, pass_seed, sampled_pixels

__all__ = ["auxiliary", "check_denoiser", "denoise", "denoiser_name"]

#: Samples per pixel of albedo and normals: primary rays only, which cost next to nothing.
AUXILIARY_SPP = 64


def check_denoiser() -> Any:
    """Return the module ``mitsuba_oidn``.

    Raises
    ------
    RuntimeSetupError
        If it is not there.
    """
    import_mitsuba()  # it uses the threads of Dr.Jit
    try:
        import mitsuba_oidn
    except ImportError as error:
        raise RuntimeSetupError(
            f"denoising needs mitsuba-oidn ({error}): pip install 'mitsuba-bezier[denoise]'"
        ) from None
    return mitsuba_oidn


def denoiser_name() -> str:
    """Return name and version of the denoiser, for headers."""
    oidn = check_denoiser()
    return f"Open Image Denoise {oidn.oidn_version()}, mitsuba-oidn {oidn.__version__}"


def denoise(
    image: Any, aovs: Any = None, *, hdr: bool = True, noisy_aovs: bool = False
) -> np.ndarray:
    """Return a picture without noise.

    Parameters
    ----------
    image : (H, W), (H, W, 3) or (H, W, 4) array
        What was rendered with the `box` filter: an array, a tensor or a bitmap, linear. A fourth
        channel, alpha, stays as it is.
    aovs : mapping or (H, W, 6) array, optional
        Albedo and shading normals of the same pixels, as `bezieraov` gives them for
        ``"albedo:albedo,normal:sh_normal"`` (the last six channels of ``mi.render``), without
        noise: of some 64 samples per pixel. A mapping has the keys ``"albedo"`` and, maybe,
        ``"normal"``.
    hdr : bool
        Whether values may be larger than 1.
    noisy_aovs : bool
        Whether albedo and normals have noise, too, as where a lens blurs them: noise that is taken
        for clean stays in the picture as texture.

    Returns
    -------
    array of float32
        Of the same shape.

    Raises
    ------
    RuntimeSetupError
        If ``mitsuba-oidn`` is not installed.
    BezierError
        If a shape does not fit.

    Examples
    --------
    >>> noisy = np.random.default_rng(0).random((32, 32, 3), np.float32)
    >>> clean = mb.denoise(noisy)
    >>> bool(clean.std() < noisy.std() / 3)
    True
    """
    oidn = check_denoiser()
    pixels = np.ascontiguousarray(np.array(image), dtype=np.float32)
    channels = pixels.shape[2] if pixels.ndim == 3 else 1
    if pixels.ndim not in (2, 3) or channels not in (1, 3, 4) or not pixels.size:
        raise BezierError.expected("image", "shape (H, W), (H, W, 3) or (H, W, 4)", pixels.shape)
    guides = _guides(aovs, pixels.shape[:2])
    if "normal" in guides and "albedo" not in guides:
        raise BezierError.expected("aovs", "albedo, if there are normals", "none")
    colour = pixels[..., :3] if pixels.ndim == 3 else pixels[..., None]
    # of one channel: three that are alike, which is what the denoiser has learned
    colour = np.ascontiguousarray(np.broadcast_to(colour, (*pixels.shape[:2], 3)))
    finite = np.isfinite(colour).all(axis=-1, keepdims=True)
    clean = oidn.denoise(
        np.where(finite, colour, np.float32(0)),
        hdr=hdr,
        clean_aux=bool(guides) and not noisy_aovs,
        **guides,
    )
    result = pixels.copy()
    kept = np.where(finite, np.array(clean), colour)  # a pixel that is broken stays so
    if pixels.ndim == 2:
        result[...] = kept[..., 0]
    else:
        result[..., :3] = kept[..., : min(channels, 3)]
    return result


def _guides(aovs: Any, size: tuple[int, ...]) -> dict[str, np.ndarray]:
    """Return albedo and normals as the denoiser takes them."""
    if aovs is None:
        return {}
    if not isinstance(aovs, Mapping):
        planes = np.array(aovs)
        if planes.ndim != 3 or planes.shape[2] != 6:
            raise BezierError.expected("aovs", "shape (H, W, 6): albedo, normals", planes.shape)
        aovs = {"albedo": planes[..., :3], "normal": planes[..., 3:]}
    unknown = sorted(set(aovs) - {"albedo", "normal"})
    if unknown:
        raise BezierError.expected("aovs", "the keys albedo and normal", ", ".join(unknown))
    guides = {}
    for name, values in aovs.items():
        pixels = np.nan_to_num(np.array(values, dtype=np.float32))
        if pixels.shape != (*size, 3):
            expected = f"shape {(*size, 3)}, as the image"
            raise BezierError.expected(f"aovs: {name}", expected, pixels.shape)
        low = 0.0 if name == "albedo" else -1.0
        guides[name] = np.ascontiguousarray(np.clip(pixels, low, 1.0))
    return guides


def auxiliary(
    scene: Any, sensor: Any, variant: str, spp: int = AUXILIARY_SPP
) -> dict[str, np.ndarray]:
    """Return albedo and shading normals of a scene, ``(H, W, 3)`` each.

    Parameters
    ----------
    scene, sensor
        Objects of Mitsuba.
    variant : str
        The variant that is set.
    spp : int
        Samples per pixel.
    """
    mi = import_mitsuba()
    integrator = mi.load_dict({"type": "bezieraov", "aovs": "albedo:albedo,normal:sh_normal"})
    total = Accumulator()
    plan = make_plan(sampled_pixels(sensor.film()), spp, variant, style="large")
    for index, samples in enumerate(plan):
        one = render_pass(scene, sensor, integrator, samples, pass_seed(0, index))
        total.add(one.channels, one.spp, [one.seed], one.weight)
    mean = total.mean()
    return {
        "albedo": np.stack([mean[f"albedo.{c}"] for c in "RGB"], axis=-1),
        "normal": np.stack([mean[f"normal.{c}"] for c in "XYZ"], axis=-1),
    }
