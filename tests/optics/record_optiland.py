"""Record what Optiland says of its own sample lenses: ``python tests/optics/record_optiland.py``.

The tests compare with the file that this writes, so that they need no Optiland. Run it in an
environment with ``optiland`` (0.6.3 made the file) to make it anew.
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

#: Height of the field (share of the largest) and place in the pupil.
#: Fields at which foci are recorded, from the axis on, and frequencies of the modulation.
FOCI, FREQUENCIES = 5, 4
RAYS = [(h, *p) for h in (0, 0.7, 1.0) for p in ((0, 0), (0, 1), (0.5, -0.5), (-0.9, 0.1))]


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
                lenses[name] = lens
    report = {"optiland": version("optiland"), "lenses": lenses}
    Path(__file__).with_name("optiland.json").write_text(json.dumps(report, indent=0))


if __name__ == "__main__":
    main()
