"""Adding up passes: exact in any order and grouping, from memory and from files."""

from __future__ import annotations

import itertools
import math
import os
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from mitsuba_bezier.cli import main as cli
from mitsuba_bezier.errors import BezierError
from mitsuba_bezier.verification.images import read_image, write_exr
from mitsuba_bezier.verification.merge import Accumulator

F32 = st.floats(width=32, allow_nan=False, allow_infinity=False)


def passes(count=6, seed=3, kind=np.float32):
    """Random passes of wide range: (channels, spp, seed)."""
    rng = np.random.default_rng(seed)
    result = []
    for index in range(count):
        size = 10.0 ** rng.uniform(-8, 4, (5, 4, 3))
        rgb = (size * rng.choice([-1, 0, 1, 1], size.shape)).astype(kind)
        spp = int(rng.integers(1, 100))
        result.append(({c: rgb[..., i] for i, c in enumerate("RGB")}, spp, 10 + index))
    return result


def accumulate(items, **more):
    total = Accumulator(**more)
    for channels, spp, seed in items:
        total.add(channels, spp, [seed])
    return total


def assert_same_bits(a, b):
    assert a.keys() == b.keys()
    for name in a:
        assert a[name].dtype == b[name].dtype == np.float32
        np.testing.assert_array_equal(a[name].view(np.uint32), b[name].view(np.uint32))


def run(*words):
    return cli.main([str(word) for word in words])


def write_part(path, channels, spp, seed, **attributes):
    write_exr(path, channels, {"spp": spp, "seed": seed, **attributes})
    return path


# large terms that cancel: one float64 would forget the small one
@example([(1e30, 1), (1.0, 1), (-1e30, 1)])
@given(st.lists(st.tuples(F32, st.integers(1, 2**20)), min_size=1, max_size=8))
def test_the_mean_is_the_exact_one_rounded(items):
    total = Accumulator()
    for seed, (value, spp) in enumerate(items):
        total.add({"R": np.array([[value]], np.float32)}, spp, [seed])
    exact = sum(Fraction(value) * spp for value, spp in items) / sum(spp for _, spp in items)
    mean = float(total.mean()["R"][0, 0])
    # half a unit in the last place of float32, and 1e-8 of it for the float64 quotient before
    unit = float(np.spacing(np.float32(abs(mean)))) if math.isfinite(mean) else math.inf
    assert abs(Fraction(mean) - exact) <= Fraction(unit) * Fraction(0.50000001)


def test_the_order_of_the_passes_does_not_matter():
    expected = accumulate(passes(4)).mean()
    for order in itertools.permutations(passes(4)):
        assert_same_bits(accumulate(order).mean(), expected)


def test_one_pass_comes_out_as_it_went_in():
    channels, spp, seed = passes(1)[0]
    assert_same_bits(accumulate([(channels, spp, seed)]).mean(), channels)
    weight = np.random.default_rng(0).uniform(0.1, 40, (5, 4)).astype(np.float32)
    total = Accumulator()
    total.add(channels, spp, [seed], weight)
    assert_same_bits(total.mean(), channels)


def test_weights_of_the_film_count_pixel_by_pixel():
    total = Accumulator()
    total.add({"R": np.array([[1.0, 5.0, 7.0]])}, 4, [1], np.array([[1.0, 0.0, 0.0]]))
    total.add({"R": np.array([[4.0, 2.0, 9.0]])}, 4, [2], np.array([[2.0, 3.0, 0.0]]))
    assert total.mean()["R"].tolist() == [[3.0, 2.0, 0.0]]  # nothing sampled: black


def test_sums_carry_all_bits():
    total = accumulate(passes())
    sums = total.sums()
    again = Accumulator()
    by_channel = {c: [sums[f"sum{i}.{c}"] for i in (1, 2, 3)] for c in "RGB"}
    again.add_sums(by_channel, [sums["sum1.weight"]], total.spp, total.seeds)
    for name in "RGB":
        np.testing.assert_array_equal(again._sums[name].value(), total._sums[name].value())
    assert_same_bits(again.mean(), total.mean())


