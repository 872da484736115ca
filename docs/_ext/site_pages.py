"""A small extension of Sphinx: what the pages of the repository need to be pages of the site."""

from __future__ import annotations

import posixpath
import re
import shutil
from pathlib import Path
from typing import Any

#: Pages that have another place on the site; links to them lead there.
MOVED = {
    "docs/lecture.md": "generated/lecture.md",  # cut into pages
    "README.md": "index.md",
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "contributing.md",
}


def lead(docname: str, text: str) -> str:
    """Lead the links of a page to where the site has what they mean."""
    depth = "../" * docname.count("/")
    folder = posixpath.dirname("docs/" + docname)

    def link(found: re.Match[str]) -> str:
        target, place = found[1], found[2]
        path = posixpath.normpath(posixpath.join(folder, target))
        if path in MOVED:
            return f"]({depth}{MOVED[path]}{place})"
        if not path.startswith("docs/"):  # a page beside the code, as a file
            return f"](path:{target})"
        return found[0]

    return re.sub(r"\]\(([^)#\s:]+\.md)((?:#[^)]*)?)\)", link, text)


def pictures(_block: Any, variables: dict[str, Any], settings: dict[str, Any]) -> str:
    """Take the pictures that a script of the gallery has written into its page."""
    from sphinx_gallery.scrapers import figure_rst

    folder = Path(variables["src_file"]).parent
    targets = []
    for path in sorted(folder.glob("*.png")):
        target = next(variables["image_path_iterator"])
        shutil.move(path, target)
        targets.append(target)
    for path in (*folder.glob("*.vtu"), *folder.glob("*.ply")):  # what they are made from
        path.unlink()
    return figure_rst(targets, settings["src_dir"])


def _links(_app: Any, docname: str, source: list[str]) -> None:
    source[0] = lead(docname, source[0])


def is_drawing(uri: str) -> bool:
    """Return whether a picture is black on white: those turn dark with the page."""
    drawn_over_a_render = posixpath.splitext(uri)[0].endswith("_drawn")
    line_art = uri.endswith(".svg") or posixpath.basename(uri) == "lens-focus.jpg"
    return line_art or ("figures/" in uri and not drawn_over_a_render)


def _drawings(_app: Any, tree: Any) -> None:
    """Mark what is drawn, for the style sheet."""
    from docutils.nodes import image

    for node in tree.findall(image):
        if is_drawing(node["uri"]):
            node["classes"].append("drawing")


def _formula(display: str) -> Any:
    """Return what writes a formula as MathML, which browsers draw by themselves."""

    def visit(writer: Any, node: Any) -> None:
        from docutils.nodes import SkipNode
        from latex2mathml.converter import convert

        formula = convert(node.astext(), display=display)
        # signs of derivatives are raised as they are; as exponents they fly off
        prime = r"<msup>(<mi>.</mi>)<mi>(&#x0203[23];)</mi></msup>"
        formula = re.sub(prime, r'\1<mo lspace="0" rspace="0">\2</mo>', formula)
        writer.body.append(formula)
        raise SkipNode

    return visit


def setup(app: Any) -> dict[str, bool]:
    """Register with Sphinx."""
    app.connect("source-read", _links)
    app.connect("doctree-read", _drawings)
    formulas = (_formula("inline"), None), (_formula("block"), None)
    app.add_html_math_renderer("mathml", *formulas)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
