"""The rules for imports (which layer may know which), held by looking at the source."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import mitsuba_bezier

ROOT = Path(mitsuba_bezier.__file__).parent
MODULES = sorted(path.relative_to(ROOT).as_posix() for path in ROOT.rglob("*.py"))

# imports go from a larger number to a smaller one, or stay within one folder
LAYERS = {
    "errors": 0,
    "_version": 0,
    "_children": 0,
    "_signals": 0,
    "_threads": 0,
    "_files": 1,
    "_llvm": 1,
    "_runtime": 2,
    "_loading": 2,
    "geometry": 10,
    "figures": 12,
    "leaves": 15,
    "oracles": 15,
    "io": 20,
    "kernels": 20,
    "optics": 25,
    "verification": 20,
    "plugins": 30,
    "models": 35,
    "fit": 35,
    "rendering": 33,
    "studio": 45,
    "__init__": 40,
    "cli": 50,
    "regression": 60,  # a door like the command line, and it renders as that does
}

FORBIDDEN = {
    "geometry": {"mitsuba", "drjit", "scipy"},
    "figures": {"mitsuba", "drjit", "scipy"},
    "leaves": {"mitsuba", "drjit", "scipy"},
    "oracles": {"mitsuba", "drjit", "scipy"},
    "kernels": {"mitsuba"},
    "io": {"mitsuba", "drjit"},
    "optics": {"mitsuba", "drjit"},
}


def layer(name: str) -> str:
    """Return the layer of a module given by its path or its name below the package."""
    return name.removesuffix(".py").replace(".", "/").split("/")[0]


def imports(tree: ast.AST, module: str) -> Iterator[tuple[str, ast.stmt]]:
    """Yield what is imported: names of the package as ".geometry.x", others as they are."""
    depth = module.count("/")  # folders between the module and the package
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.name.replace("mitsuba_bezier", "", 1), node
        elif isinstance(node, ast.ImportFrom):
            if node.level == 0:
                base = (node.module or "").replace("mitsuba_bezier", "", 1)
            else:
                here = module.split("/")[:-1]
                base = "." + ".".join(
                    [*here[: depth + 1 - node.level], *filter(None, [node.module])]
                )
            if base in ("", "."):
                # "from .. import x": a module of the package, or a name of its __init__
                for alias in node.names:
                    known = alias.name in LAYERS or (ROOT / f"{alias.name}.py").exists()
                    yield f".{alias.name if known else '__init__'}", node
            else:
                yield base, node


def violations(source: str, module: str) -> list[str]:
    """Return what breaks the rules in one module of the package."""
    tree = ast.parse(source)
    found = []
    own = layer(module)
    if own not in LAYERS:
        found.append(f"{own} has no place among the layers")
    for name, node in imports(tree, module):
        if name.startswith("."):
            other = layer(name[1:])
            allowed = other == own or LAYERS.get(other, 99) < LAYERS.get(own, 0)
            if own == "oracles" and other == "leaves":
                allowed = False
            if not allowed:
                found.append(f"line {node.lineno}: {own} imports {other}")
        else:
            top = name.split(".")[0]
            if top in FORBIDDEN.get(own, ()):
                found.append(f"line {node.lineno}: {own} imports {top}")
            if own == "cli" and top in ("mitsuba", "drjit") and node in tree.body:
                found.append(f"line {node.lineno}: --help would import {top}")
    if own != "cli":
        for node in ast.walk(tree):
            name = getattr(node, "attr", None) or getattr(node, "id", None)
            if name == "set_variant":
                found.append(f"line {node.lineno}: set_variant outside cli")  # type: ignore[attr-defined]
    has_code = any(
        isinstance(node, (ast.Import, ast.ImportFrom, ast.FunctionDef, ast.ClassDef))
        for node in tree.body
    )
    if has_code and not any(
        isinstance(node, ast.ImportFrom)
        and node.module == "__future__"
        and "annotations" in [alias.name for alias in node.names]
        for node in tree.body
    ):
        found.append("from __future__ import annotations is missing")
    return found


@pytest.mark.parametrize("module", MODULES)
def test_rules(module: str) -> None:
    assert violations((ROOT / module).read_text(encoding="utf-8"), module) == []


F = "from __future__ import annotations\n"


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("geometry/a.py", F + "import mitsuba as mi"),
        ("geometry/a.py", F + "def f():\n    import drjit.auto"),
        ("geometry/a.py", F + "from scipy.linalg import svd"),
        ("geometry/a.py", F + "from ..kernels import net"),
        ("geometry/a.py", F + "from .. import io"),
        ("geometry/a.py", F + "from mitsuba_bezier.io import load"),
        ("geometry/triangles.py", F + "def save():\n    from ..io import save"),
        ("oracles/a.py", F + "from ..leaves import builder"),  # leans on what it judges
        ("geometry/a.py", F + "from .. import sphere"),  # a name of __init__
        ("figures/a.py", F + "import mitsuba"),
        ("figures/a.py", F + "from ..io import load"),
        ("geometry/a.py", F + "from ..figures import plane"),
        ("kernels/a.py", F + "import mitsuba"),
        ("kernels/a.py", F + "from ..io import load"),
        ("io/a.py", F + "from ..plugins.shape import Shape"),
        ("plugins/a.py", F + "from ..cli.main import main"),
        ("plugins/a.py", F + "def f(mi):\n    mi.set_variant('llvm_ad_rgb')"),
        ("plugins/a.py", F + "from mitsuba import set_variant\nset_variant('llvm_ad_rgb')"),
        ("__init__.py", F + "from .cli.main import main"),
        ("errors.py", F + "from .geometry import bernstein"),
        ("cli/a.py", F + "import mitsuba as mi"),
        ("kernels/a.py", "import drjit"),  # no __future__
        ("other/a.py", F),
    ],
)
def test_a_violation_is_seen(module: str, source: str) -> None:
    assert len(violations(source, module)) == 1


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("geometry/a.py", F + "import numpy as np\nfrom ..errors import NetError\nfrom . import b"),
        ("kernels/a.py", F + "import drjit as dr\nfrom ..geometry.bernstein import size"),
        (
            "plugins/a.py",
            F + "import mitsuba as mi\nfrom .. import _runtime\nfrom ..kernels import net",
        ),
        ("__init__.py", F + "from . import _runtime\nfrom .geometry.covers import sphere"),
        (
            "cli/a.py",
            F + "from .. import load\ndef run(args):\n    import mitsuba as mi\n"
            "    mi.set_variant('llvm_ad_rgb')",
        ),
        ("_version.py", "__version__ = '1'"),
    ],
)
def test_what_is_allowed_passes(module: str, source: str) -> None:
    assert violations(source, module) == []


def test_the_picture_of_the_layers_is_that_of_the_source():
    from importlib.util import module_from_spec, spec_from_file_location

    script = ROOT.parent / "docs" / "make_architecture.py"
    spec = spec_from_file_location("make_architecture", script)
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    # "python docs/make_architecture.py" draws it again
    assert module.TARGET.read_text(encoding="utf-8") == module.draw()


def cycles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Return the groups of modules that import each other, by Tarjan's algorithm."""
    order: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found = []

    def visit(name: str) -> None:
        order[name] = low[name] = len(order)
        stack.append(name)
        for other in graph[name]:
            if other not in order:
                visit(other)
            if other in stack:
                low[name] = min(low[name], low[other])
        if low[name] == order[name]:
            group = stack[stack.index(name) :]
            del stack[stack.index(name) :]
            if len(group) > 1:
                found.append(sorted(group))

    for name in graph:
        if name not in order:
            visit(name)
    return found


