"""Mitsuba's integrators by their own names, exact in scenes with Bézier shapes.

Integrators written in C++ cannot see the patches, and do not tell their parameters. So their names
are registered anew: the factory makes Mitsuba's own object, and remembers the parameters. When such
an integrator is asked to render a scene with Bézier shapes, its counterpart, made with the same
parameters, does it. A scene without Bézier shapes never meets any of this.

Mitsuba's integrators in Python work as they are, by the replaced methods of the scene
(`scene_methods`); those whose estimator needs derivatives of ours are exchanged, too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from typing import Any

import drjit as dr
import mitsuba as mi

from ...errors import BezierError
from ..integrators.path_tracing import skip_emitters
from ..scene import SceneRays
from ..scene_data import data_for_scene
from . import scene_methods
from .names import take_name
from .originals import of_class, original, replace

__all__ = ["COUNTERPARTS", "counterpart", "install", "register"]

#: Names of Mitsuba's integrators in C++, and ours with the same parameters.
COUNTERPARTS = {
    "path": "bezierpath",
    "volpath": "beziervolpath",
    "volpathmis": "beziervolpath",
    "aov": "bezieraov",
    "depth": "bezierdepth",
    "direct": "bezierdirect",
    "moment": "beziermoment",
    "ptracer": "bezierptracer",
    "stokes": "bezierstokes",
}

#: Classes of Mitsuba's integrators in Python that are exchanged, and the parameters they have.
_PATH = ("max_depth", "rr_depth", "hide_emitters")
_PYTHON = {
    "PRBIntegrator": ("bezierpath", _PATH),
    "PathProjectiveIntegrator": ("bezier_prb_projective", (*_PATH, "sppc", "sppp", "sppi")),
    "DirectProjectiveIntegrator": (
        "bezier_direct_projective",
        ("hide_emitters", "sppc", "sppp", "sppi"),
    ),
}

#: Parameters that only steer how a counterpart's original samples; the image does not depend on
#: them.
_STEERING = {"volpathmis": ("use_spectral_mis",), "ptracer": ("samples_per_pass",)}


@dataclass(frozen=True)
class _Made:
    """How an integrator of Mitsuba's was made."""

    name: str
    class_name: str
    parameters: dict[str, Any]


# by address; a later object at the same address is one of ours again, and replaces the entry
_made: dict[tuple[str, int], _Made] = {}
_counterparts: dict[int, tuple[_Made | None, Any]] = {}
_told: set[str] = set()


def register() -> None:
    """Take the names of Mitsuba's integrators, in the variant that is set."""
    _counterparts.clear()
    for name in COUNTERPARTS:
        take_name("integrator", name, partial(_make, name))


def _make(name: str, props: Any, own: Callable[[Any], Any]) -> Any:
    made = own(props)
    parameters = {}
    if not props.unqueried():  # else it is refused, which reading them would prevent
        parameters = {key: props[key] for key in props.keys()}  # noqa: SIM118 (no dict)
    _made[str(mi.variant()), made.ptr] = _Made(name, made.class_name(), parameters)
    return made


def install() -> None:
    """Let integrators find their counterparts, in the variant that is set; once is enough."""
    replace(mi.Integrator, "render", _handing_over("render"))
    replace(mi.Integrator, "skip_area_emitters", _skip_area_emitters)
    for owner in (mi.SamplingIntegrator, mi.AdjointIntegrator):
        replace(owner, "render_forward", _handing_over("render_forward"))
        replace(owner, "render_backward", _handing_over("render_backward"))
    replace(mi.SamplingIntegrator, "sample", _sample)
    common = import_module("mitsuba.python.ad.integrators.common")
    for owner in (common.ADIntegrator, common.RBIntegrator, common.PSIntegrator):
        for name in _DERIVED:
            if name in vars(owner):
                replace(owner, name, _in_python(owner, name))


def counterpart(integrator: Any, scene: Any) -> Any:
    """Return the integrator that renders `scene` exactly; `integrator` itself if it does.

    Parameters
    ----------
    integrator : mi.Integrator
    scene : mi.Scene

    Raises
    ------
    BezierError
        If the scene has Bézier shapes and nothing is known that sees them as `integrator` would.
    """
    if not scene_methods.is_on() or data_for_scene(scene) is None:
        return integrator
    return _seeing(integrator)


