"""Which LLVM is chosen, in which order things may be imported, and what errors then say.

Whatever Dr.Jit loads is settled for a whole process, so most tests start one of their own. They
must pass whatever LLVM the machine has: an old default is simulated by a real library where one
is found, and by a made-up answer of Dr.Jit everywhere.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
from pathlib import Path

import pytest

from mitsuba_bezier import _llvm, _runtime
from mitsuba_bezier.errors import RuntimeSetupError, VariantError

linux_only = pytest.mark.skipif(sys.platform != "linux", reason="about Linux's dynamic loader")

MINMAX = """
import drjit as dr
low, high = dr.minimum(mi.Float([1, 4]), 3), dr.maximum(mi.Float([1, 4]), 3)
assert list(low) == [1, 3] and list(high) == [3, 4]
"""

# what the user meets when a plugin of ours is to be used
USE = """
from mitsuba_bezier import BezierError
try:
    mi.load_dict({"type": "beziertriangle", "control_points":
        mi.TensorXf([0, 0, 0, 1, 1, 0, 0, 1, 0, 1, 0, 1], shape=(1, 3, 4))})
except Exception as error:
    print(str(error).strip().splitlines()[-1])
else:
    print("works")
"""


def good_library() -> str:
    library = _llvm.find()
    assert library is not None, "the tests need an LLVM, as every render does"
    return library.path


# ---------------------------------------------------------------- versions of Mitsuba

OTHER_VERSION = """
import sys
import mitsuba as mi
mi.__version__ = sys.argv[1]
import mitsuba_bezier as mb
mi.set_variant("llvm_ad_rgb")
print(mb.sphere().degree)
assert mi.load_dict({"type": "path"}).class_name() == "PathIntegrator"  # Mitsuba goes on
"""


@pytest.mark.parametrize("version", ["3.8.0", "3.9.0", "3.10.0", "3.10.0.dev0", "4.1"])
def test_another_version_of_mitsuba_is_named_at_import(python, version):
    done = python(OTHER_VERSION + USE, None, version)
    said = f"mitsuba: expected version 3.9.1 or later, before 3.10, got {version}; install one: "
    assert done.stderr.count(said) == 1, done.stderr  # as a warning
    assert 'pip install "mitsuba>=3.9.1,<3.10"' in done.stderr
    lines = done.stdout.splitlines()
    assert lines[0] == "4"  # the geometry needs no Mitsuba
    assert lines[1].startswith("RuntimeSetupError: " + said)


@pytest.mark.parametrize("version", ["3.9.1", "3.9.12", "unknown"])
def test_versions_that_will_do(python, version):
    done = python(OTHER_VERSION + USE, None, version)
    assert done.stdout.splitlines()[1] == "works", done.stderr
    assert "expected version" not in done.stderr


@pytest.mark.parametrize("command", ["render", "doctor"])
def test_the_command_line_names_the_version(python, command, tmp_path):
    code = """
import sys, mitsuba
mitsuba.__version__ = "3.10.0"
from mitsuba_bezier.cli import doctor
from mitsuba_bezier.cli.main import main
doctor._try = lambda *_: "works"
sys.exit(main())
"""
    scene = Path(__file__).parents[2] / "scenes" / "sphere.xml"
    words = ["render", str(scene), "-o", str(tmp_path / "x.exr")] if command == "render" else []
    done = python(code, None, *(words or ["doctor"]))
    text = " ".join((done.stdout + done.stderr.splitlines()[-1]).split())
    assert "mitsuba: expected version 3.9.1 or later, before 3.10, got 3.10.0" in text
    assert 'pip install "mitsuba>=3.9.1,<3.10"' in text
    assert done.returncode == (2 if command == "render" else 0)


# ---------------------------------------------------------------- orders that work


@pytest.mark.parametrize(
    "code",
    [
        "import mitsuba_bezier, mitsuba as mi; mi.set_variant('llvm_ad_rgb')",
        "import mitsuba_bezier; from mitsuba_bezier import _runtime; _runtime.prepare()\n"
        "import drjit; import mitsuba as mi; mi.set_variant('llvm_ad_rgb')",
    ],
)
def test_imported_first_with_the_variable_unset(python, code):
    done = python(code + MINMAX + USE)
    assert (done.returncode, done.stdout) == (0, "works\n"), done.stderr


def test_imported_after_mitsuba_and_the_variant(python):
    code = "import mitsuba as mi; mi.set_variant('llvm_ad_rgb'); import mitsuba_bezier"
    done = python(code + MINMAX + USE, {"DRJIT_LIBLLVM_PATH": good_library()})
    assert (done.returncode, done.stdout) == (0, "works\n"), done.stderr


def test_variants_switched_back_and_forth(python):
    code = """
