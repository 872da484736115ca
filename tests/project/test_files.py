"""The writer of all files: whole on the disk, or the old file as it was and nothing beside it."""

from __future__ import annotations

import ast
import errno
import os
import stat
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

import mitsuba_bezier as mb
from mitsuba_bezier import _files
from mitsuba_bezier.cli import main
from mitsuba_bezier.verification import png
from mitsuba_bezier.verification.images import encode_exr, read_image, write_exr
from mitsuba_bezier.verification.report import write_report

ROOT = Path(mb.__file__).parents[1]
PIXELS = {c: np.linspace(0, 1, 35 * 20, dtype=np.float32).reshape(35, 20) for c in "RGB"}

WRITERS: dict[str, Callable[[Path], object]] = {
    "a.exr": lambda path: write_exr(path, PIXELS, {"spp": 1}),
    "a.html": lambda path: write_report(path, [], "title"),
    "a.vtu": lambda path: mb.save(mb.sphere(), path),
    "a.bv": lambda path: mb.save(mb.sphere(), path),
    "a.ply": lambda path: mb.save(mb.sphere(), path),
    "a.json": lambda path: _files.write_file(path, b"{}"),
}
FAULTS = (errno.ENOSPC, errno.EIO, errno.EDQUOT)


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[Path]:
    yield tmp_path
    assert not [name for name in os.listdir(tmp_path) if name.endswith(".tmp")]
    assert not _files._unfinished


def fail(monkeypatch: pytest.MonkeyPatch, name: str, code: int, call: int) -> list[int]:
    """Let a function of the system fail at one of its calls that concern our temporary file."""
    real, calls = getattr(os, name), []

    def faulty(first, *args, **kwargs):
        ours = any(p.endswith(".tmp") for p in _files._unfinished)
        if ours:
            calls.append(1)
            if len(calls) == call:
                if name == "close":
                    real(first)  # as Linux does: the descriptor is gone, the error is told
                raise OSError(code, os.strerror(code))
        return real(first, *args, **kwargs)

    monkeypatch.setattr(os, name, faulty)
    return calls


@pytest.mark.parametrize("code", FAULTS)
@pytest.mark.parametrize("call", ["open", "write", "fsync", "close", "replace"])
@pytest.mark.parametrize("name", WRITERS)
def test_a_fault_at_each_call_is_an_error_and_leaves_the_old_file(
    folder, monkeypatch, name, call, code
):
    path = folder / name
    path.write_bytes(b"old")
    with monkeypatch.context() as patch:
        calls = fail(patch, call, code, 1)
        with pytest.raises(mb.FileFormatError) as error:
            WRITERS[name](path)
    assert calls and os.strerror(code) in str(error.value) and "\n" not in str(error.value)
    assert path.read_bytes() == b"old" and os.listdir(folder) == [name]
    WRITERS[name](path)
    assert path.stat().st_size != 3 and os.listdir(folder) == [name]


def test_a_fault_at_a_later_write(folder, monkeypatch):
    """Some disks take a part of the bytes and refuse the rest."""
    real = os.write

    def slow(descriptor, data):
        return real(descriptor, data[:100])

    whole = bytes(range(256)) * 3
    with monkeypatch.context() as patch:
        patch.setattr(os, "write", slow)
        _files.write_file(folder / "a", whole)
    assert (folder / "a").read_bytes() == whole
    for last in (4, 8):  # of eight
        with monkeypatch.context() as patch:
            patch.setattr(os, "write", slow)
            calls = fail(patch, "write", errno.ENOSPC, last)
            with pytest.raises(mb.FileFormatError, match="No space"):
                _files.write_file(folder / "a", b"new" * 256)
        assert len(calls) == last and (folder / "a").read_bytes() == whole
    with monkeypatch.context() as patch:
        patch.setattr(os, "write", lambda *_: 0)
        with pytest.raises(mb.FileFormatError, match="Input/output"):
            _files.write_file(folder / "a", b"new")


@pytest.mark.parametrize("call", ["open", "write", "fsync", "close"])
def test_a_fault_at_the_second_of_two_files_leaves_both_old_ones(folder, monkeypatch, call):
    for name in "ab":
        (folder / name).write_bytes(b"old")
    with monkeypatch.context() as patch:
        calls = fail(patch, call, errno.ENOSPC, 2)
        with pytest.raises(mb.FileFormatError, match="b: No space"):
            _files.write_files({folder / "a": b"new", folder / "b": b"new"})
    assert len(calls) == 2 and {(folder / name).read_bytes() for name in "ab"} == {b"old"}


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="users of POSIX")
def test_another_users_file_in_a_folder_like_tmp_is_told_before(folder, monkeypatch):
    path = folder / "a"
    path.write_bytes(b"old")
    me = os.geteuid()
    for mode, user, fine in (
        (0o1777, me, True),
        (0o1777, me + 1, False),
        (0o777, me + 1, True),
        (0o1777, 0, True),
    ):
        folder.chmod(mode)
        monkeypatch.setattr(os, "geteuid", lambda user=user: user)
        if fine:
            _files.check_target(path, "OUT")
        else:
            with pytest.raises(mb.FileFormatError, match="a, which is another user's"):
                _files.check_target(path, "OUT")
    _files.check_target(folder / "new", "OUT")


