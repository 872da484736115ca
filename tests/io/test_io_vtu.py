"""Bézier triangles in VTK's XML files."""

from __future__ import annotations

import base64
import lzma
import os
import re
import struct
import warnings
import zlib

import numpy as np
import pytest

import mitsuba_bezier as mb
from mitsuba_bezier import io
from mitsuba_bezier.errors import FileFormatError
from mitsuba_bezier.geometry import bernstein
from mitsuba_bezier.geometry.triangles import BezierTriangles
from mitsuba_bezier.io import FormatWarning
from mitsuba_bezier.io.vtk import lz4
from mitsuba_bezier.io.vtk import reader as vtu
from mitsuba_bezier.io.vtk import writer as vtu_writer
from mitsuba_bezier.io.vtk.xml import decode_bytes


def random_nets(n: int, count: int = 3, seed: int = 0, *, ideal: bool = False) -> BezierTriangles:
    rng = np.random.default_rng(seed + n)
    nets = rng.normal(size=(count, bernstein.size(n), 4))
    nets[..., 3] = rng.uniform(0.5, 2, nets.shape[:2])
    if ideal:
        nets[:, 1, 3] = 0  # a control vector
        nets[0, 2] = 0  # the zero vector
        nets[1, 0, 3] *= -1
    return BezierTriangles(nets)


# The example of the VTK documentation's style, written by hand: one quadratic triangle whose
# points are its own VTK numbers, so the order of points can be read off.
HAND = """<?xml version="1.0"?>
<VTKFile type="UnstructuredGrid" version="0.1" byte_order="LittleEndian">
 <UnstructuredGrid>
  <Piece NumberOfPoints="6" NumberOfCells="1">
   <PointData{flag}>
    <DataArray type="Float64" Name="RationalWeights" format="ascii">1 1 1 2 3 4</DataArray>
   </PointData>
   <Points>
    <DataArray type="Float64" NumberOfComponents="3" format="ascii">
     0 0 0  1 0 0  2 0 0  3 0 0  4 0 0  5 0 0
     <InformationKey name="L2_NORM_RANGE"><Value index="0">7</Value></InformationKey>
    </DataArray>
   </Points>
   <Cells>
    <DataArray type="Int32" Name="connectivity" format="ascii">0 1 2 3 4 5</DataArray>
    <DataArray type="Int32" Name="offsets" format="ascii">6</DataArray>
    <DataArray type="UInt8" Name="types" format="ascii">{kind}</DataArray>
   </Cells>
  </Piece>
 </UnstructuredGrid>
</VTKFile>
"""


def hand(flag=' RationalWeights="RationalWeights"', kind="76", change=("", "")) -> str:
    return HAND.format(flag=flag, kind=kind).replace(*change)


def put(tmp_path, text: str | bytes, name: str = "a.vtu"):
    path = tmp_path / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


# ---------------------------------------------------------------------------- reading


def test_order_of_points_and_weights(tmp_path):
    t = io.load(put(tmp_path, hand()))
    # rows (200) (110) (101) (020) (011) (002) are VTK's corner 0, edge 01, edge 20, corner 1,
    # edge 12, corner 2
    number = [0, 3, 5, 1, 4, 2]
    weight = [1, 2, 4, 1, 3, 1]
    expected = [[a * w, 0, 0, w] for a, w in zip(number, weight)]
    assert t.control_points[0].tolist() == expected


# Listed by VTK 9.7 (vtkHigherOrderTriangle.BarycentricIndex), turned to exponents of the
# corners 0, 1, 2.
VTK_QUINTIC = "500 050 005 410 320 230 140 041 032 023 014 104 203 302 401 311 131 113 221 122 212"


def test_order_of_points_of_degree_five():
    rows = [bernstein.row(5, int(t[0]), int(t[1])) for t in VTK_QUINTIC.split()]
    assert vtu_writer.point_order(5).tolist() == rows


@pytest.mark.parametrize("n", range(1, 10))
def test_order_is_a_permutation(n):
    assert sorted(vtu_writer.point_order(n)) == list(range(bernstein.size(n)))


