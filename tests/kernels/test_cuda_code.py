"""The code that Dr.Jit generates of the kernels for CUDA, looked at and run without a GPU.

``cuda_standin`` has the stand-in for the driver and what runs the code on the CPU.
"""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from backend_cases import has_float64
from cuda_standin.standin import KNOWN, StandIn, reason_without

import mitsuba_bezier

#: All but the one that has `reciprocal` and `inverse_root`, which the others use.
KERNELS = sorted(
    path
    for path in (Path(mitsuba_bezier.__file__).parent / "kernels").rglob("*.py")
    if path.stem not in ("__init__", "arrays")
)

#: All that Dr.Jit turns into `rcp.approx.ftz.f64`, which has 20 bits, for float64.
ROUGH = re.compile(r"\bdr\.(rcp|rsqrt|normalize|tanh?)\(")
#: ... and this is what they are.
ROUGH_CODE = re.compile(r"^.*\bapprox\S*\.f64\b.*$", re.MULTILINE)

#: Results of instructions are off by the one or two roundings that NVIDIA's manual allows, and all
#: that kernels do in float32 amplifies them some ten times. In `t` relative, in `u` and `v` of the
#: patch.
TOLERANCE = 3e-6

needs_stand_in = pytest.mark.skipif(reason_without() is not None, reason=reason_without() or "")


@pytest.fixture(scope="module")
def stand_in(tmp_path_factory) -> StandIn:
    return StandIn(tmp_path_factory.mktemp("cuda"))


def rough_code(folder: Path) -> dict[str, list[str]]:
    """Return the instructions that have too few bits, by the kernel of Dr.Jit's code generator."""
    texts = {path.name: path.read_text(encoding="utf-8") for path in folder.glob("**/*.ptx")}
    generated = {name: text for name, text in texts.items() if "drjit_" in text}
    assert generated
    found = {name: ROUGH_CODE.findall(text) for name, text in generated.items()}
    return {name: lines for name, lines in found.items() if lines}


@pytest.mark.parametrize("path", KERNELS, ids=lambda path: path.stem)
def test_kernels_divide_in_float64(path):
    assert not ROUGH.findall(path.read_text(encoding="utf-8"))


@needs_stand_in
def test_the_version_of_drjit():
    assert not StandIn.about(), f"{StandIn.about()}then change KNOWN ({KNOWN}) in standin.py"


#: Cases that share a process. Not "dr.rcp".
GROUPS = {
    "closed forms": ("tetrahedral", "octants", "capped cone", "inverted"),
    "general": ("general", "torus"),
    "infinity": ("infinity",),
    "several kinds": ("several kinds",),
    "trims": ("trims",),
    "instances": ("instances",),
    "aspheres": ("aspheres", "an asphere"),
}


@needs_stand_in
@pytest.mark.parametrize("kind", ["closest", "any"])
@pytest.mark.parametrize("group", GROUPS)
def test_cuda_finds_what_llvm_finds(stand_in, group, kind):
    names = [f"{name}, {kind}" for name in GROUPS[group]]
    if group == "instances" and kind == "closest":  # one is enough: not used on CUDA so far
        names.append("batch, closest")
    folder, results = stand_in.run("cases", f"{group}, {kind}", names, rough=True)
    assert [result["case"] for result in results] == names
    for result in results:
        assert result["hits"] > 0.2
        assert result["different"] == 0, result
        if kind == "closest":
            assert max(result[key] for key in "tuv") < TOLERANCE, result
    assert not rough_code(folder)
    # a kernel of Dr.Jit's own that the stand-in does not know would leave zeros
    assert not list(folder.glob("**/not_run.txt"))


@needs_stand_in
def test_points_and_partials(stand_in):
    folder, (result,) = stand_in.run("cases", "points", ["points"], rough=True)
    assert result["values"] < TOLERANCE
    assert not rough_code(folder)


@needs_stand_in
def test_float64(stand_in):
    names = [
        f"float64: {name}"
        for name in ("general, closest", "several kinds, any", "an asphere, closest", "points")
    ]
    folder, results = stand_in.run("cases", "float64", names)
    for result in results:
        assert result.get("different", 0) == 0, result
        # no instruction is rough then; some roundings, and some more where a step is the last
        assert max(result.get(key, 0.0) for key in ("t", "u", "v", "values")) < 1e-12, result
    assert not rough_code(folder)


@needs_stand_in
def test_pairs_of_float32(stand_in):
    """Products and sums are not fused, and no division or root has to be exact."""
    kinds = ("octants", "capped cone", "inverted", "infinity", "an asphere")
    names = [f"pairs: {kind}, closest" for kind in kinds]
    folder, results = stand_in.run("cases", "pairs", names, rough=True)
    for result in results:
        assert result["hits"] > 0.2 and result["different"] == 0, result
        assert max(result[key] for key in "tuv") < TOLERANCE, result
    texts = [path.read_text(encoding="utf-8") for path in folder.glob("**/*.ptx")]
    assert len(texts) >= len(kinds)
    assert not [text for text in texts if "drjit_" in text and has_float64(text)]


@needs_stand_in
def test_whole_scenes(stand_in):
    folder, results = stand_in.run("scenes", "scenes", ["path", "layers"], some=True)
    assert len(results) == 2
    assert not rough_code(folder)


@needs_stand_in
def test_what_is_too_rough_is_seen(stand_in):
    folder, (result,) = stand_in.run("cases", "rcp", ["dr.rcp"])
    assert 1e-8 < result["values"] < 2e-6  # 20 bits
    (lines,) = rough_code(folder).values()
    assert len(lines) == 1


@needs_stand_in
def test_the_benchmark_of_registers_says_what_is_missing(tmp_path):
    if importlib.util.find_spec("nvidia") is not None:
        pytest.skip("NVIDIA's wheels are here")
    gcc = shutil.which("gcc")
    assert gcc is not None
    (tmp_path / "gcc").symlink_to(gcc)
    run = subprocess.run(
        [sys.executable, Path(__file__).parents[2] / "benchmarks" / "ptxas.py"],
        env={**os.environ, "PATH": str(tmp_path)},
        capture_output=True,
        text=True,
    )
    assert run.returncode == 2 and not run.stdout
    assert len(run.stderr.splitlines()) == 1
    assert "nvidia-cuda-nvcc-cu12" in run.stderr and "mitsuba-bezier[ptxas]" in run.stderr
