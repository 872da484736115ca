"""Sensors of Mitsuba that look from, or at, a Bézier shape.

Mitsuba's `irradiancemeter` and `distant` ask their shape for positions in C++, which a Bézier
shape cannot answer. Integrators that see Bézier shapes are Python, and ask the sensor there: so its
methods are replaced, and answer exactly for these sensors.
"""

from __future__ import annotations

import weakref
from collections import OrderedDict
from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi

from ..frozen import is_bezier
from ..offsets import spawn_ray
from .names import take_name
from .originals import original, replace

__all__ = ["install", "register", "watch"]

# by address: what kind of sensor it is, its class, and its shape
_watched: dict[int, tuple[str, str, Any]] = {}

# Targets of distant sensors need not be in the scene: nobody else holds them. Nobody tells, either,
# when a sensor is gone, so only as many are held as one renders with at a time.
_targets: OrderedDict[int, Any] = OrderedDict()
_MOST_TARGETS = 64


def watch(sensor: Any, kind: str, shape: Any) -> None:
    """Remember that a sensor stands on, or looks at, a Bézier shape."""
    _watched[sensor.ptr] = kind, sensor.class_name(), weakref.ref(shape)


def _shape_of(sensor: Any) -> tuple[str, Any] | None:
    found = _watched.get(sensor.ptr) if _watched else None
    if found is None:
        return None
    kind, name, reference = found
    shape = reference()
    if shape is None or sensor.class_name() != name:  # another object at the address of a dead one
        del _watched[sensor.ptr]
        return None
    return kind, shape


def register() -> None:
    """Take the name of `distant`, whose target cannot be asked for later."""
    _watched.clear()
    _targets.clear()
    take_name("sensor", "distant", _make_distant)


def _make_distant(props: Any, own: Callable[[Any], Any]) -> Any:
    has_object = "target" in props and props.type("target") == mi.Properties.Type.Object
    target: Any = props["target"] if has_object else None
    if not is_bezier(target):
        return own(props)
    # rays towards one point, which are then moved to points of the surface
    props["target"] = mi.ScalarPoint3f(target.bbox().center())
    made = own(props)
    watch(made, "distant", target)
    _targets[made.ptr] = target
    _targets.move_to_end(made.ptr)
    while len(_targets) > _MOST_TARGETS:
        _targets.popitem(last=False)
    return made


def install() -> None:
    """Replace the methods in the variant that is set; once is enough."""
    for name in ("sample_ray", "sample_ray_differential"):
        replace(mi.Sensor, name, _sampler_of_rays(name))
    replace(mi.Sensor, "sample_direction", _sample_direction)
    replace(mi.Sensor, "pdf_direction", _pdf_direction)
    replace(mi.Sensor, "eval", _eval)


def _sampler_of_rays(name: str) -> Any:
    def sample(
        self: Any, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True
    ) -> tuple[Any, Any]:
        found = _shape_of(self)
        own = original(self, name)
        if found is None:
            return own(time, sample1, sample2, sample3, active)
        kind, shape = found
        active = mi.Bool(active)
        # wavelengths, direction and weight are the sensor's; the position it cannot know
        ray, weight = own(time, sample1, sample2, sample3, active)
        point = sample3 if kind == "distant" else sample2
        ps, p_err = shape.sample_point(time, mi.Point2f(point), active)
        share = dr.rcp(ps.pdf * shape.surface_area())
        share = dr.select(ps.pdf > 0, share, 0.0)
        if kind == "distant":
            ray.o = ps.p + (ray.o - mi.Point3f(shape.bbox().center()))
            return ray, weight * share
        local = mi.warp.square_to_cosine_hemisphere(mi.Point2f(sample3))
        si = dr.zeros(mi.SurfaceInteraction3f, dr.width(ps.pdf))
        si.p, si.n, si.time = ps.p, ps.n, mi.Float(time)
        si.sh_frame = mi.Frame3f(ps.n)
        away = spawn_ray(si, p_err, si.to_world(local))
        ray.o, ray.d = away.o, away.d
        return ray, weight * share

    return sample


def _sample_direction(self: Any, it: Any, sample: Any, active: Any = True) -> tuple[Any, Any]:
    found = _shape_of(self)
    if found is None or found[0] != "irradiancemeter":
        return original(self, "sample_direction")(it, sample, active)
    shape = found[1]
    return shape.sample_direction(it, mi.Point2f(sample), mi.Bool(active)), mi.Spectrum(dr.pi)


def _pdf_direction(self: Any, it: Any, ds: Any, active: Any = True) -> Any:
    found = _shape_of(self)
    if found is None or found[0] != "irradiancemeter":
        return original(self, "pdf_direction")(it, ds, active)
    return found[1].pdf_direction(it, ds, mi.Bool(active))


def _eval(self: Any, si: Any, active: Any = True) -> Any:
    found = _shape_of(self)
    if found is None or found[0] != "irradiancemeter":
        return original(self, "eval")(si, active)
    return mi.Spectrum(dr.pi / found[1].surface_area())
