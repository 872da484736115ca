"""Rewrite the text of finite element meshes into the form that meshio understands.

meshio takes what follows the letter of these formats as most programs write them, and passes over
keywords it does not know without a word. Here comments, blanks and letters of editors are
straightened, nodes in several blocks are put together, and what is not read is told.
"""

from __future__ import annotations

import re
from collections import Counter
from os import PathLike

from .files import damaged
from .report import Report
from .text import plain_exponents

__all__ = ["prepared"]


def prepared(path: str | PathLike[str], suffix: str, text: str, report: Report) -> str:
    """Return the text for meshio; what it will not read is entered in the report.

    Parameters
    ----------
    path : path
        The file, for errors.
    suffix : str
        Of the file, in lower case.
    text : str
        What stands in it, with lines that end in newlines.
    report : Report
        Gets notes and refused cells.

    Raises
    ------
    FileFormatError
        If the text cannot be understood.
    """
    how = {".inp": _abaqus, ".bdf": _nastran, ".nas": _nastran, ".mesh": _medit}
    return how[suffix](path, text, report)


# ---------------------------------------------------------------------------- Abaqus

#: Keywords that make or move nodes and cells, which meshio does not read.
_ABAQUS_LOST = {
    *("NGEN", "NFILL", "NCOPY", "NMAP", "ELGEN", "ELCOPY", "INCLUDE", "SYSTEM", "TRANSFORM"),
    *("SUBSTRUCTURE GENERATE", "PARAMETER", "MANIFEST"),
}


def _abaqus(path: str | PathLike[str], text: str, report: Report) -> str:
    from meshio.abaqus._abaqus import abaqus_to_meshio_type as types

    nodes: list[str] = []
    cells: list[str] = []
    lost: Counter[str] = Counter()
    refused: Counter[str] = Counter()
    seen: set[str] = set()
    into: list[str] | None = None  # where data lines go
    kind = ""
    goes_on = False  # the last data line ended with a comma
    parts = 0
    for number, raw in enumerate(_joined_keywords(text), start=1):
        line = raw.strip()
        if not line or line.startswith("**"):
            continue
        if not line.startswith("*"):
            line = plain_exponents(line)
            if into is nodes and line.partition(",")[0].strip() in seen:
                got = f"node {line.partition(',')[0].strip()[:20]} twice ({parts} parts)"
                raise damaged(path, "a number for each node", got)
            if into is nodes:
                seen.add(line.partition(",")[0].strip())
            if into is not None:
                into.append(line)
            elif kind and not goes_on:
                refused[kind] += 1
            goes_on = line.endswith(",")
            continue
        words = [word.strip() for word in line[1:].upper().split(",")]
        keyword = " ".join(words[0].split())
        options = dict(word.replace(" ", "").partition("=")[::2] for word in words[1:])
        into, kind, goes_on = None, "", False
        if keyword == "NODE":
            into = nodes
            if options.get("SYSTEM", "R") != "R":
                raise damaged(path, "*NODE in rectangular coordinates", line[:60], line=number)
            if "INPUT" in options:
                lost["NODE, INPUT"] += 1
        elif keyword == "ELEMENT":
            kind = options.get("TYPE", "")
            if kind in types:
                cells.append(f"*ELEMENT, TYPE={kind}")
                into = cells
            if "INPUT" in options:
                lost["ELEMENT, INPUT"] += 1
        elif keyword in ("PART", "INSTANCE"):
            parts += keyword == "PART"
            lost["INSTANCE"] += keyword == "INSTANCE"
        elif keyword in _ABAQUS_LOST:
            lost[keyword] += 1
    for kind, count in refused.items():
        report.refuse(f"elements of type {kind[:40] or 'not given'}", "not supported", count)
    _note(report, "*", +lost)
    return "\n".join(["*NODE", *nodes, *cells, ""])


def _joined_keywords(text: str) -> list[str]:
    """Return the lines; those of keywords that end with a comma go on in the next."""
    out: list[str] = []
    goes_on = False
    for line in text.split("\n"):
        if goes_on and not line.startswith("*"):
            out[-1] += " " + line.strip()
        else:
            out.append(line)
        goes_on = out[-1].startswith("*") and out[-1].rstrip().endswith(",")
    return out