import mitsuba_bezier, mitsuba as mi
for variant in ("llvm_ad_rgb", "scalar_rgb", "llvm_ad_spectral", "llvm_ad_rgb"):
    mi.set_variant(variant)
"""
    body = "\n".join("    " + line for line in USE.splitlines())
    lines = python(code + body).stdout.splitlines()
    assert [lines[0], *lines[2:]] == ["works"] * 3
    assert "variant: expected one of llvm_ad_rgb" in lines[1]
    assert "got scalar_rgb, which cannot run a Dr.Jit kernel" in lines[1]


def test_a_child_process_inherits_the_choice(python):
    # the child must load what lies beside the library again, though the variable is set
    code = """
import mitsuba_bezier, os, subprocess, sys
assert os.environ["DRJIT_LIBLLVM_PATH"]
sys.exit(subprocess.call([sys.executable, "-c", sys.argv[1]]))
"""
    child = "import mitsuba_bezier, mitsuba as mi; mi.set_variant('llvm_ad_rgb')" + MINMAX
    done = python(code, None, child)
    assert done.returncode == 0, done.stderr


def test_a_variable_set_by_the_user_stays(python):
    code = "import mitsuba_bezier, os; print(os.environ['DRJIT_LIBLLVM_PATH'])"
    done = python(code, {"DRJIT_LIBLLVM_PATH": "/somewhere/libLLVM.so"})
    assert done.stdout == "/somewhere/libLLVM.so\n"


def test_an_empty_variable_counts_as_unset(python):
    code = "import mitsuba_bezier, os; print(os.environ['DRJIT_LIBLLVM_PATH'])"
    done = python(code, {"DRJIT_LIBLLVM_PATH": ""})
    assert done.stdout == good_library() + "\n"


def test_importing_needs_no_llvm(python):
    # the geometry and scalar Mitsuba go on without
    code = """
import mitsuba_bezier._llvm as l
l.find = lambda: None
import mitsuba_bezier as mb, mitsuba as mi, numpy as np
mi.set_variant("scalar_rgb")
print(len(mb.BezierTriangles(np.eye(3, 4)).split()))
"""
    done = python(code, {"DRJIT_LIBLLVM_PATH": "/nowhere/libLLVM.so"})
    assert (done.returncode, done.stdout) == (0, "4\n"), done.stderr


# ---------------------------------------------------------------- mitsuba first, old LLVM


def old_libraries() -> list[str]:
    return [lib.path for lib in _llvm._system() if lib.version < (_llvm.MINIMUM,)]


# from here on as on a machine where the linker finds this library, or none
FORGET = "import os; del os.environ['DRJIT_LIBLLVM_PATH']\n"


@pytest.mark.parametrize("imports", ["import drjit", "import mitsuba", "import drjit, mitsuba"])
@pytest.mark.parametrize("library", old_libraries(), ids=os.path.basename)
def test_imported_last_with_a_real_old_llvm(python, library, imports):
    # LLVM 15 and 16 abort the process at the first minimum; Dr.Jit itself refuses 14
    code = f"{imports}\n{FORGET}import mitsuba_bezier, mitsuba as mi; mi.set_variant('llvm_ad_rgb')"
    done = python(code + MINMAX + USE, {"DRJIT_LIBLLVM_PATH": library})
    assert (done.returncode, done.stdout) == (0, "works\n"), done.stderr
    assert "Warning" not in done.stderr


def test_started_anew_with_a_library_that_will_do(python):
    # anywhere: what is left of Dr.Jit works after a restart
    code = """
import mitsuba_bezier, mitsuba as mi
from mitsuba_bezier import _runtime
mi.set_variant("scalar_rgb")
before = _runtime.llvm_version()
assert _runtime._may_restart()
_runtime._restart()
assert _runtime.llvm_version() == before
mi.set_variant("llvm_ad_rgb")
assert not _runtime._may_restart()  # Mitsuba holds arrays
"""
    done = python(code + MINMAX + USE)
    assert (done.returncode, done.stdout) == (0, "works\n"), done.stderr


def test_an_array_stays(python):
    code = """