def test_tests_take_the_backend_from_one_place():
    for path in (ROOT.parent / "tests").rglob("*.py"):
        if path.name not in ("backend_cases.py", Path(__file__).name):
            assert "drjit.llvm" not in path.read_text(encoding="utf-8"), path


def test_files_of_tests_have_names_of_their_own():
    # pytest imports them by their names alone, and stops at the second one of a name
    names = [path.name for path in Path(__file__).parents[1].rglob("test_*.py")]
    assert sorted(set(names)) == sorted(names)


def test_no_modules_import_each_other():
    names = {module.removesuffix(".py").replace("/", ".") for module in MODULES}
    graph = {}
    for module in MODULES:
        own = module.removesuffix(".py").replace("/", ".")
        others = set()
        tree = ast.parse((ROOT / module).read_text(encoding="utf-8"))
        for node in tree.body:  # what is imported in a function is imported when all is there
            for name, statement in imports(ast.Module([node], []), module):
                target = name[1:] if name.startswith(".") else ""
                pieces = [target]
                if isinstance(statement, ast.ImportFrom):
                    pieces = [f"{target}.{alias.name}" for alias in statement.names] + [target]
                others |= {piece for piece in pieces if piece in names and piece != own}
        graph[own] = others
    found = cycles(graph)
    print(f"{len(found)} circles among {len(graph)} modules")
    assert found == []
    assert cycles({"a": {"b"}, "b": {"c"}, "c": {"b"}}) == [["b", "c"]]
