"""A scene, seen by one of its sensors, rendered as ``mitsuba-bezier render`` does."""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .. import _loading, _runtime
from .._version import __version__
from ..cli import _scene
from ..errors import BezierError, FileFormatError, VariantError
from ..rendering.picture import render_picture
from ..rendering.plan import Plan, make_plan, sampled_pixels, usual_style
from ..verification.calibration import ATTRIBUTE, own_shares
from ..verification.fingerprint import scene_fingerprint
from ..verification.images import Image, encode_exr
from ..verification.merge import Accumulator

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["FIRST_REFERENCE_SEED", "REFERENCE_PASSES", "Shot", "find_scene"]

REFERENCE_PASSES = 32
#: Bytes of passes that are kept to see how they differ among each other.
_MEMORY = 1 << 29
#: Seeds of the reference's passes begin here; tests take small numbers.
FIRST_REFERENCE_SEED = 1_000_000


def find_scene(name: str | Path, folders: Sequence[Path]) -> Path:
    """Return the scene file of that name, in the first folder that has it.

    Raises
    ------
    FileFormatError
        If none has.
    """
    for folder in folders:
        path = folder / name  # an absolute name stays what it is
        if path.is_file():
            return path
    places = " or ".join(str(folder) for folder in dict.fromkeys(folders))
    raise FileFormatError.expected("scene", "an existing file", f"{name}, which is not in {places}")