import mitsuba_bezier, drjit as dr
from mitsuba_bezier import _runtime
x = dr.llvm.Float([1, 2])
assert not _runtime._may_restart()
del x
assert _runtime._may_restart()
"""
    done = python(code)
    assert done.returncode == 0, done.stderr


def at_once(stderr: str) -> str:
    """Return the one warning, which names the line of the import and is valid in any order."""
    (line,) = [line for line in stderr.splitlines() if "Warning" in line]
    assert line.startswith("<string>:")
    assert line.endswith(
        "Set the variable before Python starts, then the order does not matter: "
        f"export DRJIT_LIBLLVM_PATH={good_library()}"
    )
    return line


@linux_only
def test_imported_last_where_dr_jit_found_no_llvm(python):
    # it does not look again, so this process cannot be helped
    code = f"import drjit, mitsuba as mi\n{FORGET}import mitsuba_bezier; print('imported')\n{USE}"
    done = python(code, {"DRJIT_LIBLLVM_PATH": "/nowhere/libLLVM.so"})
    assert done.returncode == 0, done.stderr
    assert "got no LLVM library that Dr.Jit can use; Dr.Jit was imported" in at_once(done.stderr)
    assert done.stdout.startswith("imported\n")


@linux_only
@pytest.mark.parametrize("library", old_libraries(), ids=os.path.basename)
def test_imported_after_the_variant_with_a_real_old_llvm(python, library):
    code = f"""
import mitsuba as mi
try:
    mi.set_variant("llvm_ad_rgb")
except ImportError:  # 14, which Mitsuba names before we are asked
    print("DRJIT_LIBLLVM_PATH")
else:
    {FORGET}
    import mitsuba_bezier, sys
    try:
        mitsuba_bezier._runtime.check("llvm_ad_rgb")
    except mitsuba_bezier.RuntimeSetupError as error:
        print(error)
"""
    done = python(code, {"DRJIT_LIBLLVM_PATH": library})
    assert done.returncode == 0, done.stderr
    assert "DRJIT_LIBLLVM_PATH" in done.stdout
    if "LLVM: expected" in done.stdout:
        assert at_once(done.stderr).endswith(done.stdout.strip())


def test_the_command_that_is_advised_works(python):
    code = "import drjit, mitsuba, mitsuba_bezier; mi = mitsuba; mi.set_variant('llvm_ad_rgb')"
    done = python(code + MINMAX + USE, {"DRJIT_LIBLLVM_PATH": good_library()})
    assert (done.returncode, done.stdout) == (0, "works\n"), done.stderr
    assert "Warning" not in done.stderr


def test_export_quotes(monkeypatch):
    assert _llvm.export("V", "/a b/x.so") == "export V='/a b/x.so'"
    monkeypatch.setattr(sys, "platform", "win32")
    assert _llvm.export("V", "C:\\x.dll") == "set V=C:\\x.dll"


@pytest.mark.parametrize("library", old_libraries(), ids=os.path.basename)
def test_the_variable_names_a_real_old_llvm(python, library):
    code = """
import mitsuba_bezier
from mitsuba_bezier import _runtime
try:
    _runtime.check("llvm_ad_rgb")
except mitsuba_bezier.RuntimeSetupError as error:
    print(error)