def test_variance_of_one_sample():
    rng = np.random.default_rng(5)
    spp, deviation = 25, 0.4
    items = [
        ({"R": rng.normal(2.0, deviation / math.sqrt(spp), (100, 100))}, spp, seed)
        for seed in range(9)
    ]
    total = accumulate(items, variance=True)
    variance = total.variance()["variance.R"]
    # chi-squared of 8 degrees over 10^4 pixels: the mean is known to sqrt(2/8)/100 = 0.5 %
    assert variance.mean() == pytest.approx(deviation**2, rel=0.02)
    means = np.stack([channels["R"].astype(np.float32) for channels, _, _ in items])
    # float32 storage of the result
    np.testing.assert_allclose(variance, spp * means.var(axis=0, ddof=1, dtype=float), rtol=1e-6)


def test_variance_needs_two_passes():
    with pytest.raises(BezierError, match="two or more passes"):
        accumulate(passes(1), variance=True).variance()
    with pytest.raises(BezierError, match="variance=True"):
        accumulate(passes(3)).variance()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (({"R": np.zeros((2, 2))}, 4, [2]), "channels: expected B, G, R, got R"),
        (({c: np.zeros((2, 2)) for c in "RGB"}, 4, [2]), "size: expected 4 x 5"),
        ((passes(1)[0][0], 0, [2]), "spp: expected a number of samples from 1"),
        ((passes(1)[0][0], 4, [10]), "seed: expected seeds not merged before, got 10"),
    ],
)
def test_what_cannot_be_added(arguments, message):
    total = accumulate(passes(1))
    with pytest.raises(BezierError, match=message):
        total.add(*arguments)


def test_an_empty_sum_has_no_mean():
    for ask in (Accumulator().mean, Accumulator().sums):
        with pytest.raises(BezierError, match="passes: expected at least one"):
            ask()


# ------------------------------------------------------------------ files


def test_files_give_the_bits_of_one_process(tmp_path, capsys):
    items = passes()
    files = [write_part(tmp_path / f"{s}.exr", c, n, s) for c, n, s in items]
    out = tmp_path / "out.exr"
    assert run("merge", *files[::-1], "-o", out) == 0
    merged, expected = read_image(out), accumulate(items)
    assert_same_bits(merged.channels, expected.mean())
    assert merged.attributes["spp"] == expected.spp == sum(n for _, n, _ in items)
    assert merged.attributes["seeds"] == "10 11 12 13 14 15"
    assert (merged.attributes["seed"], merged.attributes["passes"]) == (10, 6)
    assert merged.attributes["command"].startswith("mitsuba-bezier merge ")
    assert "note" not in capsys.readouterr().err


def test_merging_in_steps_gives_the_same_bits(tmp_path, capsys):
    items = passes()
    files = [write_part(tmp_path / f"{s}.exr", c, n, s) for c, n, s in items]
    left, right, whole = (tmp_path / f"{name}.exr" for name in ("left", "right", "whole"))
    assert run("merge", *files[:4], "-o", left, "--keep-sums") == 0
    assert run("merge", *files[4:], "-o", right, "--keep-sums") == 0
    assert run("merge", right, left, "-o", whole) == 0
    assert "note" not in capsys.readouterr().err
    assert_same_bits(read_image(whole).channels, accumulate(items).mean())
    assert read_image(whole).attributes["passes"] == 6
    # without the sums the result is only near, and the user is told
    assert run("merge", *files[:4], "-o", left) == 0
    assert run("merge", left, right, "-o", whole) == 0
    assert f"rounded before, so the result is not that of one process to the last bit: {left}" in (
        capsys.readouterr().err
    )
    for name, pixels in accumulate(items).mean().items():
        # the mean of float32 values of up to 1e4, each rounded to 2^-24
        np.testing.assert_allclose(read_image(whole).channels[name], pixels, rtol=1e-6, atol=1e-3)


def test_half_parts_with_sums_give_the_half_of_the_whole(tmp_path):
    items = passes()
    files = []
    for channels, spp, seed in items:
        total = accumulate([(channels, spp, seed)])
        stored = {n: np.clip(p, -65504, 65504).astype(np.float16) for n, p in channels.items()}
        path = tmp_path / f"{seed}.exr"
        files.append(write_part(path, {**stored, **total.sums()}, spp, seed))
    assert run("merge", *files, "-o", tmp_path / "out.exr") == 0
    merged = read_image(tmp_path / "out.exr")
    for name, pixels in accumulate(items).mean().items():
        expected = np.clip(pixels, -65504, 65504).astype(np.float16)
        assert merged.channels[name].dtype == np.float16
        np.testing.assert_array_equal(merged.channels[name], expected)


