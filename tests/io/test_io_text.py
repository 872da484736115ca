"""Text as editors and other programs write it: nothing is lost in silence."""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from format_cases import BEZ, FILES, INP, MSH, OFF, written

import mitsuba_bezier as mb
from mitsuba_bezier import io
from mitsuba_bezier.errors import FileFormatError

TEXT = sorted(
    set(FILES) - {".3dm", ".pvtu", ".vtp", ".vtu"}  # binary, and XML, which is tested below
)

#: What editors make of a text.
EDITED = {
    "utf-8 with mark": lambda text: b"\xef\xbb\xbf" + text.encode(),
    "utf-16": lambda text: text.encode("utf-16"),
    "utf-16 of the other order": lambda text: b"\xfe\xff" + text.encode("utf-16-be"),
    "utf-32": lambda text: text.encode("utf-32"),
    "crlf": lambda text: text.replace("\n", "\r\n").encode(),
    "cr": lambda text: text.replace("\n", "\r").encode(),
    "utf-8 with mark, crlf": lambda t: b"\xef\xbb\xbf" + t.replace("\n", "\r\n").encode(),
}
#: What they make of its lines, where these are not columns of fixed width.
LINES = {
    "trailing blanks": lambda text: text.replace("\n", " \t \n"),
    "blank lines": lambda text: text.replace("\n", "\n\n"),
    "no newline at the end": lambda text: text.rstrip("\n"),
    "end of file of DOS": lambda text: text + "\x1a",
}
FREE = sorted(set(TEXT) - {".brep", ".iges", ".igs", ".step", ".stp"})


def load(path: Path) -> mb.BezierTriangles:
    """Load a file in this process: the second Python changes nothing here, and takes its time."""
    name = {".inp": "meshes", ".bdf": "meshes", ".nas": "meshes", ".mesh": "meshes"}
    name |= dict.fromkeys((".brep", ".iges", ".igs", ".step", ".stp"), "cad.opencascade")
    if path.suffix in name:
        return import_module(f"mitsuba_bezier.io.{name[path.suffix]}").read_here(path).triangles()
    return mb.load(path)


@pytest.mark.parametrize("suffix", TEXT)
def test_encodings_and_line_ends(tmp_path, suffix):
    path = written(tmp_path, suffix)
    expected = load(path)
    text = path.read_bytes().decode()
    for name, edited in EDITED.items():
        path.write_bytes(edited(text))
        assert load(path) == expected, name


@pytest.mark.parametrize("suffix", FREE)
def test_blanks_and_ends(tmp_path, suffix):
    path = written(tmp_path, suffix)
    expected = load(path)
    text = path.read_bytes().decode()
    for name, edited in LINES.items():
        path.write_bytes(edited(text).encode())
        assert load(path) == expected, name


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_xml_of_editors(tmp_path, encoding):
    path = tmp_path / "a.vtu"
    io.save(mb.sphere(), path, encoding="ascii")
    text = path.read_text()
    path.write_bytes(text.replace("\n", "\r\n").encode(encoding))
    assert mb.load(path) == mb.sphere()


@pytest.mark.parametrize("suffix", [".bbp", ".bez", ".bv", ".msh", ".obj", ".off"])
@pytest.mark.parametrize(
    ("number", "value"),
    [
        *(("5d-1", 0.5), ("5D-1", 0.5), ("+0.5", 0.5), (".5", 0.5), ("5.e-1", 0.5)),
        *(("+50.0E-02", 0.5), ("0,5", None), ("1_0", None), ("nan", None), ("inf", None)),
        *(("1e999", None), ("0x10", None), ("٣", None), ("½", None), ("1.5+3", None)),
    ],
)
def test_forms_of_numbers(tmp_path, suffix, number, value):
    """Fortran's exponents are read; what only some languages take for a number is refused."""
    path = written(tmp_path, suffix)
    if suffix == ".bv":
        path.write_text("3\n1\n0 0 0\n1 0 0\n0 1 0.5\n")
    text = path.read_text()
    old = "0.6666666666666666" if suffix in (".bbp", ".bez") else "0.5"
    assert old in text
    expected = None
    if value is not None:
        path.write_text(text.replace(old, repr(value)))
        expected = mb.load(path)
    path.write_text(text.replace(old, number), encoding="utf-8")
    if expected is not None:
        assert mb.load(path) == expected
    else:
        with pytest.raises(FileFormatError, match=r"number|expected"):
            mb.load(path)


# ---------------------------------------------------------------------------- Wavefront

