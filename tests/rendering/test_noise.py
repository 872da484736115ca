"""The estimate of noise: right on the average, whatever the weights, and in every order."""

from __future__ import annotations

import numpy as np
import pytest

from mitsuba_bezier.verification.merge import Accumulator


def accumulated(seed: int, passes: int, level: float = 0.5, varying: bool = False) -> Accumulator:
    """Add up passes of gray noise of a standard deviation of `level` a sample."""
    rng = np.random.default_rng(seed)
    total = Accumulator(squares=True)
    for index in range(passes):
        spp = 1 << (index // 4)
        light = 2.0 + level * rng.standard_normal((40, 50)) / np.sqrt(spp)
        weight = spp * (0.9 + 0.2 * rng.random((40, 50))) if varying else None
        total.add({c: light for c in "RGB"}, spp, [index], weight)
    return total


@pytest.mark.parametrize("passes", [4, 8, 20])
@pytest.mark.parametrize("varying", [False, True])
def test_it_is_the_standard_error(passes, varying):
    total = accumulated(1, passes, varying=varying)
    expected = 0.5 / np.sqrt(total.spp) / 2.0
    # of 2000 pixels, each with an error of 1 / sqrt(2 (passes - 1)): 1 %, and what weights add
    assert total.noise() == pytest.approx(expected, rel=0.04)


def test_it_goes_through_sums_in_any_grouping():
    whole = accumulated(2, 12)
    rng = np.random.default_rng(2)
    groups = [Accumulator(squares=True) for _ in range(3)]
    for index in range(12):
        spp = 1 << (index // 4)
        light = 2.0 + 0.5 * rng.standard_normal((40, 50)) / np.sqrt(spp)
        groups[index % 3].add({c: light for c in "RGB"}, spp, [index])
    from mitsuba_bezier.verification.merge import split_sums

    total = Accumulator(squares=True)
    for group in reversed(groups):
        total.add_sums(*split_sums(group.sums()), group.spp, group.seeds, group.passes)
    assert total.noise() == whole.noise()


def test_where_there_is_none():
    total = Accumulator(squares=True)
    assert total.noise() is None
    total.add({c: np.ones((3, 4)) for c in "RGB"}, 1, [0])
    assert total.noise() is None  # of one pass
    total.add({c: np.ones((3, 4)) for c in "RGB"}, 1, [1])
    assert total.noise() == 0.0
    depths = Accumulator(squares=True)
    for seed in (1, 2):
        depths.add({"dd.T": np.ones((3, 4)) * seed}, 1, [seed])
    assert depths.noise() is None  # no colours
    black = Accumulator(squares=True)
    for seed in (1, 2):
        black.add({"Y": np.zeros((3, 4))}, 1, [seed])
    assert black.noise() == 0.0


def test_broken_and_black_pixels_count_for_nothing():
    rng = np.random.default_rng(3)
    total = Accumulator(squares=True)
    for seed in range(6):
        light = 1.0 + 0.1 * rng.standard_normal((50, 40))
        light[:, :20] = 0.0
        light[0, 30], light[1, 30] = np.nan, np.inf
        light[2, 30] = 1e25
        with np.errstate(all="ignore"):
            total.add({"Y": light}, 1, [seed])
    with np.errstate(all="ignore"):
        noise = total.noise()
    assert noise is not None and np.isfinite(noise)