def test_a_fault_of_the_folder_is_told_and_both_files_are_whole(folder, monkeypatch):
    """The last call of all: the new file is in its place, but the disk may forget its name."""
    (folder / "a").write_bytes(b"old")
    with monkeypatch.context() as patch:
        calls = fail(patch, "fsync", errno.EIO, 2)
        patch.setattr(_files, "_unfinished", {".tmp"})
        with pytest.raises(mb.FileFormatError, match="Input/output"):
            _files.write_file(folder / "a", b"new")
    assert len(calls) == 2 and (folder / "a").read_bytes() == b"new"
    for code in (errno.EINVAL, errno.ENOTSUP):  # disks that cannot do this for folders
        with monkeypatch.context() as patch:
            fail(patch, "fsync", code, 2)
            patch.setattr(_files, "_unfinished", {".tmp"})
            _files.write_file(folder / "a", b"new")


def test_an_interrupt_leaves_the_old_file(folder, monkeypatch):
    (folder / "a").write_bytes(b"old")

    def stop(*_):
        raise KeyboardInterrupt

    for call in ("write", "fsync", "replace"):
        with monkeypatch.context() as patch:
            patch.setattr(os, call, stop)
            with pytest.raises(KeyboardInterrupt):
                _files.write_file(folder / "a", b"new")
        assert (folder / "a").read_bytes() == b"old" and os.listdir(folder) == ["a"]


@pytest.mark.parametrize("keep", [0, 1, 300, 500, -100, -1])
def test_an_exr_that_its_library_did_not_finish_is_seen(folder, monkeypatch, keep):
    """OpenEXR tells no error when it closes a file: of a full disk, here of a short memory."""
    real = _files.encoded
    monkeypatch.setattr("mitsuba_bezier.verification.images.encoded", lambda w: real(w)[:keep])
    write = WRITERS["a.exr"]
    (folder / "a.exr").write_bytes(b"old")
    with pytest.raises(mb.FileFormatError, match="room for an EXR file"):
        write(folder / "a.exr")
    assert (folder / "a.exr").read_bytes() == b"old"


def test_an_exr_without_its_table_is_seen(monkeypatch):
    """The table of offsets is written last, where the first lines were: zeros till then."""
    data = encode_exr(PIXELS)
    table = data.index(b"screenWindowWidth") + len(b"screenWindowWidth\0float\0") + 4 + 4 + 1
    spoiled = data[:table] + bytes(8) + data[table + 8 :]
    monkeypatch.setattr("mitsuba_bezier.verification.images.encoded", lambda _: spoiled)
    with pytest.raises(mb.FileFormatError, match="room for an EXR file"):
        encode_exr(PIXELS)


@pytest.mark.parametrize("height", [1, 15, 16, 17, 64])
def test_whole_exr_files_pass(height, tmp_path, monkeypatch):
    for kind in (np.float16, np.float32, np.uint32):
        rows = np.arange(height * 9).reshape(height, 9).astype(kind)
        attributes = {"note": ["a", "b"], "text": "x" * 300, "number": 7}
        found = []
        for memory in (True, False):  # Linux, and the way of others
            with monkeypatch.context() as patch:
                if not memory:
                    patch.delattr(os, "memfd_create", raising=False)
                write_exr(tmp_path / "a.exr", {"V": rows, "W": rows}, attributes, (3, 4), (99, 99))
            image = read_image(tmp_path / "a.exr")
            np.testing.assert_array_equal(image.channels["V"], rows)
            found.append((tmp_path / "a.exr").read_bytes())
        assert found[0] == found[1]


