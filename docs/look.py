"""Look at the built site in Chromium, as wide as a screen and as a telephone.

    python docs/look.py [SITE] [--screens FOLDER]

Needs playwright and the system's Chromium (``$CHROMIUM``, or the first on the PATH). A page that is
wider than the window, or throws an exception, is a fault. The pictures of all pages are kept.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
from pathlib import Path

HERE = Path(__file__).parent
WIDTHS = (1280, 420)
NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")


def browser() -> str | None:
    """Return the program of the browser, or None."""
    return os.environ.get("CHROMIUM") or next(filter(None, map(shutil.which, NAMES)), None)


def look(site: Path, screens: Path | None = None) -> list[str]:
    """Open all pages in both widths; return what is wrong, a line each."""
    from playwright.sync_api import sync_playwright

    found: list[str] = []
    with sync_playwright() as playwright:
        started = playwright.chromium.launch(
            executable_path=browser(), args=["--no-sandbox", "--disable-dev-shm-usage"]
        )
        for width in WIDTHS:
            page = started.new_page(viewport={"width": width, "height": 900})
            errors: list[str] = []
            page.on("pageerror", lambda error, errors=errors: errors.append(str(error)))
            for path in sorted(site.rglob("*.html")):
                name = path.relative_to(site).as_posix()
                page.goto(path.resolve().as_uri())
                root = "document.documentElement"
                beyond = page.evaluate(f"{root}.scrollWidth - {root}.clientWidth")
                if beyond > 0:
                    found.append(f"{name}: {beyond} pixels wider than {width}")
                found += [f"{name}: {error}" for error in errors]
                errors.clear()
                if screens is not None:
                    file = screens / str(width) / f"{name.removesuffix('.html')}.jpg"
                    file.parent.mkdir(parents=True, exist_ok=True)
                    page.screenshot(path=file, type="jpeg", quality=70)
            page.close()
        started.close()
    return found


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(description="Look at the site in Chromium.")
    site = HERE / "_build" / "html"
    parser.add_argument("site", type=Path, nargs="?", default=site, metavar="SITE")
    parser.add_argument("--screens", type=Path, metavar="FOLDER", help="keep pictures of all pages")
    args = parser.parse_args()
    if browser() is None:
        print("docs/look.py: no Chromium on the PATH: nothing was looked at")
        return 1 if os.environ.get("CI", "").lower() in ("1", "true") else 0
    found = look(args.site, args.screens)
    for line in found:
        print(line, file=sys.stderr)
    count = len(list(args.site.rglob("*.html")))
    print(f"looked at {count} pages, {len(found) or 'no'} faults")
    return 1 if found or not count else 0


if __name__ == "__main__":
    sys.exit(main())
