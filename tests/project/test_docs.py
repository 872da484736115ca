"""The code blocks of the documentation run, in the order of their page."""

from __future__ import annotations

import importlib.util
import re
from typing import Any

import pytest
from docs_cases import DOCS, LIVE, PAGES, blocks, code_blocks, run_page

#: README's example renders at full size: `test_readme.py` runs it small. CONTRIBUTING's is below.
ELSEWHERE = {"README", "CONTRIBUTING"}


@pytest.fixture
def variant():
    """Pages may set a variant; the one before is restored."""
    import mitsuba as mi

    before = mi.variant()
    yield
    if before is not None and mi.variant() != before:
        mi.set_variant(before)


@pytest.mark.parametrize("page", sorted(set(PAGES) - ELSEWHERE - set(LIVE)))
def test_code_blocks_run(page, variant, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # some write files
    run_page(page, tmp_path)


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
