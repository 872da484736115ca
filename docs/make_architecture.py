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
    ("models", "studio", "fit"),
    ("rendering",),
    ("plugins",),
    ("optics",),
    ("kernels", "io", "verification"),
    ("leaves", "oracles", "figures"),
    ("geometry",),
)
#: What is drawn below all: single modules.
BASE = ("errors", "_runtime", "_llvm")

#: Sizes in pixels: the whole, its margin, a folder's box, and the columns of the matrix.
WIDTH, MARGIN, BOX, ROW, HEAD = 1360, 16, 58, 66, 112
BOX_WIDTH, CELL = 640, 42
COLOURS = {
    "regression": "#e8eef7",
    "cli": "#e8eef7",
    "models": "#e8eef7",
    "studio": "#e8eef7",
    "fit": "#e8eef7",
    "optics": "#efe3f3",
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
    return text.splitlines()[0].rstrip(".").replace("`", "") if text else ""


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
    """Return the picture: a box a folder, and beside it how many of its modules import which."""
    names = [name for row in ROWS for name in row if (PACKAGE / name).is_dir()]
    height = HEAD + ROW * len(names) + 60
    left = MARGIN + BOX_WIDTH + 18
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" '
        f'width="{WIDTH}" height="{height}" font-family="sans-serif">',
        f'<rect width="{WIDTH}" height="{height}" fill="white"/>',
        _text(MARGIN, 40, "Layers: imports go down only", 20, weight="bold"),
        _text(MARGIN, 64, "Right: how many modules of a folder import something of another", 13),
    ]
    for k, name in enumerate(names):
        x, y = left + CELL * (k + 0.5), HEAD + ROW * k
        parts.append(
            f'<text transform="translate({x + 4:.0f} {HEAD - 10}) rotate(-55)" '
            f'font-size="13">{name}</text>'
        )
        folder = PACKAGE / name
        inside = sorted(p.name for p in folder.iterdir() if (p / "__init__.py").exists())
        about = f"{len(modules(folder))} modules"
        if inside:
            about += ", in " + ", ".join(f"{n}/" for n in inside)
        parts += [
            f'<rect x="{MARGIN}" y="{y}" width="{BOX_WIDTH}" height="{BOX}" rx="6" '
            f'fill="{COLOURS[name]}" stroke="#555"/>',
            f'<text x="{MARGIN + 12}" y="{y + 21}" font-size="17" font-weight="bold">{name}/'
            f'<tspan font-size="12" font-weight="normal" fill="#444" dx="8">{about}</tspan></text>',
        ]
        for j, line in enumerate(wrapped(purpose(folder), 92)[:2]):
            parts.append(_text(MARGIN + 12, y + 37 + 15 * j, escape(line), 12))
        parts.append(
            f'<line x1="{left}" y1="{y + BOX / 2:.0f}" x2="{left + CELL * len(names)}" '
            f'y2="{y + BOX / 2:.0f}" stroke="#ddd"/>'
        )
        parts.append(
            f'<line x1="{x:.0f}" y1="{HEAD}" x2="{x:.0f}" y2="{HEAD + ROW * len(names) - 8}" '
            'stroke="#ddd"/>'
        )
    for (source, target), number in sorted(arrows().items()):
        if target in names:
            x, y = left + CELL * (names.index(target) + 0.5), HEAD + ROW * names.index(source)
            y += BOX / 2
            down = names.index(target) > names.index(source)
            parts.append(
                f'<circle cx="{x:.0f}" cy="{y:.0f}" r="{min(17, 8 + number**0.5 * 1.5):.1f}" '
                f'fill="{COLOURS[target] if down else "#d33"}" stroke="#555"/>'
            )
            parts.append(_text(x, y + 4.5, str(number), 12, anchor="middle"))
    for k in range(len(names)):  # the diagonal: what lies left of it would point up
        x, y = left + CELL * (k + 0.5), HEAD + ROW * k + BOX / 2
        parts.append(f'<rect x="{x - 7:.0f}" y="{y - 7:.0f}" width="14" height="14" fill="#bbb"/>')
    y = HEAD + ROW * len(names)
    parts.append(
        f'<rect x="{MARGIN}" y="{y}" width="{BOX_WIDTH}" height="38" rx="6" '
        'fill="#f7f7f7" stroke="#555"/>'
    )
    parts.append(_text(MARGIN + 12, y + 24, "below all: " + ", ".join(BASE), 13))
    return "\n".join([*parts, "</svg>"]) + "\n"


def _text(x: float, y: float, text: str, size: int, weight: str = "normal",
          anchor: str = "start") -> str:  # fmt: skip
    return (
        f'<text x="{x:.0f}" y="{y:.0f}" font-size="{size}" font-weight="{weight}" '
        f'text-anchor="{anchor}">{text}</text>'
    )


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
