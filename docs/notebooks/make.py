"""Make the notebooks of the lecture from their sources, with the figures inside.

    python docs/notebooks/make.py [NAME ...]

A source is a Python file: ``# %% [markdown]`` begins text, ``# %%`` code, of which the last line is
shown if it is an expression. The notebooks are executed here, and again in the tests; no Jupyter is
needed.
"""

from __future__ import annotations

import ast
import base64
import io
import json
import sys
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

from mitsuba_bezier._files import write_file

HERE = Path(__file__).resolve().parent
SOURCES = sorted(p for p in HERE.glob("*.py") if p.name != "make.py")

#: Pixels across of the figures inside.
WIDTH = 600


def cells(source: str) -> list[tuple[str, str]]:
    """Return kind ("markdown" or "code") and text of the cells of a source."""
    out = []
    for part in source.split("# %%")[1:]:
        head, _line, body = part.partition("\n")
        body = body.strip("\n")
        if "[markdown]" in head:
            lines = [line.removeprefix("# ").removeprefix("#") for line in body.splitlines()]
            out.append(("markdown", "\n".join(lines)))
        else:
            out.append(("code", body))
    return out


def executed(code: str, namespace: dict[str, Any]) -> tuple[str, Any]:
    """Run one cell; return what it prints, and the value of its last expression."""
    tree = ast.parse(code)
    last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    printed = io.StringIO()
    value = None
    with redirect_stdout(printed):
        exec(compile(tree, "<cell>", "exec"), namespace)
        if last is not None:
            value = eval(compile(ast.Expression(last.value), "<cell>", "eval"), namespace)
    return printed.getvalue(), value


def notebook(source: str) -> dict[str, Any]:
    """Return a notebook with its outputs, as Jupyter's format 4.5 has it."""
    namespace: dict[str, Any] = {"__name__": "__notebook__"}
    out = []
    for number, (kind, text) in enumerate(cells(source)):
        cell: dict[str, Any] = {
            "cell_type": kind,
            "id": f"cell-{number}",
            "metadata": {},
            "source": text.splitlines(keepends=True),
        }
        if kind == "code":
            printed, value = executed(text, namespace)
            outputs: list[dict[str, Any]] = []
            if printed:
                outputs.append({"output_type": "stream", "name": "stdout", "text": printed})
            if value is not None:
                data: dict[str, Any] = {"text/plain": repr(value)}
                if hasattr(value, "_repr_png_"):
                    png = value.encoded(".png", WIDTH)
                    data["image/png"] = base64.b64encode(png).decode()
                outputs.append(
                    {"output_type": "display_data", "data": data, "metadata": {}}
                )  # fmt: skip
            cell |= {"execution_count": None, "outputs": outputs}
        out.append(cell)
    return {
        "cells": out,
        "metadata": {"language_info": {"name": "python"}},
        "nbformat": 4,
        "nbformat_minor": 5,
    }


def main(names: list[str]) -> None:
    """Make the notebooks."""
    for path in SOURCES:
        if not names or path.stem in names:
            made = notebook(path.read_text(encoding="utf-8"))
            data = json.dumps(made, indent=1, ensure_ascii=False) + "\n"
            write_file(path.with_suffix(".ipynb"), data.encode())
            print(f"{path.stem}.ipynb  {len(data) / 1000:.0f} kB")


if __name__ == "__main__":
    main(sys.argv[1:])
