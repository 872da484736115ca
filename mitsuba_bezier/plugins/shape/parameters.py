"""What a `beziertriangle` reads from its parameters and files, checked."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np

from ...errors import BezierError, FileFormatError, NetError
from ...geometry.triangles import BezierTriangles
from ...geometry.trims import Trims
from .attributes import check_attribute, check_texcoords, is_attribute

__all__ = ["read_affine", "read_patches", "read_tables"]


def read_affine(transform: Any) -> np.ndarray:
    """Return the matrix ``(4, 4)`` of ``to_world``, checked."""
    if not hasattr(transform, "matrix"):
        raise BezierError.expected("to_world", "a transformation", repr(transform))
    matrix = np.array(transform.matrix, dtype=np.float64)
    if matrix.ndim == 3:
        matrix = matrix[..., 0]
    if not np.isfinite(matrix).all() or (matrix[3] != (0, 0, 0, 1)).any():
        raise BezierError.expected("to_world", "a finite affine transformation", matrix.tolist())
    # 1e-14: what float64 can invert
    sigma = np.linalg.svd(matrix, compute_uv=False)
    if not sigma[-1] > 1e-14 * sigma[0]:
        raise BezierError.expected(
            "to_world", "a regular transformation", f"{matrix.tolist()}, which flattens space"
        )
    return matrix


def read_tables(
    props: mi.Properties, count: int
) -> tuple[np.ndarray | None, dict[str, np.ndarray]]:
    """Take texture coordinates and attributes of `count` patches out of the properties.

    Those of the file come first; parameters of the same name replace them.
    """
    found: dict[str, Any] = {}
    if "filename" in props:
        from ...io import load_attributes

        found.update(load_attributes(str(mi.file_resolver().resolve(props["filename"]))))
    if "texcoords" in props:
        found["texcoords"] = props["texcoords"]
    for key in list(props.keys()):
        # "face_normals" is a parameter of Mitsuba's meshes, and textures are for any shape
        if is_attribute(key) and key != "face_normals" and not isinstance(props[key], mi.Texture):
            found[key] = props[key]
            del props[key]
    texcoords = found.pop("texcoords", None)
    return (
        None if texcoords is None else check_texcoords(texcoords, count),
        {key: check_attribute(key, values, count) for key, values in found.items()},
    )


def read_patches(props: mi.Properties) -> tuple[BezierTriangles, Trims | None]:
    """Take the net from exactly one of ``control_points`` and ``filename``."""
    has = [key for key in ("control_points", "filename") if key in props]
    if len(has) != 1:
        raise NetError.expected(
            "beziertriangle",
            'exactly one of the parameters "control_points" and "filename"',
            "both" if has else "neither",
        )
    if has == ["control_points"]:
        tensor = props["control_points"]
        if not hasattr(tensor, "shape"):
            raise NetError.expected("control_points", "a tensor of shape (P, K, 4)", repr(tensor))
        net = np.array(tensor, dtype=np.float64).reshape(tensor.shape)
        if net.ndim == 4 and net.shape[:2] == (1, 3):  # as `native.dictionaries` passes three
            net = net[0]
        patches = BezierTriangles(net)
        return patches, _read_trims(props, len(patches))
    if "trims" in props:
        raise NetError.expected("trims", "none beside filename: the file has them", "some")
    from ...io import load_trimmed

    name = props["filename"]
    if not isinstance(name, str):
        raise NetError.expected("filename", "the name of a file", repr(name))
    try:
        return load_trimmed(str(mi.file_resolver().resolve(name)))
    except FileFormatError as error:
        raise FileFormatError(f"filename: {str(error).removeprefix('path: ')}") from None


def _read_trims(props: mi.Properties, count: int) -> Trims | None:
    """Take the trims of `count` patches that come as a tensor, see `io.trim_arrays`."""
    if "trims" not in props:
        return None
    from ...io.trim_arrays import trims_of_numbers

    tensor = props["trims"]
    del props["trims"]
    if not hasattr(tensor, "shape"):
        raise NetError.expected("trims", "those of a model", repr(tensor))
    trims = trims_of_numbers(np.array(tensor, dtype=np.float64))
    if len(trims) != count:
        raise NetError.expected("trims", f"those of {count} patches", len(trims))
    return trims
