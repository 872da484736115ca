"""``mitsuba-bezier render``: from a scene file to an EXR with a header and a preview."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from importlib import metadata
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from cli_cases import BEZIER, INTEGRATOR, render, scene

import mitsuba_bezier as mb
from mitsuba_bezier import _runtime
from mitsuba_bezier._threads import thread_for_files
from mitsuba_bezier.cli import _images, _passes, main
from mitsuba_bezier.rendering.passes import render_pass
from mitsuba_bezier.rendering.picture import Picture
from mitsuba_bezier.rendering.plan import Plan, pass_seed
from mitsuba_bezier.verification.images import write_exr


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Return an empty folder with a scene file, which is the current one."""
    (tmp_path / "ball.xml").write_text(scene())
    monkeypatch.chdir(tmp_path)
    return tmp_path


def pixels(path: Path | str) -> dict[str, np.ndarray]:
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {name: np.array(channel.pixels) for name, channel in file.channels().items()}


def header(path: Path | str) -> dict:
    with OpenEXR.File(str(path)) as file:
        return dict(file.header())


# ---------------------------------------------------------------- files


def test_the_default_output_lies_beside_the_scene(folder, capsys):
    (folder / "scenes").mkdir()
    (folder / "scenes/ball.xml").write_text(scene())
    assert render("scenes/ball.xml") == 0
    assert sorted(os.listdir("scenes")) == ["ball.exr", "ball.png", "ball.xml"]
    err = capsys.readouterr().err
    assert "the integrator 'path' cannot see Bézier shapes: rendering with bezierpath" in err
    assert "wrote scenes/ball.exr and scenes/ball.png: 16 spp, seed 0, llvm_ad_rgb" in err


def test_the_header_tells_how_it_was_made(folder):
    assert render("ball.xml", "-q", "-o", "a b.exr", "--spp", "8", "--seed", "7") == 0
    found = header("a b.exr")
    assert found["spp"] == 8 and found["seed"] == 7 and found["passes"] == 1
    assert found["variant"] == "llvm_ad_rgb" and found["integrator"] == "bezierpath"
    assert found["command"] == "mitsuba-bezier render ball.xml -q -o 'a b.exr' --spp 8 --seed 7"
    assert found["rfilter"] == "box" and found["render_seconds"] > 0
    assert found["version_mitsuba_bezier"] == mb.__version__
    assert found["version_mitsuba"] == metadata.version("mitsuba")
    assert found["version_drjit"] == metadata.version("drjit")
    assert found["version_llvm"] == ".".join(map(str, _runtime.llvm_version()))
    assert found["compression"] == OpenEXR.ZIP_COMPRESSION


@pytest.mark.parametrize(("kind", "dtype"), [("float16", np.float16), ("float32", np.float32)])
def test_half_or_float_as_the_film_says(folder, kind, dtype):
    film = f'<string name="component_format" value="{kind}"/>'
    (folder / "ball.xml").write_text(scene(film=film))
    assert render("ball.xml", "-q", "--spp", "1") == 0
    assert {name: values.dtype for name, values in pixels("ball.exr").items()} == {
        "R": dtype,
        "G": dtype,
        "B": dtype,
    }


def test_the_preview_is_srgb(folder):
    import mitsuba as mi

    film = '<string name="component_format" value="float32"/>'
    (folder / "ball.xml").write_text(scene(film=film))
    assert render("ball.xml", "-q", "--spp", "4", "--exposure", "-1") == 0
    linear = np.stack([pixels("ball.exr")[name] for name in "RGB"], axis=-1) / 2
    encoded = np.where(
        linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055
    )
    shown = np.array(mi.Bitmap("ball.png"))
    assert shown.dtype == np.uint8 and shown.shape == (24, 32, 3)
    # one step for rounding of the curve in float32
    assert np.abs(shown - 255 * np.clip(encoded, 0, 1)).max() <= 1