def _seeing(integrator: Any) -> Any:
    name = type(integrator).__name__
    if type(integrator).__module__ == "mitsuba":
        return _of_native(integrator)
    if name in _PYTHON and type(integrator).__module__.startswith("mitsuba."):
        own, names = _PYTHON[name]
        parameters = {key: getattr(integrator, key) for key in names}
        if parameters.get("max_depth") == 0xFFFFFFFF:
            parameters["max_depth"] = -1
        return _exchanged(name, own, {k: v for k, v in parameters.items() if v is not None})
    return integrator


def _of_native(integrator: Any) -> Any:
    made = _made.get((str(mi.variant()), integrator.ptr))
    kind = integrator.class_name()
    if made is None or made.class_name != kind:
        known = ", ".join(COUNTERPARTS)
        raise BezierError.expected(
            "integrator",
            f"one that sees Bézier shapes: {known}, made after mitsuba_bezier was imported and in "
            "the variant that is set, an integrator of mitsuba_bezier, or one in Python",
            kind,
        )
    kept = _counterparts.get(integrator.ptr)
    if kept is None or kept[0] is not made:
        parameters = {
            key: _seeing(value) if isinstance(value, mi.Integrator) else value
            for key, value in made.parameters.items()
            if key not in _STEERING.get(made.name, ())
        }
        kept = made, _exchanged(made.name, COUNTERPARTS[made.name], parameters)
        _counterparts[integrator.ptr] = kept
    return kept[1]


def _exchanged(name: str, own: str, parameters: dict[str, Any]) -> Any:
    if name not in _told:
        _told.add(name)
        mi.Log(mi.LogLevel.Info, f"'{name}' renders Bézier shapes by its exact counterpart '{own}'")
    return mi.load_dict({"type": own, **parameters})


# ---------------------------------------------------------------------- methods of integrators


def _handing_over(name: str) -> Any:
    """Return a method that hands a scene with Bézier shapes to the counterpart."""

    def method(self: Any, scene: Any, *args: Any, **kwargs: Any) -> Any:
        chosen = counterpart(self, scene)
        own = original(self, name) if chosen is self else getattr(chosen, name)
        return own(scene, *args, **kwargs)

    return method


def _sample(
    self: Any, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True
) -> Any:
    chosen = counterpart(self, scene)
    if chosen is self:
        return original(self, "sample")(scene, sampler, ray, medium, active)
    value, valid, aovs, _state = chosen.sample(dr.ADMode.Primal, scene, sampler, ray, active=active)
    return value, valid, aovs


def _skip_area_emitters(
    self: Any, scene: Any, ray: Any, coherent: Any = True, active: Any = True
) -> Any:
    if not scene_methods.is_on() or data_for_scene(scene) is None:
        return original(self, "skip_area_emitters")(scene, ray, coherent, active)
    rays = SceneRays(scene)
    hit = rays.preliminary(skip_emitters(rays, ray, mi.Bool(active)), True, active)
    return scene_methods.handed_out(rays, hit)


# ---------------------------------------------------------------------- in Python


#: Methods of Mitsuba's base classes in Python, and what they track derivatives in.
_DERIVED = {
    "render": None,
    "render_forward": dr.ADMode.Forward,
    "render_backward": dr.ADMode.Backward,
}


def _in_python(owner: type, name: str) -> Any:
    """Return what takes the place of a class's own method, and prepares the scene for it."""

    def method(self: Any, scene: Any, *args: Any, **kwargs: Any) -> Any:
        chosen = counterpart(self, scene)
        if chosen is not self:
            return getattr(chosen, name)(scene, *args, **kwargs)
        own, mode = of_class(owner, name), _DERIVED[name]
        if mode is None:
            _prepare(scene)
            return own(self, scene, *args, **kwargs)
        with SceneRays(scene).attach(mode):
            return own(self, scene, *args, **kwargs)

    return method


def _prepare(scene: Any) -> None:
    """Build what queries need now: inside of a recorded loop it would be too late."""
    if scene_methods.is_on():
        scene_methods.prepare(scene)