V = "".join(f"v {i} {j} {i * j * 0.5}\n" for j in range(2) for i in range(2))
V += "".join(f"v {i + 5} {j} 0\n" for j in range(2) for i in range(2))
S = "cstype bezier\ndeg 1 1\nsurf 0 1 0 1 1 2 3 4\nparm u 0 1\nparm v 0 1\nend\n"
#: The area of z = x y / 2 over the unit square, by a Gauss rule of 40 x 40 points.
AREA = 1.079037016441534


def read_obj(tmp_path, text: str) -> io.Model:
    path = tmp_path / "a.obj"
    path.write_bytes(text.encode())
    return io.read(path)


@pytest.mark.parametrize(
    "text",
    [
        V + S,
        "# exported to C:\\models\\\n" + V + S,
        V + S.replace("1 2 3 4", "1 2 \\ \n3 4"),
        V + S.replace("1 2 3 4", "1 2 \\\t\n3 4"),
        V + S.replace("1 2 3 4", "1 2\\\n3 4"),
        V + S.replace("1 2 3 4", "1 2 \\ # to be continued \\\n3 4 # the end \\"),
        V + S.replace("1 2 3 4", "1 2 \\\n# between \\\n3 4"),
        V + S.replace("1 2 3 4", "1 \\\n2 \\\n3 \\\n4"),
        V + S.replace("end\n", "end \\"),
        V + S.replace("end\n", "end"),
        "mtllib C:\\materials\\\n" + V + "g one\\\n" + S,
        V + "   \n\t\n" + S.replace("\n", "\t \n"),
        V + S.replace("surf", "  surf").replace("parm", "\tparm"),
    ],
)
def test_continuation_and_comments(tmp_path, text):
    model = read_obj(tmp_path, text)
    (patches,) = model.groups
    # 1e-6: what numerical areas promise
    assert float(np.sum(patches.area())) == pytest.approx(AREA, rel=1e-6)
    assert patches.control_points[..., 0].max() == 1
    assert (model.report.notes, model.report.refused) == ([], [])


def test_old_patches_are_refused_faces(tmp_path):
    model = read_obj(tmp_path, V + "bsp 1 2 3 4\ncdp 1 2 3 4\ncdp 1 2 3 4\n" + S)
    assert (model.report.faces, model.report.converted) == (4, 1)
    assert [r.face for r in model.report.refused] == [f"{k} in line {n}" for k, n in OLD]


OLD = (("bsp", 9), ("cdp", 10), ("cdp", 11))


def test_what_is_not_known_is_counted_and_told(tmp_path):
    words = "V 1 2 3\nserf 0 1\nserf 0 1\n3 4\ncall other.obj\n"
    model = read_obj(tmp_path, V + words + S + "curv 0 1 1 2\nparm u 0 1\nend\nl 1 2\nvt 0 0\n")
    notes = "\n".join(model.report.notes)
    for told in ("1 statements 'V' (line 9)", "2 statements 'serf' (line 10)", "1 statements '3'"):
        assert told in notes
    assert "'call' (line 13)" in notes
    assert model.report.remarks == [
        "1 statements 'curv': curves in space",
        "1 statements 'l': lines",
    ]
    with pytest.warns(io.FormatWarning) as told:
        mb.load(tmp_path / "a.obj")
    assert len(told) == 4


def test_many_unknown_words_are_few_lines(tmp_path):
    model = read_obj(tmp_path, V + S + "".join(f"word{k}\n" for k in range(500)))
    assert len(model.report.notes) == 21 and "480 more words" in model.report.notes[-1]


@pytest.mark.parametrize("kind", ["surf 0 1 0 1 1 2 3 4", "curv 0 1 1 2", "curv2 1 2"])
def test_an_element_without_end(tmp_path, kind):
    """The next one takes its place: it would be lost."""
    with pytest.raises(FileFormatError, match=rf"'end' after '{kind.split()[0]}', got none before"):
        read_obj(tmp_path, V + "cstype bezier\ndeg 1 1\n" + kind + "\nparm u 0 1\n" + S)
    with pytest.raises(FileFormatError, match=f"'end' after '{kind.split()[0]}'"):
        read_obj(tmp_path, V + S + kind + "\nparm u 0 1\n")


# ---------------------------------------------------------------------------- others


def test_off_with_more_faces_than_announced(tmp_path):
    path = tmp_path / "a.off"
    path.write_text(OFF + "3 0 1 3\n3 1 2 3\n")
    assert "8 words from line 9 on" in io.read(path).report.notes[0]
    path.write_text("{ " + OFF + "}\n")
    assert io.read(path).report.notes == []


