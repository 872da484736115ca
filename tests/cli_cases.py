"""Scene files of a lit sphere for the tests of commands."""

from __future__ import annotations

from pathlib import Path

from mitsuba_bezier.cli import main

INTEGRATOR = '<integrator type="path"><integer name="max_depth" value="$depth"/></integrator>'
BEZIER = '<shape type="beziertriangle"><string name="filename" value="{}"/><ref id="gray"/></shape>'
SPHERE = '<shape type="sphere"><ref id="gray"/></shape>'


def scene(
    integrator: str = INTEGRATOR,
    shapes: str = SPHERE,
    film: str = "",
    sampler: str = "independent",
    sensors: int = 1,
) -> str:
    """Return the XML of a lit sphere on a film of 32 x 24 pixels."""
    depth = '<default name="depth" value="3"/>' if "$depth" in integrator else ""
    sensor = f"""
  <sensor type="perspective">
    <transform name="to_world"><lookat origin="0,0,5" target="0,0,0" up="0,1,0"/></transform>
    <sampler type="{sampler}"><integer name="sample_count" value="16"/></sampler>
    <film type="hdrfilm">
      <integer name="width" value="32"/><integer name="height" value="24"/>
      <rfilter type="box"/>{film}
    </film>
  </sensor>"""
    return f"""<scene version="3.0.0">
  {depth}
  {integrator}{sensor * sensors}
  <bsdf type="diffuse" id="gray"/>
  {shapes}
  <emitter type="constant"/>
</scene>"""


def render(*words: str | Path) -> int:
    """Run ``mitsuba-bezier render`` in this process and return its exit code."""
    try:
        return main.main(["render", *map(str, words)])
    except SystemExit as end:
        return int(end.code or 0)
