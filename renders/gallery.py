"""Make all pictures of this folder, the verification report and the index page.

    python renders/gallery.py              everything (about half an hour on two cores)
    python renders/gallery.py NAME ...     some pictures, and the index
    python renders/gallery.py --index      index.html and README.md alone

Each picture is a PNG to look at and a small EXR, half float, as reference for `mitsuba-bezier
compare`; the header of the EXR holds the command that made it.
"""

from __future__ import annotations

import argparse
import html
import re
import shlex
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from mitsuba_bezier._files import write_file

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent


@dataclass(frozen=True)
class Picture:
    """One picture: its scene, the size of the PNG, and what it shows."""

    name: str
    scene: str
    width: int
    height: int
    spp: int
    caption: str
    options: tuple[str, ...] = ()
    section: str = "lecture"

    def command(self, output: str, width: int, height: int, spp: int) -> list[str]:
        """Return the words of a render command."""
        size = ["-D", f"width={width}", "-D", f"height={height}", "--spp", str(spp)]
        return ["render", "-q", f"scenes/{self.scene}.xml", "-o", output, *size, *self.options]

    def preview(self) -> list[str]:
        """Return the command of the PNG."""
        return self.command(f"{self.name}.exr", self.width, self.height, self.spp)

    def reference(self) -> list[str]:
        """Return the command of the EXR, at most 256 pixels in either direction."""
        scale = 256 / max(self.width, self.height)
        width, height = round(self.width * scale), round(self.height * scale)
        return self.command(f"renders/{self.name}.exr", width, height, 256)


PICTURES = (
    Picture(
        "teapot",
        "teapot",
        512,
        320,
        512,
        "The Utah teapot from its 32 bicubic patches",
        section="classics",
    ),
    Picture(
        "teaset",
        "teaset",
        512,
        320,
        512,
        "Newell's whole tea set: pot, cup, saucer, spoon",
        section="classics",
    ),
    Picture(
        "quadrics",
        "quadrics",
        576,
        324,
        512,
        "All quadrics and a torus, on one floor",
        section="classics",
    ),
    Picture(
        "sphere",
        "sphere",
        480,
        320,
        512,
        "Both covers of the sphere, in glass and in metal",
        section="classics",
    ),
    Picture(
        "cornell",
        "cornell",
        320,
        320,
        1024,
        "Glass ball and torus in a Cornell box",
        section="classics",
    ),
    Picture(
        "caustic",
        "caustic",
        512,
        320,
        768,
        "Caustics of ring, torus, lens, ball: `ptracer`",
        section="classics",
    ),
    Picture(
        "media",
        "media",
        384,
        240,
        256,
        "Jade, fog and coloured glass: media in patches",
        section="classics",
    ),
    # models of other programs: a CAD part, a mesh of high order
    # the lecture
    Picture("railroad", "railroad", 512, 288, 128, "A plane to the horizon; rails to infinity"),
    Picture("duerer", "duerer", 512, 288, 128, "Dürer's machine: threads through a frame"),
    Picture("duerer_eye", "duerer", 512, 288, 128, "The same from the eye point", ("-s", "1")),
    Picture("figure2", "figure2", 512, 288, 128, "Four triangles and six lunes tile the sphere"),
    Picture("paraboloids", "paraboloids", 512, 288, 128, "Quadrics as images of one paraboloid"),
    Picture("weights", "weights", 512, 288, 128, "One weight from large through zero to negative"),
    Picture("developable", "developable", 512, 288, 128, "A developable and its regression curve"),
    Picture("decasteljau", "decasteljau", 512, 288, 64, "De Casteljau's scheme of a cubic"),
    Picture("farin", "farin", 512, 288, 64, "Farin points: evaluation by cross ratios"),
    Picture("relief", "relief", 512, 288, 128, "Relief perspective of a lute"),
    Picture(
        "cad_part",
        "cad_part",
        512,
        384,
        256,
        "A part from a STEP file, holes cut exactly",
        section="models",
    ),
    Picture(
        "high_order_mesh",
        "high_order_mesh",
        512,
        384,
        256,
        "A quartic mesh from Gmsh",
        section="models",
    ),
)


def mitsuba_bezier(*words: str) -> None:
    """Run the command line of this checkout."""
    print("+ mitsuba-bezier", shlex.join(words), flush=True)
    subprocess.run([sys.executable, "-m", "mitsuba_bezier.cli.main", *words], cwd=ROOT, check=True)


def make(picture: Picture) -> None:
    """Render one picture; what is there stays until the new one is finished."""
    with tempfile.TemporaryDirectory() as folder:
        words = picture.preview()
        words[words.index("-o") + 1] = str(Path(folder) / f"{picture.name}.exr")
        mitsuba_bezier(*words)
        mitsuba_bezier(*picture.reference())  # writes a PNG of its own size, too
        png = (Path(folder) / f"{picture.name}.png").read_bytes()
        write_file(HERE / f"{picture.name}.png", png)


#: Headings of the sections, in their order.
SECTIONS = {
    "classics": "Classics",
    "lecture": "The lecture, rendered",
    "drawn": "The lecture, drawn",
    "models": "Models of other programs",
    "inverse": "Inverse rendering",
}


