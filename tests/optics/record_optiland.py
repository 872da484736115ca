"""Record what Optiland says of its own sample lenses: ``python tests/optics/record_optiland.py``.

The tests compare with the file that this writes, so that they need no Optiland. Run it in an
environment with ``optiland`` (0.6.3 made the file) and ``rayoptics``, which traces the same rays
through the same surfaces, to make it anew.
"""

from __future__ import annotations

import inspect
import json
import math
from importlib.metadata import version
from pathlib import Path

import numpy as np
from optiland.analysis import FieldCurvature
from optiland.mtf import GeometricMTF
from optiland.optic import Optic
from optiland.samples import objectives, simple, telescopes
from rayoptics.elem.profiles import Conic
from rayoptics.environment import FieldSpec, OpticalModel, PupilSpec, WvlSpec
from rayoptics.raytr.raytrace import trace

#: Fields at which foci are recorded, from the axis on, and frequencies of the modulation.
FOCI, FREQUENCIES = 5, 4
#: Fields (shares of the largest) at which spots are recorded, and rings of their rays.
FIELDS, RINGS = (0, 0.7, 1.0), 4
#: Wavelengths of lenses that have fewer than three.
LINES = (0.4861, 0.5876, 0.6563)
#: Height of the field (share of the largest) and place in the pupil.
RAYS = [(h, *p) for h in (0, 0.7, 1.0) for p in ((0, 0), (0, 1), (0.5, -0.5), (-0.9, 0.1))]


def rms(points: np.ndarray) -> float:
    """Return the root mean square distance of points ``(N, 2)`` from their centroid."""
    return float(np.sqrt(((points - points.mean(axis=0)) ** 2).sum(axis=1).mean()))


def pupil() -> np.ndarray:
    """Return points of the unit disk: 6 i of them on ring i."""
    points = [(0.0, 0.0)]
    for i in range(1, RINGS + 1):
        for angle in np.arange(6 * i) / (6 * i) * 2 * np.pi:
            points.append((i / RINGS * np.cos(angle), i / RINGS * np.sin(angle)))
    return np.array(points)


def by_rayoptics(lens: dict, indices: list[float], wavelength: float) -> tuple[float, list[float]]:
    """Return focal length and spots of the same surfaces from ray-optics."""
    model = OpticalModel(radius_mode=False)
    surfaces, specs = model["seq_model"], model["optical_spec"]
    nanometres = 1000 * wavelength
    specs["pupil"] = PupilSpec(specs, key=["object", "epd"], value=lens["entrance_diameter"])
    specs["fov"] = FieldSpec(specs, key=["object", "angle"], value=1.0, flds=[0.0])
    specs["wvls"] = WvlSpec([(nanometres, 1.0)], ref_wl=0)
    surfaces.do_apertures = False
    rows = lens["surfaces"]
    # rays start on a plane in front of the first surface
    away = 2 * lens["entrance_diameter"] + 10
    surfaces.gaps[0].thi = away
    for i, row in enumerate(rows[1:-1], start=1):
        gap = rows[i + 1]["z"] - row["z"]
        surfaces.add_surface([row["curvature"], gap, "REFL" if row["mirror"] else indices[i]])
        surfaces.ifcs[surfaces.cur_surface].profile = Conic(c=row["curvature"], cc=row["conic"])
        if row["stop"]:
            surfaces.set_stop()
    model.update_model()
    found = []
    for share in FIELDS:
        slope = np.tan(np.radians(share * lens["field"]))
        at = lens["entrance_diameter"] / 2 * pupil()
        at[:, 1] -= slope * (lens["entrance_pupil"] + away)
        toward = np.array([0.0, slope, 1.0]) / np.hypot(slope, 1.0)
        ends = [
            trace(surfaces, np.array([x, y, 0.0]), toward, nanometres)[0][-1][0][:2] for x, y in at
        ]
        found.append(rms(np.array(ends)))
    return float(model["analysis_results"]["parax_data"].fod.efl), found


