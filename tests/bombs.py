"""Small files that ask for much memory or time; used by tests and by benchmarks/fuzz_readers.py."""

from __future__ import annotations

import lzma
import struct
import zlib
from pathlib import Path

__all__ = ["BOMBS"]


def vtu(points: int, cells: int, body: str, head: str = "", tail: str = "") -> str:
    return (
        f'<VTKFile type="UnstructuredGrid" {head}><UnstructuredGrid>'
        f'<Piece NumberOfPoints="{points}" NumberOfCells="{cells}">{body}</Piece>'
        f"</UnstructuredGrid>{tail}</VTKFile>"
    )


def array(name: str, kind: str, values: str, extra: str = 'format="ascii"') -> str:
    return f'<DataArray type="{kind}" Name="{name}" {extra}>{values}</DataArray>'


def grid(points: str, connectivity: str, offsets: str, types: str, data: str = "") -> str:
    count = len(points.split()) // 3
    cells = (
        array("connectivity", "Int64", connectivity)
        + array("offsets", "Int64", offsets)
        + array("types", "UInt8", types)
    )
    three = 'NumberOfComponents="3" format="ascii"'
    body = (
        f"{data}<Points>{array('Points', 'Float64', points, three)}</Points><Cells>{cells}</Cells>"
    )
    return vtu(count, len(types.split()), body)


def compressed(name: str, gib: float) -> bytes:
    """A grid whose arrays are zeros: blocks of 16 MiB, each the same few bytes."""
    block = 1 << 24
    pack = zlib.compress if name == "ZLib" else lambda data: lzma.compress(data, preset=0)
    stored = pack(bytes(block))
    count = int(gib * (1 << 30)) // block
    sizes = [count, block, block] + [len(stored)] * count
    data = struct.pack(f"<{len(sizes)}Q", *sizes) + stored * count
    cells = count * block // 8
    extra = 'format="appended" offset="0"'
    points = array("Points", "Float64", "", f'{extra} NumberOfComponents="3"')
    body = (
        f"<Points>{points}"
        f"</Points><Cells>{array('connectivity', 'Int64', '', extra)}"
        f"{array('offsets', 'Int64', '', extra)}{array('types', 'Int64', '', extra)}</Cells>"
    )
    head = f'header_type="UInt64" compressor="vtk{name}DataCompressor"'
    text = vtu(cells, cells, body, head, '<AppendedData encoding="raw">_\0</AppendedData>')
    before, _mark, after = text.encode().partition(b"\0")
    return before + data + after