def test_shared_attributes_and_the_crop_stay(tmp_path):
    (a, spp_a, _), (b, spp_b, _) = passes(2)
    for name, channels, spp, seed in (("a", a, spp_a, 1), ("b", b, spp_b, 2)):
        attributes = {"spp": spp, "seed": seed, "variant": "llvm_ad_rgb", "host": name}
        write_exr(tmp_path / f"{name}.exr", channels, attributes, (3, 2), (40, 30))
    assert run("merge", tmp_path / "a.exr", tmp_path / "b.exr", "-o", tmp_path / "c.exr", "-q") == 0
    merged = read_image(tmp_path / "c.exr")
    assert merged.attributes["variant"] == "llvm_ad_rgb" and "host" not in merged.attributes
    assert (merged.offset, merged.full_size) == ((3, 2), (40, 30))


ZERO = {c: np.zeros((2, 3), np.float32) for c in "RGB"}


@pytest.mark.parametrize(
    ("second", "message"),
    [
        (lambda p: write_part(p, ZERO, 4, 1), "seed: expected seeds not merged before, got 1"),
        (lambda p: write_exr(p, ZERO, {"seed": 2}), "spp: expected the header attribute spp"),
        (lambda p: write_exr(p, ZERO, {"spp": 4}), "seed: expected the header attribute seed"),
        (lambda p: write_part(p, ZERO, "many", 2), "spp: expected whole numbers, got 'many'"),
        (lambda p: write_part(p, {"R": ZERO["R"]}, 4, 2), "channels: expected B, G, R, got R"),
        (
            lambda p: write_part(p, {c: np.zeros((3, 3)) for c in "RGB"}, 4, 2),
            "size: expected 3 x 2, got 3 x 3",
        ),
        (
            lambda p: write_exr(p, ZERO, {"spp": 4, "seed": 2}, (1, 1), (9, 9)),
            "size: expected 3 x 2, got 3 x 2 at 1, 1 of 9 x 9",
        ),
        (
            lambda p: write_part(p, {c: np.full((2, 3), np.nan) for c in "RGB"}, 4, 2),
            "expected finite pixels .or --allow-nan., got 6 with NaN",
        ),
        (
            lambda p: write_part(p, {c: np.zeros((2, 3), np.uint32) for c in "RGB"}, 4, 2),
            "expected channels of floats",
        ),
        (lambda p: p.write_bytes(b"no image"), "expected an intact EXR file"),
        (lambda p: None, "expected an image file, got nothing there"),
    ],
)
def test_bad_parts_are_errors_in_one_line(second, message, tmp_path, capsys):
    import re

    write_part(tmp_path / "a.exr", ZERO, 4, 1)
    second(tmp_path / "b.exr")
    assert run("merge", tmp_path / "a.exr", tmp_path / "b.exr", "-o", tmp_path / "c.exr") == 2
    err = capsys.readouterr().err
    assert err.startswith("mitsuba-bezier: error: ") and err.count("\n") == 1
    assert "b.exr" in err and re.search(message, err)
    assert not (tmp_path / "c.exr").exists()


def test_nan_stays_where_it_is_allowed(tmp_path):
    spoiled = {c: np.zeros((2, 3), np.float32) for c in "RGB"}
    spoiled["R"][0, 1] = np.nan
    a = write_part(tmp_path / "a.exr", ZERO, 4, 1)
    b = write_part(tmp_path / "b.exr", spoiled, 4, 2)
    assert run("merge", a, b, "-o", tmp_path / "c.exr", "--allow-nan") == 0
    merged = read_image(tmp_path / "c.exr")
    assert [int(np.isnan(merged.channels[c]).sum()) for c in "RGB"] == [1, 0, 0]


def test_a_filter_that_is_no_box_is_told(tmp_path, capsys):
    files = [write_part(tmp_path / f"{k}.exr", ZERO, 4, k, rfilter="gaussian") for k in (1, 2)]
    assert run("merge", *files, "-o", tmp_path / "c.exr") == 0
    assert "rounded before" in capsys.readouterr().err


