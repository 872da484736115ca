"""Pages of the reference that are made from the code: commands, plugins, names of the package.

They are written to ``docs/generated``, which is not in the repository, whenever the site is built.
"""

from __future__ import annotations

import argparse
import ast
import os
import re
import shutil
import textwrap
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import mitsuba_bezier
from mitsuba_bezier.cli import main as program
from mitsuba_bezier.plugins import PLUGINS

HERE = Path(__file__).parent
DOCS = HERE.parent
PACKAGE = Path(mitsuba_bezier.__file__).parent


def all_pages(folder: Path) -> None:
    """Write all pages; a page that has not changed keeps its time, so that Sphinx skips it."""
    pages = {
        "commands.md": commands(),
        "plugins.md": plugins(),
        "api.md": api(),
        **modules(),
        **lecture(),
    }
    folder.mkdir(exist_ok=True)
    for old in folder.iterdir():
        if old.name not in pages:
            shutil.rmtree(old) if old.is_dir() else old.unlink()
    for name, text in pages.items():
        path = folder / name
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


# Commands, from their parsers


def commands() -> str:
    """Return the page of all commands and their options."""
    os.environ["COLUMNS"] = "88"  # of the usage lines
    parser = program._parser([])
    (subparsers,) = (a for a in parser._actions if isinstance(a, argparse._SubParsersAction))
    parts = [
        "# Commands",
        "One program, `mitsuba-bezier`, with the commands below. `mitsuba-bezier COMMAND --help` "
        "prints what stands here. Exit codes: 0 on success, 1 if a check failed, 2 for a user's "
        "error, told in one line; 130 after Ctrl-C, 143 after SIGTERM.",
        "Every command takes `--debug`, which shows the traceback of an error.",
    ]
    helps = {choice.dest: choice.help for choice in subparsers._choices_actions}
    rows = [f"| [`{name}`](#{name}) | {_cell(helps[name])} |" for name in subparsers.choices]
    parts.append("\n".join(["| command | does |", "| --- | --- |", *rows]))
    for name, command in subparsers.choices.items():
        parts += [f"## {name}", *_command(command)]
    return "\n\n".join(parts) + "\n"


def _command(parser: argparse.ArgumentParser) -> list[str]:
    nested = [a for a in parser._actions if isinstance(a, argparse._SubParsersAction)]
    formatter = parser._get_formatter()
    usage = "       " + parser.format_usage().removeprefix("usage: ").rstrip()
    parts = [f"```text\n{textwrap.dedent(usage)}\n```"]
    parts += [_text(parser.description or "")]
    for group in parser._action_groups:
        rows = []
        for action in group._group_actions:
            shown = action.help != argparse.SUPPRESS and action.dest not in ("help", "debug")
            if shown and action not in nested:
                help_text = formatter._expand_help(action) if action.help else ""
                rows.append(f"| `{_name(action)}` | {_cell(help_text)} |")
        if rows:
            title = str(group.title).replace("positional arguments", "arguments")
            parts.append("\n".join([f"| {title} | |", "| --- | --- |", *rows]))
    if parser.epilog:
        parts.append(_text(parser.epilog))
    for action in nested:
        for name, command in action.choices.items():
            parts += [f"### {parser.prog.split()[-1]} {name}", *_command(command)]
    return [part for part in parts if part]


def _name(action: argparse.Action) -> str:
    values = ""
    if action.nargs != 0:
        if isinstance(action.metavar, tuple):
            values = " ".join(action.metavar)
        elif action.choices is not None and action.metavar is None:
            values = "{" + ",".join(map(str, action.choices)) + "}"
        else:
            values = str(action.metavar or action.dest.upper())
        if action.nargs in ("*", "+"):
            values += " ..."
        elif action.nargs == "?":
            values = f"[{values}]"
    if not action.option_strings:
        return values.replace("|", "\\|")
    return (", ".join(action.option_strings) + " " + values).strip().replace("|", "\\|")


def _text(text: str) -> str:
    """Return words of a help text as Markdown that shows them as they are."""
    return re.sub(r"([*_<>\[\]])", r"\\\1", text)


def _cell(text: str | None) -> str:
    return _text(" ".join((text or "").split())).replace("|", "\\|")


# Plugins, from the tables in their docstrings


def plugin_docstring(name: str) -> str:
    """Return the docstring of a plugin's class, without making the class."""
    _kind, path = PLUGINS[name]
    module, _, function = path.rpartition(".")
    file = PACKAGE / "plugins" / (module.replace(".", "/") + ".py")
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef) and node.name == function:
            for inner in ast.walk(node):
                text = ast.get_docstring(inner) if isinstance(inner, ast.ClassDef) else None
                if text:
                    return text
    raise LookupError(f"{file}: the class of {name} has no docstring")