def test_unflagged_weights_are_named_and_not_used(tmp_path):
    with pytest.warns(FormatWarning, match='<PointData RationalWeights="RationalWeights">'):
        t = io.load(put(tmp_path, hand(flag="")))
    assert (t.weights == 1).all()


@pytest.mark.parametrize("flag", ["", ' RationalWeights="RationalWeights"'])
def test_polyhedra_are_no_bezier_triangles(tmp_path, flag):
    with pytest.raises(FileFormatError, match=r"expected Bézier triangles.*VTK_POLYHEDRON"):
        io.load(put(tmp_path, hand(flag, kind="42")))


def test_other_cells_are_reported(tmp_path):
    text = hand().replace('NumberOfCells="1"', 'NumberOfCells="3"')
    text = text.replace(">6<", ">6 9 10<").replace("5</", "5 0 1 2 0</").replace(">76", ">76 42 1")
    path = put(tmp_path, text)
    with pytest.warns(FormatWarning, match="1 of 2 faces converted.*VTK_POLYHEDRON"):
        assert len(io.load(path)) == 1
    report = io.read(path).report
    assert (report.faces, report.converted) == (2, 1)
    assert [(r.face, r.count) for r in report.refused] == [("cells of type 42", 1)]
    assert report.remarks == ["1 cells of type 1 (VTK_VERTEX: no surface)"]


def test_mixed_degrees(tmp_path):
    one, two, four = random_nets(1, 2), random_nets(2, 3), random_nets(4, 1)
    path = tmp_path / "mixed.vtu"
    vtu_writer.write([four, one, two], path)
    assert io.load_groups(path) == [one, two, four]
    joined = io.load(path)
    assert joined.degree == 4
    # the order of the file is kept
    assert joined[:1] == four
    assert joined[1:3] == one.elevate(3)


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 6, 8, 9])
@pytest.mark.parametrize("encoding", ["ascii", "binary", "appended"])
@pytest.mark.parametrize("ideal", [False, True])
def test_round_trip_is_lossless(tmp_path, n, encoding, ideal):
    nets = random_nets(n, ideal=ideal)
    path = tmp_path / "a.vtu"
    vtu_writer.write(nets, path, encoding)
    assert io.load(path) == nets  # every bit


def test_nets_at_infinity_and_far_apart_scales(tmp_path):
    nets = random_nets(2, 4).control_points.copy()
    nets[0, :, 3] = 0
    nets[1] *= 1e-200
    nets[2, 0, 3] = 1e-320  # its Euclidean point overflows
    nets[3] *= -1
    nets[3, 0, 3] = 0
    path = tmp_path / "a.vtu"
    vtu_writer.write(BezierTriangles(nets), path)
    assert np.array_equal(io.load(path).control_points, nets)


def test_polynomial_nets_carry_no_weights(tmp_path):
    nets = random_nets(3).control_points.copy()
    nets[..., 3] = 1
    vtu_writer.write(BezierTriangles(nets), tmp_path / "a.vtu", "ascii")
    text = (tmp_path / "a.vtu").read_text()
    assert "RationalWeights" not in text and vtu.HOMOGENEOUS not in text
    assert np.array_equal(io.load(tmp_path / "a.vtu").control_points, nets)


def test_points_changed_by_another_program(tmp_path):
    path = tmp_path / "a.vtu"
    vtu_writer.write(random_nets(2), path, "ascii")
    text = path.read_text()
    first = text.index('Name="Points"')
    line_end = text.index("\n", first) + 1
    path.write_text(text[:line_end] + "5" + text[line_end:])
    with pytest.raises(FileFormatError, match=r"HomogeneousPoints.*agree"):
        io.load(path)


# ---------------------------------------------------------------------------- encodings

HEADERS = {"UInt32": "I", "UInt64": "Q"}


def lz4_literals(data: bytes) -> bytes:
    """Encode as one run of literals, which every LZ4 decoder takes."""
    if len(data) < 15:
        return bytes([len(data) << 4]) + data
    full, rest = divmod(len(data) - 15, 255)
    return b"\xf0" + b"\xff" * full + bytes([rest]) + data


