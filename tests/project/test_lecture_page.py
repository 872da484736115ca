"""The lecture's page: what its table of concepts names is there, and its pictures are small."""

from __future__ import annotations

import ast
import re
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "lecture.md"
FIGURES = ROOT / "docs" / "figures"


def rows() -> list[list[str]]:
    text = PAGE.read_text(encoding="utf-8")
    table = text[text.index("| concept |") : text.index("## Sources")]
    return [[c.strip() for c in line.split("|")[1:-1]] for line in table.splitlines()[2:] if line]


ROWS = rows()


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[0])
def test_every_concept_has_its_call_picture_and_check(row):
    concept, call, picture, check = row  # none is empty, as the next lines show
    assert concept
    names = re.findall(r"`([\w.]+)`", call)
    assert names
    for name in names:
        if name.startswith("Camera"):
            name = f"camera.{name}"
        module, attribute, *rest = name.split(".")
        found = getattr(import_module(f"mitsuba_bezier.geometry.{module}"), attribute)
        assert found.__doc__
        for part in rest:
            assert hasattr(found, part)
    (target,) = re.findall(r"\]\((\S+)\)", picture)
    assert (PAGE.parent / target).is_file()
    path, _colons, function = check.strip("`").partition("::")
    source = (ROOT / path).read_text(encoding="utf-8")
    if function:
        defined = {n.name for n in ast.parse(source).body if isinstance(n, ast.FunctionDef)}
        assert function in defined


def test_the_table_has_every_row_of_the_lecture():
    assert len(ROWS) >= 40
    concepts = [row[0] for row in ROWS]
    assert len(set(concepts)) == len(concepts)


def test_the_pictures_are_small_and_all_of_them_shown():
    files = [p for p in FIGURES.iterdir() if p.suffix in (".svg", ".png", ".webp")]
    text = PAGE.read_text(encoding="utf-8")
    for path in files:
        assert path.stat().st_size <= 300_000, path.name
        assert f"(figures/{path.name})" in text, path.name
    assert sum(p.stat().st_size for p in files) < 6_000_000


def test_every_figure_of_the_catalogue_is_there():
    pytest.importorskip("matplotlib", reason="figures need the extra 'figures'")
    from mitsuba_bezier import figures

    drawn = {p.stem for p in FIGURES.iterdir() if p.suffix in (".svg", ".png", ".webp")}
    assert set(figures.names()) <= drawn


def test_history_names_its_sources():
    text = PAGE.read_text(encoding="utf-8")
    table = text[text.index("## History") : text.index("## 1.")]
    sources = text[text.index("## Sources") :]
    known = set(re.findall(r"^(\d+)\.", sources, re.MULTILINE))
    lines = [line for line in table.splitlines() if re.match(r"\| (about )?\d", line)]
    for year in ("1425", "1525", "1604", "1639", "1752", "1822", "1959"):
        assert any(line.startswith(f"| {year}") for line in lines), year
    for line in lines:
        cited = re.findall(r"\[(\d+)\]", line)
        assert cited and set(cited) <= known, line
