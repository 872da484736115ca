"""A pytest plugin: hold renders against stored references, with a report of what changed.

::

    def test_sphere(render_regression):
        render_regression({"type": "scene", ...}, "sphere", spp=16)

``pytest --bezier-generate-refs`` renders the references, 32 passes with other seeds, and stores
mean and variance as ``references/sphere.exr`` beside the test file. Every later run renders with
`spp` samples and applies the Z-test of `ztest`; limits may be given besides. What fails is kept
under ``bezier-artifacts/``, with one report for all tests, also under pytest-xdist.

Loaded by pytest in any project where this package is installed, so NumPy and Mitsuba are
imported only when the fixture is used.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from .comparison import Comparison
    from .images import Image

__all__ = ["RenderRegression", "render_regression"]

REFERENCE_PASSES = 32
#: Seeds of the reference's passes begin here; tests take small numbers.
FIRST_REFERENCE_SEED = 1_000_000

_PROPERTY = "render_regression"


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options of this plugin."""
    group = parser.getgroup("mitsuba-bezier", "regression of renders (mitsuba-bezier)")
    group.addoption(
        "--bezier-generate-refs",
        action="store_true",
        help="render and store the references of render_regression instead of comparing",
    )
    group.addoption(
        "--bezier-report",
        metavar="FILE",
        help="write a report of all compared renders (default: of failures only)",
    )
    parser.addini(
        "bezier_reference_dir",
        "references, beside each test file (references)",
        default="references",
    )
    parser.addini(
        "bezier_artifact_dir",
        "what failed, below the root (bezier-artifacts)",
        default="bezier-artifacts",
    )
    parser.addini("bezier_thresholds", "TOML file with limits, below the root", default="")


def pytest_configure(config: pytest.Config) -> None:
    """Collect the outcomes in the process that talks to the user."""
    if not hasattr(config, "workerinput"):  # pytest-xdist: reports of the workers come here
        config.pluginmanager.register(_Collector(config), "mitsuba-bezier-collector")


class _Collector:
    """Gathers what the tests recorded and writes the report at the end."""

    def __init__(self, config: pytest.Config) -> None:
        self._config = config
        self._records: list[dict[str, Any]] = []
        self._written: Path | None = None

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.when == "call":
            properties: list[tuple[str, Any]] = report.user_properties
            self._records += [value for name, value in properties if name == _PROPERTY]

    def pytest_sessionfinish(self) -> None:
        shown = [record for record in self._records if record["test"] or record["error"]]
        if not shown:
            return
        from . import report

        self._written = _report_path(self._config)
        report.write_report(
            self._written,
            [_entry(record) for record in shown],
            "Render regression",
            f"Tests below {self._config.rootpath}",
            shlex.join(["pytest", *self._config.invocation_params.args]),
        )

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        if self._written:
            terminalreporter.write_sep("-", "render regression")
            terminalreporter.write_line(f"report: {self._written}")


def _report_path(config: pytest.Config) -> Path:
    chosen = config.getoption("--bezier-report")
    if chosen:
        return Path(config.invocation_params.dir, chosen)
    return Path(config.rootpath, config.getini("bezier_artifact_dir"), "report.html")


def _entry(record: Mapping[str, Any]) -> Any:
    """Build the entry of a report from what a test recorded; images are read again."""
    from . import report
    from .comparison import Comparison, compare_images
    from .images import read_image
    from .thresholds import Thresholds

    if record["error"]:
        a, b = (Path(record[key]) if record[key] else None for key in ("reference", "test"))
        result = Comparison(record["title"], a, b, error=record["error"])
    else:
        images = [read_image(record[key]) for key in ("reference", "test")]
        thresholds = Thresholds(record["limits"])
        result = compare_images(images[0], images[1], thresholds, record["title"])
    return report.entry(result, record["command"])


@pytest.fixture
def render_regression(request: pytest.FixtureRequest) -> RenderRegression:
    """Give a function that renders a scene and compares it with its reference."""
    return RenderRegression(request)