def test_renders_in_two_files_give_the_bits_of_one_process(tmp_path):
    """With Mitsuba itself: film, developing and files are part of the way."""
    import mitsuba as mi

    if mi.variant() is None:
        mi.set_variant("scalar_rgb")
    scene = mi.cornell_box()
    scene["sensor"]["film"].update(width=16, height=12, rfilter={"type": "box"})
    scene["integrator"] = {"type": "direct"}
    scene = mi.load_dict(scene)
    total, files = Accumulator(), []
    for seed, spp in ((5, 4), (6, 12), (7, 3)):
        pixels = np.array(mi.render(scene, spp=spp, seed=seed))
        channels = {c: pixels[..., i] for i, c in enumerate("RGB")}
        total.add(channels, spp, [seed])
        path = tmp_path / f"{seed}.exr"
        again = np.array(mi.render(scene, spp=spp, seed=seed))
        files.append(write_part(path, {c: again[..., i] for i, c in enumerate("RGB")}, spp, seed))
    assert run("merge", *files, "-o", tmp_path / "out.exr") == 0
    merged = read_image(tmp_path / "out.exr").channels
    assert_same_bits(merged, total.mean())
    assert merged["R"].max() > 0


# ---------------------------------------------------------------- what does not belong together

ALIKE = {
    "scene": "0123",
    "sensor": 0,
    "integrator": "bezierpath",
    "rfilter": "box",
    "variant": "llvm_ad_rgb",
}


def write_parts(folder, count, seed=0, plan="8 spp in passes of 4", **attributes):
    """Write the parts of a render, each of one pass, with the headers of `render --part`."""
    return [
        write_part(
            folder / f"{seed}-{i}of{count}-{len(plan)}.exr",
            {c: np.full((2, 3), i, np.float32) for c in "RGB"},
            4,
            seed,
            **{**ALIKE, "seeds": str(100 * seed + i + len(plan)), "part": f"{i}/{count}"},
            **{"plan": plan, **attributes},
        )
        for i in range(1, count + 1)
    ]


def test_all_parts_of_a_render_merge(tmp_path):
    a, b, c = write_parts(tmp_path, 3)
    assert run("merge", c, a, b, "-o", tmp_path / "out.exr") == 0
    found = read_image(tmp_path / "out.exr").attributes
    assert {key: found[key] for key in ALIKE} == ALIKE
    assert "part" not in found and "plan" not in found and found["seed"] == 0
    # with another render of the same scene, and with one that says nothing about itself
    others = write_parts(tmp_path, 2, seed=1)
    assert run("merge", a, *others, b, c, "-o", tmp_path / "out2.exr") == 0


@pytest.mark.parametrize("left", [0, 1, 2])
def test_a_missing_part_is_named(tmp_path, capsys, left):
    parts = write_parts(tmp_path, 3)
    lost = parts.pop(left)
    out = tmp_path / "out.exr"
    assert run("merge", *parts, "-o", out) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and f"none that is part {left + 1}/3 of seed 0, 8 spp" in err
    assert "--allow missing" in err and not out.exists()
    assert run("merge", *parts, "-o", out, "--allow", "missing", "--keep-sums") == 0
    # what is not there may still come
    assert run("merge", out, lost, "-o", tmp_path / "whole.exr") == 0
    whole = read_image(tmp_path / "whole.exr")
    assert "part" not in whole.attributes and (whole.channels["R"] == 2).all()


def test_two_plans_are_no_render(tmp_path, capsys):
    ours = write_parts(tmp_path, 2)
    for other in (
        write_parts(tmp_path, 2, plan="16 spp in passes of 4"),
        write_parts(tmp_path, 2, seed=5),
        write_parts(tmp_path, 3),
    ):
        assert run("merge", ours[0], other[1], "-o", tmp_path / "out.exr") == 2
        assert "PART: expected all parts of a render" in capsys.readouterr().err
        assert not (tmp_path / "out.exr").exists()