@pytest.mark.skipif(sys.platform != "linux", reason="mounts a small tmpfs, as Linux can")
def test_a_full_disk(folder):
    """With the system's own errors: a disk of 200 kB in a mount namespace of its own."""
    script = f"""
import errno, os, sys
sys.path.insert(0, {str(ROOT)!r})
import mitsuba_bezier as mb, numpy as np
from mitsuba_bezier import _files
from mitsuba_bezier.verification.images import write_exr
rng = np.random.default_rng(0)
noise = {{c: rng.random((200, 200), dtype=np.float32) for c in "RGB"}}
write_exr("old.exr", {{"R": noise["R"][:50]}})
old = open("old.exr", "rb").read()
for name, write in {{
    "old.exr": lambda p: write_exr(p, noise),
    "old.vtu": lambda p: mb.save(mb.BezierTriangles(rng.random((3000, 3, 4))), p),
    "old.bv": lambda p: mb.save(mb.BezierTriangles(rng.random((3000, 3, 4))), p),
}}.items():
    open(name, "wb").write(old[:100]) if name != "old.exr" else None
    before = open(name, "rb").read(), sorted(os.listdir())
    try:
        write(name)
    except mb.FileFormatError as error:
        assert "No space left" in str(error), error
    else:
        sys.exit(f"{{name}}: no error")
    assert before[0] == open(name, "rb").read() and sorted(os.listdir()) == before[1]
try:
    with open("fill", "wb") as file:
        while True:
            file.write(bytes(4096)); file.flush()
except OSError:
    pass
try:
    _files.check_target("new.exr", "--output")
except mb.FileFormatError as error:
    assert "free space" in str(error) or "No space" in str(error), error
else:
    sys.exit("a full disk was not seen before the work")
print("fine")
"""
    command = f'mount -t tmpfs -o size=200k none "{folder}" && cd "{folder}" && exec "$0" -c "$1"'
    done = subprocess.run(
        ["unshare", "--mount", "sh", "-c", command, sys.executable, script],
        capture_output=True,
        text=True,
    )
    if "unshare" in done.stderr or "mount:" in done.stderr:
        pytest.skip(f"no right to mount: {done.stderr.strip()}")
    assert done.stdout == "fine\n", done.stderr


# ---------------------------------------------------------------- names, links, permissions


@pytest.mark.parametrize(
    "name", ["a", "x" * 255, "é" * 127, " a b ", "a\nb", "a'b\"c", "-o", "$(x)", b"\xff\xfe"]
)
def test_every_legal_name_can_be_written(folder, name):
    path = os.path.join(folder, os.fsdecode(name))
    for data in (b"1", b"22"):
        _files.check_target(path, "OUT")
        _files.write_file(path, data)
        with open(path, "rb") as file:
            assert file.read() == data
    assert os.listdir(folder) == [os.fsdecode(name)]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("", "OUT: expected the name of a file, got ''"),
        ("sub", "OUT: expected the name of a file, got the folder sub"),
        ("sub/", "OUT: expected the name of a file, got 'sub/'"),
        (".", "OUT: expected the name of a file, got the folder ."),
        ("none/a", "OUT: expected a folder that exists, got none"),
        ("file/a", "OUT: expected a folder that exists, got file"),
        ("x" * 256, "File name too long"),
        ("a\0b", "OUT: expected the name of a file"),
        ("pipe", "OUT: expected the name of a file, got the device pipe"),
        ("to_pipe", "OUT: expected the name of a file, got the device to_pipe"),
        ("/dev/null", "OUT: expected the name of a file, got the device /dev/null"),
        ("/dev/stdout", "OUT: expected the name of a file, got the device /dev/stdout"),
        ("/proc/self/fd/1", "OUT: expected the name of a file, got the device /proc/self/fd/1"),
    ],
)
@pytest.mark.skipif(sys.platform == "win32", reason="names of POSIX")
def test_what_is_no_name_of_a_file_is_told_before(folder, monkeypatch, name, message):
    monkeypatch.chdir(folder)
    os.mkdir("sub")
    os.mkfifo("pipe")
    os.symlink("pipe", "to_pipe")
    (folder / "file").write_text("old")
    before = sorted(os.listdir())
    with pytest.raises(mb.FileFormatError) as error:
        _files.check_target(name, "OUT")
    assert message in str(error.value)
    with pytest.raises(mb.FileFormatError):
        _files.write_file(name, b"new")
    assert sorted(os.listdir()) == before and (folder / "file").read_text() == "old"


def test_folders_are_made_where_that_is_wanted(folder):
    path = folder / "a/b/c.json"
    _files.check_target(path, "OUT", make_folders=True)
    assert os.listdir(folder) == []
    _files.write_file(path, b"1", make_folders=True)
    assert path.read_bytes() == b"1"
    with pytest.raises(mb.FileFormatError, match="a folder that exists"):
        _files.check_target(path / "d/e", "OUT", make_folders=True)


def test_a_disk_that_is_too_small_is_told_before(folder, monkeypatch):
    monkeypatch.setattr(_files, "free_space", lambda _: 1000)
    _files.check_target(folder / "a", "OUT", 999)
    with pytest.raises(mb.FileFormatError, match="at least 2000 bytes of free space, got 1000 in"):
        _files.check_target(folder / "a", "OUT", 2000)


