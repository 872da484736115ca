"""The code blocks of the documentation run, in the order of their page."""

from __future__ import annotations

import importlib.util
import re
import shutil
from typing import Any

import pytest
from docs_cases import DOCS, PAGES, ROOT, Block, blocks, commands

#: Pages whose commands of ours are run, too, with files of their own: small, with few samples.
LIVE = [page for page in PAGES if page == "quickstart" or page.startswith("howto/")]
#: README's example renders at full size: `test_readme.py` runs it small. CONTRIBUTING's is below.
ELSEWHERE = {"README", "CONTRIBUTING"}
#: Packages that a page needs, which not every installation has.
NEEDS: dict[str, tuple[str, ...]] = {"fitting": ("scipy",)}


def code_blocks(text: str) -> list[tuple[int, str]]:
    """Line number and code of each block of Python."""
    return [(block.line, block.text) for block in blocks(text) if block.language == "python"]


@pytest.fixture
def variant():
    """Pages may set a variant; the one before is restored."""
    import mitsuba as mi

    before = mi.variant()
    yield
    if before is not None and mi.variant() != before:
        mi.set_variant(before)


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
    if any(word.endswith(".xml") for word in words[1:2]):
        return words
    return [*words, "--size", "40x30"]


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
            if words[0] == "mitsuba-bezier" and words[1] != "doctor":  # it starts all variants
                code = main(small_command(words[1:]))
                assert code == 0, f"{words} ended with {code}"


@pytest.mark.parametrize("page", sorted(set(PAGES) - ELSEWHERE))
def test_code_blocks_run(page, variant, tmp_path, monkeypatch):
    for package in NEEDS.get(page, ()):
        pytest.importorskip(package)
    found = blocks(PAGES[page].read_text(encoding="utf-8"))
    found = [b for b in found if b.language in ("python", "xml") or page in LIVE]
    if not found:
        return
    monkeypatch.chdir(tmp_path)  # some write files
    if "xml" in {block.language for block in found} or page in LIVE:
        for folder in ("lenses", "models"):  # which scenes name
            shutil.copytree(ROOT / "scenes" / folder, tmp_path / "scenes" / folder)
            (tmp_path / folder).symlink_to(tmp_path / "scenes" / folder)
    namespace: dict[str, Any] = {"__name__": "__docs__"}
    for block in found:
        run(block, page, namespace)


def test_the_blocks_are_found():
    count = {page: len(code_blocks(PAGES[page].read_text(encoding="utf-8"))) for page in PAGES}
    assert count["lecture"] >= 5 and count["conventions"] >= 5 and count["quickstart"] >= 4
    assert sum(count.values()) >= 25
    text = "1. x\n   ```python\n   a\n   ```\n\n````sh\n```\nb\n````\n"
    assert [(b.language, b.line) for b in blocks(text)] == [("python", 2), ("sh", 6)]


def test_every_section_of_the_lecture_has_a_call_a_check_and_a_picture():
    text = (DOCS / "lecture.md").read_text(encoding="utf-8")
    every = re.split(r"^## ", text, flags=re.MULTILINE)[1:]
    sections = [section for section in every if section[0].isdigit()]  # not history and sources
    assert len(sections) == 9
    for section in sections:
        code = "".join(block for _line, block in code_blocks(section))
        assert "assert " in code, section.splitlines()[0]
        assert re.search(r"<!-- picture: renders/\S+\.png: .+ -->|!\[", section), section[:40]


def test_the_table_of_formats_is_that_of_the_readers():
    from mitsuba_bezier.io import _READERS
    from mitsuba_bezier.io.vtk.cell_types import READ

    text = (DOCS / "formats.md").read_text(encoding="utf-8")
    table = text[text.index("| suffix |") : text.index("Text may be")]
    needs: dict[str, str] = {}
    for row in table.splitlines()[2:]:
        suffixes, what, need = row.split("|")[1:-1] if row else ("", "", "")
        extras = "".join(re.findall(r"\[\w+\]", need))
        needs |= dict.fromkeys(re.findall(r"`(\.\w+)`", suffixes), extras)
        if "`.vtu`" in suffixes:
            types = " ".join(re.findall(r"\(([^)]*)\)", what))
            assert {int(n) for n in re.findall(r"\d+", types)} == set(READ)
    extra = {"meshes": "[mesh]", "opencascade": "[cad]", "rhino": "[rhino]"}
    assert needs == {key: extra.get(name.split(".")[-2], "") for key, name in _READERS.items()}


def test_the_reader_in_contributing_reads(tmp_path):
    text = (DOCS.parent / "CONTRIBUTING.md").read_text(encoding="utf-8")
    ((_line, code),) = code_blocks(text)
    namespace: dict[str, Any] = {}
    exec("from __future__ import annotations\nimport numpy as np\n" + code, namespace)
    path = tmp_path / "two.toy"
    path.write_text("0 0 0  1 0 0  1 1 .5\n0 0 0  1 1 .5  0 1 0\n")
    model = namespace["read"](path)
    assert model.report.converted == len(model.triangles()) == 2
    path.write_text("0 0 0 1")
    with pytest.raises(ValueError, match=r"two\.toy"):
        namespace["read"](path)


PROSE = list(PAGES.values())


def prose():
    """Return the module that counts words, docs/prose.py."""
    spec = importlib.util.spec_from_file_location("docs_prose", DOCS / "prose.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("page", PROSE, ids=lambda page: page.stem)
def test_sentences_are_short(page):
    counter = prose()
    found = counter.sentences(page.read_text(encoding="utf-8"))
    lengths = [counter.count(sentence) for sentence in found]
    # fewer than one in fifty of all pages together (below); no page is much worse than that
    too_long = [s for s in found if counter.count(s) > counter.LONG]
    assert len(too_long) <= max(2, len(found) // 30), "\n".join(too_long)
    assert sum(lengths) <= 25 * max(len(lengths), 1)


def test_of_all_sentences_fewer_than_one_in_fifty_is_long():
    counter = prose()
    found = [s for page in PROSE for s in counter.sentences(page.read_text(encoding="utf-8"))]
    assert len(found) > 1000
    assert 50 * sum(counter.count(s) > counter.LONG for s in found) < len(found)


def test_what_counts_as_a_sentence():
    counter = prose()
    text = """# A title is none

Two words. One, [two three](x.md) `a b`!
Goes on here.

| a | table |
| --- | --- |

* An item
  in two lines.
* Another.

```text
Code is none.
```

    mitsuba-bezier render

1. Last, e.g. this.
"""
    words = ["Two words.", "One, two three code!", "Goes on here.", "An item in two lines."]
    assert counter.sentences(text) == [*words, "Another.", "Last, e.g this."]
    assert counter.count("It is 3 * 4 - 5, or so.") == 7