COMPRESS = {
    "": None,
    "vtkZLibDataCompressor": zlib.compress,
    "vtkLZMADataCompressor": lzma.compress,
    "vtkLZ4DataCompressor": lz4_literals,
}


def encode(nets: BezierTriangles, form, order, header, compressor, block=64, apart=False) -> bytes:
    """Write a file as the format's description says; independent of the writer under test."""
    e = "<" if order == "LittleEndian" else ">"
    h = e + HEADERS[header]
    net = nets.control_points[:, vtu_writer.point_order(nets.degree)].reshape(-1, 4)
    count, size = len(net), nets.control_points.shape[1]
    appended = b""

    def array(values, typename, code, name, components=1):
        nonlocal appended
        data = struct.pack(e + code * np.size(values), *np.ravel(values).tolist())
        if COMPRESS[compressor]:
            parts = [COMPRESS[compressor](data[i : i + block]) for i in range(0, len(data), block)]
            sizes = [len(p) for p in parts]
            head = b"".join(
                struct.pack(h, x) for x in [len(parts), block, len(data) % block, *sizes]
            )
            data = b"".join(parts)
            together = False
        else:
            head, together = struct.pack(h, len(data)), not apart
        tag = f'<DataArray type="{typename}" Name="{name}" NumberOfComponents="{components}"'
        if form == "raw":
            stored = head + data
        elif together:
            stored = base64.b64encode(head + data)
        else:
            stored = base64.b64encode(head) + base64.b64encode(data)
        if form == "inline":
            return f'{tag} format="binary">\n {stored.decode()}\n</DataArray>'
        at = len(appended)
        appended += stored
        return f'{tag} format="appended" offset="{at}"/>'

    body = [
        f'<VTKFile type="UnstructuredGrid" version="1.0" byte_order="{order}"',
        f' header_type="{header}"' + (f' compressor="{compressor}"' if compressor else "") + ">",
        f'<UnstructuredGrid><Piece NumberOfPoints="{count}" NumberOfCells="{len(nets)}">',
        '<PointData RationalWeights="w">',
        array(net[:, 3], "Float64", "d", "w"),
        "</PointData><Points>",
        array(net[:, :3] / net[:, 3:], "Float64", "d", "Points", 3),
        "</Points><Cells>",
        array(np.arange(count), "Int64", "q", "connectivity"),
        array(size * np.arange(1, len(nets) + 1), "Int32", "i", "offsets"),
        array([76] * len(nets), "UInt8", "B", "types"),
        "</Cells></Piece></UnstructuredGrid>",
    ]
    text = "\n".join(body).encode()
    if form != "inline":
        text += b'<AppendedData encoding="%s">\n _' % form.encode() + appended + b"</AppendedData>"
    return text + b"</VTKFile>"


@pytest.mark.parametrize("form", ["inline", "raw", "base64"])
@pytest.mark.parametrize("order", ["LittleEndian", "BigEndian"])
@pytest.mark.parametrize("header", list(HEADERS))
@pytest.mark.parametrize("compressor", list(COMPRESS))
def test_encodings(tmp_path, form, order, header, compressor):
    nets = random_nets(3)
    for block in (64, 48, 8):  # 48: no partial block at the end
        path = put(tmp_path, encode(nets, form, order, header, compressor, block))
        # 1e-15: the file holds x/w, one rounding; the net is (x/w) w, another
        np.testing.assert_allclose(
            io.load(path).control_points, nets.control_points, rtol=1e-15, atol=0
        )


@pytest.mark.parametrize("form", ["inline", "base64"])
def test_header_in_a_run_of_its_own(tmp_path, form):
    nets = random_nets(3)
    path = put(tmp_path, encode(nets, form, "LittleEndian", "UInt64", "", apart=True))
    np.testing.assert_allclose(
        io.load(path).control_points, nets.control_points, rtol=1e-15, atol=0
    )


