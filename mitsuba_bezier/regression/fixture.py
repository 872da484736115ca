"""The fixture `render_regression`: render a scene, compare it with its reference."""

from __future__ import annotations

import json
import re
import shlex
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import pytest

from ..verification.accept import digest
from ..verification.records import Record, measures, relative, without_folders
from .artifacts import safe_name
from .settings import settings

if TYPE_CHECKING:
    from ..verification.comparison import Comparison
    from ..verification.images import Image
    from .shot import Shot

__all__ = ["PROPERTY", "RECORDS", "RenderRegression"]

#: Name of the JUnit property of each comparison; its value is JSON.
PROPERTY = "render_regression"

#: What tests recorded and no report of theirs carries yet.
RECORDS = pytest.StashKey[list[dict[str, Any]]]()

REFERENCE_PASSES = 32


class RenderRegression:
    """What the fixture `render_regression` gives: call it with a scene and a name."""

    def __init__(self, request: pytest.FixtureRequest) -> None:
        self._node = request.node
        self._settings = settings(request.config)
        self._count: Counter[str] = Counter()
        # a test that is run again tells of its last run only
        self._node.user_properties[:] = [p for p in self._node.user_properties if p[0] != PROPERTY]
        self._node.stash[RECORDS] = []

    def __call__(
        self,
        scene: Any,
        name: str,
        *,
        spp: int | None = None,
        seed: int = 0,
        sensor: int = 0,
        integrator: Any = None,
        define: Mapping[str, Any] | None = None,
        reference_passes: int = REFERENCE_PASSES,
        **limits: Any,
    ) -> Comparison:
        """Render and compare; fail the test if a limit is broken.

        Parameters
        ----------
        scene : mi.Scene, dict, str or Path
            A scene, its description, or an XML file, for the variant that is set. Files are
            looked for beside the test file, then in pytest's root.
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
        define : mapping, optional
            Values of the ``$parameters`` of an XML file.
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
        from ..verification.thresholds import Thresholds
        from .shot import Shot

        if not re.fullmatch(r"\w[\w.-]*(/\w[\w.-]*)*", name):
            raise BezierError.expected(
                "name", "letters, digits, '.', '_', '-' and '/'", f"{name!r}"
            )
        file = self._settings.thresholds
        thresholds = Thresholds.load(file, limits) if file else Thresholds(flags=limits)
        started = time.perf_counter()
        folders = (self._node.path.parent, self._settings.root)
        shot = Shot(scene, folders, spp, sensor, integrator, define)
        return _Case(self, shot, name, seed, reference_passes, thresholds, started).run()

    def number(self, name: str) -> int:
        """Return how often the test has asked for that name, with this time."""
        self._count[name] += 1
        return self._count[name]


class _Case:
    """One call of the fixture."""

    def __init__(
        self,
        fixture: RenderRegression,
        shot: Shot,
        name: str,
        seed: int,
        passes: int,
        thresholds: Any,
        started: float,
    ) -> None:
        self._shot, self._name, self._seed, self._passes = shot, name, seed, passes
        self._thresholds, self._started, self._mine = thresholds, started, False
        self._node, self._settings = fixture._node, fixture._settings
        folder = self._settings.references(self._node.path)
        self._reference = folder / f"{name}.exr"
        number = fixture.number(name)
        again = f" ({number})" if number > 1 else ""
        nodeid = without_folders(self._node.nodeid)
        self._kept = f"{safe_name(nodeid)}/{name}{again.replace(' ', '')}"
        self._command = f"pytest {shlex.quote(nodeid)}"
        self._record = Record(
            title=f"{nodeid} {name}{again}",
            test=nodeid,
            name=name,
            state="unchanged",
            reference=relative(self._reference, self._settings.root),
            command=self._command,
            was=digest(self._reference),
            limits={k: v for k, v in asdict(thresholds.limits(name)).items() if v is not None},
        )

    def run(self) -> Comparison:
        """Render, compare, record; fail or skip the test."""
        from ..errors import BezierError
        from ..verification.comparison import compare_images
        from ..verification.images import read_image

        config = self._settings
        record = self._record
        if config.generates and self._claim():
            return self._accept()
        if not self._reference.is_file():
            if config.accepts(self._name, record.test):
                return self._accept()
            again = f"{self._command} --bezier-generate-refs"
            test = self._shot.render(self._seed)
            self._keep(test)
            self._fail("new", f"no reference {record.reference}; make it: {again}")
        stored, problem = None, _pointer(self._reference)
        if not problem:
            try:
                stored = read_image(self._reference)
            except BezierError as error:
                problem = str(error)
        if stored is None:
            if config.accepts(self._name, record.test):
                return self._accept()
            self._fail("error", problem)
        if self._seed in _seeds(stored):
            raise BezierError.expected(
                "seed", "one that the reference does not contain", self._seed
            )
        test = self._shot.render(self._seed)
        result = None
        try:
            result = compare_images(stored, test, self._thresholds, self._name)
        except BezierError as error:
            problem = f"{error}{_differences(stored, test)}"
        if result is None:
            if config.accepts(self._name, record.test):
                return self._accept()
            self._keep(test)
            self._fail("error", problem)
        record.measures, record.notes = measures(result), result.notes
        changed = result.state != "pass"
        strict = config.strict and bool(record.notes)
        if changed and config.accepts(self._name, record.test):
            return self._accept()
        if changed or strict or config.config.getoption("--bezier-report"):
            self._keep(test, candidate=changed)
        if changed:
            lines = [
                f"{layer + ': ' if layer else ''}{check.describe()}"
                for layer, check in result.failed_checks
            ]
            message = f"{self._name} differs from its reference: {'; '.join(lines)}"
            self._fail("changed", message + _differences(stored, test))
        if strict:
            self._fail("error", f"{self._name}: {'; '.join(record.notes)}")
        self._finish(test)
        return result

    def _keep(self, test: Image, candidate: bool = True) -> None:
        """Write the render, and what would become the reference."""
        from .shot import encode

        folder = self._settings.artifacts
        name = f"{self._kept}.exr"
        folder.write(name, encode(test))
        self._record.image = name
        if candidate and self._settings.candidates:
            new, _first = self._render_reference()
            name = f"{self._kept}.candidate.exr"
            folder.write(name, encode(new, self._settings.compression))
            self._record.candidate = name
        self._thumbnail(test)

    def _render_reference(self) -> tuple[Image, Image]:
        command = f"{self._command} --bezier-generate-refs"
        return self._shot.render_reference(self._passes, command, {"test": self._record.test})

    def _claim(self) -> bool:
        """Note that this call writes the reference; return whether no other one has."""
        scene = self._shot.fingerprint
        self._mine = self._mine or _claim(self._settings, self._reference, self._record, scene)
        return self._mine

    def _accept(self) -> Comparison:
        """Write the reference anew; the test is told to be skipped when it ends."""
        from .._files import write_file
        from ..verification.comparison import compare_images
        from .shot import encode

        if not self._claim():
            self._fail(
                "error",
                f"{self._name}: the renders of this test under one name differ by more than its "
                "limits",
            )
        new, first = self._render_reference()
        data = encode(new, self._settings.compression)
        write_file(self._reference, data, make_folders=True)
        # what is wrong with the test shows in one of its own passes, too
        result = compare_images(new, first, self._thresholds, self._name)
        self._record.notes, self._record.state = result.notes, "accepted"
        self._finish(new)
        return result

    def _fail(self, state: str, message: str) -> NoReturn:
        record = self._record
        record.state, record.message = state, "" if state == "changed" else message
        self._finish(None)
        lines = [f"render_regression: {message}", f"  reference: {record.reference}"]
        config = self._settings
        if record.image:
            kept = relative(config.artifacts.folder / record.image, config.root)
            lines.append(f"  render:    {kept}")
        lines += [f"  note:      {note}" for note in record.notes]
        lines.append(f"  report:    {relative(config.report, config.root)}")
        if state in ("changed", "new"):
            lines.append(f"  accept:    {self._command} --bezier-accept")
        pytest.fail("\n".join(lines), pytrace=False)

    def _thumbnail(self, image: Image) -> None:
        from ..verification.preview import thumbnail_jpeg

        self._record.thumbnail = self._record.thumbnail or thumbnail_jpeg(image)

    def _finish(self, image: Image | None) -> None:
        record = self._record
        if image is not None:
            self._thumbnail(image)
        if not record.image:  # kept by an attempt before
            for suffix in (".exr", ".candidate.exr"):
                self._settings.artifacts.remove(self._kept + suffix)
        record.seconds = time.perf_counter() - self._started
        root = self._settings.root
        record.message = without_folders(record.message, [root])
        self._node.stash[RECORDS].append(record.as_json())
        figures = json.dumps(record.figures(), ensure_ascii=False, allow_nan=False)
        self._node.user_properties.append((PROPERTY, figures))


def _claim(config: Any, reference: Path, record: Record, scene: str) -> bool:
    """Note who writes a reference; return whether this is the first time.

    Tests of one scene share a reference, and the first writes it. Tests of two scenes would undo
    each other's, so the second one fails.
    """
    claims = config.config.__dict__.setdefault("_mitsuba_bezier_claims", {})
    first = str(reference) not in claims
    test, other = claims.setdefault(str(reference), (record.test, scene))
    if other != scene:
        pytest.fail(
            f"render_regression: name: expected one that no test of another scene writes, got "
            f"{record.name}, which is that of {test}, too",
            pytrace=False,
        )
    return first


def _pointer(reference: Path) -> str:
    """Return what is to be told if a file is a pointer of Git LFS, else nothing."""
    try:
        with open(reference, "rb") as file:
            head = file.read(40)
    except OSError:
        return ""
    if not head.startswith(b"version https://git-lfs"):
        return ""
    return (
        f"{reference.name}: expected an EXR file, got a pointer of Git LFS; fetch it: git lfs pull"
    )


def _differences(stored: Image, test: Image) -> str:
    """Return in words what the headers say of how the two were made, where they differ."""
    words = {"variant": "variant", "integrator": "integrator", "rfilter": "filter"}
    found = [
        f"{word} {stored.attributes[key]} in the reference, {test.attributes[key]} now"
        for key, word in words.items()
        if key in stored.attributes and stored.attributes[key] != test.attributes.get(key)
    ]
    a, b = (image.attributes.get("scene") for image in (stored, test))
    if a is not None and a != b:
        found.append("the scene is another than that of the reference")
    return f" ({'; '.join(found)})" if found else ""


def _seeds(image: Image) -> set[int]:
    words = str(image.attributes.get("seeds", image.attributes.get("seed", ""))).split()
    return {int(word) for word in words if word.isdecimal()}
