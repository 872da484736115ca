"""Small files that ask for much: under 1 GiB and 10 s of processor, or one error (`bombs`)."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import bombs
import numpy as np
import pytest

import mitsuba_bezier as mb
from mitsuba_bezier import io
from mitsuba_bezier.errors import FileFormatError
from mitsuba_bezier.geometry import bernstein
from mitsuba_bezier.geometry.tensor import tensor_matrices
from mitsuba_bezier.io import limits
from mitsuba_bezier.io.cells import MAX_LAGRANGE

#: Opens each file of a folder with as much as a file may take, beyond what the imports took.
WORKER = """
import json, resource, sys, time
from pathlib import Path
from mitsuba_bezier.cli import info, main
from mitsuba_bezier.errors import BezierError
from mitsuba_bezier.io import bezierview, geomview, gmsh, load, obj
from mitsuba_bezier.io.vtk import reader as vtu
from mitsuba_bezier.verification.thresholds import Thresholds
taken = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (taken + (1 << 30),) * 2)
for path in sys.argv[1:]:
    print(json.dumps(Path(path).name), end=" ", flush=True)
    resource.setrlimit(resource.RLIMIT_CPU, (int(time.process_time()) + 11, resource.RLIM_INFINITY))
    try:
        (Thresholds.load if path.endswith(".toml") else load)(path)
        print(json.dumps("read"), flush=True)
    except BezierError as error:
        print(json.dumps(str(error)), flush=True)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="limits of address space")