def test_a_crop_keeps_its_place(folder):
    names = ("crop_offset_x", 5), ("crop_offset_y", 3), ("crop_width", 10), ("crop_height", 8)
    crop = "".join(f'<integer name="{name}" value="{value}"/>' for name, value in names)
    (folder / "part.xml").write_text(scene(film=crop))
    assert render("ball.xml", "-q", "--spp", "256") == 0
    assert render("part.xml", "-q", "--spp", "256") == 0
    found = header("part.exr")
    assert [list(corner) for corner in found["dataWindow"]] == [[5, 3], [14, 10]]
    assert [list(corner) for corner in found["displayWindow"]] == [[0, 0], [31, 23]]
    whole, part = pixels("ball.exr")["R"], pixels("part.exr")["R"]
    # noise of 256 samples at the edge of the ball (values 0..1) is below 0.5 / 16, times six
    assert np.abs(whole[3:11, 5:15] - part).max() < 6 * 0.5 / 16


def test_all_channels_of_an_aov_integrator(folder, capsys):
    aov = '<integrator type="aov"><string name="aovs" value="dd:depth,nn:sh_normal"/></integrator>'
    (folder / "ball.xml").write_text(scene(integrator=aov))
    assert render("ball.xml", "--spp", "4") == 0
    found = pixels("ball.exr")
    assert {"dd.T", "nn.X", "nn.Y", "nn.Z"} <= set(found)
    # the camera at distance 5 looks at the pole (0, 0, 1) of the unit sphere
    assert found["dd.T"][12, 16] == pytest.approx(4, abs=0.05)  # half a pixel of curvature
    assert found["nn.Z"][12, 16] == pytest.approx(1, abs=0.05)
    assert (folder / "ball.png").exists()


def test_variables_and_nested_integrators_with_bezier_shapes(folder, capsys):
    mb.save(mb.sphere(), folder / "ball.vtu")
    aov = """<integrator type="aov">
      <string name="aovs" value="dd:depth, i:prim_index, p:position, c:albedo, b:boundary_test"/>
      <integrator type="path" name="image"><integer name="max_depth" value="3"/></integrator>
    </integrator>"""
    path = '<integrator type="path"><integer name="max_depth" value="3"/></integrator>'
    for name, integrator in (("all", aov), ("alone", path)):
        text = scene(integrator=integrator, shapes=BEZIER.format("ball.vtu"))
        (folder / f"{name}.xml").write_text(text)
        assert render(f"{name}.xml", "--spp", "4") == 0
    err = capsys.readouterr().err
    assert "'aov' cannot see Bézier shapes: rendering with bezieraov" in err
    assert "'path' cannot see Bézier shapes: rendering with bezierpath" in err
    assert header("all.exr")["integrator"] == "bezieraov"
    found, alone = pixels("all.exr"), pixels("alone.exr")
    # the picture is that of the nested integrator, in the film's channels and the preview too
    for channel in "RGB":
        assert np.abs(found[channel] - alone[channel]).max() < 1e-3  # half precision
        assert np.array_equal(found[f"image.{channel}"], found[channel])
    assert (folder / "all.png").read_bytes() == (folder / "alone.png").read_bytes()
    assert found["dd.T"][12, 16] == pytest.approx(4, abs=0.05)
    assert found["i.I"].max() == 6  # four octants are seen from above
    # colours are halves, as the film says; depths, positions and numbers are not
    assert found["b"].dtype == np.float32 and found["b"][0, 0] == 1
    types = {name: values.dtype for name, values in found.items()}
    assert types["dd.T"] == types["i.I"] == types["p.X"] == np.float32
    assert types["R"] == types["image.A"] == types["c.G"] == np.float16


def test_passes_and_parts_of_variables(folder):
    mb.save(mb.sphere(), folder / "ball.vtu")
    aov = '<integrator type="bezieraov"><string name="aovs" value="k:patch"/></integrator>'
    (folder / "a.xml").write_text(scene(integrator=aov, shapes=BEZIER.format("ball.vtu")))
    assert render("a.xml", "-q", "--spp", "4", "--spp-per-pass", "2") == 0
    patch = pixels("a.exr")["k.I"]
    # no sample of a corner sees the ball, and the middle of a patch is of one number
    assert patch[0, 0] == -1
    assert (patch == np.round(patch)).mean() > 0.8 and len(np.unique(patch)) >= 5
    assert (folder / "a.png").exists()  # black: there is no nested integrator
    # parts carry sums of the variables too
    for part in ("1/2", "2/2"):
        words = ("a.xml", "-q", "--spp", "4", "--spp-per-pass", "2", "--part", part)
        assert render(*words, "-o", f"part{part[0]}.exr") == 0
    assert main.main(["merge", "part1.exr", "part2.exr", "-o", "whole.exr", "-q"]) == 0
    assert np.array_equal(pixels("whole.exr")["k.I"], patch)


