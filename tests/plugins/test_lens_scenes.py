"""The scenes of lenses are loaded, rendered small, and show what they are for."""

from __future__ import annotations

from pathlib import Path

import mitsuba as mi
import numpy as np

SCENES = Path(__file__).parents[2] / "scenes/lenses"


def test_lamps_out_of_focus_are_discs():
    mi.set_variant("llvm_ad_rgb")
    scene = mi.load_file(str(SCENES / "bokeh.xml"), width="60", height="40", spp="16")
    image = np.array(mi.render(scene, spp=16)).mean(axis=2)
    assert np.isfinite(image).all()
    # a lamp of 1 cm behind the teapot would be a pixel without the lens; its discs cover much
    bright = image > 0.5 * np.percentile(image, 99)
    assert 0.02 < bright.mean() < 0.6


def test_a_prism_spreads_colours_in_their_order():
    mi.set_variant("llvm_ad_spectral")
    scene = mi.load_file(str(SCENES / "prism.xml"), width="160", height="90", spp="64")
    image = np.array(mi.render(scene, spp=64))
    assert np.isfinite(image).all()
    # one column of the fan, right of the prism: red is turned least and stands highest
    column = image[:, 125:140].mean(axis=1)
    rows = np.arange(len(column))[:, None]
    middle = (rows * column).sum(axis=0) / column.sum(axis=0)
    # the fan is some ten pixels wide there; noise of a mean row is a tenth of a pixel
    assert middle[0] + 1 < middle[1] < middle[2] - 1
    # before the prism the beam is white: equal shares but for the illuminant's own colour
    white = image[:, 15:40].sum(axis=(0, 1))
    assert white.min() > 0.5 * white.max()