class Shot:
    """A scene ready to be rendered.

    Parameters
    ----------
    scene : mi.Scene, dict, str or Path
        A scene, its description, or an XML file, for the variant that is set.
    folders : sequence of Path
        Where XML files are looked for.
    spp : int, optional
        Samples per pixel; by default the sampler's.
    sensor : int
        Number of the sensor.
    integrator : mi.Integrator or dict, optional
        Overrules the scene's.
    define : mapping, optional
        Values of the ``$parameters`` of an XML file.
    """

    def __init__(
        self,
        scene: Any,
        folders: Sequence[Path] = (Path(),),
        spp: int | None = None,
        sensor: int = 0,
        integrator: Any = None,
        define: Mapping[str, Any] | None = None,
    ) -> None:
        mi = self._mi = _runtime.import_mitsuba()
        if mi.variant() is None:
            raise VariantError.expected(
                "variant", "one that is set before, e.g. mi.set_variant('llvm_ad_rgb')", "none"
            )
        self._scalar = mi.variant().startswith("scalar")
        self._digest, self._source = "", scene
        self._values: dict[str, str] = {}
        own = None
        if define and not isinstance(scene, (str, Path)):
            raise BezierError.expected("define", "parameters of an XML file", "another scene")
        if isinstance(scene, (str, Path)):
            self._source = find_scene(scene, folders)
            self._values = {key: str(value) for key, value in (define or {}).items()}
            scene, own = self._load(self._source)
        elif isinstance(scene, dict):
            scene = _loading.load_dict(mi, scene)
        if not isinstance(scene, mi.Scene):
            raise BezierError.expected(
                "scene", "a Mitsuba scene, dict or XML file", type(scene).__name__
            )
        sensors = scene.sensors()
        if not 0 <= sensor < len(sensors):
            raise BezierError.expected("sensor", f"a number below {len(sensors)}", sensor)
        if isinstance(integrator, dict):
            integrator = mi.load_dict(integrator)
        self._scene, self._sensor, self._number = scene, sensors[sensor], sensor
        integrator = integrator or own or scene.integrator()
        if integrator is None:
            integrator = mi.load_dict({"type": "path" if self._scalar else _scene.SEES_BEZIER[0]})
        self._integrator = integrator
        self._check_integrator()
        self.spp = self._sensor.sampler().sample_count() if spp is None else spp
        if self.spp < 1:
            raise BezierError.expected("spp", "a number of samples >= 1", spp)

    def _load(self, path: Path) -> tuple[Any, Any]:
        """Return scene and integrator of a file."""
        if self._scalar:  # no kernels of ours, so nothing to be exchanged
            _scene.check_name(path)
            return _loading.load_file(self._mi, path, self._values), None
        loaded = _scene.load(path, self._mi.variant(), self._values)
        self._digest = loaded.digest
        return loaded.scene, loaded.integrator

    def _check_integrator(self) -> None:
        """Make sure that what renders the scene sees all of it."""
        if self._scalar or type(self._integrator).__module__ != "mitsuba":
            return
        from ..plugins.native import counterparts, scene_methods
        from ..plugins.scene_data import data_for_scene

        if data_for_scene(self._scene) is None:
            return
        if not scene_methods.is_on():
            raise BezierError.expected(
                "integrator",
                "one that sees the scene's Bézier shapes (mb.native(False) is in force)",
                self._integrator.class_name(),
            )
        counterparts.counterpart(self._integrator, self._scene)

    def render(self, seed: int) -> Image:
        """Return one render, float32, with the header attributes of a file."""
        film, sampler = self._sensor.film(), self._sensor.sampler()
        if self._scalar:
            plan = Plan(self.spp, self.spp, self.spp)
        else:
            style = usual_style(sampler)
            variant = self._mi.variant()
            plan = make_plan(sampled_pixels(film), self.spp, variant, style=style)
        before = sampler.sample_count()
        try:
            picture = render_picture(self._scene, self._sensor, self._integrator, plan, seed)
        finally:
            sampler.set_sample_count(before)
        return Image(picture.total.mean(), self._attributes(picture.total.spp, [seed]))

    def render_reference(
        self, passes: int, command: str, extra: Mapping[str, str | int]
    ) -> tuple[Image, Image]:
        """Render `passes` times; return mean and variance as one image, and the first render."""
        total = Accumulator(variance=True)
        first: Image | None = None
        kept: list[Mapping[str, Any]] = []
        room = _MEMORY
        for index in range(passes):
            seed = FIRST_REFERENCE_SEED + index
            image = self.render(seed)
            total.add(image.channels, image.attributes["spp"], [seed])
            first = first or image
            room -= sum(pixels.nbytes for pixels in image.channels.values())
            if room > 0 or len(kept) < 8:
                kept.append(image.channels)
        attributes = self._attributes(total.spp, total.seeds) | {
            "passes": passes,
            "command": command,
            **extra,
        }
        assert first is not None
        shares = own_shares(kept, first.attributes["spp"])
        if shares:
            attributes[ATTRIBUTE] = json.dumps(shares)
        return Image({**total.mean(), **total.variance()}, attributes), first

    def _attributes(self, spp: int, seeds: list[int]) -> dict[str, str | int]:
        film = self._sensor.film()
        return {
            "spp": spp,
            "seed": seeds[0],
            "seeds": " ".join(map(str, seeds)),
            "scene": self.fingerprint,
            "sensor": self._number,
            "integrator": self._integrator_name(),
            "rfilter": film.rfilter().class_name().removesuffix("Filter").lower(),
            "variant": self._mi.variant(),
            "version_mitsuba_bezier": __version__,
            "version_mitsuba": metadata.version("mitsuba"),
            "version_drjit": metadata.version("drjit"),
            "version_llvm": ".".join(map(str, _runtime.llvm_version() or ())) or "none",
        }

    def _integrator_name(self) -> str:
        name = type(self._integrator).__name__
        if type(self._integrator).__module__ == "mitsuba":
            name = self._integrator.class_name()
        return name.removesuffix("Integrator").lower()

    @property
    def fingerprint(self) -> str:
        """What tells the scene from others."""
        if not self._digest:
            try:
                self._digest = scene_fingerprint(self._source, self._values)
            except BezierError:  # the dictionary has objects in it
                self._digest = scene_fingerprint(self._scene)
        return self._digest


def encode(image: Image, compression: str = "zip") -> bytes:
    """Return the file of an image of `Shot`; its header says if the values are not exact.

    Raises
    ------
    BezierError
        If the compression is neither ``"zip"`` nor ``"dwaa"``.
    """
    if compression not in ("zip", "dwaa"):
        raise BezierError.expected("bezier_compression", "zip or dwaa", repr(compression))
    lossy = compression == "dwaa"
    note = {"lossy": compression} if lossy else {}
    return encode_exr(image.channels, image.attributes | note, lossy=lossy)
