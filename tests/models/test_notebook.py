"""Quick pictures in notebooks: of nets and models, without a variant."""

from __future__ import annotations

import numpy as np

import mitsuba_bezier as mb
from mitsuba_bezier.io import Model, Report
from mitsuba_bezier.models.quick import SIZE, TooMuch, drawn
from mitsuba_bezier.models.scene import models_of
from mitsuba_bezier.verification import png


def test_a_net_and_a_model_show_a_small_picture():
    net = mb.sphere((4, 5, 6), 3)
    model = Model([net], [np.arange(len(net))], Report("ball.vtu", "vtu"))
    for thing in (net, model):
        data = thing._repr_png_()
        pixels = png.decode(data, "picture")
        assert pixels.shape == (SIZE[1], SIZE[0], 3) and len(data) < 200_000
        seen = pixels.min(axis=-1) < 250
        rows, columns = np.flatnonzero(seen.any(axis=1)), np.flatnonzero(seen.any(axis=0))
        # a disk that fills the height but for the margin of 6 %, without gaps
        assert abs(np.ptp(rows) - 0.94 * SIZE[1]) < 6 and abs(np.ptp(columns) - np.ptp(rows)) < 6
        assert abs(seen.mean() - np.pi / 4 * np.ptp(rows) ** 2 / np.prod(SIZE)) < 0.02


def test_what_cannot_be_drawn_shows_no_picture(monkeypatch):
    assert mb.plane()._repr_png_() is None
    assert mb.BezierTriangles([[[0, 0, 0, 1.0]] * 3])._repr_png_() is None
    monkeypatch.setattr("mitsuba_bezier.models.quick._MOST", 10)
    try:
        drawn(models_of(mb.sphere())[0].parts, [(1, 1, 1)])
    except TooMuch:
        pass
    else:
        raise AssertionError("expected TooMuch")
    assert mb.sphere()._repr_png_() is None


def test_show_renders():
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    picture = mb.show(mb.sphere(), size=(32, 24), spp=2, view="front")
    assert picture.pixels.shape == (24, 32, 3) and picture._repr_png_().startswith(b"\x89PNG")
    assert "32 x 24" in repr(picture)
