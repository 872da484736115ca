"""Parts on workers that are slow, die, hang, or send what does not fit: the picture is the same."""

from __future__ import annotations

import dataclasses
import threading
import time

import numpy as np
import pytest

from mitsuba_bezier.errors import BezierError, FileFormatError
from mitsuba_bezier.rendering.parts import Rendered, check, part_size, render_part
from mitsuba_bezier.rendering.passes import Pass
from mitsuba_bezier.rendering.picture import Picture, checksum
from mitsuba_bezier.rendering.plan import Plan, pass_seed

PLAN = Plan(70, 4, 1)  # 1, 1, 2, then 4, and a last one of 2
IDENTITY = {"scene": "a", "seed": 3}
SIZE = (5, 7)


def fake(spp: int, seed: int) -> Pass:
    """Render noise in no time."""
    rng = np.random.default_rng(seed)
    channels = {c: rng.random(SIZE).astype(np.float32) for c in "RGB"}
    return Pass(channels, rng.random(SIZE).astype(np.float32) + spp, spp, seed)


def alone() -> Picture:
    picture = Picture(PLAN)
    for index, spp in enumerate(PLAN):
        picture.add(index, fake(spp, pass_seed(3, index)))
    return picture


def part(indices) -> Rendered:
    return render_part(PLAN, indices, 3, IDENTITY, fake)


def same(a: Picture, b: Picture) -> None:
    assert a.done == b.done and a.total.spp == b.total.spp and a.complete
    for name, pixels in a.total.mean().items():
        np.testing.assert_array_equal(pixels, b.total.mean()[name])
    assert a.total.noise() == b.total.noise()


def test_parts_in_any_order_give_the_bits_of_the_whole():
    assert len(PLAN) == 20 and PLAN.is_cut(19)
    picture = Picture(PLAN)
    for indices in ((19,), (3, 4, 5), (0, 1, 2), *[(i,) for i in range(18, 5, -1)]):
        rendered = part(indices)
        check(rendered, indices, 3, IDENTITY, SIZE)
        picture.add_sums(indices, rendered.sums, rendered.spp, rendered.seeds)
    same(picture, alone())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"indices": (0, 2)}, "passes"),
        ({"identity": {"scene": "b", "seed": 3}}, "part: scene"),
        ({"seeds": (3, 4)}, "seeds"),
        ({"checksum": 0}, "checksum"),
        ({"sums": {"sum1.weight": np.zeros((2, 2), np.float32)}}, "sums of size"),
        ({"spp": 0}, "samples"),
    ],
)
def test_what_does_not_fit_is_seen(change, message):
    rendered = dataclasses.replace(part((0, 1)), **change)
    with pytest.raises(BezierError, match=message):
        check(rendered, (0, 1), 3, IDENTITY, SIZE)
    with pytest.raises(BezierError, match="sums of passes"):
        check(b"nothing", (0, 1), 3, IDENTITY, SIZE)


def test_the_size_of_parts():
    assert part_size(None, 1000, 4) == 1  # nothing is measured
    assert part_size(0.5, 1000, 4) == 20
    assert part_size(0.5, 32, 4) == 2  # towards the end they get smaller
    assert part_size(100.0, 1000, 4) == 1
    assert part_size(1e-6, 3, 4) == 1
    # sums that take as long as two passes are made of twenty, while there are passes for everybody
    assert part_size(0.5, 32, 4, 1.0) == 8 and part_size(0.5, 100, 4, 1.0) == 20
    assert part_size(0.5, 1000, 4, 0.01) == 20 and part_size(0.5, 3, 4, 1.0) == 1


# ---------------------------------------------------------------- with dask

_bad: dict[int, dict[str, str]] = {}
_lock = threading.Lock()
#: Set when it was told that a worker hangs; tests and workers are threads of one process.
_told: dict[int, threading.Event] = {}


def work(job, indices):
    from distributed import get_worker

    # by the order of appearance; tasks of the test before may still run
    with _lock:
        own = _bad[job["run"]]
        role = own.setdefault(get_worker().address, job.get(len(own), "good"))
    rendered = part(indices)
    if role == "hangs":
        _told[job["run"]].wait()
    if role == "dies":
        raise MemoryError
    if role == "damages":
        rendered.sums["sum1.R"][0, 0] += 1
    if role == "lies":
        wrong = {name: values[1:] for name, values in rendered.sums.items()}
        rendered = dataclasses.replace(rendered, sums=wrong, checksum=checksum(wrong))
    if role == "cannot":
        raise FileFormatError("scene: this cannot be loaded")
    time.sleep(0.01)
    return rendered