"""
    done = python(code, {"DRJIT_LIBLLVM_PATH": library})
    assert done.returncode == 0, done.stderr
    assert library in done.stdout
    assert f"unset DRJIT_LIBLLVM_PATH, or set it to {good_library()}" in done.stdout


@pytest.mark.parametrize("version", [None, (14, 0, 6), (15, 0, 7), (16, 0, 6)])
def test_mitsuba_first_with_an_old_llvm_as_drjit_tells(monkeypatch, version):
    monkeypatch.setattr(_runtime, "llvm_version", lambda: version)
    monkeypatch.setattr(_runtime, "llvm_path", lambda: version and "/usr/lib/libLLVM-old.so.1")
    monkeypatch.setattr(_runtime, "_late", True)
    monkeypatch.setattr(_runtime, "_ours", None)
    monkeypatch.setattr(_runtime, "_good", set())
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH")
    with pytest.raises(RuntimeSetupError) as raised:
        _runtime.check("llvm_ad_rgb")
    message = str(raised.value)
    got = "no LLVM library" if version is None else ".".join(map(str, version))
    assert message.startswith(f"LLVM: expected version 17 or newer, got {got}")
    assert "Dr.Jit was imported before mitsuba_bezier and keeps its choice" in message
    assert f"the order does not matter: export DRJIT_LIBLLVM_PATH={good_library()}" in message
    assert "\n" not in message


@pytest.mark.parametrize("version", [(17, 0, 6), (19, 1, 7), (23, 1, 4)])
def test_newer_versions_pass(monkeypatch, version):
    monkeypatch.setattr(_runtime, "llvm_version", lambda: version)
    assert _runtime.llvm_problem() is None


# ---------------------------------------------------------------- nothing usable


def test_no_llvm_anywhere(monkeypatch):
    monkeypatch.setattr(_runtime, "llvm_version", lambda: None)
    monkeypatch.setattr(_runtime, "llvm_path", lambda: None)
    monkeypatch.setattr(_runtime, "_ours", None)
    monkeypatch.setattr(_runtime, "_good", set())
    monkeypatch.setattr(_llvm, "find", lambda: None)
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH")
    with pytest.raises(RuntimeSetupError) as raised:
        _runtime.check("llvm_ad_rgb")
    assert str(raised.value).endswith(f"install one: {_llvm.install_command('llvm')}")


@pytest.mark.parametrize(
    ("content", "reason"),
    [(None, "cannot open shared object file"), ("no library\n", "file too short|invalid ELF")],
)
@linux_only
def test_the_variable_names_a_bad_file(python, tmp_path, content, reason):
    path = tmp_path / "libLLVM.so"
    if content:
        path.write_text(content)
    code = """
import mitsuba_bezier
from mitsuba_bezier import _runtime
try:
    _runtime.check("llvm_ad_rgb")
except mitsuba_bezier.RuntimeSetupError as error:
    print(error)
"""
    message = python(code, {"DRJIT_LIBLLVM_PATH": str(path)}).stdout
    assert f"got DRJIT_LIBLLVM_PATH={path}" in message
    assert any(part in message for part in reason.split("|"))
    assert f"unset DRJIT_LIBLLVM_PATH, or set it to {good_library()}" in message


@linux_only
def test_without_libatomic(python, tmp_path):
    # an empty file in front of the real library: the loader stops there
    (tmp_path / "libatomic.so.1").touch()
    code = """
import mitsuba_bezier as mb, numpy as np
from mitsuba_bezier import _runtime
print(len(mb.BezierTriangles(np.eye(3, 4))))
for use in (_runtime.import_mitsuba, lambda: mb.ray_test, lambda: _runtime.check("llvm_ad_rgb")):
    try:
        use()
    except mb.RuntimeSetupError as error:
        print(error)