class RenderRegression:
    """What the fixture `render_regression` gives: call it with a scene and a name."""

    def __init__(self, request: pytest.FixtureRequest) -> None:
        self._node = request.node
        self._config = request.config

    def __call__(
        self,
        scene: Any,
        name: str,
        *,
        spp: int | None = None,
        seed: int = 0,
        sensor: int = 0,
        integrator: Any = None,
        reference_passes: int = REFERENCE_PASSES,
        **limits: Any,
    ) -> Comparison:
        """Render and compare; fail the test if a limit is broken.

        Parameters
        ----------
        scene : mi.Scene, dict, str or Path
            A scene, its description, or an XML file, for the variant that is set.
        name : str
            Of the reference, ``references/<name>.exr``; may contain folders.
        spp : int, optional
            Samples per pixel; by default the sampler's.
        seed : int
            Seed of the render.
        sensor : int
            Number of the sensor.
        integrator : mi.Integrator or dict, optional
            Overrules the scene's.
        reference_passes : int
            Renders of `spp` samples that make up a new reference. Below some 16, its estimate
            of the variance is so rough that equal scenes may fail.
        **limits
            Fields of `thresholds.Limits`, over those of the file ``bezier_thresholds``.

        Raises
        ------
        BezierError
            If no variant is set, or an argument cannot be used.
        """
        from ..errors import BezierError
        from . import comparison
        from .images import read_image, write_exr
        from .thresholds import Thresholds

        if not re.fullmatch(r"\w[\w.-]*(/\w[\w.-]*)*", name):
            raise BezierError.expected(
                "name", "letters, digits, '.', '_', '-' and '/'", f"{name!r}"
            )
        reference = self._reference_path(name)
        file = self._config.getini("bezier_thresholds")
        if file:
            thresholds = Thresholds.load(Path(self._config.rootpath, file), limits)
        else:
            thresholds = Thresholds(flags=limits)

        shot = _Shot(scene, spp, sensor, integrator)
        if self._config.getoption("--bezier-generate-refs"):
            command = f"{self._pytest()} --bezier-generate-refs"
            shot.write_reference(reference, reference_passes, command)
            pytest.skip(f"reference written: {reference}")

        title = f"{self._node.nodeid} {name}"
        if not reference.is_file():
            again = f"{self._pytest()} --bezier-generate-refs"
            missing = f"no reference {reference}; make it: {again}"
            self._record(title, reference, None, {}, missing)
            pytest.fail(f"render_regression: {missing}", pytrace=False)
        stored = read_image(reference)
        if seed in _seeds(stored):
            raise BezierError.expected("seed", "one that the reference does not contain", seed)
        test = shot.render(seed)
        kept = self._artifact_path(name)
        values = asdict(thresholds.limits(name))
        try:
            result = comparison.compare_images(stored, test, thresholds, name)
        except BezierError as error:
            write_exr(kept, test.channels, test.attributes)
            self._record(title, reference, kept, values, str(error))
            pytest.fail(f"render_regression: {error}", pytrace=False)
        if result.state != "pass" or self._config.getoption("--bezier-report"):
            write_exr(kept, test.channels, test.attributes)
            self._record(title, reference, kept, values)
        if result.state != "pass":
            lines = [
                f"{layer + ': ' if layer else ''}{check.describe()}"
                for layer, check in result.failed_checks
            ]
            report = _report_path(self._config)
            pytest.fail(
                f"render_regression: {name} differs from its reference: {'; '.join(lines)}\n"
                f"  reference: {reference}\n  render:    {kept}\n  report:    {report}",
                pytrace=False,
            )
        return result

    def _reference_path(self, name: str) -> Path:
        folder = self._config.getini("bezier_reference_dir")
        return self._node.path.parent / folder / f"{name}.exr"

    def _artifact_path(self, name: str) -> Path:
        folder = Path(self._config.rootpath, self._config.getini("bezier_artifact_dir"))
        test = re.sub(r"[^\w.-]+", "_", self._node.nodeid)
        return folder / test / f"{name}.exr"

    def _pytest(self) -> str:
        return f"pytest {shlex.quote(self._node.nodeid)}"

    def _record(
        self,
        title: str,
        reference: Path,
        test: Path | None,
        limits: dict[str, Any],
        error: str = "",
    ) -> None:
        record = {
            "title": title,
            "reference": str(reference) if reference.is_file() else "",
            "test": str(test or ""),
            "limits": {key: value for key, value in limits.items() if value is not None},
            "error": error,
            "command": self._pytest(),
        }
        self._node.user_properties.append((_PROPERTY, record))


class _Shot:
    """A scene, seen by one of its sensors, ready to be rendered."""

    def __init__(self, scene: Any, spp: int | None, sensor: int, integrator: Any) -> None:
        from .. import _loading
        from .._runtime import import_mitsuba
        from ..errors import BezierError, FileFormatError, VariantError

        mi = self._mi = import_mitsuba()
        if mi.variant() is None:
            raise VariantError.expected(
                "variant", "one that is set before, e.g. mi.set_variant('llvm_ad_rgb')", "none"
            )
        if isinstance(scene, (str, Path)):
            if not Path(scene).is_file():
                raise FileFormatError.expected("scene", "an existing file", f"{scene}")
            scene = _loading.load_file(mi, scene)
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
        self._scene, self._sensor = scene, sensors[sensor]
        self._integrator = integrator or scene.integrator()
        self._spp = self._sensor.sampler().sample_count() if spp is None else spp
        if self._spp < 1:
            raise BezierError.expected("spp", "a number of samples >= 1", spp)

    def render(self, seed: int) -> Image:
        """Return one render, float32, with the header attributes of a file."""
        import numpy as np

        from .images import Image

        self._mi.render(
            self._scene,
            sensor=self._sensor,
            integrator=self._integrator,
            spp=self._spp,
            seed=seed,
        )
        # the bitmap and not the tensor: that one leaves out some layers of AOV integrators
        bitmap = self._sensor.film().bitmap()
        pixels = np.array(bitmap)
        names = [field.name for field in bitmap.struct_()]
        pixels = pixels.reshape(*pixels.shape[:2], -1)
        channels = {name: pixels[..., i] for i, name in enumerate(names)}
        return Image(channels, self._attributes(self._spp, [seed]))

    def write_reference(self, path: Path, passes: int, command: str) -> None:
        """Render `passes` times and write mean and variance."""
        from .images import write_exr
        from .merge import Accumulator

        total = Accumulator(variance=True)
        for index in range(passes):
            seed = FIRST_REFERENCE_SEED + index
            total.add(self.render(seed).channels, self._spp, [seed])
        attributes = self._attributes(total.spp, total.seeds) | {
            "passes": passes,
            "command": command,
        }
        write_exr(path, {**total.mean(), **total.variance()}, attributes)

    def _attributes(self, spp: int, seeds: list[int]) -> dict[str, str | int]:
        from importlib.metadata import version

        return {
            "spp": spp,
            "seed": seeds[0],
            "seeds": " ".join(map(str, seeds)),
            "variant": self._mi.variant(),
            "version_mitsuba": version("mitsuba"),
            "version_drjit": version("drjit"),
        }


def _seeds(image: Image) -> set[int]:
    words = str(image.attributes.get("seeds", image.attributes.get("seed", ""))).split()
    return {int(word) for word in words if word.isdecimal()}