def test_lz4_block_with_matches():
    # token 0x52: 5 literals, then a match of 2 + 4 bytes 3 back (overlapping); last: 1 literal
    block = b"\x52abcde\x03\x00" + b"\x10!"
    assert lz4.decompress_block(block, 12) == b"abcdecdecde!"
    long = b"\x1fa\x01\x00" + b"\xff\x05" + b"\x00"  # 15 + 255 + 5 + 4 times "a" more
    assert lz4.decompress_block(long, 280) == b"a" * 280
    for size, bad in ((12, b"\x52abcde\x09\x00"), (12, b"\x52abc"), (3, block), (13, block)):
        with pytest.raises(ValueError):
            lz4.decompress_block(bad, size)


def test_base64_in_several_runs():
    data = b"A" * 8 + b"xyz" * 5
    text = base64.b64encode(data[:8]) + base64.b64encode(data[8:])
    for count in range(len(data) + 1):
        assert decode_bytes(text, count)[0] == data[:count]


# ---------------------------------------------------------------------------- bad input


def test_missing_file_folder_and_suffix(tmp_path):
    nets = random_nets(2)
    with pytest.raises(FileFormatError, match="does not exist"):
        io.load(tmp_path / "none.vtu")
    (tmp_path / "folder.vtu").mkdir()
    with pytest.raises(FileFormatError, match="which is a folder"):
        io.load(tmp_path / "folder.vtu")
    with pytest.raises(FileFormatError, match=r"read \(.*\.vtu.*\), got suffix '\.xyz'"):
        io.load(tmp_path / "none.xyz")
    with pytest.raises(FileFormatError, match=r"written \(.*\.vtu.*\), got suffix ''"):
        mb.save(nets, tmp_path / "none")
    with pytest.raises(FileFormatError, match="a folder that exists"):
        mb.save(nets, tmp_path / "no" / "a.vtu")
    with pytest.raises(FileFormatError, match="the name of a file"):
        mb.save(nets, tmp_path / "folder.vtu")


def test_write_is_one_step(tmp_path, monkeypatch):
    path = tmp_path / "a.vtu"
    mb.save(random_nets(2), path)
    before = path.read_bytes()

    def fail(*_args):
        raise OSError("disk full")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(FileFormatError, match="disk full"):
        mb.save(random_nets(3), path)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["a.vtu"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("4 0 0  5", "4 0 x  5"), "line 10: expected numbers.*'x'"),
        (("4 0 0  5", "4 0  5"), "line 9: expected 18 values.*got 17"),
        (("3 4 5<", "3 4 6<"), "point numbers from 0 to 5.*cell 0"),
        (("3 4 5<", "3 4 -1<"), "point numbers from 0 to 5"),
        ((">6<", ">5<"), "expected 5 values.*got 6"),
        ((">6<", ">-6<"), "offsets that grow"),
        ((">6<", ">9223372036854775807<"), "offsets that grow"),
        (('Points="6"', 'Points="999999999999"'), "line 4: expected NumberOfPoints that fits"),
        (('Cells="1"', 'Cells="99999999999999999999999"'), "expected NumberOfCells that fits"),
        (('Points="6"', 'Points="six"'), "NumberOfPoints to be a number, got 'six'"),
        (('Points="6"', 'Points="6' + "0" * 5000 + '"'), "NumberOfPoints to be a number"),
        (('Name="offsets"', 'Name="offs"'), "a DataArray 'offsets'"),
        (('type="Int32"', 'type="Float64"'), "an integer type of DataArray 'offsets'"),
        (('type="Int32"', 'type="Int31"'), "'Int31'"),
        (('format="ascii"', 'format="morse"'), "'morse'"),
        (("LittleEndian", "MiddleEndian"), "byte_order to be one of"),
        (("LittleEndian", 'LittleEndian" compressor="vtkZip'), "compressor to be one of"),
        (("</Cells>", ""), "well-formed.*mismatched tag"),
        (('type="UnstructuredGrid"', 'type="PolyData"'), "type 'UnstructuredGrid', got 'PolyD"),
        (('<?xml version="1.0"?>', '<!DOCTYPE a [<!ENTITY b "c">]>'), "got a DOCTYPE"),
        (("1 1 1 2", "1 1 1 nan"), "face 0.*not finite"),
        ((">1 1 1 2 3 4<", ">0 0 0 0 0 0<"), "face 0.*only zero"),
        (('NumberOfComponents="3"', 'NumberOfComponents="2"'), "points of 3 components"),
        (('RationalWeights="RationalWeights"', 'RationalWeights="w"'), "'w' named as weights"),
    ],
)
def test_damaged_text(tmp_path, change, message):
    text = hand()
    assert change[0] in text
    with pytest.raises(FileFormatError, match=message) as caught:
        io.load(put(tmp_path, text.replace(*change)))
    assert "\n" not in str(caught.value) and "a.vtu" in str(caught.value)