def there(section: str) -> list[Picture]:
    """Return the pictures of a section that have been made."""
    return [p for p in PICTURES if p.section == section and (HERE / f"{p.name}.png").exists()]


def drawn() -> list[tuple[str, str]]:
    """Return the drawings on the lecture's page: their files, and what they show."""
    page = (ROOT / "docs" / "lecture.md").read_text(encoding="utf-8")
    found = re.findall(r"!\[([^\]]+)\]\(figures/([\w.]+)\)", page)
    return [(f"../docs/figures/{file}", text) for text, file in found]


#: What `scenes/inverse_quadric.py` makes.
INVERSE = (
    ("inverse_quadric.png", "A quadric found from four pictures; dotted: the target's boundary"),
    ("inverse_quadric_loss.svg", "The loss, step by step"),
)


def others(section: str) -> list[tuple[str, str]]:
    """Return pictures of a section that no render command makes: files, and what they show."""
    known = {"drawn": drawn(), "inverse": list(INVERSE)}
    return [(file, text) for file, text in known.get(section, []) if (HERE / file).exists()]


def readme() -> str:
    """Return the same as Markdown."""
    parts = [_README]
    for section, heading in SECTIONS.items():
        parts.append(f"## {heading}\n")
        for p in there(section):
            words = shlex.join(p.preview())
            parts.append(
                f"### {p.name}\n\n![{p.caption}]({p.name}.png)\n\n{p.caption}; "
                f"[EXR]({p.name}.exr)\n\n    mitsuba-bezier {words}\n"
            )
        for file, text in others(section):
            parts.append(f"![{text}]({file})\n" if section != "drawn" else f"* [{text}]({file})")
        if section == "drawn":
            parts.append("\n    python docs/figures/make.py\n")
    return "\n".join(parts)


_README = """# Pictures from exact patches

`python renders/gallery.py` makes all of this, as does the command below each picture for that one,
in the root of the repository. Each picture is a PNG and a smaller OpenEXR file in half floats, a
reference for `mitsuba-bezier compare`; its header holds its own command, the samples, the time and
the versions. Seeds are 0. The models come from the `make_*.py` scripts in [scenes](../scenes).

[index.html](index.html) shows the same as thumbnails, [verification.html](verification.html) the
intersections against formulas; both are to be opened from a checkout. The pictures of the lecture
are explained in [lecture.md](lecture.md). Those that are drawn over a render are denoised, at 1600
pixels; the references are not.
"""


def index() -> str:
    """Return the index page: thumbnails, captions, commands."""
    items = []
    for section, heading in SECTIONS.items():
        items.append(f'<h2 id="{section}">{heading}</h2>')
        for p in there(section):
            words = html.escape("mitsuba-bezier " + shlex.join(p.preview()))
            items.append(
                _figure(
                    f"{p.name}.png", p.name, p.caption, f'<a href="{p.name}.exr">EXR</a>', words
                )
            )
        for file, text in others(section):
            name = Path(file).stem
            command = f"mitsuba-bezier figure {name}" if section == "drawn" else ""
            if name.endswith("_drawn"):
                command = f"python docs/figures/overlays.py {name}"
            items.append(_figure(file, name, text, "", command))
    return _PAGE.replace("@@", "\n".join(items))


def _figure(file: str, name: str, caption: str, link: str, command: str) -> str:
    """Return one picture of the index page."""
    text = html.escape(caption)
    return (
        f'<figure><a href="{file}"><img src="{file}" alt="{text}" loading="lazy"></a>'
        f"<figcaption><b>{name}</b> {text} {link}<code>{command}</code></figcaption></figure>"
    )


_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>mitsuba_bezier: pictures</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<style>
:root { color-scheme: light dark; }
body { font: 16px/1.45 system-ui, sans-serif; margin: 2rem auto; max-width: 76rem;
  padding: 0 1rem; }
main { display: grid; gap: 1.6rem; grid-template-columns: repeat(auto-fill, minmax(20rem, 1fr)); }
figure { margin: 0; } img { width: 100%; aspect-ratio: 16/10; object-fit: contain;
  background: #8882; border-radius: .4rem; }
h2 { grid-column: 1 / -1; margin: 1rem 0 0; }
figcaption code { display: block; font-size: .75rem; overflow-wrap: anywhere; opacity: .75;
  margin-top: .3rem; }
</style></head><body>
<h1>Pictures from exact patches</h1>
<p>Each is made by the command below it; <code>python renders/gallery.py</code> makes all of them.
The <a href="verification.html">verification report</a> holds the intersections against
formulas.</p>
<main>
@@
</main></body></html>
"""


def main() -> None:
    """Make what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help="pictures to make; all by default")
    parser.add_argument("--index", action="store_true", help="write index.html and README.md only")
    args = parser.parse_args()
    known = {p.name: p for p in PICTURES}
    unknown = [n for n in args.names if n not in known]
    if unknown:
        parser.error(f"NAME: expected one of {', '.join(known)}, got {unknown[0]}")
    if not args.index:
        for name in args.names or known:
            make(known[name])
        if not args.names:
            words = ["--resolution", "1024", "--html", "renders/verification.html"]
            mitsuba_bezier("verify", *words, "--html-size", "160")
    write_file(HERE / "index.html", index().encode())
    write_file(HERE / "README.md", readme().encode())


if __name__ == "__main__":
    main()
