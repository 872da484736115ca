"""Compare two images or two folders of images, and judge the outcome by limits."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import BezierError, FileFormatError
from . import flip
from .calibration import passing_share
from .images import SUFFIXES, Image, read_image, refuse_denoised
from .metrics import Metrics, measure
from .noise import blank, expected_values, shows_nothing
from .thresholds import Limits, Thresholds
from .ztest import PASSING_SHARE, ZTest, comparable_layers, noise_variance, z_test

__all__ = ["Check", "Comparison", "Layer", "compare_images", "compare_paths", "pair_files"]


@dataclass(frozen=True)
class Check:
    """One number and what became of it.

    Attributes
    ----------
    name : str
        What is measured.
    value : float or None
        The number; None where it could not be had.
    limit : float or None
        What it was held against.
    passed : bool or None
        None: not judged.
    note : str
        Place, conditions, or why there is no number.
    at_least : bool
        Whether the limit is a lower one.
    expected : float or None
        What noise alone gives, where the variance is known.
    """

    name: str
    value: float | None
    limit: float | None = None
    passed: bool | None = None
    note: str = ""
    at_least: bool = False
    expected: float | None = None

    @property
    def below_noise(self) -> bool:
        """Whether noise alone breaks the limit."""
        return self.limit is not None and self.expected is not None and self.limit < self.expected

    def describe(self) -> str:
        """Return name, value, limit and note in a line."""
        text = f"{self.name} {self._show(self.value)}"
        if self.limit is not None:
            text += f", at {'least' if self.at_least else 'most'} {self._show(self.limit)}"
            if self.expected is not None:
                text += f", noise alone gives {self._show(self.expected)}"
        return f"{text} ({self.note})" if self.note else text

    def _show(self, value: float | None) -> str:
        if value is None:
            return "none"
        return f"{100 * value:.2f} %" if self.at_least else f"{value:.4g}"


@dataclass(frozen=True)
class Layer:
    """Comparison of one layer: channel names, pixels of both sides, numbers, maps, and notes.

    Notes say what is wrong with the test itself, whatever came out.
    """

    name: str
    channels: list[str]
    reference: np.ndarray
    test: np.ndarray
    metrics: Metrics
    checks: list[Check]
    flip: np.ndarray | None = None
    z: ZTest | None = None
    notes: list[str] = field(default_factory=list)

    @property
    def passed(self) -> bool:
        """Whether no check failed."""
        return all(check.passed is not False for check in self.checks)


@dataclass(frozen=True)
class Comparison:
    """Comparison of two images.

    Attributes
    ----------
    name : str
        File name without suffix, with its folders below the compared ones.
    reference, test : Path or None
        The files; None where one is missing.
    layers : list of Layer
        Empty where the images could not be compared.
    error : str
        Why they could not.
    attributes : pair of dict
        Header attributes of reference and test.
    limits : Limits
        Those of the colour layer.
    encoding : str
        See `images.Image`.
    """

    name: str
    reference: Path | None
    test: Path | None
    layers: list[Layer] = field(default_factory=list)
    error: str = ""
    attributes: tuple[dict[str, Any], dict[str, Any]] = field(default_factory=lambda: ({}, {}))
    limits: Limits = field(default_factory=Limits)
    encoding: str = "linear"

    @property
    def state(self) -> str:
        """``"pass"``, ``"fail"``, or ``"error"`` for what could not be compared."""
        if self.error:
            return "error"
        return "pass" if all(layer.passed for layer in self.layers) else "fail"

    @property
    def change(self) -> str:
        """What became of the picture.

        ``"new"`` without a reference, ``"removed"`` without a test image, ``"error"`` for what
        could not be compared, ``"changed"`` or ``"unchanged"``.
        """
        if self.error:
            if self.reference is None and self.test is not None:
                return "new"
            return "removed" if self.test is None and self.reference is not None else "error"
        return "unchanged" if self.state == "pass" else "changed"

    @property
    def notes(self) -> list[str]:
        """What is wrong with the test itself: nothing shown, limits that cannot decide."""
        return [
            f"{layer.name}: {note}" if layer.name else note
            for layer in self.layers
            for note in layer.notes
        ]

    @property
    def failed_checks(self) -> list[tuple[str, Check]]:
        """Layer name and check of all that failed."""
        return [(v.name, c) for v in self.layers for c in v.checks if c.passed is False]

    def as_json(self) -> dict[str, Any]:
        """Return the outcome as plain data, without pixels."""
        return {
            "name": self.name,
            "state": self.state,
            "change": self.change,
            "notes": self.notes,
            "reference": None if self.reference is None else str(self.reference),
            "test": None if self.test is None else str(self.test),
            "error": self.error,
            "layers": [
                {
                    "name": layer.name,
                    "channels": layer.channels,
                    "checks": [
                        {
                            "name": check.name,
                            # JSON has no NaN
                            "value": None
                            if check.value is None or np.isnan(check.value)
                            else check.value,
                            "limit": check.limit,
                            "passed": check.passed,
                            "note": check.note,
                            "expected": check.expected,
                            "text": check.describe(),
                        }
                        for check in layer.checks
                    ],
                }
                for layer in self.layers
            ],
        }


def _judge(
    metrics: Metrics,
    flip_error: float | None,
    z: ZTest | str,
    limits: Limits,
    names: list[str],
    noise: Mapping[str, float],
) -> list[Check]:
    """Hold the numbers of one layer against its limits."""

    def upper(name: str, value: float | None, limit: float | None, note: str = "") -> Check:
        passed = None if limit is None or value is None else bool(value <= limit)
        return Check(name, value, limit, passed, note, expected=noise.get(name))

    judged_z = limits.z_test is not False and (limits.z_test or isinstance(z, ZTest))
    max_limit, max_note = limits.max_abs, ""
    if metrics.max_abs > 0:
        column, row, channel = metrics.max_at
        max_note = f"{names[channel]} at column {column}, row {row}"
    if not limits.any_number and not judged_z:
        # like `cmp`: who states no limit wants to know of any difference
        max_limit = 0.0
        max_note = f"{max_note}; no limit given, so images must be equal".lstrip("; ")
    checks = []
    bad = metrics.not_finite
    if bad:
        note = (
            f"NaN in {metrics.nan_reference} of the reference and {metrics.nan_test} of the test "
            f"image, unlike infinities in {metrics.infinite}; left out of the other numbers"
        )
        allowed = limits.allow_nan
        checks.append(Check("pixels not finite", bad, None if allowed else 0, allowed, note))
    checks += [
        upper("RMSE", metrics.rmse, limits.rmse),
        upper("relative MSE", metrics.relative_mse, limits.relative_mse),
        upper("max", metrics.max_abs, max_limit, max_note),
    ]
    if flip_error is not None or limits.flip is not None:
        note = "" if flip_error is not None else "FLIP needs RGB or grey"
        check = upper("FLIP", flip_error, limits.flip, note)
        checks.append(
            check if flip_error is not None else Check("FLIP", None, limits.flip, False, note)
        )
    if isinstance(z, ZTest):
        passed = bool(z.share >= limits.z_share) if judged_z else None
        limit = limits.z_share if judged_z else None
        checks.append(Check("Z-test", z.share, limit, passed, z.note, at_least=True))
    elif limits.z_test:
        checks.append(Check("Z-test", None, limits.z_share, False, z, at_least=True))
    checks.append(Check("mean difference", metrics.mean_difference))
    return checks


def _compare_layer(
    name: str,
    channels: list[str],
    reference: Image,
    test: Image,
    limits: Limits,
    spp: int | None,
    with_flip: bool,
) -> Layer:
    if limits.z_share == PASSING_SHARE:
        limits = replace(limits, z_share=passing_share(reference, name))
    a, b = reference.stack(channels), test.stack(channels)
    metrics = measure(a, b)
    flip_pixels = None
    is_color = name == "" and len(channels) in (1, 3)
    if is_color and (limits.flip is not None or (with_flip and flip.available())):
        rgb = [np.repeat(v, 3, axis=-1) if len(channels) == 1 else v for v in (a, b)]
        flip_pixels = flip.flip_map(rgb[0], rgb[1], reference.encoding)
    z = z_test(reference, test, channels, spp) if limits.z_test is not False else ""
    flip_error = None if flip_pixels is None else float(flip_pixels.mean())
    variance = noise_variance(reference, test, channels, spp)
    noise: dict[str, float] = {}
    if variance is not None:
        exact = limits.flip is not None and is_color and len(channels) == 3
        noise = expected_values(a, variance, reference.encoding if exact else None)
    checks = _judge(metrics, flip_error, z, limits, channels, noise)
    notes = [
        f"{check.name}: the limit {check.limit:.4g} is below what noise alone gives, "
        f"{check.expected:.4g}: no render of so few samples keeps it"
        for check in checks
        if check.below_noise and metrics.max_abs > 0
    ]
    z_found = z if isinstance(z, ZTest) else None
    exact_test = replace(test, channels={}, attributes={})
    if shows_nothing(a, noise_variance(reference, exact_test, channels)):
        if is_color:
            color = ", ".join(f"{v:.4g}" for v in blank(a)[0, 0])
            notes.append(f"the reference shows nothing: every pixel is {color}")
    elif _cannot_fail(name, channels, reference, test, limits, spp):
        notes.append(
            "this test cannot fail: the limits let a picture pass that has one colour all over"
        )
    return Layer(name, channels, a, b, metrics, checks, flip_pixels, z_found, notes)


def _cannot_fail(
    name: str, channels: list[str], reference: Image, test: Image, limits: Limits, spp: int | None
) -> bool:
    """Tell whether a picture without any contrast would pass in place of the test image."""
    a = reference.stack(channels)
    flat = blank(a)
    if not np.isfinite(flat).all():
        return False
    empty = Image(
        {
            **{c: p for c, p in test.channels.items() if c not in channels},
            **{c: flat[..., k] for k, c in enumerate(channels)},
        },
        test.attributes,
        test.encoding,
        test.path,
    )
    z = z_test(reference, empty, channels, spp) if limits.z_test is not False else ""
    flip_error = None
    if limits.flip is not None and name == "" and len(channels) in (1, 3):
        rgb = [np.repeat(v, 3, axis=-1) if len(channels) == 1 else v for v in (a, flat)]
        flip_error = float(flip.flip_map(rgb[0], rgb[1], reference.encoding).mean())
    checks = _judge(measure(a, flat), flip_error, z, replace(limits, allow_nan=True), channels, {})
    return all(check.passed is not False for check in checks)


def compare_images(
    reference: Image,
    test: Image,
    thresholds: Thresholds,
    name: str,
    spp: int | None = None,
    with_flip: bool = True,
) -> Comparison:
    """Compare two images, layer by layer.

    The share of pixels that must pass the Z-test is that of the limits; if they leave it as it is,
    that of the reference's header (`calibration`).

    Parameters
    ----------
    reference, test : Image
        Of one size and with the same channels; statistics channels may be on one side only.
    thresholds : Thresholds
        What they are held to.
    name : str
        Name of the image, for the thresholds.
    spp : int, optional
        Samples of the test image for the Z-test, if its header tells none.
    with_flip : bool
        Whether to find the FLIP error even where no limit asks for it (if the wheel is there).

    Raises
    ------
    FileFormatError
        If size, channels or encoding differ, or one of them was denoised.
    """
    refuse_denoised(reference)
    refuse_denoised(test)
    layers, others = comparable_layers(reference), comparable_layers(test)
    for what, a, b in (
        ("size", _extent(reference), _extent(test)),
        ("channels", _listed(layers), _listed(others)),
        ("encoding", reference.encoding, test.encoding),
    ):
        if a != b:
            raise FileFormatError.expected(
                f"{test.path or name}: {what}", f"{a} as in the reference", b
            )
    if not layers:
        raise FileFormatError.expected(name, "channels to compare", "statistics channels only")
    return Comparison(
        name,
        reference.path,
        test.path,
        [
            _compare_layer(
                layer, channels, reference, test, thresholds.limits(name, layer), spp, with_flip
            )
            for layer, channels in layers.items()
        ],
        attributes=(reference.attributes, test.attributes),
        limits=thresholds.limits(name),
        encoding=reference.encoding,
    )


def _extent(image: Image) -> str:
    height, width = image.size
    at = "" if image.offset == (0, 0) else " at column {}, row {}".format(*image.offset)
    return f"{width} x {height}{at}"


def _listed(layers: dict[str, list[str]]) -> str:
    return ", ".join(name for names in layers.values() for name in names)


def pair_files(
    reference: str | os.PathLike[str], test: str | os.PathLike[str]
) -> list[tuple[str, Path | None, Path | None]]:
    """Return name, reference file and test file of what is to be compared.

    Two files are one pair; two folders give a pair for each image below either of them, by
    path below the folder, with None for a missing counterpart.

    Raises
    ------
    FileFormatError
        If a path does not exist, one is a file and the other a folder, or there is no image.
    """
    a, b = Path(reference), Path(test)
    for path in (a, b):
        if not path.exists():
            raise FileFormatError.expected(str(path), "an image or a folder", "nothing there")
    if a.is_dir() != b.is_dir():
        raise FileFormatError.expected(
            str(b), f"a {'folder' if a.is_dir() else 'file'}, as {a} is one", "the other kind"
        )
    if not a.is_dir():
        return [(b.stem, a, b)]

    def below(folder: Path) -> dict[str, Path]:
        files = (p for p in folder.rglob("*") if p.suffix.lower() in SUFFIXES and p.is_file())
        return {p.relative_to(folder).as_posix(): p for p in files}

    left, right = below(a), below(b)
    for folder, found in ((a, left), (b, right)):
        if not found:
            raise FileFormatError.expected(str(folder), "images, .exr or .png", "an empty folder")
    pairs = []
    for name in sorted(left.keys() | right.keys()):
        stem = name.rpartition(".")[0]
        twins = [n for n in left.keys() | right.keys() if n.rpartition(".")[0] == stem]
        # a.exr beside a.png: keep the suffix to tell them apart
        pairs.append((stem if len(twins) == 1 else name, left.get(name), right.get(name)))
    return pairs


def compare_paths(
    reference: str | os.PathLike[str],
    test: str | os.PathLike[str],
    thresholds: Thresholds,
    spp: int | None = None,
    with_flip: bool = True,
    only: str = "*",
) -> Iterator[Comparison]:
    """Compare two images or folders, one after the other; see `pair_files`.

    What cannot be compared (a missing counterpart, a damaged file, other size or channels)
    is handed out as a `Comparison` with its `error`, so that the rest is still seen. `only` is
    a pattern for the names.

    Raises
    ------
    FileFormatError
        As `pair_files` does, or if `only` fits no name.
    """
    pairs = [pair for pair in pair_files(reference, test) if fnmatchcase(pair[0], only)]
    if not pairs:
        raise FileFormatError.expected("only", "a pattern that fits an image", f"'{only}'")
    for name, a, b in pairs:
        try:
            if a is None or b is None:
                there, folder = (b, reference) if a is None else (a, test)
                raise FileFormatError.expected(f"{there}", f"a counterpart in {folder}", "none")
            images = read_image(a), read_image(b)
            yield compare_images(*images, thresholds, name, spp, with_flip)
        except BezierError as error:
            yield Comparison(name, a, b, error=str(error), limits=thresholds.limits(name))