def spectrum(optic: Optic, lens: dict) -> list[dict]:
    """Return indices, focal lengths and spots at three wavelengths, from both programs."""
    waves = sorted(float(w.value) for w in optic.wavelengths.wavelengths)
    waves = [waves[0], waves[len(waves) // 2], waves[-1]] if len(waves) > 2 else list(LINES)
    points = pupil()
    rows = []
    for w in waves:
        n = [float(np.ravel(s.material_post.n(w))[0]) for s in optic.surface_group.surfaces]
        spots = []
        for share in FIELDS:
            zero = np.zeros(len(points))
            r = optic.trace_generic(zero, zero + share, *points.T, w)
            spots.append(rms(np.stack([np.ravel(r.x), np.ravel(r.y)], axis=1)))
        focal, others = by_rayoptics(lens, n, w)
        rows.append(
            {"wavelength": w, "n": n, "focal_length": focal, "spots": spots, "rayoptics": others}
        )
    return rows


def describe(optic: Optic) -> dict:
    """Return surfaces, first-order data and ray intercepts on the image of one lens."""
    wavelength = float(optic.primary_wavelength)
    surfaces = []
    for s in optic.surface_group.surfaces:
        radius = float(s.geometry.radius)
        surfaces.append(
            {
                "curvature": 1 / radius if math.isfinite(radius) else 0.0,
                "conic": float(getattr(s.geometry, "k", 0.0) or 0.0),
                "z": float(np.ravel(s.geometry.cs.z)[0]),
                "n": float(np.ravel(s.material_post.n(wavelength))[0]),
                "stop": bool(s.is_stop),
                "mirror": bool(s.interaction_model.is_reflective),
                "kind": type(s.geometry).__name__,
            }
        )
    p = optic.paraxial
    rays = []
    for ray in RAYS:
        r = optic.trace_generic(0.0, *ray, wavelength)
        rays.append([*ray, float(np.ravel(r.x)[0]), float(np.ravel(r.y)[0])])
    tangential, sagittal = FieldCurvature(optic, [wavelength], FOCI).data[0]
    # so far that the spot of the outermost field has lost some contrast
    outer = np.array([r[4:] for r in rays if r[0] == 1.0])
    top = 0.3 / max(float(outer.std(axis=0).max()), 1e-3)
    mtf = GeometricMTF(
        optic, [(0, 0), (0, 1)], wavelength, 200, "uniform", FREQUENCIES, top, scale=False
    )
    mtf.num_points = 2000  # bins of its histogram, which would blur
    curves, _ = mtf._generate_mtf_data()
    return {
        "foci": [np.ravel(tangential).tolist(), np.ravel(sagittal).tolist()],
        "frequencies": np.ravel(mtf.freq).tolist(),
        "mtf": np.array(curves).reshape(2, 2, -1).tolist(),
        "wavelength": wavelength,
        "surfaces": surfaces,
        "aperture": [optic.aperture.ap_type, float(optic.aperture.value)],
        "field": float(optic.fields.max_field),
        "focal_length": float(p.f2()),
        "entrance_pupil": float(p.EPL()),
        "entrance_diameter": float(p.EPD()),
        "exit_pupil": float(p.XPL()),
        "exit_diameter": float(p.XPD()),
        "rays": rays,
    }


def main() -> None:
    """Write the file beside this script."""
    lenses = {}
    for module in (objectives, simple, telescopes):
        for name, kind in inspect.getmembers(module, inspect.isclass):
            if not issubclass(kind, Optic) or kind is Optic:
                continue
            lens = describe(kind())
            # even aspheres are left to our own tests: Optiland's first order leaves r^2 out.
            # Fields beyond 45 degrees are aimed by Optiland at the real pupil; curved images differ
            plain = all(s["kind"] in ("StandardGeometry", "Plane") for s in lens["surfaces"])
            flat = lens["surfaces"][-1]["curvature"] == 0
            if plain and flat and lens["field"] < 45:
                lenses[name] = lens | {"spectrum": spectrum(kind(), lens)}
    report = {"optiland": version("optiland"), "lenses": lenses}
    Path(__file__).with_name("optiland.json").write_text(json.dumps(report, indent=0))


if __name__ == "__main__":
    main()