"""
    done = python(code, {"LD_LIBRARY_PATH": str(tmp_path)})
    lines = done.stdout.splitlines()
    assert lines[0] == "1", done.stderr  # the geometry works
    assert len(lines) == 4
    for line in lines[1:]:
        assert line.startswith("libatomic: expected libatomic.so.1, which Dr.Jit needs, got")
        assert line.endswith(f"install it: {_llvm.install_command('libatomic')}")


# ---------------------------------------------------------------- variants


def test_a_scalar_variant_is_refused():
    with pytest.raises(VariantError, match=r"variant: expected one of .*llvm_ad_rgb.*scalar_rgb"):
        _runtime.check("scalar_rgb")


def test_no_variant_is_refused():
    with pytest.raises(VariantError, match=r"got none; choose one.*mi\.set_variant"):
        _runtime.check(None)


def test_an_unknown_variant_is_refused():
    with pytest.raises(VariantError, match=r"variant: expected one of .*, got llvm_ad_rbg"):
        _runtime.check("llvm_ad_rbg")


def test_cuda_without_a_gpu_is_refused(monkeypatch):
    starts = _runtime._starts
    monkeypatch.setattr(
        _runtime, "_starts", lambda name: not name.startswith("cuda_") and starts(name)
    )
    monkeypatch.setattr(_runtime, "_good", set())
    with pytest.raises(VariantError, match="got cuda_ad_rgb, but there is no GPU"):
        _runtime.check("cuda_ad_rgb")


# ---------------------------------------------------------------- the wheel without its links


@linux_only
def test_the_wheel_before_its_symbolic_links_are_made(python, tmp_path):
    """The wheel's files as pip leaves them: under their full names, without links."""
    wheels = [lib for lib in _llvm._wheels() if "karellen" in lib.origin]
    if not wheels:
        pytest.skip("the wheel karellen-llvm-core is made for x86-64 only")
    original = Path(wheels[0].path)
    library = tmp_path / original.name
    shutil.copy(original, library)
    (runtime,) = original.parent.glob("*-unknown-linux-gnu/libc++.so.1.0")
    folder = tmp_path / runtime.parent.name
    folder.mkdir()
    for file in runtime.parent.glob("*.so.1.0"):
        shutil.copy(file, folder)
    # without help it does not load (else the rest would show nothing) ...
    bare = python(f"import ctypes; ctypes.CDLL({str(library)!r})")
    assert "libc++.so.1: cannot open shared object file" in bare.stderr
    # ... with `prepare` it does, and renders
    code = f"""
import mitsuba_bezier, mitsuba as mi
mi.set_variant("llvm_ad_rgb")
from mitsuba_bezier import _runtime
assert _runtime.llvm_path() == {str(library)!r}, _runtime.llvm_path()
"""
    done = python(code + MINMAX, {"DRJIT_LIBLLVM_PATH": str(library)})
    assert done.returncode == 0, done.stderr


# ---------------------------------------------------------------- finding libraries


@pytest.mark.parametrize(
    ("path", "version"),
    [
        ("/usr/lib/x86_64-linux-gnu/libLLVM-17.so.1", (17,)),
        ("/usr/lib/x86_64-linux-gnu/libLLVM-14.0.6.so.1", (14, 0, 6)),
        ("/usr/lib64/libLLVM.so.19.1", (19, 1)),
        ("/usr/lib/llvm-18/lib/libLLVM.so", (18,)),
        ("/opt/homebrew/opt/llvm@20/lib/libLLVM.dylib", (20,)),
        ("/opt/homebrew/Cellar/llvm/21.1.2/lib/libLLVM.dylib", (21, 1, 2)),
        ("/usr/lib/libLLVM.so", ()),
    ],
)
def test_version_of_a_path(path, version):
    assert _llvm._version_of(path) == version


@pytest.mark.parametrize(
    "name", ["libLLVM-C.dylib", "libLLVM-19-rust-1.84.so", "libLLVM-17jl.so", "libLLVMX86.so.17"]
)
def test_private_builds_are_left_alone(name):
    assert not _llvm._NAME.search(name)


def fake_library(path: Path, machine: bytes | None = None) -> Path:
    """Write an ELF header of this machine, or of another one."""
    path.parent.mkdir(parents=True, exist_ok=True)
    header = Path("/proc/self/exe").read_bytes()[:20]
    path.write_bytes(header[:18] + machine if machine else header)
    return path


@linux_only
def test_the_newest_system_library_of_this_machine(tmp_path, monkeypatch):
    fake_library(tmp_path / "llvm-18/lib/libLLVM.so.18.1")
    newest = fake_library(tmp_path / "lib/libLLVM.so.21.1")
    (tmp_path / "lib/libLLVM-21.so").symlink_to(newest)
    fake_library(tmp_path / "lib/libLLVM-16.so.1")
    fake_library(tmp_path / "lib/libLLVM.so.22.1", machine=b"\xf3\x00")  # RISC-V
    (tmp_path / "lib/libLLVM-23.so").symlink_to(tmp_path / "gone.so")
    monkeypatch.setattr(_llvm, "_FOLDERS", {"linux": (f"{tmp_path}/llvm-*/lib", f"{tmp_path}/lib")})
    monkeypatch.setattr(_llvm, "_from_linker_cache", lambda: [])
    monkeypatch.setattr(_llvm, "_wheels", lambda: iter(()))
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "none"))
    assert _llvm.find() == _llvm.Library(str(newest), (21, 1), "the system")