@pytest.mark.parametrize("size", [4, 5, 7])
def test_no_triangular_number(tmp_path, size):
    text = hand().replace(">6<", f">{size}<")
    text = text.replace("0 1 2 3 4 5<", " ".join("0" * size) + "<")
    with pytest.raises(FileFormatError, match=f"{size} points in cell 0"):
        io.load(put(tmp_path, text))


@pytest.mark.parametrize("form", ["inline", "raw", "base64"])
@pytest.mark.parametrize("compressor", list(COMPRESS))
def test_truncated(tmp_path, form, compressor):
    """Cut anywhere: an error of ours with the name of the file, never another exception."""
    whole = encode(random_nets(2, 2), form, "LittleEndian", "UInt32", compressor)
    closing = len("</AppendedData></VTKFile>") if form != "inline" else 0
    for cut in range(0, len(whole) - closing - 1, 13):
        with pytest.raises(FileFormatError, match=r"a\.vtu"):
            io.load(put(tmp_path, whole[:cut]))


@pytest.mark.parametrize("compressor", [c for c in COMPRESS if c])
def test_forged_block_counts(tmp_path, compressor):
    """Counts in binary headers are checked before anything of that size is made."""
    whole = encode(random_nets(2, 2), "raw", "LittleEndian", "UInt64", compressor)  # two blocks
    start = whole.index(b"_", whole.index(b"<AppendedData")) + 1
    # the fields: blocks, block size, partial block, first compressed size
    for field in range(4):
        for value in (0, 2**31, 2**62, 2**64 - 1):
            at = start + 8 * field
            bad = whole[:at] + struct.pack("<Q", value) + whole[at + 8 :]
            with pytest.raises(FileFormatError, match=r"byte |line 5: expected 12 values"):
                io.load(put(tmp_path, bad))


def test_zlib_bomb(tmp_path):
    """A block that decodes to more than it says is cut off."""
    whole = encode(random_nets(2, 2), "inline", "LittleEndian", "UInt32", "")
    bomb = zlib.compress(bytes(1 << 24))
    data = struct.pack("<4I", 1, 96, 96, len(bomb))
    text = base64.b64encode(data).decode() + base64.b64encode(bomb).decode()
    whole = whole.replace(b'"UInt32">', b'"UInt32" compressor="vtkZLibDataCompressor">')
    start = whole.index(b'format="binary">') + len('format="binary">')
    whole = whole[:start] + text.encode() + whole[whole.index(b"</DataArray>") :]
    with pytest.raises(FileFormatError):
        io.load(put(tmp_path, whole))


# ---------------------------------------------------------------------------- VTK itself


def vtk_values(path, uv: np.ndarray) -> tuple[np.ndarray, object]:
    """Evaluate all cells with VTK at our (u, v): VTK's (r, s) are (v, w)."""
    vtk = pytest.importorskip("vtk")
    reader = vtk.vtkXMLUnstructuredGridReader()
    reader.SetFileName(str(path))
    reader.Update()
    grid = reader.GetOutput()
    out = np.empty((grid.GetNumberOfCells(), len(uv), 3))
    for c in range(grid.GetNumberOfCells()):
        cell = vtk.vtkGenericCell()
        grid.GetCell(c, cell)
        assert cell.GetCellType() == 76
        weights = [0.0] * cell.GetNumberOfPoints()
        sub, x = vtk.reference(0), [0.0] * 3
        for q, (u, v) in enumerate(uv):
            cell.EvaluateLocation(sub, (v, 1 - u - v, 0), x, weights)
            out[c, q] = x
    return out, grid