@pytest.mark.parametrize("suffix", sorted({Path(name).suffix for name in bombs.BOMBS}))
def test_bombs(tmp_path, suffix):
    names = [name for name in bombs.BOMBS if name.endswith(suffix)]
    paths = [bombs.write(name, tmp_path) for name in names]
    assert all(path.stat().st_size < 10**6 for path in paths)
    command = [sys.executable, "-W", "ignore", "-c", WORKER, *map(str, paths)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    told = dict(line_pair(line) for line in done.stdout.splitlines())
    assert done.returncode == 0, (done.stderr[-1000:], done.stdout[-1000:])
    assert list(told) == names
    for name, text in told.items():
        assert "\n" not in text and (text == "read" or name in text), text


def line_pair(line: str) -> tuple[str, str]:
    name, end = json.JSONDecoder().raw_decode(line)
    return name, json.loads(line[end:])


def test_memory_is_named_with_the_way_to_raise_it(tmp_path):
    path = bombs.write("spans_3.obj", tmp_path)
    words = "--read-memory or MITSUBA_BEZIER_READ_MEMORY sets this limit"
    with pytest.raises(FileFormatError, match=words):
        io.read(path)
    path.write_text(bombs.spans(3, 60, 60))
    with limits.chosen(memory=0.01), pytest.raises(FileFormatError, match=r"in 0\.01 GiB"):
        io.read(path)
    assert len(io.read(path).triangles()) == 2 * 60 * 60


def test_patches_of_one_degree_are_counted_first(tmp_path):
    """What is small as groups can be large as one array."""
    path = bombs.write("elevated.bv", tmp_path)
    assert [g.degree for g in io.load_groups(path)] == [1, 40]
    with pytest.raises(FileFormatError, match="34440861 control points of degree 40"):
        mb.load(path)


def test_memory_that_runs_out_is_one_error(tmp_path, monkeypatch, capsys):
    from mitsuba_bezier.cli.main import main
    from mitsuba_bezier.io import bezierview

    def full(*_arguments, **_options):
        raise MemoryError

    path = tmp_path / "a.bv"
    io.save(mb.sphere(), path)
    monkeypatch.setattr(bezierview, "Tokens", full)
    assert main(["info", str(path)]) == 2
    text = capsys.readouterr().err
    assert text.count("\n") == 1 and "GiB of memory" in text
    monkeypatch.setattr(io, "read", full)
    assert main(["info", str(path)]) == 2
    assert (
        capsys.readouterr().err == "mitsuba-bezier: error: this takes more memory than there is\n"
    )


@pytest.mark.parametrize("n", [17, 20])
def test_elevation_of_high_degree(n):
    """Without matrices: the same surface."""
    rng = np.random.default_rng(n)
    net = mb.BezierTriangles(1 + rng.random((2, bernstein.size(n), 4)))
    up = net.elevate(2)
    uv = rng.dirichlet([1, 1, 1], 9)[:, :2]
    # 1e-14: sums of 200 products
    np.testing.assert_allclose(up.points(1, uv), net.points(1, uv), rtol=1e-14)


@pytest.mark.parametrize("degrees", [(1, 2), (9, 7), (16, 16), (30, 10)])
def test_tensor_matrices_of_any_degree(degrees):
    """Every row sums to 1, and the triangles meet the patch: in s = u, t = v."""
    p, q = degrees
    first, second = tensor_matrices(p, q)
    # 1e-13: sums of up to 1000 terms, each rounded once
    np.testing.assert_allclose(first.sum(axis=1), 1, rtol=1e-13)
    # coefficients i / p and j / q give s and t: u and v in the first, 1 - u and 1 - v in the second
    s = np.repeat(np.arange(p + 1) / p, q + 1)
    t = np.tile(np.arange(q + 1) / q, p + 1)
    u, v, _w = (bernstein.multi_indices(p + q) / (p + q)).T
    np.testing.assert_allclose([first @ s, first @ t], [u, v], atol=1e-13)
    np.testing.assert_allclose([second @ s, second @ t], [1 - u, 1 - v], atol=1e-13)


@pytest.mark.parametrize("degree, read", [(MAX_LAGRANGE, True), (MAX_LAGRANGE + 1, False)])
def test_degree_of_interpolated_cells(tmp_path, degree, read):
    """Above, rounding grows to 1e5 of the size at degree 40: refused, not drawn wrong."""
    from mitsuba_bezier.io.lattices import triangle_lattice

    lattice = triangle_lattice(degree) / degree
    points = np.column_stack([lattice[:, :2], np.sin(lattice[:, 0])])
    path = tmp_path / "a.vtu"
    numbers = " ".join(map(str, range(len(points))))
    text = bombs.grid(" ".join(map(repr, points.ravel().tolist())), numbers, str(len(points)), "69")
    path.write_text(text)
    if not read:
        with pytest.raises(FileFormatError, match="degree above 20"):
            io.read(path)
        return
    net = io.read(path).triangles()
    x, _y, z = net.points(0, [[0.3, 0.4]]).T
    np.testing.assert_allclose(z, np.sin(x), atol=1e-6)


def test_limits_of_a_toml_file(tmp_path):
    """What people write is far below the limits; a byte order mark is no matter."""
    from mitsuba_bezier.verification.thresholds import Thresholds

    path = tmp_path / "limits.toml"
    path.write_bytes(b"\xef\xbb\xbf[default]\r\nrmse = 0.5\r\n")
    assert Thresholds.load(path).limits("x").rmse == 0.5
    with pytest.raises(FileFormatError, match="expected a TOML file, got Is a directory"):
        Thresholds.load(tmp_path)
    with pytest.raises(FileFormatError, match="expected a TOML file, got no regular file"):
        Thresholds.load("/dev/zero")
    with pytest.raises(FileFormatError, match="expected a valid TOML file"):
        path.write_bytes("[default]\n".encode("utf-16"))
        Thresholds.load(path)


# ---------------------------------------------------------------------------- scenes


def scene(body: str) -> str:
    return f'<scene version="3.0.0">{body}</scene>'


def test_deep_scenes_are_refused(tmp_path):
    """Mitsuba calls itself for each element, until its stack is full: SIGSEGV."""
    from mitsuba_bezier.cli._scene_xml import check_xml

    path, other = tmp_path / "a.xml", tmp_path / "b.xml"
    path.write_text(scene('<bsdf type="twosided">' * 190 + "</bsdf>" * 190))
    check_xml(path, [tmp_path])
    path.write_text(scene('<bsdf type="twosided">' * 60_000 + "</bsdf>" * 60_000))
    with pytest.raises(FileFormatError, match=r"at most 200 elements .*a\.xml, line 1"):
        check_xml(path, [tmp_path])
    other.write_text(scene('<include filename="b.xml"/><include filename="a.xml"/>'))
    with pytest.raises(FileFormatError, match=r"more in .*a\.xml, line 1"):
        check_xml(other, [tmp_path])
    code = "import sys; from mitsuba_bezier.cli.main import main; sys.exit(main())"
    command = [sys.executable, "-c", code, "render", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 2 and done.stderr.count("\n") == 1


@pytest.mark.skipif(sys.platform == "win32", reason="no named pipes here")
@pytest.mark.parametrize(
    "body", ['<include filename="{}"/>', '<string name="filename" value="{}"/>']
)
def test_pipes_named_by_scenes_are_refused(tmp_path, body):
    import os

    from mitsuba_bezier.cli._scene_xml import check_xml

    os.mkfifo(tmp_path / "pipe.ply")
    path = tmp_path / "a.xml"
    path.write_text(scene(body.format("pipe.ply")))
    with pytest.raises(FileFormatError, match="which is a named pipe"):
        check_xml(path, [tmp_path])
    path.write_text(scene(body.format("nothing.ply")))
    check_xml(path, [tmp_path])