def test_monochrome(folder):
    assert render("ball.xml", "-q", "--spp", "4", "-m", "llvm_ad_mono") == 0
    assert header("ball.exr")["variant"] == "llvm_ad_mono"
    assert (folder / "ball.png").exists()


# ---------------------------------------------------------------- options


def test_defines_reach_the_scene(folder):
    assert render("ball.xml", "-q", "--spp", "4", "-D", "depth=1") == 0
    # depth 1: the light itself, seen beside a black ball
    assert pixels("ball.exr")["R"][12, 16] == 0
    assert pixels("ball.exr")["R"][0, 0] == 1


def test_the_sensor_is_chosen(folder):
    text = scene(sensors=2)
    first, second = text.split('origin="0,0,5"', 1)[0], text.split('origin="0,0,5"', 1)[1]
    (folder / "two.xml").write_text(
        first + 'origin="0,0,-50"' + second  # from there the ball is small
    )
    assert render("two.xml", "-q", "--spp", "4", "-o", "far.exr") == 0
    assert render("two.xml", "-q", "--spp", "4", "-s", "1", "-o", "near.exr") == 0
    dark = [(pixels(name)["R"] < 0.9).mean() for name in ("far.exr", "near.exr")]
    assert dark[0] < 0.05 < dark[1]


def test_files_are_found_beside_the_scene_and_in_search_paths(folder):
    mb.save(mb.sphere(), folder / "ball.vtu")
    (folder / "ball.xml").write_text(scene(shapes=BEZIER.format("ball.vtu")))
    (folder / "elsewhere").mkdir()
    os.chdir(folder / "elsewhere")
    assert render("../ball.xml", "-q", "--spp", "1", "-o", "a.exr") == 0
    os.chdir(folder)
    (folder / "ball.vtu").rename(folder / "elsewhere/ball.vtu")
    assert render("ball.xml", "-q", "--spp", "1", "-a", "nowhere;elsewhere") == 0
    assert render("ball.xml", "-q", "--spp", "1") == 2


def test_integrator_in_an_included_file(folder, capsys):
    (folder / "light.xml").write_text(f'<scene version="3.0.0">{INTEGRATOR}</scene>')
    (folder / "ball.xml").write_text(
        scene(integrator='<default name="depth" value="1"/><include filename="light.xml"/>')
    )
    assert render("ball.xml", "--spp", "4") == 0
    assert "rendering with bezierpath" in capsys.readouterr().err
    assert pixels("ball.exr")["R"][12, 16] == 0  # its parameter stayed


def test_no_integrator(folder, capsys):
    (folder / "ball.xml").write_text(scene(integrator=""))
    assert render("ball.xml", "--spp", "1024") == 0
    assert "names no integrator: rendering with bezierpath" in capsys.readouterr().err
    # white sky, albedo 1/2, nothing else around: the ball is 1/2 everywhere; a sample lies
    # between 0 and 1, so the mean of 9 * 1024 is within six times 0.5 / 96
    patch = pixels("ball.exr")["R"][11:14, 15:18]
    assert patch.mean(dtype=float) == pytest.approx(0.5, abs=0.03)


def test_bezier_shapes_are_rendered(folder):
    mb.save(mb.sphere(), folder / "ball.vtu")
    (folder / "bezier.xml").write_text(scene(shapes=BEZIER.format("ball.vtu")))
    assert render("ball.xml", "-q", "--spp", "64") == 0
    assert render("bezier.xml", "-q", "--spp", "64") == 0
    native, exact = pixels("ball.exr")["R"], pixels("bezier.exr")["R"]
    # same seed, same film samples: the same pixels but for the rounding of half precision and
    # single samples at the silhouette that fall to the other side
    assert (np.abs(native - exact) > 2e-3).mean() < 0.01