@pytest.mark.skipif(sys.platform == "win32", reason="links and permissions of POSIX")
def test_a_link_is_replaced_and_what_it_points_to_stays(folder):
    other = folder / "other"
    other.write_bytes(b"precious")
    other.chmod(0o600)
    for target in (other, folder / "nowhere"):
        link = folder / "link"
        link.symlink_to(target)
        _files.check_target(link, "OUT")
        _files.write_file(link, b"new")
        assert not link.is_symlink() and link.read_bytes() == b"new"
        assert other.read_bytes() == b"precious" and not (folder / "nowhere").exists()
        link.unlink()


@pytest.mark.skipif(sys.platform == "win32", reason="links and permissions of POSIX")
def test_a_prepared_link_in_place_of_the_temporary_file_is_not_followed(folder, monkeypatch):
    (folder / "other").write_bytes(b"precious")
    (folder / ".00.tmp").symlink_to("other")
    monkeypatch.setattr(_files.secrets, "token_hex", lambda _: "00")
    with pytest.raises(mb.FileFormatError):
        _files.write_file(folder / "a", b"new")
    assert (folder / "other").read_bytes() == b"precious"


def test_temporary_names_cannot_be_foretold(folder, monkeypatch):
    seen = []
    real = os.replace
    monkeypatch.setattr(os, "replace", lambda a, b: (seen.append(a), real(a, b)))
    for _ in range(20):
        _files.write_file(folder / "a", b"1")
    assert len({len(name) for name in seen}) == 1 and len(set(seen)) == 20
    assert all(str(os.getpid()) not in os.path.basename(n) or len(n) > 16 for n in seen)


@pytest.mark.skipif(sys.platform == "win32", reason="links and permissions of POSIX")
def test_permissions_are_those_of_the_umask_or_of_the_old_file(folder):
    path = folder / "a"
    old = os.umask(0o027)
    try:
        _files.write_file(path, b"1")
        assert stat.S_IMODE(path.stat().st_mode) == 0o640
        for mode in (0o600, 0o666, 0o755):
            path.chmod(mode)
            _files.write_file(path, b"2")
            assert stat.S_IMODE(path.stat().st_mode) == mode
    finally:
        os.umask(old)


def test_a_write_protected_file_stays(folder, monkeypatch):
    path = folder / "a"
    path.write_bytes(b"old")
    # root, as which tests may run, may write everywhere
    monkeypatch.setattr(os, "access", lambda p, mode: str(p) != str(path))
    for act in (lambda: _files.check_target(path, "OUT"), lambda: _files.write_file(path, b"new")):
        with pytest.raises(mb.FileFormatError, match="write-protected"):
            act()
    assert path.read_bytes() == b"old"


# ---------------------------------------------------------------- one writer


def test_no_module_opens_a_file_for_writing_by_itself():
    """Every file goes through `write_file`, except those in temporary folders and lists.

    A line is added to a list of artefacts, or to a summary that others write to as well.
    """
    allowed = {"mitsuba_bezier/_files.py", "mitsuba_bezier/io/isolated.py"}
    allowed |= {"mitsuba_bezier/regression/artifacts.py", "mitsuba_bezier/verification/summary.py"}
    names = {"write_text", "write_bytes", "tofile", "savez", "save_compressed", "write_bitmap"}
    found = []
    for path in sorted((ROOT / "mitsuba_bezier").rglob("*.py")):
        module = path.relative_to(ROOT).as_posix()
        if module in allowed:
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.Call):
                continue
            name = getattr(node.func, "attr", getattr(node.func, "id", ""))
            words = [a.value for a in node.args if isinstance(a, ast.Constant)]
            words += [k.value.value for k in node.keywords if isinstance(k.value, ast.Constant)]
            mode = any(
                isinstance(w, str) and set(w) <= set("rwxabt+") and set(w) & set("wax+")
                for w in words
            )
            method = isinstance(node.func, ast.Attribute)
            if (name == "open" and mode) or (name in names and method):
                found.append(f"{module}:{node.lineno}")
    assert found == []


def test_a_preview_is_the_png_of_its_pixels(folder):
    pixels = np.arange(5 * 7 * 3, dtype=np.uint8).reshape(5, 7, 3)
    np.testing.assert_array_equal(png.decode(png.encode(pixels), "a"), pixels)


def test_the_command_line_tells_a_full_disk_in_one_line(folder, monkeypatch, capsys):
    for name in ("a.exr", "b.exr"):
        write_exr(folder / name, PIXELS, {"spp": 1, "seed": ord(name[0])})
    out = folder / "c.exr"
    out.write_bytes(b"old")
    words = ["merge", str(folder / "a.exr"), str(folder / "b.exr"), "-o", str(out)]
    with monkeypatch.context() as patch:
        real = os.write
        patch.setattr(
            os, "write", lambda d, b: _raise(errno.ENOSPC) if d > 2 and b[:4] else real(d, b)
        )
        assert main.main(words) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and "No space left" in err and "wrote" not in err
    assert out.read_bytes() == b"old"


def _raise(code: int) -> int:
    raise OSError(code, os.strerror(code))
