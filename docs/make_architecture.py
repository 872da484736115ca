"""Draw ``architecture.svg``: the layers of the package, and who imports whom.

    python docs/make_architecture.py

Everything in the picture is read from the source: folders, their modules, imports between them. A
test holds the committed picture against it.
"""

from __future__ import annotations

import ast
import sys
from html import escape
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "mitsuba_bezier"
TARGET = Path(__file__).with_name("architecture.svg")

#: Rows of the picture, from the top: what users call stands above what it is made of.
ROWS = (
    ("regression",),
    ("cli",),
    ("models",),
    ("rendering",),
    ("plugins",),
    ("kernels", "io", "verification"),
    ("leaves", "oracles", "figures"),
    ("geometry",),
)
#: What is drawn below all: single modules.
BASE = ("errors", "_runtime", "_llvm")

WIDTH, MARGIN, GAP, BOX, ROW = 1200, 20, 24, 96, 150
COLOURS = {
    "regression": "#e8eef7",
    "cli": "#e8eef7",
    "models": "#e8eef7",
    "rendering": "#dcebdc",
    "plugins": "#dcebdc",
    "kernels": "#fbe9cf",
    "io": "#efe3f3",
    "verification": "#efe3f3",
    "leaves": "#fbe9cf",
    "oracles": "#f0f0f0",
    "figures": "#e3f0ee",
    "geometry": "#fff4c2",
}


def purpose(folder: Path) -> str:
    """Return the first line of a folder's docstring."""
    text = ast.get_docstring(ast.parse((folder / "__init__.py").read_text(encoding="utf-8")))
    return (text or "").splitlines()[0].rstrip(".") if text else ""


def modules(folder: Path) -> list[Path]:
    """Return the modules of a folder and those below it."""
    return sorted(p for p in folder.rglob("*.py") if p.name != "__init__.py")


def imported(path: Path) -> set[str]:
    """Return the top folders or modules of the package that a module imports."""
    place = path.relative_to(PACKAGE).parts[:-1]
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.ImportFrom):
            continue
        if node.level == 0:
            names = (node.module or "").split(".")
            if names[0] != PACKAGE.name:
                continue
            parts = names[1:]
        else:
            parts = [*place[: len(place) + 1 - node.level], *filter(None, [node.module])]
            parts = [piece for part in parts for piece in part.split(".")]
        found |= {parts[0]} if parts else {alias.name for alias in node.names}
    return found


def arrows() -> dict[tuple[str, str], int]:
    """Return how many modules of one folder import something of another."""
    count: dict[tuple[str, str], int] = {}
    for row in ROWS:
        for name in row:
            if not (PACKAGE / name).is_dir():
                continue
            for path in modules(PACKAGE / name):
                for other in imported(path) - {name}:
                    count[name, other] = count.get((name, other), 0) + 1
    return count


def draw() -> str:
    """Return the picture."""
    rows = [[name for name in row if (PACKAGE / name).is_dir()] for row in ROWS]
    height = MARGIN + ROW * len(rows) + 70
    places: dict[str, tuple[float, float, float]] = {}
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" '
        f'width="{WIDTH}" height="{height}" font-family="sans-serif">',
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" '
        'markerHeight="7" orient="auto"><path d="M0 0 8 4 0 8z" fill="#666"/></marker></defs>',
        f'<rect width="{WIDTH}" height="{height}" fill="white"/>',
    ]
    boxes = []
    for level, row in enumerate(rows):
        y = MARGIN + level * ROW
        width = (WIDTH - 2 * MARGIN - GAP * (len(row) - 1)) / len(row)
        for k, name in enumerate(row):
            x = MARGIN + k * (width + GAP)
            places[name] = x, y, width
            folder = PACKAGE / name
            inside = sorted(p.name for p in folder.iterdir() if (p / "__init__.py").exists())
            count = len(modules(folder))
            boxes.append(
                f'<rect x="{x:.0f}" y="{y}" width="{width:.0f}" height="{BOX}" rx="6" '
                f'fill="{COLOURS[name]}" stroke="#555"/>'
            )
            boxes.append(
                f'<text x="{x + 14:.0f}" y="{y + 27}" font-size="19" font-weight="bold">{name}/'
                f'<tspan font-size="13" font-weight="normal" fill="#444">  {count} modules'
                f"</tspan></text>"
            )
            lines = wrapped(purpose(folder), int(width / 7.2))[:2]
            for j, line in enumerate(lines):
                boxes.append(
                    f'<text x="{x + 14:.0f}" y="{y + 48 + 17 * j}" font-size="13">'
                    f"{escape(line)}</text>"
                )
            if inside:
                boxes.append(
                    f'<text x="{x + 14:.0f}" y="{y + BOX - 9}" font-size="12" fill="#444">'
                    f"{escape('  ·  '.join(f'{n}/' for n in inside))}</text>"
                )
    y = MARGIN + ROW * len(rows)
    places.update({name: (MARGIN, y, WIDTH - 2 * MARGIN) for name in BASE})
    boxes.append(
        f'<rect x="{MARGIN}" y="{y}" width="{WIDTH - 2 * MARGIN}" height="40" rx="6" '
        f'fill="#f7f7f7" stroke="#555"/><text x="{MARGIN + 14}" y="{y + 25}" font-size="14">'
        f"{'  ·  '.join(BASE)}</text>"
    )
    level_of = {name: level for level, row in enumerate(rows) for name in row}
    drawn: dict[str, int] = {}
    for (source, target), number in sorted(arrows().items()):
        if target not in level_of or level_of[target] <= level_of[source]:
            continue
        sx, sy, sw = places[source]
        tx, ty, tw = places[target]
        out, into = drawn.get(source, 0), drawn.get("->" + target, 0)
        drawn[source], drawn["->" + target] = out + 1, into + 1
        x1, x2 = sx + sw * (0.16 + 0.17 * (out % 5)), tx + tw * (0.12 + 0.13 * (into % 7))
        y1 = sy + BOX
        middle = f"{(x1 + x2) / 2:.0f}", f"{(y1 + ty) / 2 - 3:.0f}"
        parts.append(
            f'<line x1="{x1:.0f}" y1="{y1}" x2="{x2:.0f}" y2="{ty}" stroke="#888" '
            f'stroke-width="{min(4.0, 0.8 + number / 8):.1f}" marker-end="url(#tip)"/>'
        )
        boxes.append(
            f'<text x="{middle[0]}" y="{middle[1]}" font-size="11" fill="#333" '
            f'stroke="white" stroke-width="3" paint-order="stroke">{number}</text>'
        )
    return "\n".join([*parts, *boxes, "</svg>"]) + "\n"


def wrapped(text: str, width: int) -> list[str]:
    """Break a line at blanks."""
    lines = [""]
    for word in text.split():
        if len(lines[-1]) + len(word) > width:
            lines.append("")
        lines[-1] += ("" if not lines[-1] else " ") + word
    return lines


if __name__ == "__main__":
    TARGET.write_text(draw(), encoding="utf-8")
    print(f"wrote {TARGET.relative_to(ROOT)}", file=sys.stderr)
