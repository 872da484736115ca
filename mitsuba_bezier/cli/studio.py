"""``mitsuba-bezier studio``: drag control points in a browser, with the exact surface behind."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

from ..errors import BezierError
from ._limits import add_limits
from ._streams import printable

__all__ = ["add_parser", "run"]


def add_parser(subparsers: Any) -> None:
    """Add the parser of this command."""
    parser = subparsers.add_parser(
        "studio",
        help="drag control points in a browser",
        description="Serve a page on this machine: the exact surface behind, its net in front. "
        "Drag points, change weights and degree, save. Needs the extra 'studio' (viser).",
    )
    add = parser.add_argument
    says = "a file of patches, or one of the lecture's figures by its name"
    add("net", metavar="FILE|NAME", nargs="?", help=says)
    add("--patch", type=int, default=0, help="which patch of a file (default: 0)")
    add("--host", default="127.0.0.1", help="address to listen on (default: this machine alone)")
    add("--port", type=int, default=8080, help="(default: 8080)")
    add("--folder", metavar="FOLDER", default=".", help="where files are saved (default: here)")
    add("-m", "--mode", metavar="VARIANT", default="llvm_ad_rgb", help="variant of Mitsuba")
    add("-q", "--quiet", action="store_true", help="show errors only")
    add_limits(parser)


def first_net(name: str | None, patch: int) -> Any:
    """Return what is shown first: the name of a figure, or the net of a patch of a file."""
    from ..io import load
    from ..studio.presets import NETS, drawings

    if name is None:
        return next(iter(NETS))
    if name in NETS or name in drawings():
        return name
    if not Path(name).exists():
        known = ", ".join((*NETS, *drawings()))
        raise BezierError.expected("FILE|NAME", f"a file, or one of {known}", repr(printable(name)))
    patches = load(name)
    if not 0 <= patch < len(patches):
        raise BezierError.expected("--patch", f"0 to {len(patches) - 1}", patch)
    return patches.control_points[patch]


def run(args: argparse.Namespace) -> int:
    """Serve the page until Ctrl-C; return 0."""
    import mitsuba as mi

    net = first_net(args.net, args.patch)
    folder = Path(args.folder)
    if not folder.is_dir():
        raise BezierError.expected("--folder", "a folder", repr(printable(args.folder)))
    if args.mode not in mi.variants() or args.mode.startswith("scalar"):
        raise BezierError.expected("--mode", "a variant with a JIT, as llvm_ad_rgb", args.mode)
    mi.set_variant(args.mode)
    from ..studio.page import Studio

    studio = Studio(net, args.host, args.port, folder)
    if not args.quiet:
        print(f"http://{args.host}:{args.port}  (Ctrl-C ends it)", flush=True)
    try:
        while True:
            time.sleep(0.5)
    finally:
        studio.stop()