def test_integrators_that_cannot_see_bezier_shapes(folder, capsys):
    mb.save(mb.sphere(), folder / "ball.vtu")
    other = '<integrator type="volprim_rf_basic"/>'
    nested = f'<integrator type="aov"><string name="aovs" value="x:uv"/>{other}</integrator>'
    for integrator, place in ((other, "line 3, col 4"), (nested, "line 3")):
        (folder / "a.xml").write_text(
            scene(integrator=integrator, shapes=BEZIER.format("ball.vtu"))
        )
        assert render("a.xml") == 2
        err = capsys.readouterr().err
        assert "integrator: expected bezierpath or beziervolpath or bezieraov or " in err
        assert "path (rendered with bezierpath)" in err
        assert f"got volprim_rf_basic at a.xml ({place}" in err


@pytest.mark.parametrize("name", ["direct", "depth", "prb", "ptracer"])
def test_integrators_by_their_own_names(folder, name):
    mb.save(mb.sphere(), folder / "ball.vtu")
    integrator = f'<integrator type="{name}"/>'
    (folder / "native.xml").write_text(scene(integrator=integrator))
    (folder / "ours.xml").write_text(scene(integrator=integrator, shapes=BEZIER.format("ball.vtu")))
    means = []
    for file in ("native", "ours"):
        assert render(f"{file}.xml", "-q", "--spp", "64") == 0
        assert header(f"{file}.exr")["integrator"] == name
        means.append(pixels(f"{file}.exr")["R"].mean(dtype=float))
    # a ball under a constant sky: noise of the mean is below 1 %
    assert means[1] == pytest.approx(means[0], rel=0.02)
    assert means[0] > 0


# ---------------------------------------------------------------- errors, before any rendering


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["none.xml"], "SCENE: expected an existing scene file (.xml), got none.xml"),
        (["ball.xml", "-o", "a.png"], "--output: expected a name that ends in .exr"),
        (["ball.xml", "-o", "a"], "--output: expected a name that ends in .exr"),
        (["ball.xml", "-o", "none/a.exr"], "--output: expected a folder that exists, got none"),
        (["ball.xml", "-o", "dir.exr"], "--output: expected the name of a file, got the folder"),
        (["ball.xml", "-m", "scalar_rgb"], "got scalar_rgb, which cannot run a Dr.Jit kernel"),
        (["ball.xml", "-m", "rgb"], "variant: expected one of llvm_ad_rgb"),
        (["ball.xml", "-s", "1"], "--sensor: expected a number below 1, got 1"),
        (["ball.xml", "-D", "dept=2"], "Found unused parameters: - $dept=2"),
        (["eye.xml"], "--sensor: expected a scene with a sensor, got none"),
        (["ball.xml", "--spp", "9999999", "--spp-per-pass", "9999999"], "width * height * spp <"),
        (["open.xml"], "open.xml"),
        (["shape.xml"], "SCENE: expected a file whose root is <scene>"),
        (["unknown.xml"], 'plugin of type "nope"'),
        (["net.xml"], "no.vtu"),
        (["both.xml"], "neither"),
        (["twice.xml"], "Only one integrator can be specified"),
        (["aov.xml"], "aovs: expected a type among albedo, depth, position, uv, "),
        (["misspelt.xml"], "unknown parameter 'max_dept'; did you mean 'max_depth'?"),
    ],
)
def test_one_clear_line_before_rendering(folder, words, message, capsys, monkeypatch):
    (folder / "dir.exr").mkdir()
    files = {
        "open": "<scene version='3.0.0'>",
        "shape": "<shape version='3.0.0' type='sphere'/>",
        "eye": "<scene version='3.0.0'/>",
        "unknown": scene(shapes="<shape type='nope'/>"),
        "net": scene(shapes=BEZIER.format("no.vtu")),
        "both": scene(shapes="<shape type='beziertriangle'/>"),
        "twice": scene(integrator="<integrator type='path'/>" * 2),
        "aov": scene(
            integrator="<integrator type='aov'><string name='aovs' value='d:dept'/></integrator>"
        ),
        "misspelt": scene(
            integrator="<integrator type='path'><integer name='max_dept' value='2'/></integrator>"
        ),
    }
    for name, text in files.items():
        (folder / f"{name}.xml").write_text(text)
    before = sorted(os.listdir())

    def too_late(*_args):
        raise AssertionError("rendering began")

    monkeypatch.setattr(_passes, "render", too_late)
    assert render(*words, "-q") == 2
    err = capsys.readouterr().err
    assert err.startswith("mitsuba-bezier: error: ") and message in err
    assert err.count("\n") == 1 and "Traceback" not in err
    assert sorted(os.listdir()) == before


