"""Write a scene of plain dictionaries as a dictionary of Mitsuba or as an XML file.

Numbers, texts, colours ``{"type": "rgb", "value": ...}`` and nested plugins are as in dictionaries
of Mitsuba. Besides there are NumPy arrays: ``to_world`` ``(4, 4)``, nets and what is theirs, and
pictures ``bitmap`` ``(H, W, 3)``; and ``{"xml": text}``, a plugin given as XML.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from .._threads import thread_for_files
from ..errors import FileFormatError
from ..geometry.fields import BezierField
from ..geometry.triangles import BezierTriangles
from ..geometry.trims import Trims

__all__ = ["to_dictionary", "to_files"]

#: The tag of each plugin at its place in the scene is found by the key or the type.
_TAGS = {
    "perspective": "sensor",
    "orthographic": "sensor",
    "hdrfilm": "film",
    "independent": "sampler",
    "multijitter": "sampler",
    "envmap": "emitter",
    "constant": "emitter",
    "area": "emitter",
    "beziertriangle": "shape",
    "asphere": "shape",
    "rectangle": "shape",
    "disk": "shape",
    "bezierfield": "texture",
    "mesh_attribute": "texture",
    "bitmap": "texture",
    "bezierpath": "integrator",
    "path": "integrator",
}
_FILTERS = ("box", "tent", "gaussian", "mitchell", "catmullrom", "lanczos")


def to_dictionary(mi: Any, node: Mapping[str, Any]) -> dict[str, Any]:
    """Return a description as a dictionary for `mi.load_dict`."""
    out: dict[str, Any] = {}
    for key, value in node.items():
        if isinstance(value, Mapping):
            if "xml" in value:
                out[key] = _loaded(mi, str(value["xml"]))
            elif value.get("type") == "rgb":
                out[key] = {"type": "rgb", "value": list(value["value"])}
            else:
                out[key] = to_dictionary(mi, value)
        elif key == "to_world":
            out[key] = mi.ScalarTransform4f(np.asarray(value, dtype=np.float64).tolist())
        elif key == "bitmap" and isinstance(value, np.ndarray):
            out[key] = mi.Bitmap(np.ascontiguousarray(value, dtype=np.float32))
        else:
            out[key] = value
    if node.get("type") == "beziertriangle":
        from ..plugins.native.dictionaries import with_tensors

        out = with_tensors(out)
    return out


def _loaded(mi: Any, text: str) -> Any:
    """Return the plugin of a snippet of XML, which need not tell a version."""
    head, _, rest = text.strip().partition(" ")
    if "version=" not in text.split(">", 1)[0]:
        text = f'{head} version="3.0.0" {rest}'
    try:
        with thread_for_files():
            return mi.load_string(text)
    except RuntimeError as error:
        reason = " ".join(str(error).split())
        raise FileFormatError.expected("material", "XML that Mitsuba reads", reason) from None


def to_files(node: Mapping[str, Any], path: Path) -> dict[Path, bytes]:
    """Return an XML file of a description, and those of its models and pictures beside it.

    Parameters
    ----------
    node : mapping
        Of type ``scene``.
    path : Path
        The XML file.

    Returns
    -------
    dict
        The contents of files by name, the XML file last.
    """
    files: dict[Path, bytes] = {}
    lines = ['<scene version="3.0.0">']
    for key, value in node.items():
        if key != "type":
            lines += _element(key, value, path, files, "  ", key)
    lines.append("</scene>")
    files[path] = ("\n".join(lines) + "\n").encode()
    return files


def _tag(key: str, node: Mapping[str, Any]) -> str:
    kind = str(node["type"])
    if kind in _TAGS:
        return _TAGS[kind]
    return "rfilter" if kind in _FILTERS else "bsdf"


def _name(key: str) -> str:
    return "" if key == "type" else f" name={quoteattr(key)}"


def _element(
    key: str, value: Any, path: Path, files: dict[Path, bytes], indent: str, owner: str
) -> list[str]:
    """Return the lines of one property."""
    if isinstance(value, Mapping):
        if "xml" in value:
            return [indent + str(value["xml"]).strip()]
        if value["type"] == "rgb":
            numbers = " ".join(repr(float(x)) for x in value["value"])
            return [f'{indent}<rgb{_name(key)} value="{numbers}"/>']
        tag = _tag(key, value)
        role = _name(key) if tag in ("bsdf", "texture") and indent != "  " else ""
        if tag == "shape" or tag == "emitter":
            role = f" id={quoteattr(key)}" if tag == "shape" else ""
        lines = [f"{indent}<{tag} type={quoteattr(value['type'])}{role}>"]
        for inner, item in _with_files(value, path, files, owner).items():
            if inner != "type":
                lines += _element(inner, item, path, files, indent + "  ", owner)
        return [*lines, f"{indent}</{tag}>"]
    if key == "to_world":
        numbers = " ".join(repr(float(x)) for x in np.asarray(value, dtype=np.float64).ravel())
        matrix = f'{indent}  <matrix value="{numbers}"/>'
        return [f'{indent}<transform name="to_world">', matrix, f"{indent}</transform>"]
    if isinstance(value, bool):
        return [f'{indent}<boolean{_name(key)} value="{str(value).lower()}"/>']
    if isinstance(value, int):
        return [f'{indent}<integer{_name(key)} value="{value}"/>']
    if isinstance(value, float):
        return [f'{indent}<float{_name(key)} value="{value!r}"/>']
    return [f"{indent}<string{_name(key)} value={quoteattr(str(value))}/>"]


def _without_fields(
    node: Mapping[str, Any], filename: str, fields: list[BezierField], sides: list[np.ndarray]
) -> dict[str, Any]:
    """Return a node whose textures find their fields in a file, and add these to the lists."""
    out: dict[str, Any] = {}
    for key, value in node.items():
        if isinstance(value, Mapping):
            out[key] = _without_fields(value, filename, fields, sides)
        elif node.get("type") == "bezierfield" and isinstance(value, BezierField):
            fields.append(value)
            out |= {"filename": filename, "field": value.name}
        elif node.get("type") == "bezierfield" and isinstance(value, np.ndarray):
            sides.append(value)
        else:
            out[key] = value
    return out


def _with_files(
    node: Mapping[str, Any], path: Path, files: dict[Path, bytes], key: str
) -> dict[str, Any]:
    """Put what no XML can hold into files; return the node with their names."""
    out = dict(node)
    bitmap = out.pop("bitmap", None)
    if isinstance(bitmap, np.ndarray):
        from ..verification.images import encode_exr

        name = path.with_name(f"{path.stem}-{key}.exr")
        pixels = bitmap.astype(np.float32)
        files[name] = encode_exr({c: pixels[..., k] for k, c in enumerate("RGB")}, {})
        out["filename"] = name.name
    elif bitmap is not None:
        out["bitmap"] = bitmap
    if node["type"] != "beziertriangle" or "control_points" not in node:
        return out
    from .._files import temporary_folder
    from ..io.vtk.writer import write

    net, trims = out.pop("control_points"), out.pop("trims", None)
    patches = net if isinstance(net, BezierTriangles) else BezierTriangles(net)
    tables = {
        name: out.pop(name)
        for name in list(out)
        if name == "texcoords" or (name.split("_")[0] in ("face", "vertex") and "_" in name)
    }
    name = path.with_name(f"{path.stem}-{key}.vtu")
    fields: list[BezierField] = []
    sides: list[np.ndarray] = []
    for inner, item in out.items():
        if isinstance(item, Mapping):
            out[inner] = _without_fields(item, name.name, fields, sides)
    with temporary_folder() as folder:
        target = Path(folder) / "part.vtu"
        write(
            patches,
            target,
            trims=trims if isinstance(trims, Trims) else None,
            attributes=tables,
            fields=fields,
            edges=sides[0] if sides else None,
        )
        files[name] = target.read_bytes()
    filename = {"filename": name.name}
    if "instances" in out:
        rows = np.asarray(out.pop("instances"), dtype=np.float64)[:, :3].reshape(-1, 12)
        text = "\n".join(" ".join(repr(x) for x in row) for row in rows.tolist())
        where = path.with_name(f"{path.stem}-{key}.txt")
        files[where] = (text + "\n").encode()
        filename["instances_filename"] = where.name
    return {"type": out.pop("type"), **filename, **out}
