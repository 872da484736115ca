"""Products of matrices have one thread while leaves are built, and theirs again afterwards."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from threading import Barrier

import pytest
from threadpoolctl import ThreadpoolController, threadpool_limits

import mitsuba_bezier as mb
from mitsuba_bezier._threads import one_thread
from mitsuba_bezier.leaves import builder
from mitsuba_bezier.leaves.records import LeafSettings


def _threads() -> set[int]:
    blas = ThreadpoolController().select(user_api="blas")
    return {library["num_threads"] for library in blas.info()}


@pytest.fixture(autouse=True)
def _two() -> object:
    with threadpool_limits(2, user_api="blas"):
        if _threads() != {2}:
            pytest.skip("no BLAS whose threads can be set")
        yield


def test_leaves_are_built_with_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []
    subdivide = builder.subdivide

    def look(*args: object) -> object:
        seen.append(_threads())
        return subdivide(*args)

    monkeypatch.setattr(builder, "subdivide", look)
    builder.build_leaves(mb.sphere(), LeafSettings(closed_form=False))
    assert seen == [{1}]
    assert _threads() == {2}


def test_threads_come_back_after_an_error() -> None:
    with pytest.raises(ValueError, match="within"), one_thread():
        raise ValueError("within")
    assert _threads() == {2}


def test_threads_come_back_when_several_are_within() -> None:
    both = Barrier(2, timeout=60)

    def enter() -> None:
        with one_thread(), one_thread():
            both.wait()  # both are within

    with ThreadPoolExecutor(2) as pool:
        for future in (pool.submit(enter), pool.submit(enter)):
            future.result()
    assert _threads() == {2}
    with one_thread(), one_thread():
        assert _threads() == {1}
    assert _threads() == {2}