def plugins() -> str:
    """Return the page of all plugins and their parameters."""
    parts = [
        "# Plugins",
        "Each plugin by the name that stands in a scene. Types are those of Mitsuba. What is "
        "*exposed* is found by `mi.traverse`; what is *differentiable* has derivatives.",
    ]
    pictures = DOCS / "pictures"
    for name in PLUGINS:
        title, before, rows, after = read_plugin(plugin_docstring(name))
        parts += [f"## {name}", f"{title}: {PLUGINS[name][0]}.", *before]
        table = [
            f"| `{parameter}` | {kind} | {text.replace('|', chr(92) + '|')} |"
            for parameter, kind, text in rows
        ]
        if rows:
            table[:0] = ["| parameter | type | meaning |", "| --- | --- | --- |"]
        parts.append("\n".join(table))
        names = [word for row in rows for word in row[0].split(", ")]
        shown = [word for word in names if (pictures / f"{name}-{word}.webp").exists()]
        if shown:
            cells = [f"![{name} with {p}](../pictures/{name}-{p}.webp)" for p in shown]
            heads = [f"`{p}`" for p in shown]
            for begin in range(0, len(shown), 3):
                row = slice(begin, begin + 3)
                rule = " | ".join("---" for _ in shown[row])
                lines = [" | ".join(heads[row]), rule, " | ".join(cells[row])]
                parts.append("\n".join(f"| {line} |" for line in lines))
        parts += after
    parts = [part for part in parts if part]
    return "\n\n".join(parts) + "\n"


def read_plugin(
    docstring: str,
) -> tuple[str, list[str], list[tuple[str, str, str]], list[str]]:
    """Return title, paragraphs, rows (name, type, meaning), and paragraphs behind the table."""
    head, _, rest = docstring.partition(".. pluginparameters::")
    lines = [line for line in head.splitlines() if not line.startswith(".. _")]
    words = "\n".join(lines).strip()
    title, _, before = words.partition("\n")
    before = re.sub(r"^-+\s*", "", before.lstrip("\n"))
    table, after, rows = [], [], []
    for line in rest.strip("\n").splitlines():
        (table if not after and (line.startswith(" ") or not line.strip()) else after).append(line)
    for row in re.split(r"^ \* - ", "\n".join(table), flags=re.M)[1:]:
        cells = re.split(r"^\s+- ", row, flags=re.M)
        if len(cells) != 3:
            raise ValueError(f"expected a name, a type and a meaning, got {row!r}")
        parameter, kind, text = (" ".join(cell.split()) for cell in cells)
        rows.append((parameter.replace("*", ""), _inline(kind), _inline(text)))
    title = re.sub(r"\s*\(:monosp:.*", "", title)
    return title, _paragraphs(before), rows, _paragraphs("\n".join(after))


def _paragraphs(text: str) -> list[str]:
    return [_inline(" ".join(p.split())) for p in text.split("\n\n") if p.strip()]


def _inline(text: str) -> str:
    """Return a line of the docstrings' reStructuredText as Markdown."""
    signs = {r"\partial": "∂", r"\times": "×", r"\le": "≤", r"\ge": "≥", r"\sqrt": "√"}

    def formula(found: re.Match[str]) -> str:
        word = found[1]
        for sign, character in signs.items():
            word = word.replace(sign, character)
        return f"`{word}`"

    text = re.sub(r":math:`([^`]*)`", formula, text)
    text = re.sub(r":\w+:`([^`]*)`", r"`\1`", text)
    text = re.sub(r"\|(\w+)\|", r"\1", text)
    return text.replace("``", "`")


# Names of the package, by what they are for

GROUPS = {
    "Nets and files": ["BezierTriangles", "load", "save"],
    "Scenes, pictures and rays": [
        "shape",
        "scene",
        "show",
        "ray_intersect",
        "ray_test",
        "native",
        "register",
        "float64",
        "set_float64",
        "denoise",
    ],
    "Builders of surfaces": [
        "sphere",
        "ellipsoid",
        "elliptic_paraboloid",
        "hyperbolic_paraboloid",
        "hyperboloid_one_sheet",
        "hyperboloid_two_sheets",
        "cone",
        "cylinder",
        "torus",
        "disk",
        "plane",
        "half_plane",
        "quarter_plane",
    ],
    "Quadrics": [
        "quadric_patch",
        "quadric_cover",
        "ruled_cover",
        "triangulated",
        "fit_quadric",
        "fit_quadrics",
        "classify_quadric",
        "projective_type",
        "characterize",
        "collineation_to_paraboloid",
    ],
    "Other surfaces": ["tensor_to_triangles", "patchwork", "BSplineSurface"],
    "Curves": ["BezierCurve", "BSplineCurve", "BasicCurve", "DualBezierCurve", "conic_elements"],
    "Projections": ["Camera", "Perspectivity", "Polarity", "StereographicProjection"],
    "What a scene shows beside a surface": [
        "net_shapes",
        "boundary_curves",
        "isoparametric_lines",
        "arrow",
        "label",
    ],
    "Errors": [
        "BezierError",
        "GeometryError",
        "NetError",
        "FileFormatError",
        "VariantError",
        "RuntimeSetupError",
        "DerivativeWarning",
    ],
}

