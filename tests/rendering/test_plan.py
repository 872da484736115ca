"""Plans of passes: any number of samples, the same beginning whatever that is."""

from __future__ import annotations

import pytest

from mitsuba_bezier.errors import BezierError
from mitsuba_bezier.rendering.plan import PASS_SAMPLES, STYLES, Plan, make_plan, pass_seed


@pytest.mark.parametrize("pixels", [1, 1000, 512 * 512, 3840 * 2160, 1 << 26])
@pytest.mark.parametrize("spp", [1, 7, 64, 1000])
@pytest.mark.parametrize("variant", ["llvm_ad_rgb", "cuda_ad_spectral"])
@pytest.mark.parametrize("style", STYLES)
def test_plans(pixels, spp, variant, style):
    plan = make_plan(pixels, spp, variant, style=style)
    passes = list(plan)
    assert len(passes) == len(plan) and sum(passes) == spp and min(passes) >= 1
    # no more than asked for, unless one sample a pixel is more already
    assert all(n == 1 or n * pixels <= PASS_SAMPLES[variant[:4]] for n in passes)
    assert all(n & (n - 1) == 0 for n in passes[:-1])  # one kernel serves powers of two
    assert [plan.start(i) for i in range(len(plan))] == [sum(passes[:i]) for i in range(len(plan))]
    assert plan[1:3] == passes[1:3] and plan[0] == passes[0]
    # more samples only add passes, and change the last one
    more = list(make_plan(pixels, 3 * spp + 1, variant, style=style))
    whole = [n for i, n in enumerate(passes) if not plan.is_cut(i)]
    assert more[: len(whole)] == whole and len(passes) - len(whole) <= 1


def test_the_first_pass_is_small_and_then_they_grow():
    assert list(make_plan(1 << 14, 700, "llvm_ad_rgb")) == [32, 32, 64, 128, 256, 188]
    assert list(make_plan(1 << 14, 700, "llvm_ad_rgb", style="large")) == [256, 256, 188]
    fine = list(make_plan(1 << 14, 64, "llvm_ad_rgb", style="fine"))
    assert fine == [1] * 8 + [2] * 4 + [4] * 4 + [8] * 4
    # a plan of ten million passes takes no memory
    assert len(Plan(10_000_000, 1, 1)) == 10_000_000


def test_the_size_can_be_chosen():
    assert list(make_plan(100, 10, "llvm_ad_rgb", 4)) == [4, 4, 2]


def test_more_samples_than_mitsuba_can_number():
    assert make_plan(1 << 16, 1 << 16, "llvm_ad_rgb", (1 << 16) - 1)[0] == (1 << 16) - 1
    with pytest.raises(BezierError, match=r"--spp-per-pass: expected .* < 2\^32"):
        make_plan(1 << 16, 1 << 16, "llvm_ad_rgb", 1 << 16)


def test_seeds_of_passes_do_not_meet():
    # neighbouring renders of many passes share no samples
    seeds = [pass_seed(k, i) for k in range(50) for i in range(50)]
    assert len(set(seeds)) == len(seeds)
    assert all(0 <= s < 1 << 32 for s in seeds)
    assert [pass_seed(k, 0) for k in range(50)] == list(range(50))


def test_no_two_of_many_passes_have_one_seed():
    # drawn at random, some two would be equal with a probability of one half
    assert len({pass_seed(3, i) for i in range(80_000)}) == 80_000
