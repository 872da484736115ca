"""The pages of the documentation, their blocks of code, and the commands in them."""

from __future__ import annotations

import re
import shlex
import shutil
from collections.abc import Iterator
from pathlib import Path
from textwrap import dedent
from typing import Any, NamedTuple

import pytest

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"

#: Pages of the repository, below docs/ and beside it.
PAGES = {
    page.relative_to(DOCS).with_suffix("").as_posix(): page
    for page in sorted(DOCS.rglob("*.md"))
    if not {"_build", "gallery", "generated"} & set(page.relative_to(DOCS).parts)
} | {name: ROOT / f"{name}.md" for name in ("README", "CONTRIBUTING")}


class Block(NamedTuple):
    """A block between fences: its language, the number of its line, and what is in it."""

    language: str
    line: int
    text: str


def blocks(text: str) -> list[Block]:
    """Return the blocks of a page, in order."""
    pattern = r"^( *)(`{3,}|:{3,})([^\n`]*)\n(.*?)^\1\2 *$"
    return [
        Block(found[3].strip(), text[: found.start(4)].count("\n"), dedent(found[4]))
        for found in re.finditer(pattern, text, re.S | re.M)
        if not found[2].startswith(":")
    ]


def commands(text: str) -> Iterator[list[str]]:
    """Return the words of each command of a block for the shell; comments are none."""
    for line in text.replace("\\\n", " ").splitlines():
        words: list[str] = []
        for word in [*shlex.split(line, comments=True), "&&"]:
            if word == "&&":
                if words:
                    yield words
                words = []
            else:
                words.append(word)


def named_commands(text: str) -> Iterator[list[str]]:
    """Return the words of each command in the lines of a page, between backticks."""
    text = re.sub(r"^( *)(`{3,}).*?^\1\2 *$", "", text, flags=re.S | re.M)
    for found in re.findall(r"`((?:mitsuba-bezier|python|pytest) [^`]+)`", text):
        one = re.sub(r"\[(\w+)(?: \\?\| \w+)+\]", r"[\1]", " ".join(found.split()))  # of [A | B]
        words = shlex.split(one, comments=True)
        if "..." not in words:
            yield words


#: Pages whose commands of ours are run, too, with files of their own: small, with few samples.
LIVE = [page for page in PAGES if page == "quickstart" or page.startswith("howto/")]
#: Packages that a page needs, which not every installation has.
NEEDS: dict[str, tuple[str, ...]] = {
    "fitting": ("scipy",),
    "howto/fit": ("scipy",),
    "howto/film": ("imageio",),
    "howto/step-file": ("OCP",),
}
#: Commands that pages only speak of: one starts every variant, one serves until it is stopped.
NOT_RUN = {"doctor", "studio", "accept"}


def code_blocks(text: str) -> list[tuple[int, str]]:
    """Line number and code of each block of Python."""
    return [(block.line, block.text) for block in blocks(text) if block.language == "python"]


def small(code: str) -> str:
    """Return code that renders fewer pixels and samples."""
    code = re.sub(r"spp=\d+", "spp=2", code)
    code = re.sub(r'"width": \d+, "height": \d+', '"width": 40, "height": 30', code)
    return re.sub(r"size=\(\d+, \d+\)", "size=(40, 30)", code)


def small_command(words: list[str]) -> list[str]:
    """Return the words of a command of ours with fewer pixels and samples."""
    if words[0] != "render":
        return words
    words = [*words, "-q", "--spp", "2"]  # the last of two counts
    if "--part" in words:
        words += ["--spp-per-pass", "1"]
    return words if words[1].endswith(".xml") else [*words, "--size", "40x30"]


def make_part(path: Path) -> None:
    """Write a STEP file: a pierced disk."""
    from OCP.BRepAlgoAPI import BRepAlgoAPI_Cut
    from OCP.BRepPrimAPI import BRepPrimAPI_MakeCylinder
    from OCP.STEPControl import STEPControl_StepModelType, STEPControl_Writer

    disk, bore = (BRepPrimAPI_MakeCylinder(radius, 4.0).Shape() for radius in (10.0, 3.0))
    writer = STEPControl_Writer()
    writer.Transfer(BRepAlgoAPI_Cut(disk, bore).Shape(), STEPControl_StepModelType.STEPControl_AsIs)
    writer.Write(str(path))


def run(block: Block, page: str, namespace: dict[str, Any]) -> None:
    """Run a block of Python, load one of XML, run the commands of a live page."""
    import mitsuba as mi

    text, live = block.text, page in LIVE
    if block.language == "python":
        # empty lines before, so that a traceback shows the line of the page
        text = small(text) if live else text
        exec(compile("\n" * block.line + text, str(PAGES[page]), "exec"), namespace)
    elif block.language == "xml":
        name = re.match(r"<!-- (\S+\.xml) -->", text)
        if not text.lstrip().startswith("<scene") and name is None:
            text = f'<scene version="3.0.0">{text}</scene>'
        text = re.sub(r'name="(width|height)" value="\d+"', r'name="\1" value="40"', text)
        if name:
            with open(name[1], "w", encoding="utf-8") as file:
                file.write(text)
        mi.set_variant("llvm_ad_rgb")
        mi.load_string(text)
    elif block.language == "sh" and live:
        from mitsuba_bezier.cli.main import main

        for words in commands(text):
            if words[0] == "mitsuba-bezier" and words[1] not in NOT_RUN:
                code = main(small_command(words[1:]))
                assert code == 0, f"{words} ended with {code}"


def run_page(page: str, folder: Path) -> None:
    """Run the blocks of a page in a folder, which is the current one, in their order."""
    for package in NEEDS.get(page, ()):
        pytest.importorskip(package)
    found = blocks(PAGES[page].read_text(encoding="utf-8"))
    found = [b for b in found if b.language in ("python", "xml") or page in LIVE]
    if not found:
        return
    if "xml" in {block.language for block in found} or page in LIVE:
        for name in ("lenses", "models"):  # which scenes name
            shutil.copytree(ROOT / "scenes" / name, folder / "scenes" / name)
            if page not in LIVE:  # a reader of these is in the folder of the package
                (folder / name).symlink_to(folder / "scenes" / name)
    if "OCP" in NEEDS.get(page, ()):
        make_part(folder / "part.step")
    namespace: dict[str, Any] = {"__name__": "__docs__"}
    for block in found:
        run(block, page, namespace)
