"""Pages that show how to do one thing do it: their code and their commands run."""

from __future__ import annotations

import pytest
from docs_cases import LIVE, run_page


@pytest.mark.parametrize("page", LIVE)
def test_the_task_is_done(page, tmp_path, monkeypatch):
    import mitsuba as mi

    monkeypatch.chdir(tmp_path)
    before = mi.variant()
    try:
        run_page(page, tmp_path)
    finally:
        if before is not None and mi.variant() != before:
            mi.set_variant(before)