# ---------------------------------------------------------------------------- Nastran


def _nastran(path: str | PathLike[str], text: str, report: Report) -> str:
    from meshio.nastran._nastran import nastran_to_meshio_type as types

    lines = []
    cards: Counter[str] = Counter()
    moved = 0
    for raw in text.upper().split("\n"):
        line = raw.expandtabs(8).partition("$")[0].rstrip()
        if len(line.strip()) < 4 and not line.startswith(("+", "*")):
            continue  # meshio takes such lines for blank ones, but for its own continuations
        lines.append(line)
        fields = line.split(",") if "," in line else [line[:8], line[8:16], line[16:24]]
        card = fields[0].strip().rstrip("*")
        if re.fullmatch(r"[A-Z]\w*", card):
            cards[card] += 1
        wide = line[24:40] if "," not in line and fields[0].strip().endswith("*") else None
        system = (wide if wide is not None else fields[2] if len(fields) > 2 else "").strip()
        moved += card == "GRID" and system not in ("", "0")
    start = [k for k, line in enumerate(lines) if re.match(r"\s*BEGIN\s*,?\s*BULK", line)]
    body = lines[start[0] + 1 :] if start else lines
    if not any(line.startswith("ENDDATA") for line in body):
        body.append("ENDDATA")
    lost = {
        card: count
        for card, count in cards.items()
        if card == "INCLUDE"
        or (re.match(r"C(TRI|QUAD|TETR|HEX|PENT|PYR|PLST|SHEAR)", card) and card not in types)
    }
    _note(report, "", lost)
    if moved:
        report.notes.append(
            f"{moved} GRID cards name coordinate systems, which are not applied: these points are "
            "at wrong places unless the systems are the basic one"
        )
    return "\n".join(["BEGIN BULK", *body, ""])


# ---------------------------------------------------------------------------- Medit

#: Keywords of cells that meshio reads.
_MEDIT_CELLS = (
    *("Edges", "Triangles", "Quadrilaterals", "Tetrahedra", "Prisms", "Pyramids"),
    *("Hexahedra", "Hexaedra"),
)


def _medit(path: str | PathLike[str], text: str, report: Report) -> str:
    text = re.sub(r"#[^\n]*", "", text)
    pieces = re.split(r"(?<!\S)([A-Za-z]\w*)(?!\S)", text)
    if pieces[0].strip():
        raise damaged(path, "a keyword such as MeshVersionFormatted", repr(pieces[0].split()[0]))
    out = []
    others = []
    for keyword, body in zip(pieces[1::2], pieces[2::2]):
        if keyword == "End":
            break
        words = plain_exponents(body).split()
        if keyword == "MeshVersionFormatted":
            if words and words[0] in ("3", "4"):
                words[0] = "2"  # the text is the same
            out.append(" ".join([keyword, *words]))
        elif keyword in ("Dimension", "Vertices", *_MEDIT_CELLS):
            # np.fromfile stops at what is no number, and meshio does not look
            for word in words:
                if not re.fullmatch(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?", word, re.I | re.A):
                    raise damaged(path, f"numbers after {keyword!r}", repr(word[:40]))
            if keyword == "Vertices":  # np.fromfile does not take "1.e0", either
                words[1:] = [repr(float(word)) for word in words[1:]]
            out += [keyword, *words[:1], " ".join(words[1:])]
        elif re.search(r"P\d|Q\d", keyword):
            count = int(words[0]) if words and words[0].isdecimal() and len(words[0]) < 19 else 1
            report.refuse(f"cells {keyword[:40]!r}", "not supported", count)
        else:
            others.append(keyword[:40])
    if others:
        report.remarks.append(f"sections that are not used: {', '.join(others[:20])}")
    return "\n".join([*out, "End", ""])


def _note(report: Report, mark: str, lost: dict[str, int]) -> None:
    for keyword, count in list(lost.items())[:20]:
        report.notes.append(
            f"'{mark}{keyword[:40]}' is not read ({count} times): what it makes is missing"
        )
