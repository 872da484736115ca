"""Headless Chromium for tests of pages, driven by playwright; the browser is the system's."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

#: What a busy machine may take for a step; a test that passes takes none of it.
SECONDS = 900

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")


def find() -> str | None:
    """Return the browser: ``$CHROMIUM``, or the first on the PATH, or None."""
    return os.environ.get("CHROMIUM") or next(filter(None, map(shutil.which, NAMES)), None)


#: Awaits the pictures of a page, which are decoded beside its script.
DECODED = "Promise.all([...document.images].map(i => i.decode().catch(() => 0)))"


class Browser:
    """One browser with one page; a context manager."""

    def __init__(self, program: str) -> None:
        from playwright.sync_api import sync_playwright

        self._playwright = sync_playwright().start()
        arguments = ["--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"]
        self._browser = self._playwright.chromium.launch(
            executable_path=program, args=arguments, timeout=1000 * SECONDS
        )
        self.page = self._browser.new_page(viewport={"width": 1280, "height": 900})
        self.page.set_default_timeout(1000 * SECONDS)
        #: exceptions in the page, and addresses it asked for
        self.errors: list[str] = []
        self.requests: list[str] = []
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.on("request", lambda request: self.requests.append(request.url))

    def __enter__(self) -> Browser:
        return self

    def __exit__(self, *_: object) -> None:
        self._browser.close()
        self._playwright.stop()

    def clear(self) -> None:
        """Forget exceptions and addresses."""
        self.errors.clear()
        self.requests.clear()

    def open(self, path: Path) -> None:
        """Load a file and wait until it and its pictures are there."""
        self.page.goto(path.resolve().as_uri())
        self.run(DECODED)
        self.settle()

    def run(self, script: str) -> Any:
        """Return the value of an expression in the page, awaited."""
        return self.page.evaluate(script)

    def wait(self, script: str) -> None:
        """Wait until an expression is true; playwright's own way is one that pages forbid."""
        end = time.monotonic() + SECONDS
        while not self.run(script):
            if time.monotonic() > end:
                raise TimeoutError(script)
            self.page.wait_for_timeout(30)

    def settle(self) -> None:
        """Wait until what follows from the last change is laid out: observers run in a frame."""
        self.run("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")

    def resize(self, width: int, height: int) -> None:
        """Set the size of the window in CSS pixels, and wait until the page has it."""
        self.page.set_viewport_size({"width": width, "height": height})
        self.wait(f"innerWidth === {width} && innerHeight === {height}")
        self.settle()

    def scheme(self, name: Any) -> None:
        """Prefer ``"light"`` or ``"dark"``."""
        self.page.emulate_media(color_scheme=name)

    def mouse(self, kind: str, x: float, y: float) -> None:
        """Send ``mousePressed``, ``mouseMoved`` or ``mouseReleased`` of the left button."""
        self.page.mouse.move(x, y)
        if kind != "mouseMoved":
            {"mousePressed": self.page.mouse.down, "mouseReleased": self.page.mouse.up}[kind]()

    def key(self, key: str) -> None:
        """Press and release a key."""
        self.page.keyboard.press({" ": "Space"}.get(key, key))

    @contextmanager
    def bare(self, width: int, height: int, scheme: Any) -> Iterator[Any]:
        """Give a page of its own whose rules of security are off."""
        context = self._browser.new_context(
            viewport={"width": width, "height": height}, color_scheme=scheme, bypass_csp=True
        )
        try:
            context.set_default_timeout(1000 * SECONDS)
            yield context.new_page()
        finally:
            context.close()

    def screenshot(self, path: Path, whole: bool = False) -> None:
        """Write a PNG of the window, or of the whole page."""
        self.page.screenshot(path=path, full_page=whole)