def quads(degree: int) -> str:
    size = (degree + 1) ** 2
    return grid("0 0 0 1 0 0 0 1 0", "0 1 2 " * (size // 3) + "0 " * (size % 3), str(size), "77")


def many_degrees() -> str:
    """A quadrilateral of each pair of degrees, all of three points."""
    pairs = [(p, q) for p in range(1, 41) for q in range(1, 41) if p + q <= 24]
    sizes = [(p + 1) * (q + 1) for p, q in pairs]
    ends = [sum(sizes[: k + 1]) for k in range(len(sizes))]
    degrees = " ".join(f"{p} {q} 0" for p, q in pairs)
    three = 'NumberOfComponents="3" format="ascii"'
    data = array("HigherOrderDegrees", "Int64", degrees, three)
    data = f'<CellData HigherOrderDegrees="HigherOrderDegrees">{data}</CellData>'
    rows = "".join("0 " + "1 " * (size - 2) + "2 " for size in sizes)
    types = "77 " * len(pairs)
    return grid("0 0 0 1 0 0 0 1 0", rows, " ".join(map(str, ends)), types, data)


def elevated(lines: int) -> str:
    """Many flat triangles, and one of degree 40."""
    patch = "3\n1\n0 0 0\n1 0 0\n0 1 0\n"
    return patch * lines + "3\n40\n" + "0 0 1 " * 861 + "\n"


def polygon(corners: int) -> str:
    points = "".join(f"{k} {k * k} 0\n" for k in range(corners))
    return f"OFF\n{corners} 1 0\n{points}{corners} {' '.join(map(str, range(corners)))}\n"


def spans(degree: int, u: int, v: int, rows: bool = True) -> str:
    """A B-spline surface of u x v spans, all of one vertex."""
    m, n = u + degree, v + degree
    knots = [" ".join(map(str, range(k + degree + 1))) for k in (m, n)]
    return (
        "v 0 0 0\nv 1 0 0\ncstype bspline\n"
        f"deg {degree} {degree}\nsurf {degree} {m} {degree} {n} {'1 -1 ' * (m * n // 2)}"
        f"{'1 ' * (m * n % 2)}\nparm u {knots[0]}\nparm v {knots[1]}\nend\n"
    )


def trims(pieces: int, uses: int) -> str:
    """A trimming curve of many pieces, used many times."""
    points = "".join(f"vp {k % 2} {k / pieces}\n" for k in range(pieces + 1))
    knots = " ".join(map(str, range(pieces + 1)))
    return (
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\n" + points + "cstype bezier\ndeg 1 1\n"
        f"curv2 {' '.join(map(str, range(1, pieces + 2)))}\nparm u {knots}\nend\n"
        "surf 0 1 0 1 1 2 3 4\nparm u 0 1\nparm v 0 1\n"
        f"trim {f'0 {pieces} 1 ' * uses}\nend\n"
    )


def staircase(steps: int, degree: int) -> str:
    """Trims along parameter lines that cut a patch of high degree into very many."""
    corners = [(k, k) for k in range(steps)] + [(k + 1, k) for k in range(steps)]
    corners = [*sorted(corners), (steps, steps), (0, steps), (0, 0)]
    points = "".join(f"vp {u / steps} {v / steps}\n" for u, v in corners)
    indices = " ".join(map(str, range(1, len(corners) + 1)))
    return (
        f"v 0 0 0\nv 1 0 0\n{points}cstype bezier\ndeg 1\ncurv2 {indices}\n"
        f"parm u {' '.join(map(str, range(len(corners))))}\nend\ndeg {degree} {degree}\n"
        f"surf 0 1 0 1 {'1 2 ' * ((degree + 1) ** 2 // 2)}{'1 ' * ((degree + 1) % 2)}\n"
        f"parm u 0 1\nparm v 0 1\ntrim 0 {len(corners) - 1} 1\nend\n"
    )


def msh(count: int) -> str:
    """Quadrilaterals of order 10, all of the same nodes."""
    row = " ".join(map(str, range(1, 122)))
    nodes = "".join(f"{k} {k % 11} {k // 11} 0\n" for k in range(1, 122))
    cells = "".join(f"{k} 51 0 {row}\n" for k in range(1, count + 1))
    return (
        f"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n121\n{nodes}$EndNodes\n"
        f"$Elements\n{count}\n{cells}$EndElements\n"
    )


#: Name of the file: a function that makes its contents, of less than a megabyte.
BOMBS = {
    "lzma.vtu": lambda: compressed("LZMA", 5),
    "zlib.vtu": lambda: compressed("ZLib", 0.9),
    "deep.vtu": lambda: "<VTKFile>" + "<a>" * 100_000,
    "deep_closed.vtu": lambda: "<VTKFile>" + "<a>" * 70_000 + "</a>" * 70_000 + "</VTKFile>",
    "wide.vtu": lambda: "<VTKFile>" + "<a/>" * 240_000 + "</VTKFile>",
    "attributes.vtu": lambda: "<VTKFile " + "".join(f'a{k}="" ' for k in range(90_000)) + "/>",
    "entities.vtu": lambda: (
        '<!DOCTYPE VTKFile [<!ENTITY a0 "aaaaaaaaaa">'
        + "".join(f'<!ENTITY a{k + 1} "{f"&a{k};" * 10}">' for k in range(12))
        + "]><VTKFile>&a12;</VTKFile>"
    ),
    "quad_100.vtu": lambda: quads(100),
    "quad_400.vtu": lambda: quads(400),
    "many_degrees.vtu": many_degrees,
    "polygon_20000.off": lambda: polygon(20_000),
    "polygon_40000.off": lambda: polygon(40_000),
    "polygon.bv": lambda: polygon(20_000).replace("OFF", "1").replace("20000 1 0", "20000 1"),
    "many_faces.off": lambda: "OFF\n3 120000 0\n0 0 0\n1 0 0\n0 1 0\n" + "3 0 1 2\n" * 120_000,
    "many_kinds.off": lambda: (
        "OFF\n3 600 0\n0 0 0\n1 0 0\n0 1 0\n"
        + "".join(f"{k} {'0 1 2 ' * (k // 3)}{'0 ' * (k % 3)}\n" for k in range(3, 603))
    ),
    "elevated.bv": lambda: elevated(40_000),
    "tensors.bv": lambda: "".join(
        f"5 {p} {q}\n" + "0 0 0 " * ((p + 1) * (q + 1)) + "\n"
        for p, q in [(40 - k // 10, 40 - k % 10) for k in range(25)]
    ),
    "spans_30.obj": lambda: spans(30, 200, 200),
    "spans_3.obj": lambda: spans(3, 500, 500),
    "row_30.obj": lambda: spans(30, 3000, 1),
    "trims.obj": lambda: trims(10_000, 50_000),
    "staircase_30.obj": lambda: staircase(300, 30),
    "staircase_1.obj": lambda: staircase(10_000, 1),
    "words.obj": lambda: "v 0 0 0\n" + "x \\\n" * 240_000,
    "long_line.obj": lambda: "v " + "1 " * 450_000,
    "digits.obj": lambda: "v " + "9" * 900_000 + " 0 0\n",
    "brackets.bez": lambda: "{ " * 450_000,
    "order_10.msh": lambda: msh(2000),
    "sections.msh": lambda: "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n" + "$a\n$Enda\n" * 90_000,
    "nested.toml": lambda: "a=" + "[" * 100_000,
    "nested_lines.toml": lambda: "a=" + "[\n" * 100_000,
    "tables.toml": lambda: "a=" + "{b=" * 30_000,
    "dots.toml": lambda: ".".join("a" * 60_000) + "=1",
    "dotted_lines.toml": lambda: "".join(f"a{k}.{'.'.join('a' * 58)}=1\n" for k in range(3000)),
    "dotted_table.toml": lambda: "[" + ".".join("a" * 60_000) + "]",
    "digits.toml": lambda: "a=" + "9" * 900_000,
    "string.toml": lambda: 'a="' + "\\" * 900_000,
    "large.toml": lambda: "#\n" * 499_000,
}


def write(name: str, folder: Path) -> Path:
    """Write a file and return its path."""
    data = BOMBS[name]()
    path = folder / name
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    return path
