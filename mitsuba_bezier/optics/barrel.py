"""The black tube around a lens, and where a camera's lens stands in its scene."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from ..errors import PrescriptionError
from ..geometry.revolution import disk_sectors
from ..geometry.triangles import BezierTriangles
from .checks import check_body, placement
from .lens import Lens
from .paraxial import first_order
from .patches import black_paint, clear_radii, rim_patches


def camera_frame(lens: Lens, to_world: np.ndarray | None = None, scale: float = 1e-3) -> np.ndarray:
    """Return the map ``(4, 4)`` from a lens to the scene of a sensor ``lens`` with its glass there.

    Parameters
    ----------
    lens : Lens
        As the sensor has it: focused and stopped down.
    to_world : (4, 4) array, optional
        The sensor's.
    scale : float
        Scene units in a unit of the lens, as the sensor has it.

    Examples
    --------
    >>> from mitsuba_bezier.optics import Constant, Lens, Surface, camera_frame
    >>> lens = Lens([Surface(1 / 50, 4, Constant(1.5), 10, stop=True), Surface(-1 / 50, 47)])
    >>> (camera_frame(lens) @ [0, 0, 4, 1]).tolist()  # towards the film is against the camera's z
    [0.0, 0.0, -0.004, 1.0]
    """
    world = placement(to_world)
    if not 0 < scale < np.inf:
        raise PrescriptionError.expected("scale", "a positive number", scale)
    frame = np.diag([-scale, scale, -scale, 1.0])
    frame[2, 3] = scale * first_order(lens).entrance_pupil
    return world @ frame


def barrel_shapes(
    lens: Lens, film_radius: float, to_world: np.ndarray | None = None
) -> dict[str, dict[str, Any]]:
    """Return the black walls between the elements, around the film, and behind it.

    With `lens_shapes` this is a whole camera: light comes in through the glass alone.

    Parameters
    ----------
    lens : Lens
        Whose surfaces have one axis, and whose last thickness reaches the film.
    film_radius : float
        Half of the film's diagonal.
    to_world : (4, 4) array, optional
        Map from the lens to the scene.

    Returns
    -------
    dict
        ``barrel-1``, ..., ``barrel-film``, ``barrel-back`` to dictionaries for `mi.load_dict`.

    Raises
    ------
    PrescriptionError
        If surfaces are tilted, or the film is not behind the lens.

    Examples
    --------
    >>> from mitsuba_bezier.optics import Constant, Lens, Surface, barrel_shapes
    >>> lens = Lens([Surface(1 / 50, 4, Constant(1.5), 10, stop=True), Surface(-1 / 50, 47)])
    >>> sorted(barrel_shapes(lens, film_radius=5))
    ['barrel-back', 'barrel-film']
    """
    for i, s in enumerate(lens.surfaces, start=1):
        if s.mirror or not (np.allclose(s.before, np.eye(4)) and np.allclose(s.after, np.eye(4))):
            raise PrescriptionError(
                f"surface {i}: expected refracting surfaces on one axis, got a mirror or a tilt"
            )
    if not (0 < film_radius < np.inf and lens.surfaces[-1].thickness > 0):
        raise PrescriptionError.expected(
            "film_radius", "a positive number, and a film behind the lens", film_radius
        )
    world = placement(to_world)
    check_body(lens)
    radii, media = clear_radii(lens), lens.media()
    vertices = lens.frames()[:, 2, 3]
    glass = [i for i in range(len(lens.surfaces)) if media[i] != media[i + 1]]
    if not glass:
        raise PrescriptionError.expected("lens", "surfaces of glass", "none")
    rims = {i: (radii[i], vertices[i] + float(lens.surfaces[i].sag(radii[i]))) for i in glass}
    shapes: dict[str, dict[str, Any]] = {}

    def add(name: str, net: BezierTriangles) -> None:
        shapes[name] = {
            "type": "beziertriangle",
            "control_points": net.transform(world),
            "bsdf": black_paint(),
        }

    for i, j in pairwise(glass):
        inside = float(lens.indices(lens.wavelengths[lens.reference])[i + 1]) > 1.01
        (r0, z0), (r1, z1) = rims[i], rims[j]
        if not inside and (abs(z1 - z0) > 1e-9 * r0):
            add(f"barrel-{i + 1}", rim_patches((r0, z0), (r1, z1)))
    film = vertices[-1]
    wide = max(1.02 * film_radius, rims[glass[-1]][0] * 1.001)
    # a hair behind the film, on which rays start
    behind = film + 1e-3 * film_radius
    add("barrel-film", rim_patches(rims[glass[-1]], (wide, behind)))
    add("barrel-back", BezierTriangles(np.array(disk_sectors(wide, behind, up=False))))
    return shapes
