"""Build the site: ``python docs/build.py`` (``pip install ".[docs]"``), without any network.

Warnings of Sphinx are errors. Then the pages themselves are looked at: every link inside of the
site leads to a page and a place on it, no page asks another server for anything, and none weighs
more than 2 MB with all its pictures.

    python docs/build.py                    docs/_build/html/index.html
    python docs/build.py --out FOLDER
    python docs/build.py --check FOLDER     look at pages that are built
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

HERE = Path(__file__).parent
#: What a page may weigh with all that it shows, in bytes.
HEAVIEST = 2_000_000


def pages() -> list[Path]:
    """Return the pages that are in the repository, below ``docs``."""
    made = {"_build", "gallery", "generated"}
    return sorted(p for p in HERE.rglob("*.md") if not made & set(p.relative_to(HERE).parts))


class _Page(HTMLParser):
    """Links, names of places, and files of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.files: list[str] = []
        self.places: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        self.places |= {value for key in ("id", "name") if (value := values.get(key))}
        link = values.get("href") or ""
        if tag == "a" and link:
            self.links.append(link)
        elif tag == "link" and values.get("rel") in ("stylesheet", "icon"):
            self.files.append(link)
        source = values.get("src") or values.get("data")
        if tag in ("img", "script", "source", "object", "iframe", "video") and source:
            self.files.append(source)


def faults(site: Path) -> list[str]:
    """Return what is wrong with built pages, a line each."""
    if not site.is_dir() or not any(site.rglob("*.html")):
        return [f"{site}: there are no pages"]
    built = {path: _Page(path.read_text(encoding="utf-8")) for path in site.rglob("*.html")}
    found = []
    for path, page in sorted(built.items()):
        name = path.relative_to(site).as_posix()
        weight = path.stat().st_size
        for file in set(page.files):
            target = _target(path, file)
            if target is None:
                if not file.startswith("data:"):
                    found.append(f"{name}: asks another server for {file}")
            elif not target.is_file():
                found.append(f"{name}: {file} is not there")
            else:
                weight += target.stat().st_size
        if weight > HEAVIEST:
            found.append(f"{name}: weighs {weight / 1e6:.2f} MB, at most {HEAVIEST / 1e6:g} MB")
        for link in set(page.links):
            target = _target(path, link)
            if target is None:
                continue
            if target.is_dir():
                target /= "index.html"
            place = unquote(urlsplit(link).fragment)
            if not target.is_file():
                found.append(f"{name}: the link {link} leads nowhere")
            elif place and target in built and place not in built[target].places:
                found.append(f"{name}: the link {link} leads to no place on its page")
    return found


def _target(page: Path, link: str) -> Path | None:
    """Return the file that a link means, None for one outside of the site."""
    parts = urlsplit(link)
    if parts.scheme or parts.netloc:
        return None
    return (page.parent / unquote(parts.path)).resolve() if parts.path else page


def build(out: Path) -> int:
    """Build the pages into a folder; return Sphinx's exit code."""
    from sphinx.cmd.build import build_main

    if (out / ".buildinfo").exists():  # Sphinx's own: pages that are no more go
        shutil.rmtree(out)
    words = ["-b", "html", "-W", "--keep-going", "-n", "-q", "-j", "auto"]
    return build_main([*words, "-d", str(out.parent / "doctrees"), str(HERE), str(out)])


def print_report(site: Path) -> str:
    """Print the report to ``paper.pdf`` by a Chromium, and return a line that says whether."""
    names = ("chromium", "chromium-browser", "google-chrome")
    browser = next(filter(None, map(shutil.which, names)), None)
    if browser is None:
        return f"no paper.pdf: none of {', '.join(names)} is here to print it"
    pdf = site / "paper.pdf"
    words = ["--headless", "--no-sandbox", "--disable-gpu", "--no-pdf-header-footer"]
    command = [browser, *words, f"--print-to-pdf={pdf}", (site / "paper.html").as_uri()]
    try:
        subprocess.run(command, capture_output=True, check=True, timeout=120)
    except (subprocess.SubprocessError, OSError) as error:
        return f"no paper.pdf: {error}"
    return f"{pdf}, {pdf.stat().st_size / 1000:.0f} kB" if pdf.is_file() else "no paper.pdf"


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(description="Build the site, and look at its pages.")
    parser.add_argument("--out", type=Path, default=HERE / "_build" / "html", metavar="FOLDER")
    parser.add_argument("--check", type=Path, metavar="FOLDER", help="build nothing")
    args = parser.parse_args()
    site = (args.check or args.out).resolve()
    if args.check is None:
        code = build(site)
        if code:
            return code
        print(print_report(site))
    found = faults(site)
    for line in found:
        print(line, file=sys.stderr)
    count = len(list(site.rglob("*.html")))
    print(f"{count} pages in {site}, {len(found) or 'no'} faults")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
