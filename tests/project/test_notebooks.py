"""The notebooks run, and hold what their sources say, with figures inside."""

from __future__ import annotations

import base64
import json
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import pytest

pytest.importorskip("matplotlib", reason="notebooks need the extra 'figures'")

FOLDER = Path(__file__).parents[2] / "docs" / "notebooks"
_SPEC = spec_from_file_location("make_notebooks", FOLDER / "make.py")
assert _SPEC is not None and _SPEC.loader is not None
make = module_from_spec(_SPEC)
_SPEC.loader.exec_module(make)


@pytest.mark.parametrize("path", make.SOURCES, ids=lambda path: path.stem)
def test_notebooks(path):
    source = path.read_text(encoding="utf-8")
    kept = json.loads(path.with_suffix(".ipynb").read_text(encoding="utf-8"))
    assert kept["nbformat"] == 4
    # "python docs/notebooks/make.py" makes them again
    written = [(c["cell_type"], "".join(c["source"])) for c in kept["cells"]]
    assert written == make.cells(source)
    images = [
        output["data"]["image/png"]
        for cell in kept["cells"]
        for output in cell.get("outputs", ())
        if "image/png" in output.get("data", {})
    ]
    assert len(images) >= 4
    assert all(base64.b64decode(i).startswith(b"\x89PNG") for i in images)
    namespace = {"__name__": "__notebook__"}
    asserted = 0
    for kind, text in make.cells(source):
        if kind == "code":
            make.executed(text, namespace)
            asserted += "assert " in text
    assert asserted >= 3


def test_there_are_three():
    assert {path.stem for path in make.SOURCES} == {
        "curves_and_duality",
        "perspective",
        "triangles_and_quadrics",
    }