def test_a_folder_without_permission(folder, capsys, monkeypatch):
    # root, as which tests may run, may write everywhere
    monkeypatch.setattr(_images.os, "access", lambda path, mode: mode != os.W_OK)
    assert render("ball.xml") == 2
    assert "--output: expected a folder that can be written to, got ." in capsys.readouterr().err


# ---------------------------------------------------------------- passes


def test_a_seed_repeats_the_image_and_another_does_not(folder):
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        words = ("--spp", "12", "--spp-per-pass", "5", "--seed", seed)
        assert render("ball.xml", "-q", "-o", f"{name}.exr", *words) == 0
    a, b, c = (pixels(f"{name}.exr")["R"] for name in "abc")
    assert np.array_equal(a, b) and not np.array_equal(a, c)


@pytest.mark.parametrize("integrator", ["bezierpath", "ptracer"])
@pytest.mark.parametrize("filter_name", ["box", "mitchell"])
def test_passes_add_up_to_the_mean_over_all_samples(integrator, filter_name):
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    film = '<string name="component_format" value="float32"/>'
    text = scene(integrator=f'<integrator type="{integrator}"/>', film=film)
    loaded = mi.load_string(text.replace('"box"', f'"{filter_name}"'))
    sensor, plan = loaded.sensors()[0], Plan(19, 8, 8)
    together = Picture(plan)
    for index, spp in enumerate(plan):
        one = render_pass(loaded, sensor, loaded.integrator(), spp, pass_seed(4, index))
        together.add(index, one)
    assert together.total.spp == 19 and together.total.passes == 3
    mean = np.stack(list(together.total.mean().values()), axis=-1).astype(np.float64)
    sums, weights = 0.0, 0.0
    for index, spp in enumerate(plan):
        seed = pass_seed(4, index)
        loaded.integrator().render(loaded, sensor, seed=seed, spp=spp)
        if integrator == "ptracer":  # finished estimates, weighted by their samples
            sums = sums + spp * np.array(sensor.film().develop())
            weights += spp
        else:  # sums of filtered samples and of filter weights
            raw = np.array(sensor.film().develop(raw=True), dtype=np.float64)
            sums, weights = sums + raw[..., :3], weights + raw[..., 3:]
    # float32 sums of some ten numbers near 1
    assert np.abs(mean - sums / weights).max() < 1e-5


@pytest.mark.parametrize("kind", ["float16", "float32"])
def test_parts_merge_to_the_bits_of_the_whole(folder, kind):
    film = f'<string name="component_format" value="{kind}"/>'
    (folder / "ball.xml").write_text(scene(film=film))
    words = ("ball.xml", "-q", "--spp", "23", "--spp-per-pass", "3", "--seed", "5")
    assert render(*words, "-o", "whole.exr") == 0
    parts = [f"{i}.exr" for i in (3, 1, 2)]
    for part in parts:
        assert render(*words, "--part", f"{part[0]}/3", "-o", part) == 0
    assert main.main(["merge", *parts, "-o", "merged.exr", "-q"]) == 0
    whole, merged = pixels("whole.exr"), pixels("merged.exr")
    assert whole.keys() == merged.keys()
    for name, values in whole.items():
        assert values.dtype == merged[name].dtype == np.dtype(kind)
        np.testing.assert_array_equal(values, merged[name])
    for name in ("spp", "passes", "variant"):
        assert header("whole.exr")[name] == header("merged.exr")[name]
    assert sorted(header("whole.exr")["seeds"].split()) == sorted(
        header("merged.exr")["seeds"].split()
    )
    assert not np.array_equal(pixels("1.exr")["R"], whole["R"])


@pytest.mark.parametrize("part", ["0/2", "3/2", "1", "a/b", "9/9"])
def test_parts_that_are_none(folder, part, capsys):
    words = ("ball.xml", "--spp", "16", "--spp-per-pass", "2", "--part", part)
    assert render(*words) == 2
    assert "--part: expected" in capsys.readouterr().err