@linux_only
def test_the_linker_cache_is_asked(tmp_path, monkeypatch):
    library = fake_library(tmp_path / "odd/place/libLLVM-20.so.1")
    monkeypatch.setattr(_llvm, "_FOLDERS", {})
    monkeypatch.setattr(_llvm, "_from_linker_cache", lambda: [str(library)])
    monkeypatch.setattr(_llvm, "_wheels", lambda: iter(()))
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "none"))
    assert _llvm.find() == _llvm.Library(str(library), (20,), "the system")


def test_a_wheel_comes_before_the_system_and_old_ones_count_for_nothing(monkeypatch):
    def libraries(origin, *versions):
        return lambda: iter([_llvm.Library(f"{origin}{v}", (v,), origin) for v in versions])

    monkeypatch.setattr(_llvm, "_system", libraries("system", 17, 24))
    monkeypatch.setattr(_llvm, "_wheels", libraries("wheel", 19, 21))
    assert _llvm.find().path == "wheel21"
    monkeypatch.setattr(_llvm, "_wheels", libraries("wheel", 16))
    assert _llvm.find().path == "system24"
    monkeypatch.setattr(_llvm, "_system", libraries("system", 14, 15, 16))
    assert _llvm.find() is None


class FakeWheel:
    """What `importlib.metadata` tells of an installed wheel."""

    version = "21.1.6.3"

    def __init__(self, folder):
        self.folder = folder

    def read_text(self, _name):
        return (
            "llvm_nanobind.libs/libLLVM-a6b168f6.so.21.1,sha256=x,1\n"
            "llvm_nanobind.libs/libLLVMSupport.a,sha256=x,1\n"
            "llvm_nanobind.libs/libxml2.so,,\n"
        )

    def locate_file(self, name):
        return self.folder / name


def test_the_hashed_name_in_llvm_nanobind(tmp_path, monkeypatch):
    (tmp_path / "llvm_nanobind.libs").mkdir()
    for name in ("libLLVM-a6b168f6.so.21.1", "libLLVMSupport.a"):
        (tmp_path / "llvm_nanobind.libs" / name).touch()

    def distribution(name):
        if name == "llvm-nanobind":
            return FakeWheel(tmp_path)
        raise _llvm.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(_llvm.metadata, "distribution", distribution)
    (library,) = _llvm._wheels()
    assert os.path.basename(library.path) == "libLLVM-a6b168f6.so.21.1"
    assert library.version == (21, 1, 6)


@pytest.mark.parametrize(
    ("release", "machine", "what", "command"),
    [
        ({"ID": "debian"}, "x86_64", "llvm", 'pip install "karellen-llvm-core>=19,<24"'),
        ({"ID": "debian"}, "aarch64", "llvm", "apt install libllvm19"),
        (
            {"ID": "pop", "ID_LIKE": "ubuntu debian"},
            "x86_64",
            "libatomic",
            "apt install libatomic1",
        ),
        ({"ID": "rocky", "ID_LIKE": "rhel fedora"}, "x86_64", "libatomic", "dnf install libatomic"),
        ({"ID": "arch"}, "aarch64", "llvm", "pacman -S llvm-libs"),
        ({"ID": "ubuntu", "ID_LIKE": "debian"}, "x86_64", "nvidia", "ubuntu-drivers install"),
        ({"ID": "unheard-of"}, "x86_64", "libatomic", "install libatomic.so.1 with the system"),
    ],
)
def test_install_commands(monkeypatch, release, machine, what, command):
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setattr(_llvm.platform, "freedesktop_os_release", lambda: release)
    monkeypatch.setattr(_llvm.platform, "machine", lambda: machine)
    for user, prefix in ((0, ""), (1000, "sudo ")):
        monkeypatch.setattr(os, "geteuid", lambda user=user: user)
        expected = command if command.startswith(("pip", "install")) else prefix + command
        assert _llvm.install_command(what).startswith(expected)


def test_what_was_loaded_is_what_was_chosen(python):
    code = """
import json, mitsuba_bezier
from mitsuba_bezier import _runtime as r
print(json.dumps([r.llvm_version(), r.llvm_path(), r.llvm_origin()]))
"""
    version, path, origin = json.loads(python(code).stdout)
    library = _llvm.find()
    assert tuple(version[: len(library.version)]) == library.version
    assert path == library.path
    assert origin == f"mitsuba_bezier, from {library.origin}"
