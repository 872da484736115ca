"""The same surfaces in POV-Ray, by the processor time of a primary ray, one thread each.

    python benchmarks/povray.py [--side 2048] [--runs 3] [--json FILE]

A sphere, a torus, an ellipsoid as a quadric, and the teapot's bicubic patches shine white on
black: camera rays and nothing else. POV-Ray 3.7 (Debian's package ``povray``) has closed forms for
sphere and quadric and a polynomial solver for the torus. Bicubic patches it cuts into triangles
(``type 1``): 32 and 2048 of each. Ours are patches in ``bezierpath``, with Mitsuba's renderer
around them. Time is what a picture of `--side` squared takes beyond one of 16 x 16 pixels, the
least of `--runs`. Pixels that differ are counted: both look through the middle of each.
"""

from __future__ import annotations

import argparse
import json
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import mitsuba_bezier as mb  # before Dr.Jit, for which it finds LLVM

sys.path.insert(0, str(Path(__file__).parent))  # for a caller that is not in this folder
sys.path.insert(0, str(Path(__file__).parents[1] / "scenes"))

import drjit as dr
import mitsuba as mi
import numpy as np
from common import machine, set_variant
from make_classics import bicubics
from speed_surfaces import bezier_shape
from tqdm import tqdm

from mitsuba_bezier._files import write_file

#: Where both cameras are, and their field of view in degrees.
AT, FIELD = (0.5, -3.2, 1.4), 45.0
#: The ellipsoid ``x.diag(form).x = 1``.
FORM = (1.0, 1.7, 2.6)
#: A patch has ``2 4^steps`` triangles.
STEPS = (2, 5)


def into_frame(points: np.ndarray) -> np.ndarray:
    """Move and scale points so that they are 2 long around the origin."""
    low, high = points.reshape(-1, 3).min(axis=0), points.reshape(-1, 3).max(axis=0)
    return (points - (low + high) / 2) * (2 / (high - low).max())


def surfaces() -> dict[str, tuple[dict[str, Any], str]]:
    """Return each surface as a shape of ours and as POV-Ray's words."""
    from mitsuba_bezier.geometry.tensor import tensor_to_triangles

    ball = mb.sphere(cover="tetrahedral")
    squeeze = np.diag([*(1 / np.sqrt(FORM)), 1.0])
    nets = into_frame(bicubics()["teapot"])
    tensor = np.concatenate([nets, np.ones((*nets.shape[:3], 1))], axis=-1)
    teapot = bezier_shape(tensor_to_triangles(tensor))

    def words(steps: int) -> str:
        patches = []
        for net in nets:
            points = ", ".join(f"<{x:.9g},{y:.9g},{z:.9g}>" for x, y, z in net.reshape(-1, 3))
            head = f"bicubic_patch {{ type 1 flatness 0 u_steps {steps} v_steps {steps}"
            patches.append(f"{head} {points} }}")
        return "union { " + "\n".join(patches) + " SHINE }"

    a, b, c = FORM
    # axes as ours: the torus of POV-Ray turns about y
    return {
        "sphere": (bezier_shape(ball), "sphere { 0, 1 SHINE }"),
        "torus": (
            bezier_shape(mb.torus(radius=0.75, tube=0.25)),
            "torus { 0.75, 0.25 rotate 90*x SHINE }",
        ),
        "ellipsoid": (
            bezier_shape(ball.transform(squeeze)),
            f"quadric {{ <{a},{b},{c}>, <0,0,0>, <0,0,0>, -1 SHINE }}",
        ),
        "teapot, 32 triangles a patch": (teapot, words(STEPS[0])),
        "teapot, 2048 triangles a patch": (teapot, words(STEPS[1])),
    }