@pytest.mark.parametrize("n", range(1, 9))
@pytest.mark.parametrize("encoding", ["ascii", "binary", "appended"])
def test_vtk_evaluates_what_we_write(tmp_path, n, encoding):
    nets = random_nets(n)
    path = tmp_path / "a.vtu"
    vtu_writer.write(nets, path, encoding)
    uv = np.random.default_rng(n).dirichlet([1, 1, 1], 20)[:, :2]
    got, _grid = vtk_values(path, uv)
    for p in range(len(nets)):
        # 1e-12 as required; the rounding of up to 45 terms of size 10 is 1e-14
        np.testing.assert_allclose(got[p], nets.points(p, uv), rtol=0, atol=1e-12)


def test_vtk_shows_control_points_at_infinity(tmp_path):
    # a half cylinder's quarter: conic sections with a control vector
    nets = random_nets(2, ideal=False).control_points.copy()
    nets[:, 1, 3] = 0
    path = tmp_path / "a.vtu"
    vtu_writer.write(BezierTriangles(nets), path)
    uv = np.random.default_rng(0).dirichlet([1, 1, 1], 20)[:, :2]
    got, _grid = vtk_values(path, uv)
    for p in range(len(nets)):
        # the stand-in weight is 2^-20 of the largest, so 1e-6 relative, times points of size 10
        np.testing.assert_allclose(got[p], BezierTriangles(nets).points(p, uv), rtol=0, atol=1e-4)


@pytest.mark.parametrize("mode", ["Ascii", "Binary", "Appended", "AppendedBase64"])
@pytest.mark.parametrize("compressor", ["None", "ZLib", "LZ4", "LZMA"])
@pytest.mark.parametrize("order", ["LittleEndian", "BigEndian"])
@pytest.mark.parametrize("header", ["UInt32", "UInt64"])
def test_we_read_what_vtk_writes(tmp_path, mode, compressor, order, header):
    vtk = pytest.importorskip("vtk")
    nets = random_nets(4, 40)  # 600 points: several blocks
    vtu_writer.write(nets, tmp_path / "a.vtu")
    _values, grid = vtk_values(tmp_path / "a.vtu", np.zeros((0, 2)))
    grid.GetPointData().RemoveArray(vtu.HOMOGENEOUS)
    writer = vtk.vtkXMLUnstructuredGridWriter()
    writer.SetInputData(grid)
    writer.SetFileName(str(tmp_path / "b.vtu"))
    getattr(writer, f"SetDataModeTo{mode.removesuffix('Base64')}")()
    writer.SetEncodeAppendedData(mode.endswith("Base64"))
    getattr(writer, f"SetCompressorTypeTo{compressor}")()
    getattr(writer, f"SetByteOrderTo{order}")()
    getattr(writer, f"SetHeaderTypeTo{header}")()
    writer.SetBlockSize(1024)
    assert writer.Write() == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        back = io.load(tmp_path / "b.vtu")
    # 1e-15: two roundings, as above
    np.testing.assert_allclose(back.control_points, nets.control_points, rtol=1e-15, atol=0)


# ---------------------------------------------------------------------------- ghost cells


def marked(text: str, cells: str = "", points: str = "", name: str = "vtkGhostType") -> str:
    """Add arrays of ghosts to the only piece of a file."""
    array = '<DataArray type="UInt8" Name="{}" format="ascii">{}</DataArray>'
    for tag, values in (("CellData", cells), ("PointData", points)):
        if values:
            own = array.format(name, values)
            if f"<{tag}" in text:
                text = re.sub(rf"<{tag}([^>]*?)/?>", rf"<{tag}\1>{own}", text, count=1)
                if f"</{tag}>" not in text:
                    text = text.replace(own, f"{own}</{tag}>", 1)
            else:
                text = text.replace("<Cells>", f"<{tag}>{own}</{tag}><Cells>", 1)
    return text