@pytest.fixture(scope="module")
def client():
    distributed = pytest.importorskip("distributed")
    import dask

    with (
        dask.config.set({"distributed.admin.tick.limit": "60s"}),
        distributed.Client(
            n_workers=3, threads_per_worker=1, processes=False, dashboard_address=None
        ) as connected,
    ):
        yield connected


def farm(client, roles, monkeypatch, notes=None):
    from mitsuba_bezier.rendering import farm as module

    monkeypatch.setattr(module, "LATE_SECONDS", 0.3)
    monkeypatch.setattr(module, "LOOK", 0.1)
    number = len(_bad)
    roles = {**roles, "run": number}
    _bad[number], told = {}, threading.Event()
    _told[number] = told
    picture = Picture(PLAN)

    def note(text: str) -> None:
        if notes is not None:
            notes.append(text)
        if "has not answered" in text:
            told.set()

    return module.Farm(client, work, roles, picture, 3, IDENTITY, SIZE, note)


@pytest.mark.parametrize("role", ["good", "hangs", "dies", "damages", "lies"])
def test_one_bad_worker_does_no_harm(client, monkeypatch, role):
    notes: list[str] = []
    found = farm(client, {0: role}, monkeypatch, notes)
    calls = []
    found.run(range(len(PLAN)), lambda _: False, lambda: calls.append(1))
    same(found.picture, alone())
    assert calls and sum(found.shares.values()) == len(PLAN)
    words = {"hangs": "has not answered", "dies": "failed at", "damages": "checksum"}
    words |= {"lies": "sums of size"}
    assert role == "good" or any(words[role] in note for note in notes)
    if role in ("damages", "lies"):
        # it gets no more after the second; of those that were out by then, two for each worker,
        # it may have all
        assert sum("failed at" in note for note in notes) <= 6


@pytest.mark.parametrize("direct", [False, True])
def test_results_do_not_fill_the_memory(client, monkeypatch, direct):
    from mitsuba_bezier.rendering import farm as module

    monkeypatch.setattr(module, "FETCHED", 2)
    found = farm(client, {}, monkeypatch)
    monkeypatch.setattr(module, "LATE_SECONDS", 60.0)
    found._direct = direct
    there, most, count = 0, 0, threading.Lock()
    real, take = client.gather, found._take

    def gathered(*arguments, **more):
        nonlocal there, most
        with count:
            there += 1
            most = max(most, there)
        return real(*arguments, **more)

    def slowly(*arguments):
        nonlocal there
        time.sleep(0.02)
        with count:
            there -= 1
        return take(*arguments)

    monkeypatch.setattr(client, "gather", gathered)
    monkeypatch.setattr(found, "_take", slowly)
    found.run(range(len(PLAN)), lambda _: False, lambda: None)
    same(found.picture, alone())
    assert 0 < most <= 2


def test_parts_grow_where_merging_is_what_all_wait_for(client, monkeypatch):
    found = farm(client, {}, monkeypatch)
    assert found.cost(3) is None
    found._parts, found._cost, found._merging = 10, 1.0, 2.0
    # 0.1 s at the worker; or 0.2 s here, so that of a hundred each comes every 40 s
    assert found.cost(1) == pytest.approx(0.1) and found.cost(100) == pytest.approx(4.0)
    assert part_size(1.0, 100_000, 100, found.cost(100)) == 40


def test_what_is_there_is_not_rendered_again(client, monkeypatch):
    found = farm(client, {}, monkeypatch)
    for index in (0, 5, 19):
        found.picture.add(index, fake(PLAN[index], pass_seed(3, index)))
    found.run(range(len(PLAN)), lambda _: False, lambda: None)
    same(found.picture, alone())
    assert sum(found.shares.values()) == len(PLAN) - 3


def test_it_ends_when_it_is_good_enough(client, monkeypatch):
    found = farm(client, {}, monkeypatch)
    found.run(range(len(PLAN)), lambda _: len(found.picture.done) >= 5, lambda: None)
    assert 5 <= len(found.picture.done) < len(PLAN)


def test_an_error_of_the_scene_is_told_at_once(client, monkeypatch):
    found = farm(client, {0: "cannot", 1: "cannot", 2: "cannot"}, monkeypatch)
    with pytest.raises(FileFormatError, match="cannot be loaded"):
        found.run(range(len(PLAN)), lambda _: False, lambda: None)


def test_no_worker_that_can_be_trusted_is_left(client, monkeypatch):
    found = farm(client, {0: "damages", 1: "damages", 2: "damages"}, monkeypatch)
    with pytest.raises(BezierError, match="workers: expected one that can"):
        found.run(range(len(PLAN)), lambda _: False, lambda: None)