def picture_of_pov(words: str, side: int, folder: Path) -> tuple[float, np.ndarray]:
    """Return processor seconds and the picture as a mask."""
    scene, out = folder / "scene.pov", folder / "out.ppm"
    x, y, z = AT
    camera = (
        # right to the left of POV-Ray's own: a space with the hand of Mitsuba's
        f"camera {{ location <{x},{y},{z}> sky z up z right -x look_at 0 angle {FIELD} }}"
    )
    shine = (
        "#declare WHITE = texture { pigment { rgb 1 } finish { ambient 0 diffuse 0 emission 1 } }"
    )
    text = "#version 3.7; global_settings { assumed_gamma 1 ambient_light 0 }"
    text = f"{text}\n{shine}\n{camera}\n{words.replace('SHINE', 'texture { WHITE }')}"
    scene.write_text(text)
    command = ["povray", f"+I{scene}", f"+O{out}", f"+W{side}", f"+H{side}", "+WT1", "-D", "-A"]
    command += ["+FP8", "-J"]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(command, capture_output=True, text=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        raise SystemExit(f"povray failed:\n{done.stderr[-2000:]}")
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    # Mitsuba does not read its comments; the pixels are the last bytes of the file
    pixels = np.fromfile(out, np.uint8)[-3 * side * side :].reshape(side, side, 3)
    return seconds, pixels[..., 0] > 127


def scene_of(shape: dict[str, Any], side: int) -> Any:
    """Return the same picture as a scene of ours, one ray through the middle of each pixel."""
    film = {"type": "hdrfilm", "width": side, "height": side, "rfilter": {"type": "box"}}
    place = mi.ScalarTransform4f().look_at(list(AT), [0, 0, 0], [0, 0, 1])
    sensor = {"type": "perspective", "fov": FIELD, "to_world": place, "film": film}
    sensor["sampler"] = {"type": "independent", "sample_count": 1}
    shine = {"type": "area", "radiance": {"type": "rgb", "value": 1.0}}
    shape = shape | {"bsdf": {"type": "twosided", "bsdf": {"type": "diffuse"}}, "light": shine}
    integrator = {"type": "bezierpath", "max_depth": 1}
    return mi.load_dict({"type": "scene", "a": integrator, "b": sensor, "shape": shape})


def measure(name: str, shape: dict[str, Any], words: str, side: int, runs: int) -> dict[str, Any]:
    """Return the row of one surface."""
    scene, small = scene_of(shape, side), scene_of(shape, 16)

    def ours(scene: Any) -> float:
        dr.sync_thread()
        start = time.process_time()
        dr.eval(mi.render(scene, spp=1))
        dr.sync_thread()
        return time.process_time() - start

    for _ in range(2):
        ours(scene), ours(small)
    with tempfile.TemporaryDirectory() as folder:
        times = []
        for _ in range(runs):
            a, b = ours(scene) - ours(small), 0.0
            seconds, mask = picture_of_pov(words, side, Path(folder))
            b = seconds - picture_of_pov(words, 16, Path(folder))[0]
            times.append((a, b))
    a, b = (min(column) / side**2 * 1e9 for column in zip(*times))
    sensor = scene.sensors()[0]
    # the middles of pixels, where POV-Ray looks
    x, y = dr.meshgrid(dr.arange(mi.Float, side), dr.arange(mi.Float, side))
    at = mi.Point2f((x + 0.5) / side, (y + 0.5) / side)
    ray, _ = sensor.sample_ray(0.0, 0.0, at, mi.Point2f(0.5))
    hit = np.array(scene.ray_test(ray)).reshape(side, side)
    return {"surface": name, "ours": a, "povray": b, "differ": int((hit != mask).sum())}


def main(arguments: list[str] | None = None) -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--side", type=int, default=2048, help="pixels along a side (2048)")
    parser.add_argument("--runs", type=int, default=3, help="repetitions (3)")
    parser.add_argument("--json", type=Path, help="write the numbers to a file, too")
    options = parser.parse_args(arguments)
    if shutil.which("povray") is None:
        raise SystemExit("povray: expected POV-Ray 3.7 on the PATH (Debian: apt install povray)")
    set_variant("llvm_ad_rgb")
    dr.set_thread_count(1)
    rows = [
        measure(name, *both, options.side, options.runs)
        for name, both in tqdm(surfaces().items(), leave=False)
    ]
    print("| surface | ours, ns a ray | POV-Ray, ns | POV-Ray / ours | pixels that differ |")
    print("| --- | ---: | ---: | ---: | ---: |")
    for row in rows:
        ratio = row["povray"] / row["ours"]
        print(
            f"| {row['surface']} | {row['ours']:.0f} | {row['povray']:.0f} | {ratio:.2g} "
            f"| {row['differ']} of {options.side**2} |"
        )
    if options.json:
        about = subprocess.run(["povray", "--version"], capture_output=True, text=True)
        version = re.search(r"POV-Ray (\S+)", about.stdout + about.stderr)
        record = {"machine": machine(), "povray": version and version[1], "rows": rows}
        write_file(options.json, json.dumps(record, indent=1).encode())


if __name__ == "__main__":
    main()