@pytest.mark.parametrize("name", ["vtkGhostType", "vtkGhostLevels"])
def test_ghost_cells_are_left_out(tmp_path, name):
    """Copies (1), hidden (32) and refined (8) cells; other bits hide nothing."""
    path = tmp_path / "a.vtu"
    ball = mb.sphere(cover="octants")
    attributes = {"face_number": np.arange(8.0)[:, None], "texcoords": np.ones((8, 3, 2))}
    io.save(ball, path, encoding="ascii", attributes=attributes)
    bits = [0, 1, 32, 8, 33, 2 + 4 + 16, 0, 0]
    if name == "vtkGhostLevels":
        bits = [0, 1, 2, 1, 1, 0, 0, 0]
    path.write_text(marked(path.read_text(), cells=" ".join(map(str, bits)), name=name))
    model = io.read(path)
    kept = [0, 5, 6, 7]
    assert model.triangles() == ball[kept]
    assert model.sources[0].tolist() == kept
    assert (model.report.faces, model.report.refused) == (4, [])
    (note,) = model.report.notes
    assert note.startswith("4 ghost cells")
    with pytest.warns(FormatWarning, match="4 ghost cells"):
        mb.load(path)
    found = io.load_attributes(path)
    assert found["face_number"].ravel().tolist() == kept
    assert found["texcoords"].shape == (4, 3, 2)


def test_cells_of_hidden_points_are_left_out(tmp_path):
    path = tmp_path / "a.vtu"
    ball = mb.sphere(cover="octants")
    io.save(ball, path, encoding="ascii", attributes={"face_x": np.arange(8.0)[:, None]})
    bits = np.zeros((8, 15), int)
    bits[2, 7], bits[5, 0], bits[6, 1] = 2, 3, 1  # the last one is a copy, not hidden
    path.write_text(marked(path.read_text(), points=" ".join(map(str, bits.ravel()))))
    kept = [0, 1, 3, 4, 6, 7]
    assert mb.io.read(path).triangles() == ball[kept]
    assert io.load_attributes(path)["face_x"].ravel().tolist() == kept


def test_nothing_but_ghosts(tmp_path):
    path = tmp_path / "a.vtu"
    io.save(mb.sphere(cover="octants"), path, encoding="ascii")
    path.write_text(marked(path.read_text(), cells="1 " * 8))
    with pytest.raises(FileFormatError, match="got only ghost cells in this file"):
        io.read(path)


@pytest.mark.parametrize("bits, faces", [((0, 0), 6), ((0, 1), 3), ((1, 0), 3), ((0, 32), 4)])
def test_ghosts_of_a_volume_mesh(tmp_path, bits, faces):
    """Two tetrahedra share a face: it is no boundary beside a copy, but it is beside a hole."""
    path = tmp_path / "a.vtu"
    unit = np.concatenate([np.zeros((1, 3)), np.eye(3), [[1.0, 1, 1]]])
    pairs = [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3), (1, 4), (2, 4), (3, 4)]
    points = np.concatenate([unit, [(unit[a] + unit[b]) / 2 for a, b in pairs]])
    # VTK's quadratic tetrahedron: corners, then edges 01, 12, 20, 03, 13, 23
    cells = [0, 1, 2, 3, 5, 6, 7, 8, 9, 10], [1, 2, 3, 4, 6, 10, 9, 11, 12, 13]
    text = (
        '<VTKFile type="UnstructuredGrid"><UnstructuredGrid><Piece NumberOfPoints="14" '
        'NumberOfCells="2"><Points><DataArray type="Float64" NumberOfComponents="3" '
        f'format="ascii">{" ".join(map(str, points.ravel()))}</DataArray></Points><Cells>'
        '<DataArray type="Int64" Name="connectivity" format="ascii">'
        f"{' '.join(map(str, np.ravel(cells)))}</DataArray>"
        '<DataArray type="Int64" Name="offsets" format="ascii">10 20</DataArray>'
        '<DataArray type="UInt8" Name="types" format="ascii">24 24</DataArray>'
        "</Cells></Piece></UnstructuredGrid></VTKFile>"
    )
    path.write_text(marked(text, cells=" ".join(map(str, bits))))
    assert io.read(path).report.converted == faces