def test_geomview_with_more_numbers_than_patches(tmp_path):
    path = tmp_path / "a.bez"
    path.write_text(BEZ + "1 2\n")
    with pytest.raises(FileFormatError, match="the end of the file, got more text"):
        io.read(path)


def test_gmsh_sections(tmp_path):
    path = tmp_path / "a.msh"
    extra = "$elements\n1\n$Endelements\n$Comments\nhello\n$EndComments\n"
    path.write_text(MSH + extra)
    assert io.read(path).report.notes == ["unknown sections, which are not read: $elements"]


def test_abaqus(tmp_path):
    """Nodes in two blocks, comments, lower case, a keyword over two lines, unknown elements."""
    pytest.importorskip("meshio")
    path = tmp_path / "a.inp"
    path.write_text(INP)
    expected = mb.load(path)
    lines = INP.splitlines()
    text = "\n".join(
        (
            *("** a comment", *lines[:3], "*material, name=x", "1.d0", "*node", *lines[3:5]),
            *("*element,", "type=s3", *lines[6:], "*element, type=DC3D99", "7, 1, 2,", "3"),
            *("8, 1, 2", "*include, input=other.inp", "*ngen", "1, 2", ""),
        )
    )
    path.write_text(text.replace("1, 1, 0.5", "1d0, 1., 5.D-1"))
    model = io.read(path)
    assert model.triangles() == expected
    assert [(r.face, r.count) for r in model.report.refused] == [("elements of type DC3D99", 2)]
    notes = "\n".join(model.report.notes)
    assert "'*INCLUDE' is not read" in notes and "'*NGEN' is not read" in notes
    path.write_text(INP + "*PART\n*NODE\n1, 5, 5, 5\n")
    with pytest.raises(FileFormatError, match="a number for each node, got node 1 twice"):
        io.read(path)
    path.write_text(INP.replace("*NODE", "*NODE, SYSTEM=C"))
    with pytest.raises(FileFormatError, match="rectangular coordinates"):
        io.read(path)


def test_nastran(tmp_path):
    """Small and large fields, tabs, comments behind cards, exponents without letter, lower case."""
    pytest.importorskip("meshio")
    path = tmp_path / "a.bdf"
    FILES[".bdf"][0](path)
    expected = mb.load(path)
    text = (
        "$ made by hand\nSOL 101\nCEND\nBEGIN BULK\n"
        "GRID    1               0.      0.      0.      $ the first\n"
        "grid\t2\t\t1.\t0.\t0.\n"
        "GRID,3,,+1.0,10.-1,5.-1\n"
        "GRID*   4                               0.0             1.0+0\n"
        "*       0.0\n"
        "CTRIA3,1,1,1,2,3\nctria3,2,1,1,3,4\nCQUADX4,3,1,1,2,3,4\nENDDATA\n"
    )
    path.write_text(text)
    model = io.read(path)
    assert model.triangles() == expected
    assert model.report.notes == ["'CQUADX4' is not read (1 times): what it makes is missing"]
    path.write_text(re.sub(r"(?s)^.*BEGIN BULK\n|ENDDATA\n", "", text))
    assert io.read(path).triangles() == expected
    path.write_text(text.replace("GRID,3,,", "GRID,3,7,"))
    assert "1 GRID cards name coordinate systems" in " ".join(io.read(path).report.notes)


def test_medit(tmp_path):
    """Counts beside keywords, comments within, versions 3 and 4, sections that are unknown."""
    pytest.importorskip("meshio")
    path = tmp_path / "a.mesh"
    FILES[".mesh"][0](path)
    expected = mb.load(path)
    text = path.read_text()
    edited = text.replace("Formatted 2", "Formatted 4 # long integers").replace("es\n4", "es 4")
    edited = edited.replace("1 0 0 0", "1.d0 0 0 # a corner\n0")
    edited = edited.replace("End", "RequiredVertices\n2\n1\n2\nTrianglesP3\n1\n1 2 3 0\nEnd")
    path.write_text(edited)
    model = io.read(path)
    assert model.triangles() == expected
    assert [(r.face, r.count) for r in model.report.refused] == [("cells 'TrianglesP3'", 1)]
    assert model.report.remarks == ["sections that are not used: RequiredVertices"]
    path.write_text(text.replace("1 0 0 0", "1,0 0 0 0"))
    with pytest.raises(FileFormatError, match="numbers after 'Vertices', got '1,0'"):
        io.read(path)