#: Public names that are no functions or classes: modules have pages of their own. They are not
#: imported here, as they may need an extra.
NO_PAGE = {
    name
    for name in mitsuba_bezier.__all__
    if name == "__version__" or find_spec(f"mitsuba_bezier.{name}") is not None
}


def api() -> str:
    """Return the page of the package's names, which autodoc fills in."""
    named = {name for group in GROUPS.values() for name in group}
    missing = set(mitsuba_bezier.__all__) - named - NO_PAGE
    unknown = named - set(mitsuba_bezier.__all__)
    if missing or unknown:
        raise LookupError(f"docs/_ext/generate.py: groups lack {missing}, have {unknown} too much")
    parts = [
        "# Names in Python",
        "All names of `import mitsuba_bezier as mb`. The examples run in the tests, each by "
        "itself, after these lines. [Fitting](api-fit.md), [figures](api-figures.md) and "
        "[optics](api-optics.md) have pages of their own.",
        "```python\nimport mitsuba as mi\nimport mitsuba_bezier as mb\nimport numpy as np\n```",
    ]
    for title, names in GROUPS.items():
        parts.append(f"## {title}")
        for name in names:
            parts.append(_entry(f"mitsuba_bezier.{name}", getattr(mitsuba_bezier, name)))
    return "\n\n".join(parts) + "\n"


#: Modules with pages of their own, by what their names are for, and the extra that some names need.
MODULES = {
    "fit": ("Fitting", "find surfaces from pictures", "fit", "fitting"),
    "figures": ("Figures", "draw in the plane, in space, and over a render", "figures", "lecture"),
    "optics": ("Optics", "read, trace, judge and show lenses", "optics", "lenses"),
}


def modules() -> dict[str, str]:
    """Return a page for each module whose names are no names of the package itself."""
    pages = {}
    for name, (title, purpose, extra, guide) in MODULES.items():
        module = import_module(f"mitsuba_bezier.{name}")
        parts = [
            f"# {title}: `mitsuba_bezier.{name}`",
            f'Names that {purpose} (`pip install ".[{extra}]"`). '
            f"The [guide](../{guide}.md) says how they go together.",
        ]
        parts += [
            _entry(f"mitsuba_bezier.{name}.{one}", getattr(module, one)) for one in module.__all__
        ]
        pages[f"api-{name}.md"] = "\n\n".join(parts) + "\n"
    return pages


def _entry(path: str, value: object) -> str:
    """Return what has autodoc show a name."""
    kind, options = "autofunction" if callable(value) else "autodata", ""
    if isinstance(value, type):
        kind, options = "autoclass", "\n   :members:"
        if all(member.startswith("_") for member in vars(value)):  # all comes from its bases
            options += "\n   :inherited-members:"
        if issubclass(value, Exception):
            kind, options = "autoexception", ""
    if kind == "autodata":
        options = "\n   :no-value:"
    return f"```{{eval-rst}}\n.. {kind}:: {path}{options}\n```"


# The lecture, a page a section


def lecture() -> dict[str, str]:
    """Return docs/lecture.md cut into pages: it has some forty pictures, too many for one."""
    text = (DOCS / "lecture.md").read_text(encoding="utf-8")
    head, *sections = re.split(r"^(?=## )", text, flags=re.M)
    pages = {}
    for number, section in enumerate(sections):
        title, _, body = section[3:].partition("\n")
        # one level up, as the page has no other title
        body = re.sub(r"^#(#+) ", r"\1 ", body, flags=re.M)
        pages[f"lecture-{number}.md"] = f"# {title.strip()}\n{body}"
    where = {}
    for name, page in pages.items():
        for heading in re.findall(r"^#+ (.+)$", page, re.M):
            where[anchor(heading)] = name
    toc = "\n".join(name.removesuffix(".md") for name in pages)
    pages["lecture.md"] = head + f"```{{toctree}}\n:maxdepth: 1\n\n{toc}\n```\n"

    def link(found: re.Match[str]) -> str:
        target = found[1]
        if target.startswith(("https:", "http:")):
            return found[0]
        if target.startswith("#"):
            return f"]({where[target[1:]]}{target}"
        return f"](../{target}"

    return {name: re.sub(r"\]\(([^)\s]+)", link, page) for name, page in pages.items()}


def anchor(heading: str) -> str:
    """Return the anchor of a heading, as repositories and MyST make it."""
    return re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-")
