"""Find the commit that changed an image, by worktrees of git and runs of pytest."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from .._children import program
from .._files import temporary_folder, write_file
from ..errors import BezierError, RuntimeSetupError
from .accept import read_report
from .runs import RESULTS

__all__ = ["Bisection", "Step"]


@dataclass(frozen=True)
class Step:
    """A commit that was tried.

    Attributes
    ----------
    commit, subject : str
    verdict : str
        ``"unchanged"``, ``"changed"`` or ``"untested"``: it has no such test or image, or it fails
        otherwise.
    """

    commit: str
    subject: str
    verdict: str


class Bisection:
    """A search; a context manager, which removes its worktrees.

    Parameters
    ----------
    repository : Path
        A folder of the repository, pytest's root.
    test : str
        Node id of the test, relative to that folder.
    image : str, optional
        The image, if the test has several.
    seconds : float
        That a run may take.
    """

    def __init__(
        self, repository: Path, test: str, image: str | None = None, seconds: float = 3600.0
    ) -> None:
        git = program("git")
        if git is None:
            raise RuntimeSetupError.expected("bisect", "the program git", "none on the PATH")
        self._git, self._test, self._image, self._seconds = git, test, image, seconds
        if test.startswith("-") or not test:
            raise BezierError.expected("TEST", "the node id of a test", repr(test))
        self._repository = repository.resolve()
        self._below = Path(self._ask("rev-parse", "--show-prefix") or ".")
        self._stack = ExitStack()
        self._count = 0
        self._reference: tuple[str, bytes] | None = None
        self._known: dict[str, Step] = {}
        self.skipped: list[str] = []

    def __enter__(self) -> Bisection:
        self._folder = Path(self._stack.enter_context(temporary_folder()))
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()
        self._ask("worktree", "prune")

    def _ask(self, *words: str) -> str:
        """Return what git says, or raise its error."""
        done = subprocess.run(
            [self._git, "-C", str(self._repository), *words], capture_output=True, check=False
        )
        if done.returncode:
            lines = done.stderr.decode(errors="replace").strip().splitlines() or ["no reason"]
            raise BezierError.expected("bisect", f"that git can {words[0]}", lines[-1])
        return done.stdout.decode(errors="replace").strip()

    def _commit(self, name: str, parameter: str) -> str:
        if name.startswith("-"):
            raise BezierError.expected(parameter, "a commit", repr(name))
        try:
            return self._ask("rev-parse", "--verify", "--quiet", f"{name}^{{commit}}")
        except BezierError:
            raise BezierError.expected(parameter, "a commit", repr(name)) from None

    def search(self, good: str, bad: str) -> Iterator[Step]:
        """Try commits, and yield each; `first` is the one that was looked for.

        Raises
        ------
        BezierError
            If a name is no commit, BAD does not come after GOOD, GOOD differs from its own
            reference, or BAD does not differ from that of GOOD.
        """
        a, b = self._commit(good, "GOOD"), self._commit(bad, "BAD")
        line = self._ask("rev-list", "--reverse", "--first-parent", f"{a}..{b}").split()
        merged = self._ask("merge-base", a, b)
        if merged != a or not line:
            raise BezierError.expected("BAD", f"a commit after {good}", bad)
        commits = [a, *line]
        for index, wanted, name in ((0, "unchanged", "GOOD"), (len(line), "changed", "BAD")):
            step = self._try(commits[index])
            yield step
            if step.verdict != wanted:
                raise BezierError.expected(
                    name, f"a commit whose image is {wanted}", f"{step.verdict} at {step.commit}"
                )
        low, high = 0, len(line)
        untested: set[int] = set()
        while inside := [k for k in range(low + 1, high) if k not in untested]:
            middle = min(inside, key=lambda k: abs(2 * k - low - high))
            step = self._try(commits[middle])
            yield step
            if step.verdict == "untested":
                untested.add(middle)
            elif step.verdict == "changed":
                high = middle
            else:
                low = middle
        self.first = self._known[commits[high]]
        self.skipped = [commits[k] for k in range(low + 1, high)]

    def _try(self, commit: str) -> Step:
        """Check a commit out, run the test there, and tell what became of the image."""
        self._count += 1
        place = self._folder / str(self._count)
        self._ask("worktree", "add", "--detach", "--force", str(place), commit)
        root = place / self._below
        if self._reference is not None:  # always that of GOOD
            target = root / self._reference[0]
            target.parent.mkdir(parents=True, exist_ok=True)
            write_file(target, self._reference[1])
        verdict = self._run(root)
        self._ask("worktree", "remove", "--force", str(place))
        step = Step(commit, self._ask("log", "-1", "--format=%s", commit), verdict)
        self._known[commit] = step
        return step

    def _run(self, root: Path) -> str:
        artifacts = self._folder / f"artifacts-{self._count}"
        settings = ["bezier_candidates=false", "bezier_strict=false"]
        settings.append(f"bezier_artifact_dir={artifacts}")
        options = [word for setting in settings for word in ("-o", setting)]
        # what is imported is that of the commit
        paths = [str(root), str(root / "src"), os.environ.get("PYTHONPATH", "")]
        environment = dict(os.environ, PYTHONPATH=os.pathsep.join(filter(None, paths)))
        for name in ("GITHUB_STEP_SUMMARY", "GITHUB_ACTIONS", "PYTEST_ADDOPTS"):
            environment.pop(name, None)
        command = [sys.executable, "-m", "pytest", "-q", f"--rootdir={root}", *options]
        try:
            subprocess.run(
                [*command, "-p", "no:cacheprovider", self._test],
                cwd=root,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                timeout=self._seconds,
                check=False,
            )
            _about, records = read_report(artifacts / RESULTS)
        except (subprocess.TimeoutExpired, BezierError):
            return "untested"
        records = [r for r in records if self._image in (None, r.name) and r.state != "removed"]
        if not records:
            return "untested"
        if self._reference is None and len({r.reference for r in records}) == 1:
            path = root / records[0].reference
            if path.is_file():
                self._reference = records[0].reference, path.read_bytes()
        states = {record.state for record in records}
        if "changed" in states:
            return "changed"
        return "unchanged" if states == {"unchanged"} else "untested"
