"""Reading images, the distances between them, limits, and ``mitsuba-bezier compare``."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from mitsuba_bezier.cli import main as cli
from mitsuba_bezier.errors import FileFormatError
from mitsuba_bezier.verification import flip, png, ztest
from mitsuba_bezier.verification.comparison import compare_images, pair_files
from mitsuba_bezier.verification.images import Image, group_layers, read_image, write_exr
from mitsuba_bezier.verification.metrics import measure
from mitsuba_bezier.verification.thresholds import Limits, Thresholds

RNG = np.random.default_rng(7)
needs_flip = pytest.mark.skipif(
    not flip.available(), reason="FLIP is not tested: no flip-evaluator wheel here"
)


def gradient(height=6, width=9, seed=0):
    """A smooth positive RGB image with a little noise, float32."""
    y, x = np.mgrid[:height, :width]
    rgb = np.stack([0.2 + 0.05 * x, 0.5 + 0.02 * y, 0.9 - 0.03 * x], axis=-1)
    noise = np.random.default_rng(seed).uniform(0, 0.01, rgb.shape)
    return (rgb + noise).astype(np.float32)


def channels(rgb, **more):
    return {**{name: rgb[..., i] for i, name in enumerate("RGB")}, **more}


def run(*words):
    try:
        return cli.main([str(word) for word in words])
    except SystemExit as end:  # argparse ends this way
        return int(end.code or 0)


@pytest.fixture
def pair(tmp_path):
    """Two folders with one equal image each."""
    for folder in ("a", "b"):
        write_exr(tmp_path / folder / "x.exr", channels(gradient()))
    return tmp_path / "a", tmp_path / "b"


# ------------------------------------------------------------------ files


def test_exr_keeps_pixels_types_and_attributes(tmp_path):
    written = {
        "R": RNG.random((3, 5), np.float32) * 1e6,
        "half": RNG.random((3, 5)).astype(np.float16),
        "id": RNG.integers(0, 2**32, (3, 5), dtype=np.uint32),
    }
    attributes = {"spp": 16, "note": "Bézier", "seconds": 1.5, "list": ["a", "b"], "big": 2**40}
    write_exr(tmp_path / "new" / "x.exr", written, attributes, (2, 1), (20, 10))
    image = read_image(tmp_path / "new" / "x.exr")
    assert image.channels.keys() == written.keys()
    for name, pixels in written.items():
        assert image.channels[name].dtype == pixels.dtype
        np.testing.assert_array_equal(image.channels[name], pixels)
    assert image.size == (3, 5) and image.offset == (2, 1) and image.full_size == (20, 10)
    # EXR integers have 32 bits, and the library would store 0 for a larger one
    assert {k: image.attributes[k] for k in attributes} == {**attributes, "big": str(2**40)}
    assert [p.name for p in (tmp_path / "new").iterdir()] == ["x.exr"]


def test_parts_of_an_exr_file_become_layers(tmp_path):
    pixels = RNG.random((4, 4), np.float32)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    parts = [
        OpenEXR.Part({**header, "spp": 3}, {"R": pixels, "G": pixels, "B": pixels}, "colour"),
        OpenEXR.Part(dict(header), {"Z": pixels + 1}, "depth"),
        OpenEXR.Part(dict(header), {"nn.X": pixels + 2}, "nn"),
    ]
    OpenEXR.File(parts).write(str(tmp_path / "x.exr"))
    image = read_image(tmp_path / "x.exr")
    assert set(image.channels) == {"R", "G", "B", "depth.Z", "nn.X"}
    np.testing.assert_array_equal(image.channels["depth.Z"], pixels + 1)
    assert image.attributes["spp"] == 3


def test_layers_are_in_their_usual_order():
    names = ["nn.Z", "B", "A", "nn.X", "R", "uv.V", "G", "uv.U", "nn.Y", "Z"]
    assert group_layers(names) == {
        "": ["R", "G", "B"],
        "A": ["A"],
        "Z": ["Z"],
        "nn": ["nn.X", "nn.Y", "nn.Z"],
        "uv": ["uv.U", "uv.V"],
    }


@pytest.mark.parametrize("keep", [0, 3, 200, 500, 1500])
def test_a_damaged_exr_is_an_error_in_one_line(keep, tmp_path, capfd):
    path = tmp_path / "x.exr"
    write_exr(path, channels(RNG.random((40, 40, 3), np.float32)))
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(FileFormatError, match="expected an intact EXR file") as caught:
        read_image(path)
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")  # the library talks to the terminal by itself


def test_damaged_pixels_of_an_exr_are_an_error(tmp_path):
    path = tmp_path / "x.exr"
    write_exr(path, channels(np.tile(gradient(), (8, 8, 1))))
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 255  # what ZIP made smaller has a checksum
    path.write_bytes(data)
    with pytest.raises(FileFormatError, match="expected an intact EXR file"):
        read_image(path)


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_png_keeps_all_bits(kind, count):
    pixels = RNG.integers(0, np.iinfo(kind).max, (7, 5, count), endpoint=True).astype(kind)
    back = png.decode(png.encode(pixels), "x")
    assert back.dtype == kind
    np.testing.assert_array_equal(back, pixels)


def test_a_png_is_read_as_display_values(tmp_path):
    path = tmp_path / "x.PNG"
    path.write_bytes(png.encode(np.array([[[0, 51, 255]]], np.uint8)))
    image = read_image(path)
    assert image.encoding == "srgb"
    assert [float(image.channels[c][0, 0]) for c in "RGB"] == [0.0, 0.2, 1.0]


def test_any_damage_to_a_png_is_noticed():
    data = png.encode(RNG.integers(0, 255, (6, 6, 3)).astype(np.uint8))
    for at in range(len(data)):
        flipped = bytearray(data)
        flipped[at] ^= 0x55
        for damaged in (bytes(flipped), data[:at]):
            with pytest.raises(FileFormatError, match="x: expected"):
                png.decode(damaged, "x")


@pytest.mark.parametrize(
    ("name", "message"),
    [("none.exr", "nothing there"), ("x.jpg", "suffix '.jpg'"), ("folder.exr", "a folder")],
)
def test_what_is_no_image_file(name, message, tmp_path):
    (tmp_path / "folder.exr").mkdir()
    with pytest.raises(FileFormatError, match=message):
        read_image(tmp_path / name)


@pytest.mark.parametrize(
    ("pixels", "attributes", "message"),
    [
        ({}, {}, "at least one"),
        ({"R": np.zeros(3)}, {}, r"channel R: expected shape \(H, W\)"),
        ({"R": np.zeros((2, 2)), "G": np.zeros((2, 3))}, {}, "all of one size"),
        ({"R": np.zeros((2, 2))}, {"x": None}, "attribute x: expected text or a number"),
    ],
)
def test_what_cannot_be_written(pixels, attributes, message, tmp_path):
    with pytest.raises(FileFormatError, match=message):
        write_exr(tmp_path / "x.exr", pixels, attributes)


# ------------------------------------------------------------------ numbers


def test_measures_by_hand():
    a = np.array([[[1.0], [2.0]], [[0.0], [4.0]]])
    b = np.array([[[1.0], [2.5]], [[0.1], [3.0]]])
    m = measure(a, b)
    squares = [0.5**2, 0.1**2, 1.0]
    # 1e-15: a few roundings of numbers near 1
    assert m.rmse == pytest.approx(math.sqrt(sum(squares) / 4), abs=1e-15)
    relative = [s / (v**2 + 0.01) for s, v in zip(squares, (2.0, 0.0, 4.0))]
    assert m.relative_mse == pytest.approx(sum(relative) / 4, abs=1e-15)
    assert (m.max_abs, m.max_at) == (1.0, (1, 1, 0))
    assert m.mean_difference == pytest.approx((0.5 + 0.1 - 1.0) / 4, abs=1e-15)
    assert (m.nan_reference, m.nan_test, m.infinite, m.not_finite) == (0, 0, 0, 0)


def test_pixels_that_are_not_finite_are_counted_and_left_out():
    a, b = np.ones((2, 4, 2)), np.full((2, 4, 2), 1.5)
    a[0, 0, 1] = np.nan
    b[0, 0, 0] = b[0, 1, 0] = b[1, 1, 1] = np.nan
    a[1, 0, 0] = np.inf  # against a number
    a[1, 2, 0] = b[1, 2, 0] = -np.inf  # the same on both sides: no difference
    a[1, 3, 0], b[1, 3, 0] = np.inf, -np.inf
    m = measure(a, b)
    assert (m.nan_reference, m.nan_test, m.infinite, m.not_finite) == (1, 3, 2, 5)
    assert m.max_abs == 0.5
    # of the three pixels left, one has a channel with difference 0
    assert m.rmse == pytest.approx(math.sqrt(5 / 6) * 0.5, abs=1e-15)


def test_nothing_finite_at_all():
    m = measure(np.full((2, 2, 1), np.nan), np.ones((2, 2, 1)))
    assert m.not_finite == 4 and math.isnan(m.rmse) and math.isnan(m.max_abs)


@needs_flip
def test_flip_is_that_of_the_wheel_where_all_is_lit():
    import flip_evaluator

    a = np.clip(gradient(24, 32), 0.1, 1)
    b = a**1.1
    for encoding, kind in (("linear", "HDR"), ("srgb", "LDR")):
        ours = flip.flip_map(a, b, encoding)
        theirs = flip_evaluator.evaluate(a, b, kind, applyMagma=False)
        assert ours.shape == (24, 32) and ours.max() > 0.01
        # float32 within the wheel; our exposures differ from its own by rounding
        np.testing.assert_allclose(ours, theirs[0][..., 0], atol=1e-4)


@needs_flip
@pytest.mark.parametrize(
    "reference",
    [np.zeros((8, 8, 3)), np.full((8, 8, 3), -1.0), np.full((8, 8, 3), np.nan), gradient(8, 8)],
    ids=["black", "negative", "nan", "one pixel lit"],
)
def test_flip_survives_hard_references(reference):
    # the wheel itself ends the process for a black reference
    if not np.isnan(reference).any() and reference.max() > 0:
        reference = np.where(np.arange(64).reshape(8, 8, 1) == 20, 1e4, 0.0) * np.ones(3)
    errors = flip.flip_map(reference, gradient(8, 8), "linear")
    assert errors.shape == (8, 8) and np.isfinite(errors).all()
    assert (errors.max() > 0.5) == np.isfinite(reference).all()


def test_exposures_do_not_follow_a_black_background():
    reference = np.zeros((10, 10, 3))
    reference[4:6, 4:6] = [[[1.0] * 3, [0.5] * 3], [[0.5] * 3, [0.25] * 3]]
    start, stop = flip.exposure_range(reference)
    # where the wheel itself begins for a white of 1; it has float32 inside
    assert start == pytest.approx(1.0832973, abs=1e-5)
    # one stop to the median of the lit pixels
    assert stop - start == pytest.approx(1.0, abs=1e-12)


# ------------------------------------------------------------------ Z-test


def test_critical_score():
    assert ztest.critical_z(1) == pytest.approx(2.5758293, abs=1e-6)  # the 99 % quantile
    for pixels in (100, 256 * 256, 4096 * 4096):
        alpha = 1 - (1 - 0.01) ** (1 / pixels)
        p_value = math.erfc(ztest.critical_z(pixels) / math.sqrt(2))
        # 1e-6: what 1 - 0.99^(1/n) itself keeps of its digits for 2^24 pixels
        assert p_value == pytest.approx(alpha, rel=1e-6)


def noisy(mean, deviation, spp, seed, **attributes):
    """Mean of `spp` normal samples, with their true variance in channels."""
    rng = np.random.default_rng(seed)
    rgb = mean + rng.normal(size=mean.shape) * deviation / math.sqrt(spp)
    variance = {f"variance.{c}": np.full(mean.shape[:2], deviation**2) for c in "RGB"}
    return Image(channels(rgb, **variance), {"spp": spp, **attributes})


def test_noise_passes_and_a_change_fails():
    mean = np.full((64, 64, 3), 0.5)
    reference = noisy(mean, 0.3, 256, 1)
    same = ztest.z_test(reference, noisy(mean, 0.3, 16, 2), ["R", "G", "B"])
    assert same.share == 1.0 and "256 spp against 16 spp" in same.note
    # the scores must be standard normal: 3 * 4096 of them, so 0.05 is five of their sigmas
    assert np.std(same.z) == pytest.approx(1.0, abs=0.05)
    changed = mean.copy()
    changed[:8, :8] += 0.6
    other = ztest.z_test(reference, noisy(changed, 0.3, 16, 2), ["R", "G", "B"])
    assert other.share == pytest.approx(1 - 64 / 4096, abs=1e-3)
    assert other.share < ztest.PASSING_SHARE


def test_the_variance_of_one_image_stands_for_both():
    mean = np.full((32, 32, 3), 0.5)
    with_variance, plain = noisy(mean, 0.3, 256, 1), noisy(mean, 0.3, 16, 2)
    for name in ("variance.R", "variance.G", "variance.B"):
        del plain.channels[name]
    names = ["R", "G", "B"]
    both = ztest.z_test(with_variance, noisy(mean, 0.3, 16, 2), names)
    for images in ((with_variance, plain), (plain, with_variance)):
        one = ztest.z_test(*images, names)
        np.testing.assert_allclose(np.abs(one.z), np.abs(both.z), rtol=1e-12)
    assert ztest.z_test(plain, plain, names) == "no variance channels"
    del with_variance.attributes["spp"], plain.attributes["spp"]
    assert "no number of samples" in ztest.z_test(with_variance, plain, names)
    # Mitsuba's form: the reference is exact, and the caller says how many samples the test has
    exact = ztest.z_test(with_variance, plain, names, spp=16)
    difference = plain.stack(names) - with_variance.stack(names)
    np.testing.assert_allclose(exact.z, difference * math.sqrt(16) / 0.3, rtol=1e-12)


def test_each_side_counts_with_its_own_variance():
    mean = np.full((4, 4, 3), 0.5)
    a, b = noisy(mean, 0.3, 100, 1), noisy(mean, 0.8, 25, 2)
    names = ["R", "G", "B"]
    expected = (b.stack(names) - a.stack(names)) / math.sqrt(0.3**2 / 100 + 0.8**2 / 25)
    np.testing.assert_allclose(ztest.z_test(a, b, names).z, expected, rtol=1e-12)


def test_variance_has_a_floor():
    a = Image(channels(np.zeros((4, 4, 3)), **{f"variance.{c}": np.zeros((4, 4)) for c in "RGB"}))
    b = Image(channels(np.full((4, 4, 3), 0.02)), {"spp": 25})
    z = ztest.z_test(a, b, ["R", "G", "B"]).z
    np.testing.assert_allclose(z, 0.02 / math.sqrt(1e-4 / 25), rtol=1e-12)


def test_moments_of_mitsuba_give_a_test_in_xyz(tmp_path):
    import mitsuba as mi

    if mi.variant() is None:
        mi.set_variant("scalar_rgb")
    scene = mi.cornell_box()
    scene["sensor"]["film"].update(width=24, height=24, rfilter={"type": "box"})
    nested = {"type": "direct"}
    scene["integrator"] = {"type": "moment", "nested": nested}
    with_moments = mi.load_dict(scene)
    mi.render(with_moments, spp=512, seed=1)
    film = with_moments.sensors()[0].film()
    film.bitmap().write(str(tmp_path / "a.exr"))
    plain = mi.load_dict({**scene, "integrator": nested})
    mi.render(plain, spp=16, seed=2)
    plain.sensors()[0].film().bitmap().write(str(tmp_path / "b.exr"))

    a, b = read_image(tmp_path / "a.exr"), read_image(tmp_path / "b.exr")
    assert ztest.comparable_layers(a) == {"": ["R", "G", "B"]}
    result = compare_images(a, b, Thresholds(flags={"z_test": True}), "x", spp=16)
    assert result.state == "pass", result.failed_checks
    z = result.layers[0].z
    assert z.note == "variance of reference in XYZ; exact against 16 spp"
    # our matrix must be Mitsuba's: the RGB of the file, taken to XYZ, is the moment's mean
    xyz = a.stack(["R", "G", "B"]) @ ztest._TO_XYZ.T
    np.testing.assert_allclose(xyz, a.stack(f"nested.{c}" for c in "XYZ"), rtol=1e-4, atol=1e-5)
    # and the scores see the noise of 16 samples: a deviation near 1 where the floor does not rule
    assert 0.3 < np.std(z.z) < 1.5
    brighter = Image({k: v * 1.5 for k, v in b.channels.items()}, b.attributes)
    assert compare_images(a, brighter, Thresholds(), "x", spp=16).state == "fail"


# ------------------------------------------------------------------ limits


def test_tables_and_flags_overrule_each_other(tmp_path):
    file = tmp_path / "limits.toml"
    file.write_text(
        '[default]\nrmse = 0.1\nallow_nan = true\n[images."s/*"]\nrmse = 0.2\nflip = 0.3\n'
        '[images."*:nn"]\nmax_abs = 1\n[images."s/b"]\nrmse = 0.4\n'
    )
    limits = Thresholds.load(file, {"relative_mse": 0.5})
    base = Limits(rmse=0.1, relative_mse=0.5, allow_nan=True)
    assert limits.limits("a") == base
    assert limits.limits("s/a") == Limits(rmse=0.2, flip=0.3, relative_mse=0.5, allow_nan=True)
    assert limits.limits("s/b").rmse == 0.4 and limits.limits("s/b").flip == 0.3
    assert limits.limits("s/a", "nn").max_abs == 1 and limits.limits("s/a", "uv").max_abs is None
    assert Thresholds.load(file, {"rmse": 9.0}).limits("s/b").rmse == 9.0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("rmse = 1", r"expected the tables \[default\]"),
        ("[default]\nrsme = 1", "default: expected one of rmse, relative_mse.*got 'rsme'"),
        ("[default]\nrmse = -1", "default: rmse: expected a number >= 0, got -1"),
        ("[default]\nrmse = nan", "expected a number >= 0, got nan"),
        ("[default]\nrmse = true", "expected a number >= 0, got True"),
        ("[default]\nallow_nan = 1", "allow_nan: expected true or false, got 1"),
        ("[default]\nz_share = 99", "expected a share from 0 to 1"),
        ('[images."a"]\nflip = "x"', 'images."a": flip: expected a number'),
        ("[images]\na = 1", r"expected the tables \[default\]"),
        ("[default", "expected a valid TOML file"),
    ],
)
def test_wrong_limits(text, message, tmp_path):
    file = tmp_path / "limits.toml"
    file.write_text(text)
    with pytest.raises(FileFormatError, match=message):
        Thresholds.load(file)


def test_no_file_of_limits(tmp_path):
    with pytest.raises(FileFormatError, match="expected a TOML file, got No such file"):
        Thresholds.load(tmp_path / "none.toml")


@pytest.mark.parametrize(
    ("limit", "value"),
    [("rmse", 0.05), ("relative_mse", 0.05), ("max_abs", 0.1), ("flip", 0.1), ("z_share", 0.5)],
)
def test_every_limit_can_pass_and_fail(limit, value):
    if limit == "flip" and not flip.available():
        pytest.skip("FLIP is not tested: no flip-evaluator wheel here")
    a = noisy(np.full((16, 16, 3), 0.5), 0.1, 1, 1)
    near = Image({**a.channels, "R": a.channels["R"] + 0.01}, a.attributes)
    far = Image({**a.channels, **{c: a.channels[c] * 3 for c in "RGB"}}, a.attributes)
    flags = {limit: value, **({} if limit == "z_share" else {"z_test": False})}
    assert compare_images(a, near, Thresholds(flags=flags), "x").state == "pass"
    result = compare_images(a, far, Thresholds(flags=flags), "x")
    assert result.state == "fail" and len(result.failed_checks) == 1


def test_a_demanded_test_that_is_impossible_fails():
    plain = Image(channels(gradient()))
    result = compare_images(plain, plain, Thresholds(flags={"z_test": True}), "x")
    assert [check.note for _, check in result.failed_checks] == ["no variance channels"]


# ------------------------------------------------------------------ the command


def test_equal_images_pass(pair, capsys):
    assert run("compare", *pair) == 0
    assert "1 compared: 1 passed" in capsys.readouterr().out
    assert run("compare", pair[0] / "x.exr", pair[1] / "x.exr") == 0


def test_without_limits_the_last_bit_counts(pair, capsys):
    rgb = gradient()
    rgb[2, 3, 1] = np.nextafter(rgb[2, 3, 1], np.float32(9))
    write_exr(pair[1] / "x.exr", channels(rgb))
    assert run("compare", *pair) == 1
    out = capsys.readouterr().out
    assert "x: max" in out and "G at column 3, row 2; no limit given" in out
    assert run("compare", *pair, "--max-abs", "1e-6") == 0


def test_a_bias_fails_the_z_test_by_itself(tmp_path):
    mean = np.full((32, 32, 3), 0.5)
    for name, image in (("a", noisy(mean, 0.3, 64, 1)), ("b", noisy(mean * 1.6, 0.3, 64, 2))):
        write_exr(tmp_path / f"{name}.exr", image.channels, image.attributes)
    words = ["compare", tmp_path / "a.exr", tmp_path / "b.exr"]
    assert run(*words) == 1
    assert run(*words, "--no-z-test", "--rmse", "1") == 0
    assert run("compare", tmp_path / "a.exr", tmp_path / "a.exr") == 0


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_what_is_not_finite_fails_unless_allowed(value, pair, capsys):
    rgb = gradient()
    rgb[0, :2, 0] = value
    write_exr(pair[1] / "x.exr", channels(rgb))
    assert run("compare", *pair, "--rmse", "1") == 1
    assert "pixels not finite 2, at most 0" in capsys.readouterr().out
    assert run("compare", *pair, "--rmse", "1", "--allow-nan") == 0


def damage(folder: Path):
    path = folder / "x.exr"
    path.write_bytes(path.read_bytes()[:300])


def crop(folder: Path):
    write_exr(folder / "x.exr", channels(gradient()[:4]))


def shift(folder: Path):
    write_exr(folder / "x.exr", channels(gradient()), {}, (1, 0), (20, 20))


def add_channel(folder: Path):
    write_exr(folder / "x.exr", channels(gradient(), **{"Z": np.zeros((6, 9))}))


def remove(folder: Path):
    (folder / "x.exr").rename(folder / "y.exr")


def text_as_png(folder: Path):
    (folder / "x.exr").unlink()
    (folder / "x.png").write_bytes(b"not a picture")


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (damage, "expected an intact EXR file"),
        (crop, "size: expected 9 x 6 as in the reference, got 9 x 4"),
        (shift, "size: expected 9 x 6 as in the reference, got 9 x 6 at column 1, row 0"),
        (add_channel, "channels: expected R, G, B as in the reference, got R, G, B, Z"),
        (remove, "expected a counterpart in"),
        (text_as_png, "expected a counterpart in"),
    ],
)
def test_bad_input_is_told_and_the_rest_compared(spoil, message, pair, capsys):
    for folder in pair:
        write_exr(folder / "good.exr", channels(gradient()))
    spoil(pair[1])
    assert run("compare", *pair) == 2
    out = capsys.readouterr().out
    assert message in out and "1 passed" in out and "not compared" in out
    # bad input weighs more than a failed comparison
    write_exr(pair[1] / "good.exr", channels(gradient() * 2))
    assert run("compare", *pair) == 2


def test_a_picture_is_not_compared_with_radiance(pair, capsys):
    (pair[1] / "x.png").write_bytes(png.encode(np.zeros((6, 9, 3), np.uint8)))
    assert run("compare", pair[0] / "x.exr", pair[1] / "x.png") == 2
    assert "encoding: expected linear as in the reference, got srgb" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("none", "b"), "none: expected an image or a folder, got nothing there"),
        (("a/x.exr", "b"), "expected a file, as .*x.exr is one, got the other kind"),
        (("a", "empty"), "empty: expected images, .exr or .png, got an empty folder"),
        (("a", "b", "--only", "z*"), "only: expected a pattern that fits an image, got 'z*'"),
        (("a", "b", "--thresholds", "none.toml"), "expected a TOML file"),
    ],
)
def test_usage_errors_take_one_line(words, message, pair, capsys, monkeypatch):
    monkeypatch.chdir(pair[0].parent)
    Path("empty").mkdir()
    assert run("compare", *words) == 2
    err = capsys.readouterr().err
    assert err.startswith("mitsuba-bezier: error: ") and err.count("\n") == 1
    import re

    assert re.search(message.replace("z*'", r"z\*'"), err)


@pytest.mark.parametrize("value", ["-1", "nan", "much"])
def test_limits_on_the_command_line_are_checked(value, pair, capsys):
    assert run("compare", *pair, "--rmse", value) == 2
    assert f"argument --rmse: expected a number >= 0, got '{value}'" in capsys.readouterr().err


def test_json_holds_the_numbers(pair, tmp_path, capsys):
    rgb = gradient()
    rgb[0, 0, 0] = np.nan
    rgb[5, 5, 2] += 1
    write_exr(pair[1] / "x.exr", channels(rgb))
    assert run("compare", *pair, "--json", "-", "--max-abs", "0.5") == 1
    (image,) = json.loads(capsys.readouterr().out)
    assert (image["name"], image["state"]) == ("x", "fail")
    checks = {check["name"]: check for check in image["layers"][0]["checks"]}
    # float32 holds the pixel near 1.6 to 1e-7
    assert checks["max"]["value"] == pytest.approx(1.0, abs=2e-7)
    assert (checks["max"]["limit"], checks["max"]["passed"]) == (0.5, False)
    assert checks["pixels not finite"]["value"] == 1
    run("compare", *pair, "--json", tmp_path / "new" / "x.json")
    assert json.loads((tmp_path / "new" / "x.json").read_text())[0]["state"] == "fail"


def test_layers_are_judged_each_by_its_own_limit(pair, tmp_path, capsys):
    depth = np.full((6, 9), 5.0)
    write_exr(pair[0] / "x.exr", channels(gradient(), **{"dd.T": depth}))
    write_exr(pair[1] / "x.exr", channels(gradient(), **{"dd.T": depth + 0.5}))
    (tmp_path / "limits.toml").write_text('[images."*:dd"]\nmax_abs = 0.6\n')
    assert run("compare", *pair) == 1
    assert "x:dd: max 0.5, at most 0" in capsys.readouterr().out
    assert run("compare", *pair, "--thresholds", tmp_path / "limits.toml") == 0


def test_files_are_paired_by_their_place(tmp_path):
    for name in ("a/s/x.exr", "a/y.exr", "a/y.png", "b/s/x.exr", "b/s/z.exr", "b/y.png"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    a, b = tmp_path / "a", tmp_path / "b"
    assert pair_files(a, b) == [
        ("s/x", a / "s/x.exr", b / "s/x.exr"),
        ("s/z", None, b / "s/z.exr"),
        ("y.exr", a / "y.exr", None),
        ("y.png", a / "y.png", b / "y.png"),
    ]
