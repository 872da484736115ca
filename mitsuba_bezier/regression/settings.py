"""What the options and the ini file say: folders, names to accept, forms of the report."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..verification.accept import fits
from .artifacts import Artifacts

if TYPE_CHECKING:
    import pytest

__all__ = ["Settings", "add_options", "settings"]

_KEY = "_mitsuba_bezier_settings"


def add_options(parser: pytest.Parser) -> None:
    """Add the options and settings of this plugin."""
    group = parser.getgroup("mitsuba-bezier", "regression of renders (mitsuba-bezier)")
    add = group.addoption
    add(
        "--bezier-generate-refs",
        action="store_true",
        help="render and store the references of all render_regression tests, no comparison",
    )
    add(
        "--bezier-accept",
        metavar="NAME",
        nargs="*",
        help="render and store references where there is none or a limit is broken; of those "
        "names only, if some are given (patterns of image or test)",
    )
    add(
        "--bezier-report",
        metavar="FILE",
        help="write the report there, with the pictures of what passes, too",
    )
    add(
        "--bezier-report-form",
        choices=("auto", "page", "folder"),
        default=None,
        help="all of the report in one page, pictures in a folder beside it, or one page if it is "
        "not too large (auto)",
    )
    add(
        "--bezier-summary",
        metavar="FILE",
        help="add what became of the renders to a Markdown file (also to $GITHUB_STEP_SUMMARY)",
    )
    add("--bezier-history", metavar="DIR", help="write the figures of this run to a file there")
    ini = parser.addini
    ini(
        "bezier_reference_dir",
        "references: beside each test file (references), or an absolute folder (~, $NAME and "
        "{rootdir} are filled in) with the folders of the tests below",
        default="references",
    )
    ini(
        "bezier_artifact_dir",
        "report, renders of what failed, below the root (bezier-artifacts)",
        default="bezier-artifacts",
    )
    ini("bezier_thresholds", "TOML file with limits, below the root", default="")
    ini(
        "bezier_candidates",
        "render what would become the reference of what changed, so that it can be looked at and "
        "accepted without another render (true)",
        type="bool",
        default=True,
    )
    ini(
        "bezier_compression",
        "of references: zip, exact, or dwaa, smaller, where exact values are not needed (zip)",
        default="zip",
    )
    ini("bezier_history", "folder for the figures of each run, below the root", default="")
    ini("bezier_report_form", "auto, page or folder: see --bezier-report-form", default="auto")
    ini(
        "bezier_strict",
        "fail tests that cannot fail, show nothing, or have limits below the noise (false)",
        type="bool",
        default=False,
    )


@dataclass
class Settings:
    """What holds for one run, in one process.

    Attributes
    ----------
    root : Path
        Of the project.
    artifacts : Artifacts
        What the run leaves.
    accept : list of str or None
        None: nothing is accepted; an empty list: everything.
    """

    config: Any
    root: Path
    artifacts: Artifacts
    accept: list[str] | None

    @property
    def generates(self) -> bool:
        """Whether all references are rendered anew."""
        return bool(self.config.getoption("--bezier-generate-refs"))

    @property
    def strict(self) -> bool:
        """Whether notes fail their tests."""
        return bool(self.config.getini("bezier_strict"))

    @property
    def candidates(self) -> bool:
        """Whether what changed is rendered as a reference would be."""
        return bool(self.config.getini("bezier_candidates"))

    @property
    def form(self) -> str:
        """The form of the report."""
        chosen = self.config.getoption("--bezier-report-form")
        return str(chosen or self.config.getini("bezier_report_form"))

    @property
    def report(self) -> Path:
        """Where the report is written."""
        chosen = self.config.getoption("--bezier-report")
        if chosen:
            return Path(self.config.invocation_params.dir, chosen)
        return self.artifacts.folder / "report.html"

    @property
    def compression(self) -> str:
        """How references are packed."""
        return str(self.config.getini("bezier_compression"))

    @property
    def summaries(self) -> list[Path]:
        """Files that a summary is added to."""
        own = self.config.getoption("--bezier-summary")
        names = [Path(self.config.invocation_params.dir, own)] if own else []
        github = os.environ.get("GITHUB_STEP_SUMMARY")
        return [*names, *([Path(github)] if github else [])]

    @property
    def history(self) -> Path | None:
        """Where the figures of the run are kept."""
        chosen = self.config.getoption("--bezier-history")
        if chosen:
            return Path(self.config.invocation_params.dir, chosen)
        name = self.config.getini("bezier_history")
        return Path(self.root, name) if name else None

    @property
    def thresholds(self) -> Path | None:
        """The file of limits."""
        name = self.config.getini("bezier_thresholds")
        return Path(self.root, name) if name else None

    def references(self, test_file: Path) -> Path:
        """Return the folder of the references of a test file."""
        name = self.config.getini("bezier_reference_dir")
        outside = "{rootdir}" in name
        name = os.path.expandvars(os.path.expanduser(name.replace("{rootdir}", str(self.root))))
        folder = Path(name)
        if not (outside or folder.is_absolute()):
            return test_file.parent / folder
        try:  # one folder for all tests: theirs are kept apart in it
            return folder / test_file.parent.relative_to(self.root)
        except ValueError:
            return folder

    def accepts(self, name: str, nodeid: str) -> bool:
        """Tell whether a change of an image is to be accepted."""
        if self.accept is None:
            return False
        return not self.accept or any(fits(pattern, name, nodeid) for pattern in self.accept)


def settings(config: pytest.Config) -> Settings:
    """Return the settings of a run, made once."""
    known = getattr(config, _KEY, None)
    if known is None:
        folder = Path(config.rootpath, config.getini("bezier_artifact_dir"))
        accept = config.getoption("--bezier-accept")
        known = Settings(config, config.rootpath, Artifacts(folder), accept)
        setattr(config, _KEY, known)
    return known


def split_paths(words: Sequence[str], here: Path) -> tuple[list[str], list[str]]:
    """Return which words are names of images and which are what pytest shall run."""
    paths = [
        word
        for word in words
        if word.partition("::")[0].endswith(".py") or (here / word.partition("::")[0]).is_dir()
    ]
    return [word for word in words if word not in paths], paths