@pytest.mark.parametrize(
    ("name", "key", "value"),
    [
        ("scene", "scene", "4567"),
        ("sensor", "sensor", 1),
        ("integrator", "integrator", "direct"),
        ("filter", "rfilter", "gaussian"),
        ("colours", "variant", "llvm_ad_spectral"),
        ("colours", "variant", "cuda_ad_mono"),
        ("scene", "scene", None),
    ],
)
def test_another_picture_is_refused_and_allowed_by_name(tmp_path, capsys, name, key, value):
    a = write_part(tmp_path / "a.exr", ZERO, 4, 1, **ALIKE)
    other = {**ALIKE, key: value}
    other = {k: v for k, v in other.items() if v is not None}
    b = write_part(tmp_path / "b.exr", ZERO, 4, 2, **other)
    words = ["merge", a, b, "-o", tmp_path / "out.exr"]
    for order in (words, ["merge", b, a, *words[3:]]):
        assert run(*order) == 2
        err = capsys.readouterr().err
        assert f"{name}: expected " in err and f"--allow {name}" in err and err.count("\n") == 1
        assert not (tmp_path / "out.exr").exists()
    assert run(*words, "--allow", "missing") == 2
    assert run(*words, "--allow", name) == 0
    found = read_image(tmp_path / "out.exr").attributes
    assert key not in found and found["spp"] == 8


@pytest.mark.parametrize("variant", ["cuda_ad_rgb", "llvm_ad_rgb_double", "cuda_rgb"])
def test_what_computes_the_colours_does_not_matter(tmp_path, variant):
    a = write_part(tmp_path / "a.exr", ZERO, 4, 1, **ALIKE)
    b = write_part(tmp_path / "b.exr", ZERO, 4, 2, **{**ALIKE, "variant": variant})
    assert run("merge", a, b, "-o", tmp_path / "out.exr") == 0


def test_the_same_part_twice(tmp_path, capsys):
    a, b = write_parts(tmp_path, 2)
    copy = tmp_path / "copy.exr"
    copy.write_bytes(a.read_bytes())
    link = tmp_path / "link.exr"
    link.symlink_to(a)
    for again, message in (
        (a, "each file once"),
        (link, "each file once"),
        (copy, "not merged before"),
    ):
        assert run("merge", a, b, again, "-o", tmp_path / "out.exr", "--allow", "missing") == 2
        assert message in capsys.readouterr().err
        assert not (tmp_path / "out.exr").exists()


@pytest.mark.parametrize("how", ["name", "path", "link", "hard link", "through a link"])
def test_an_input_is_never_overwritten(tmp_path, capsys, monkeypatch, how):
    monkeypatch.chdir(tmp_path)
    a, b = (write_part(tmp_path / f"{n}.exr", ZERO, 4, ord(n)) for n in "ab")
    before = a.read_bytes()
    (tmp_path / "sub").symlink_to(tmp_path)
    out = {"name": "a.exr", "path": str(a), "through a link": "sub/a.exr"}.get(how, "c.exr")
    if how == "link":
        os.symlink("a.exr", "c.exr")
    if how == "hard link":
        os.link("a.exr", "c.exr")
    assert run("merge", a, b, "-o", out) == 2
    err = capsys.readouterr().err
    assert "--output: expected another file than those that are read" in err
    assert a.read_bytes() == before


@pytest.mark.parametrize(
    ("out", "message"),
    [
        ("out.png", "--output: expected a name that ends in .exr, got"),
        ("out", "--output: expected a name that ends in .exr, got"),
        ("", "--output: expected the name of a file, got an empty one"),
        ("none/out.exr", "--output: expected a folder that exists"),
    ],
)
def test_the_output_is_an_exr_file(tmp_path, capsys, monkeypatch, out, message):
    monkeypatch.chdir(tmp_path)
    a = write_part(tmp_path / "a.exr", ZERO, 4, 1)
    before = sorted(os.listdir())
    assert run("merge", a, "-o", out) == 2
    assert message in capsys.readouterr().err and sorted(os.listdir()) == before


def test_the_names_of_the_command_line_are_those_of_the_module():
    from mitsuba_bezier.cli import merge as command
    from mitsuba_bezier.verification import merge

    assert (merge.MISSING, merge.UNFINISHED, *merge.DIFFERENCES) == command.ALLOWED
