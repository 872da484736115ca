"""Render a scene through a lens in place of its camera: ``lens FILE --render SCENE``."""

from __future__ import annotations

import argparse
import hashlib
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import BezierError
from ._streams import printable

__all__ = ["add_options", "check_options", "render"]

#: Width of a film if neither scene nor lens say one: that of 35 mm film, in millimetres.
_WIDTH = 36.0
#: Options of the sensor, by their flags, and what they need.
_NUMBERS = {
    "film_width": "width of the film in the lens's unit (as wide as the scene's camera sees)",
    "focus_distance": "plane in focus, from the front vertex, in scene units (the middle's)",
    "f_number": "f-number (the prescription's)",
    "scale": "scene units in a unit of the lens (0.001)",
}
_MAX_WIDTH = 1 << 15


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that go with ``--render``."""
    from .render import MAX_SPP, add_define, integer

    add = parser.add_argument_group("pictures").add_argument
    add("--render", metavar="SCENE", help="render a scene through the lens, at its camera's place")
    add("-o", "--output", metavar="OUT.exr", help="default: beside the scene, SCENE-FILE.exr")
    add("-m", "--mode", metavar="VARIANT", help="variant of Mitsuba (llvm_ad_rgb)")
    add_define(add)
    add("-s", "--sensor", metavar="N", type=integer(0), default=0, help="number of the camera (0)")
    add("--spp", metavar="N", type=integer(1, MAX_SPP), help="samples per pixel (the scene's)")
    add("--seed", metavar="K", type=integer(0), default=0, help="seed of the render (0)")
    add(
        "--width",
        metavar="PIXELS",
        type=integer(1, _MAX_WIDTH),
        help="width of the picture, whose height follows (the scene's)",
    )
    for name, what in _NUMBERS.items():
        add("--" + name.replace("_", "-"), metavar="X", type=float, help=what)
    add("--blades", metavar="N", type=int, help="blades of the iris (round)")
    add("--ghosts", action="store_true", help="follow light that is reflected in the lens")
    add("--denoise", action="store_true", help="also write OUT.denoised.exr, a guess without noise")


def check_options(args: argparse.Namespace) -> None:
    """Raise an error for options of a picture without one, or for ones that cannot be."""
    given = [name for name in (*_NUMBERS, "output", "mode", "spp", "width", "blades") if
             getattr(args, name) is not None]  # fmt: skip
    given += [name for name in ("define", "sensor", "seed", "ghosts", "denoise") if
              getattr(args, name)]  # fmt: skip
    if args.render is None and given:
        flag = "--" + given[0].replace("_", "-")
        raise BezierError.expected(flag, "--render SCENE beside it", "none")
    for name in _NUMBERS:
        value = getattr(args, name)
        if value is not None and not 0 < value < np.inf:
            flag = "--" + name.replace("_", "-")
            raise BezierError.expected(flag, "a positive number", value)


def render(args: argparse.Namespace, lens: Any) -> None:
    """Render the scene and write the picture.

    Raises
    ------
    BezierError
        If scene, lens or options do not go together.
    """
    from . import _images, _inputs, _model, _passes, _scene, main
    from .render import set_variant

    scene_file = Path(args.render)
    _scene.check_name(scene_file)
    if _model.is_model(args.render):
        raise BezierError.expected("--render", "a scene file (.xml) with a camera", scene_file)
    beside = scene_file.with_name(f"{scene_file.stem}-{Path(args.file).stem}.exr")
    output = _images.check_output(args.output or beside)
    words = ["render", "--seed", str(args.seed), "-s", str(args.sensor)]
    words += ["--spp", str(args.spp)] if args.spp else []
    words += ["--denoise"] if args.denoise else []
    for key, value in args.define:
        words += ["-D", f"{key}={value}"]
    parsed = main.parse([*words, "--", str(scene_file)])
    parsed.argv = args.argv
    variant = set_variant(args.mode)
    loaded = _inputs.load(parsed, variant)
    camera = _inputs.chosen_sensor(loaded.scene, args.sensor)
    sensor, values, notes = lens_for(loaded.scene, camera, args, lens)
    for note in (*loaded.notes, *notes):
        print(f"mitsuba-bezier: {printable(note)}", file=sys.stderr)
    data = Path(args.file).read_bytes()
    text = f"{loaded.digest} {hashlib.sha256(data).hexdigest()} {sorted(values.items())}"
    digest = hashlib.sha256(text.encode()).hexdigest()[: len(loaded.digest)]
    loaded = replace(loaded, digest=digest, files=(*loaded.files, Path(args.file)))
    shot = _passes.Shot(parsed, loaded, sensor, variant, output)
    _passes.render(shot, lambda line: print(line, file=sys.stderr))


def lens_for(
    scene: Any, camera: Any, args: argparse.Namespace, lens: Any
) -> tuple[Any, dict[str, Any], list[str]]:
    """Return a sensor ``lens`` at the place of a camera, its parameters, and notes on them."""
    import mitsuba as mi

    from ..optics import first_order

    found = mi.traverse(camera)
    film = camera.film()
    if args.width is not None:
        size = np.array(film.size(), int).ravel()
        if (np.array(film.crop_size(), int).ravel() != size).any():
            raise BezierError.expected("--width", "a film without a crop window", "one with")
        height = max(1, round(args.width * size[1] / size[0]))
        parameters = mi.traverse(film)
        parameters["size"] = [args.width, height]
        parameters.update()
    aspect = float(film.size()[1]) / float(film.size()[0])
    notes = []
    values: dict[str, Any] = {"filename": str(Path(args.file).resolve())}
    for name in ("f_number", "scale", "blades"):
        if getattr(args, name) is not None:
            values[name] = getattr(args, name)
    if args.ghosts:
        values["ghosts"] = True
    width = args.film_width
    if width is None:
        width, note = _film_width(lens, found, aspect)
        notes.append(note)
    values["film_width"] = width
    distance = args.focus_distance
    if distance is None:
        pupil = first_order(lens).entrance_pupil * values.get("scale", 1e-3)
        distance, note = _focus(scene, camera, pupil)
        notes.append(note)
    if distance is not None:
        values["focus_distance"] = distance
    place = np.array(camera.world_transform().matrix, float)
    placed = {
        "to_world": mi.ScalarTransform4f(place.reshape(4, 4)),
        "film": film,
        "sampler": camera.sampler(),
    }
    try:
        sensor = mi.load_dict({"type": "lens", **values, **placed})
    except RuntimeError as error:
        # an error of ours comes as the last part of Mitsuba's
        raise BezierError(str(error).rsplit("Error: ", 1)[-1]) from None
    return sensor, {**values, "size": str(film.size()), "place": place.tolist()}, notes


def _film_width(lens: Any, found: Any, aspect: float) -> tuple[float, str]:
    """Return the film's width that sees what the camera sees, or what the lens does; and a note."""
    from ..optics import beam, first_order, trace

    diagonal = np.hypot(1.0, aspect)
    widest = np.inf
    farthest = lens.farthest_field()
    if np.hypot(*farthest) > 0:
        chief = trace(lens, *beam(lens, farthest, np.zeros((1, 2))), vignetting=False)
        height = float(np.hypot(*chief.local[-1][0, :2]))
        if height > 0:
            widest = 2 * height / diagonal
    if "x_fov" not in found:
        width = widest if np.isfinite(widest) else _WIDTH / lens.millimetres
        return width, f"the film is {width:.4g} {lens.unit} wide (--film-width)"
    slope = np.tan(np.radians(float(np.ravel(np.array(found["x_fov"]))[0])) / 2)
    width = 2 * abs(first_order(lens).focal_length) * float(slope)
    if not 0 < width < np.inf:
        raise BezierError.expected("FILE", "a lens that forms an image", "an afocal one")
    if width <= widest * (1 + 1e-6):
        return width, f"the film is {width:.4g} {lens.unit} wide, as the camera sees (--film-width)"
    return widest, (
        f"the film is {widest:.4g} {lens.unit} wide, as far as the fields of the lens reach; the "
        f"camera sees {width:.4g} (--film-width)"
    )


def _focus(scene: Any, camera: Any, pupil: float) -> tuple[float | None, str]:
    """Return the distance from the front vertex to what is in the middle, and a note."""
    import mitsuba as mi

    from .. import ray_intersect

    ray, _ = camera.sample_ray(0.0, 0.5, mi.Point2f(0.5), mi.Point2f(0.5))
    hit = ray_intersect(scene, mi.Ray3f(ray))
    if bool(np.array(hit.is_valid())[0]):
        place = np.array(camera.world_transform().matrix, float).reshape(4, 4)
        point = np.linalg.inv(place) @ [*np.array(hit.p, float).ravel(), 1.0]
        # the origin of the lens is the middle of its entrance pupil
        distance = float(point[2]) - pupil
        if distance > 0:
            return distance, f"in focus at {distance:.4g}, in the middle (--focus-distance)"
    return None, "nothing is in the middle: in focus as in the prescription (--focus-distance)"
