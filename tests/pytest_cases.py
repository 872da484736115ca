"""A project with render tests, which pytest runs in processes of its own."""

from __future__ import annotations

import json
import re
from pathlib import Path

import mitsuba_bezier
from mitsuba_bezier.regression import plugin

HEAD = """
import pytest
import mitsuba_bezier
import mitsuba as mi

mi.set_variant("{variant}")

def scene(radiance=1.0, size=24):
    return {{
        "type": "scene",
        "integrator": {{"type": "direct"}},
        "sensor": {{
            "type": "perspective", "fov": 40,
            "to_world": mi.ScalarTransform4f().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0]),
            "film": {{"type": "hdrfilm", "width": size, "height": size,
                "rfilter": {{"type": "box"}}}},
            "sampler": {{"type": "independent", "sample_count": 16}},
        }},
        "ball": {{"type": "sphere"}},
        "light": {{"type": "rectangle", "emitter": {{"type": "area", "radiance": radiance}},
            "to_world": mi.ScalarTransform4f().look_at([0, 4, 2], [0, 0, 0], [0, 0, 1])}},
        "sky": {{"type": "constant", "radiance": 0.3}},
    }}
"""
SAME = "def test_same(render_regression):\n    render_regression(scene(), 'ball')\n"


class Project:
    """A folder with tests, run in processes of their own: Mitsuba cannot be loaded twice in one."""

    def __init__(self, pytester, request):
        self._pytester = pytester
        # once the package is installed, its entry point loads the plugin
        loaded = request.config.pluginmanager.is_registered(plugin)
        self._arguments = [] if loaded else ["-p", "mitsuba_bezier.verification.pytest_plugin"]
        self.path = pytester.path
        self.makeini, self.makepyfile = pytester.makeini, pytester.makepyfile
        self.monkeypatch = pytester._monkeypatch
        self.monkeypatch.setenv("PYTHONPATH", str(Path(mitsuba_bezier.__file__).parents[1]))
        self.monkeypatch.setenv("COLUMNS", "300")  # messages are not cut
        self.reference = pytester.path / "references" / "ball.exr"

    def write(self, tests, name="test_ball", variant="scalar_rgb"):
        self._pytester.makepyfile(**{name: HEAD.format(variant=variant) + tests})

    def run(self, *more):
        return self._pytester.runpytest_subprocess(
            *self._arguments, "-p", "no:cacheprovider", "-W", "ignore", *more
        )

    def entries(self, report="bezier-artifacts/report.html"):
        text = Path(self.path, report).read_text(encoding="utf-8")
        return json.loads(re.findall(r'id="data">(.*?)</script>', text, re.S)[0])["entries"]
