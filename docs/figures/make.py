"""Draw all figures of the lecture into this folder.

    python docs/figures/make.py               all of them (under a minute of processor time)
    python docs/figures/make.py NAME ...      some

Needs the extra ``figures``. Each is 1600 px wide: as SVG where that is small, else as PNG or WebP.
"""

from __future__ import annotations

import sys
from pathlib import Path

from mitsuba_bezier import figures
from mitsuba_bezier._files import write_file

HERE = Path(__file__).resolve().parent

#: Bytes up to which a format is taken; the last one has no limit.
FORMATS = ((".svg", 120_000), (".png", 150_000), (".webp", 300_000))


def encoded(name: str) -> tuple[str, bytes]:
    """Return the suffix and the bytes of a figure, in the first format that is small enough."""
    drawing = figures.draw(name)
    for suffix, limit in FORMATS:
        data = drawing.encoded(suffix)
        if len(data) <= limit:
            return suffix, data
    raise SystemExit(f"{name}: no format is small enough")


def main(names: list[str]) -> None:
    """Draw figures; old ones of another format are removed."""
    for name in names or list(figures.names()):
        suffix, data = encoded(name)
        for other, _limit in FORMATS:
            if other != suffix:
                (HERE / f"{name}{other}").unlink(missing_ok=True)
        write_file(HERE / f"{name}{suffix}", data)
        print(f"{name}{suffix}  {len(data) / 1000:.0f} kB")


if __name__ == "__main__":
    main(sys.argv[1:])