def test_samplers_that_round_up_are_counted(folder, capsys):
    (folder / "ball.xml").write_text(scene(sampler="stratified"))
    assert render("ball.xml", "-q", "--spp", "10") == 0
    import mitsuba as mi

    sampler = mi.load_dict({"type": "stratified"})
    sampler.set_sample_count(10)
    assert header("ball.exr")["spp"] == sampler.sample_count() > 10


# ---------------------------------------------------------------- Ctrl-C


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_ctrl_c_ends_at_once_and_leaves_no_file(folder):
    # one pass of several minutes, on one core of many: the answer must not wait for its end
    words = ["render", "ball.xml", "--spp", "1000000", "--spp-per-pass", "1000000", "-t", "1"]
    (folder / "ball.exr").write_text("old")
    process = subprocess.Popen(
        [sys.executable, "-m", "mitsuba_bezier.cli.main", *words],
        stderr=subprocess.PIPE,
        text=True,
        env=dict(os.environ, PYTHONPATH=str(Path(mb.__file__).parents[1])),
    )
    try:
        assert "rendering with bezierpath" in process.stderr.readline()
        time.sleep(2)  # well into the kernel
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=600)
    finally:
        process.kill()
    assert process.returncode == 130
    # after the pass there would be a file
    assert err.splitlines()[-1] == "mitsuba-bezier: interrupted, no file was written"
    assert "Traceback" not in err
    assert sorted(os.listdir()) == ["ball.exr", "ball.xml"]
    assert (folder / "ball.exr").read_text() == "old"


# ---------------------------------------------------------------- one thread, one core

SKY = """
import os, sys
if sys.argv[1:] == ["core"]:
    os.sched_setaffinity(0, [min(os.sched_getaffinity(0))])
import numpy as np
import mitsuba_bezier as mb
import mitsuba as mi
from mitsuba_bezier.verification.images import write_exr
write_exr("sky.exr", {c: np.full((8, 16), 0.5, np.float32) for c in "RGB"}, {})
mi.set_variant("llvm_ad_rgb")
import drjit as dr
sky = {"type": "envmap", "filename": "sky.exr"}
if sys.argv[1:] == ["core"]:  # whatever reads and writes
    mi.Bitmap("sky.exr").write("again.exr")
else:
    dr.set_thread_count(1)
mi.load_dict({"type": "scene", "sky": sky})
print(dr.thread_count())
"""


@pytest.mark.parametrize("words", [(), ("core",)], ids=["thread", "core"])
def test_surroundings_on_one_thread_or_core(folder, python, words):
    """Mitsuba waits for ever for an EXR file where Dr.Jit has one thread."""
    if words and not hasattr(os, "sched_setaffinity"):
        pytest.skip("no way to give up cores")
    done = python(SKY, None, *words)
    assert done.stdout.split() == (["2"] if words else ["1"]), done.stderr


def test_loads_that_overlap_share_the_second_thread():
    """The one that ends first must not take it from the others."""
    import drjit as dr

    before = dr.thread_count()
    one, two = thread_for_files(), thread_for_files()
    try:
        dr.set_thread_count(1)
        with one:
            two.__enter__()
            assert dr.thread_count() == 2
        assert dr.thread_count() == 2  # the second is at it still
        two.__exit__(None, None, None)
        assert dr.thread_count() == 1
    finally:
        dr.set_thread_count(before)


def test_every_way_to_surroundings_with_one_thread(folder, python):
    write_exr("sky.exr", {c: np.full((8, 16), 0.5, np.float32) for c in "RGB"}, {})
    mb.save(mb.sphere(), "ball.vtu")
    sky = '<emitter type="envmap"><string name="filename" value="sky.exr"/></emitter>'
    (folder / "sky.xml").write_text(scene().replace('<emitter type="constant"/>', sky))
    board = (
        '<bsdf type="diffuse"><texture type="bitmap" name="reflectance">'
        '<string name="filename" value="sky.exr"/></texture></bsdf>'
    )
    code = "from mitsuba_bezier.cli.main import main; import sys; sys.exit(main())"
    small = ("-t", "1", "--spp", "1", "-q", "-o", "a.exr")
    model = ("ball.vtu", "--size", "8x6")
    for more in (("sky.xml",), (*model, "--light", "sky.exr"), (*model, f"--material=*={board}")):
        done = python(code, None, "render", *more, *small)
        assert done.returncode == 0, done.stderr
