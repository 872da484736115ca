"""Feed damaged files to every reader: only our own errors may come out, in time and memory.

    python benchmarks/fuzz_readers.py --minutes 10

Hypothesis mutates valid files of each format (bytes changed, parts removed, repeated, exchanged,
numbers replaced by large, negative or strange ones) and makes garbage; the small files of
`tests/bombs.py` that ask for much come first. A case passes if the file is read, or refused with
an error of ours. Everything else is a failure: another exception, more than 10 s of the processor,
more than 1 GiB of address space beyond what the imports took, a crash. Each format has a process
of its own. CAD, Rhino and finite element files (extras ``[cad]``, ``[rhino]``, ``[mesh]``; left out
if those are missing) are read in a child process each, as users read them: the libraries do crash
and hang, which `isolated` turns into an error. Such cases are shown as *died*; they have passed.
``xml`` are scenes: they are checked as ``render`` does it, and read by Mitsuba's parser; ``toml``
are limits.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import resource
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from pathlib import Path

import numpy as np
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

import mitsuba_bezier as mb
from mitsuba_bezier import io
from mitsuba_bezier.cli._scene_xml import check_xml
from mitsuba_bezier.errors import BezierError
from mitsuba_bezier.geometry.trims import Trims, closed_region, square_map
from mitsuba_bezier.io import meshes
from mitsuba_bezier.io.cad import opencascade as cad
from mitsuba_bezier.io.cad import rhino
from mitsuba_bezier.verification.thresholds import Thresholds

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
import bombs

FORMATS = ("vtu", "bv", "bez", "bbp", "off", "obj", "msh", "toml", "xml")
FORMATS += ("inp", "bdf", "mesh", "step", "iges", "brep", "3dm")
#: Read in a child process.
ISOLATED = ("xml", "inp", "bdf", "mesh", "step", "iges", "brep", "3dm")
#: Processor seconds and bytes a case may take.
LIMIT = 10
MEMORY = 1 << 30

#: What replaces a number in a file.
NUMBERS = (
    *(b"-1", b"0", b"1", b"255", b"65536", b"2147483647", b"4294967296", b"18446744073709551615"),
    *(b"99999999999999999999999", b"1e308", b"-1e400", b"nan", b"inf", b"1e-320", b"0x10", b""),
    *(b"3.5", b"+7", b"1_000", b"\xd9\xa3", b"--1", b"1,5"),
)


class Hang(BaseException):
    """A case that took too long; no reader may catch it."""


# ---------------------------------------------------------------------------- valid files


def text_seeds() -> dict[str, list[bytes]]:
    """Return small valid files of the text formats."""
    bez = "BEZ334\n" + "\n".join(f"{i % 4} {i // 4} {i % 3} 1" for i in range(16)) + "\n"
    bbp = "BBP\n" + "\n".join(f"{i % 4} {i // 4} {i % 3}" for i in range(16)) + "\n"
    off = "OFF\n4 1 4\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n"
    points = "\n".join(f"v {i % 4} {i // 4} {i % 3} {1 + i % 2}" for i in range(16))
    obj = (
        f"{points}\ncstype rat bspline\ndeg 3 3\nsurf 0 1 0 1 "
        + " ".join(map(str, range(1, 17)))
        + "\nparm u 0 0 0 0 1 1 1 1\nparm v 0 0 0 0 1 1 1 1\nend\n"
    )
    bezier = (
        f"{points}\ncstype bezier\ndeg 3 3\nsurf 0 1 0 1 "
        + " ".join(map(str, range(1, 17)))
        + "\nparm u 0 1\nparm v 0 1\nend\n"
    )
    msh = (
        "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n6\n"
        "1 0 0 0\n2 1 0 0\n3 0 1 0\n4 .5 0 .1\n5 .5 .5 .1\n6 0 .5 .1\n$EndNodes\n"
        "$Elements\n1\n1 9 2 1 1 1 2 3 4 5 6\n$EndElements\n"
    )
    found = {"bez": [bez], "bbp": [bbp], "off": [off], "obj": [obj, bezier], "msh": [msh]}
    return {name: [text.encode() for text in texts] for name, texts in found.items()}


def vtu_seeds(folder: Path) -> list[bytes]:
    """Return .vtu files in each encoding, with control vectors, mixed degrees and trims."""
    ball = mb.sphere(cover="octants")
    loop = [[[0.2, 0.2, 1], [0.6, 0.2, 1]], [[0.6, 0.2, 1], [0.5, 0.7, 1], [0.2, 0.2, 1]]]
    trims = Trims([closed_region(loop, 1e-9)], [0] * 8, [square_map()] * 8, [[[0, 0], [1, 1]]] * 8)
    path = folder / "seed.vtu"
    out = []
    for encoding in ("appended", "binary", "ascii"):
        for groups, options in (
            ([ball], {"trims": [trims]}),
            ([mb.quarter_plane(), ball], {}),
        ):
            io.save(groups, path, encoding=encoding, **options)
            out.append(path.read_bytes())
    return out


def cad_seeds(folder: Path, suffix: str) -> list[bytes]:
    """Return a cylinder with a hole across."""
    from OCP.BRepAlgoAPI import BRepAlgoAPI_Cut
    from OCP.BRepPrimAPI import BRepPrimAPI_MakeCylinder, BRepPrimAPI_MakeSphere
    from OCP.BRepTools import BRepTools
    from OCP.IGESControl import IGESControl_Writer
    from OCP.STEPControl import STEPControl_StepModelType, STEPControl_Writer

    body, ball = BRepPrimAPI_MakeCylinder(1.0, 3.0), BRepPrimAPI_MakeSphere(1.2)
    shape = BRepAlgoAPI_Cut(body.Shape(), ball.Shape()).Shape()
    path = folder / f"seed.{suffix}"
    if suffix == "brep":
        BRepTools.Write_s(shape, str(path))
    elif suffix == "iges":
        writer = IGESControl_Writer("MM", 1)
        writer.AddShape(shape)
        writer.Write(str(path))
    else:
        writer = STEPControl_Writer()
        writer.Transfer(shape, STEPControl_StepModelType.STEPControl_AsIs)
        writer.Write(str(path))
    return [path.read_bytes()]


def rhino_seeds(folder: Path) -> list[bytes]:
    """Return a cylinder with caps and a sphere."""
    import rhino3dm

    file = rhino3dm.File3dm()
    circle = rhino3dm.Circle(rhino3dm.Point3d(0, 0, 0), 1.5)
    file.Objects.AddBrep(rhino3dm.Cylinder(circle, 4.0).ToBrep(True, True))
    file.Objects.AddSphere(rhino3dm.Sphere(rhino3dm.Point3d(1, 2, 3), 2))
    path = folder / "seed.3dm"
    file.Write(str(path), 7)
    return [path.read_bytes()]


def other_seeds() -> dict[str, list[bytes]]:
    """Return meshes of finite elements, limits, and scenes."""
    corners = ((0, 0, 0), (1, 0, 0), (1, 1, 0.5), (0, 1, 0))
    rows = [(k, *c) for k, c in enumerate(corners, start=1)]
    inp = "*NODE\n" + "".join("{}, {}, {}, {}\n".format(*r) for r in rows)
    inp += "*ELEMENT, TYPE=S3, ELSET=all\n1, 1, 2, 3\n2, 1, 3, 4\n*NSET, NSET=a\n1, 2\n"
    bdf = "BEGIN BULK\n" + "".join("GRID,{},,{:.1f},{:.1f},{:.1f}\n".format(*r) for r in rows)
    bdf += "CTRIA3,1,1,1,2,3\nCTRIA3,2,1,1,3,4\nENDDATA\n"
    mesh = "MeshVersionFormatted 2\nDimension 3\nVertices\n4\n"
    mesh += "".join(f"{x} {y} {z} 0\n" for x, y, z in corners)
    mesh += "Triangles\n2\n1 2 3 0\n1 3 4 0\nEnd\n"
    toml = '[default]\nrmse = 1e-3\nallow_nan = false\n[images."a/*"]\nflip = 0.02\n'
    xml = (
        '<scene version="3.0.0"><default name="n" value="16"/><integrator type="path"/>'
        '<sensor type="perspective"><film type="hdrfilm"><integer name="width" value="$n"/></film>'
        '</sensor><shape type="sphere"><float name="radius" value="2.5"/>'
        '<transform name="to_world"><translate x="1" y="2" z="3"/></transform></shape></scene>'
    )
    found = {"inp": inp, "bdf": bdf, "mesh": mesh, "toml": toml, "xml": xml}
    return {name: [text.encode()] for name, text in found.items()}


def seeds(name: str, folder: Path) -> list[bytes]:
    """Return valid files of a format."""
    if name in other_seeds():
        return other_seeds()[name]
    if name == "vtu":
        return vtu_seeds(folder)
    if name in ("step", "iges", "brep"):
        return cad_seeds(folder, name)
    if name == "3dm":
        return rhino_seeds(folder)
    if name == "bv":
        path = folder / "seed.bv"
        io.save([mb.sphere(cover="octants"), mb.sphere()], path)
        tensor = b"8 2 1\n" + b"\n".join(b"%d %d 0 1" % (i // 2, i % 2) for i in range(6))
        return [path.read_bytes(), tensor]
    return text_seeds()[name]


# ---------------------------------------------------------------------------- mutations


def replace_number(data: bytes, place: float, number: bytes) -> bytes:
    """Replace one of the numbers of a text."""
    found = list(re.finditer(rb"-?\d[\d.eE+-]*", data[:200_000]))
    if not found:
        return data
    match = found[int(place * len(found))]
    return data[: match.start()] + number + data[match.end() :]


def exchange_lines(data: bytes, place: float, other: float) -> bytes:
    """Copy a line over another."""
    lines = data.split(b"\n")
    lines[int(place * len(lines))] = lines[int(other * len(lines))]
    return b"\n".join(lines)


fraction = st.floats(0, 1, exclude_max=True)


@st.composite
def damaged(draw: st.DrawFn, valid: list[bytes]) -> bytes:
    """Draw a file: mostly a valid one with one to four changes."""
    if draw(st.integers(0, 19)) == 0:
        return draw(st.binary(max_size=300))
    data = draw(st.sampled_from(valid))
    for _ in range(draw(st.integers(1, 4))):
        kind = draw(st.integers(0, 6))
        place, other = draw(fraction), draw(fraction)
        a, b = sorted((int(place * (len(data) + 1)), int(other * (len(data) + 1))))
        if kind == 0:
            data = data[:a]
        elif kind == 1:
            data = data[:a] + draw(st.binary(max_size=8)) + data[a + draw(st.integers(0, 8)) :]
        elif kind == 2:
            data = data[:a] + data[b:]
        elif kind == 3:
            data = data[:b] + data[a : a + min(b - a, 2000)] + data[b:]
        elif kind == 4:
            data = exchange_lines(data, place, other)
        else:
            data = replace_number(data, place, draw(st.sampled_from(NUMBERS)))
    return data


# ---------------------------------------------------------------------------- one format


def read(name: str, path: Path) -> list[mb.BezierTriangles]:
    """Read a file in this process."""
    if name == "toml":
        Thresholds.load(path)
        return []
    if name == "xml":
        check_xml(path, [path.parent])
        import mitsuba as mi

        try:
            mi.parser.parse_file(mi.parser.ParserConfig("scalar_rgb"), str(path))
        except (RuntimeError, UnicodeDecodeError) as error:  # `render` makes it one of ours
            raise BezierError(" ".join(str(error).split())) from None
        return []
    reader = {"3dm": rhino, "inp": meshes, "bdf": meshes, "mesh": meshes}.get(name, cad)
    if name in ISOLATED:
        return reader.read_here(path, trims=True).groups
    return io.read(path, trims=True).groups


def in_child(name: str, path: Path) -> tuple[str, str]:
    """Read a file in a fork of this process; return what came, and what was wrong."""
    receive, send = os.pipe()
    child = os.fork()
    if child == 0:
        what = "read"
        resource.setrlimit(resource.RLIMIT_CPU, (LIMIT, LIMIT + 1))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        os.dup2(1, 2)
        try:
            read(name, path)
        except BezierError as error:
            what = "refused" if "\n" not in str(error) else "failed an error of several lines"
        except BaseException as error:
            frame = traceback.extract_tb(error.__traceback__)[-1]
            what = f"failed {type(error).__name__} in {Path(frame.filename).name}:{frame.lineno}"
        os.write(send, what.encode())
        os._exit(0)
    os.close(send)
    os.waitpid(child, 0)
    with os.fdopen(receive) as pipe:
        text = pipe.read()
    if text.startswith("failed "):
        return "failed", text.removeprefix("failed ")
    return text or "died", ""


def work(name: str, seconds: float, first_seed: int) -> None:
    """Fuzz one format in this process; print the counts as JSON."""
    warnings.simplefilter("ignore")
    counts: Counter[str] = Counter()
    failures: dict[str, str] = {}

    def late(_number: int, _frame: object) -> None:
        raise Hang

    signal.signal(signal.SIGPROF, late)
    if name == "xml":
        import mitsuba as mi

        mi.set_variant("scalar_rgb")
    with tempfile.TemporaryDirectory() as folder:
        valid = seeds(name, Path(folder))
        path = Path(folder) / f"case.{name}"
        for data in valid:
            path.write_bytes(data)
            read(name, path)  # imports the library, once
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        soft = pages * resource.getpagesize() + MEMORY
        resource.setrlimit(resource.RLIMIT_AS, (soft, resource.RLIM_INFINITY))
        end = float("inf")

        def note(data: bytes, kind: str, what: str) -> None:
            counts["failed" if what else kind] += 1
            if what and (what not in failures or len(data) < len(failures[what])):
                failures[what] = data.decode("latin-1")

        def case(data: bytes) -> None:
            if time.monotonic() > end:
                return
            path.write_bytes(data)
            if name in ISOLATED:
                kind, what = in_child(name, path)
                note(data, kind, what)
                return
            kind = "failed"
            signal.setitimer(signal.ITIMER_PROF, LIMIT)
            try:
                groups = read(name, path)
                kind = "read"
                finite = all(np.isfinite(g.control_points).all() for g in groups)
                what = "" if finite else "control points that are not finite"
            except BezierError as error:
                kind = "refused"
                what = "" if "\n" not in str(error) else "an error of several lines"
            except Hang:
                what = f"longer than {LIMIT} s of the processor"
            except Exception as error:
                frame = traceback.extract_tb(error.__traceback__)[-1]
                what = f"{type(error).__name__} in {Path(frame.filename).name}:{frame.lineno}"
                what += f": {str(error)[:100]}"
            finally:
                signal.setitimer(signal.ITIMER_PROF, 0)
            note(data, kind, what)

        for bomb in (b for b in bombs.BOMBS if b.endswith(f".{name}")):
            case(bombs.write(bomb, Path(folder)).read_bytes())
        end = time.monotonic() + seconds
        number = first_seed
        while time.monotonic() < end:
            number += 1
            options = settings(
                max_examples=500,
                deadline=None,
                database=None,
                phases=[Phase.generate],
                suppress_health_check=list(HealthCheck),
            )
            seed(number)(options(given(damaged(valid))(case)))()
    print(json.dumps({"counts": counts, "failures": failures}))


def main() -> None:
    """Fuzz all formats, one after the other, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=10, help="for all formats together")
    parser.add_argument("--formats", nargs="+", choices=FORMATS, default=FORMATS)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, help="a folder for the files that failed")
    parser.add_argument("--worker", help=argparse.SUPPRESS)
    args = parser.parse_args()
    seconds = args.minutes * 60 / len(args.formats)
    if args.worker:
        work(args.worker, args.minutes * 60, args.seed)
        return
    print(f"{'format':8}{'cases':>8}{'read':>8}{'refused':>9}{'died':>6}{'failed':>8}")
    bad = 0
    for name in args.formats:
        command = [sys.executable, __file__, "--worker", name, "--seed", str(args.seed)]
        command += ["--minutes", str(seconds / 60)]
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=seconds + 200, check=False
            )
            result = json.loads(done.stdout.splitlines()[-1])
        except subprocess.TimeoutExpired:
            print(f"{name:8} hung in a call that Python cannot interrupt")
            bad += 1
            continue
        except (IndexError, ValueError):
            last = done.stderr.strip().splitlines()[-1:] or [f"exit code {done.returncode}"]
            missing = "ModuleNotFoundError" in last[0]
            print(f"{name:8} {'left out' if missing else 'died'}: {last[0][:120]}")
            bad += not missing
            continue
        counts = Counter(result["counts"])
        cases = sum(counts.values())
        print(
            f"{name:8}{cases:8}{counts['read']:8}{counts['refused']:9}{counts['died']:6}"
            f"{counts['failed']:8}",
            flush=True,
        )
        bad += counts["failed"]
        for number, (what, data) in enumerate(result["failures"].items()):
            print(f"    {what}")
            if args.keep:
                args.keep.mkdir(parents=True, exist_ok=True)
                (args.keep / f"{number}.{name}").write_bytes(data.encode("latin-1"))
    sys.exit(1 if bad else 0)


if __name__ == "__main__":
    main()
