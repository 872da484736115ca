"""Surfaces of a lens as exact Bézier triangles or aspheres, and a lens as shapes of a scene."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import GeometryError, PrescriptionError
from ..geometry.aspheres import EvenAsphere
from ..geometry.revolution import band, cap, disk_sectors
from ..geometry.triangles import BezierTriangles
from .beams import used_semi_diameters
from .checks import check_body, placement
from .coatings import coating as films
from .glass import absorbing, spelled
from .iris import check_blades, stop_patches
from .lens import Lens, Surface

#: Reflectance of black paint and anodised metal.
BLACK = 0.02

#: Clear radii that a prescription leaves out are this much wider than its beams.
_ROOM = 1.05


def surface_patches(surface: Surface, semi_diameter: float | None = None) -> BezierTriangles:
    """Return a surface inside its clear aperture as patches, in its own frame.

    A plane is a disk in three sectors; a conic of revolution is a quadric, and three patches are
    the cap that the aperture's circle cuts off. Normals are on the side of negative z, from where
    light comes.

    Parameters
    ----------
    surface : Surface
        A plane or a conic.
    semi_diameter : float, optional
        Radius of the aperture; the surface's own by default.

    Returns
    -------
    BezierTriangles
        Of degree 2.

    Raises
    ------
    PrescriptionError
        If the surface is an asphere with a polynomial, or the radius is not finite or beyond the
        conic.

    Examples
    --------
    >>> from mitsuba_bezier.optics import Surface, surface_patches
    >>> len(surface_patches(Surface(1 / 50, semi_diameter=10)))
    3
    """
    r = surface.semi_diameter if semi_diameter is None else semi_diameter
    if not surface.is_conic:
        raise PrescriptionError(
            "surface: expected a plane or a conic, which are exact as patches, got an even asphere "
            "(surface_shape has it)"
        )
    if not 0 < r < np.inf:
        raise PrescriptionError(f"semi_diameter: expected a finite positive number, got {r}")
    if not r < surface.reach():
        raise PrescriptionError(
            f"semi_diameter: expected less than {surface.reach():.6g}, where the conic turns back, "
            f"got {r:.6g}"
        )
    c, k = surface.curvature, surface.conic
    if not c:
        return BezierTriangles(np.array(disk_sectors(r, 0.0, up=False)))
    # c (x^2 + y^2 + (1 + k) z^2) - 2 z, whose gradient at the vertex is along -z
    quadric = np.diag([c, c, c * (1 + k), 0.0])
    quadric[2, 3] = quadric[3, 2] = -1.0
    return BezierTriangles(np.array(cap(quadric, r, float(surface.sag(r)))))


def surface_shape(
    surface: Surface, semi_diameter: float | None = None, to_world: np.ndarray | None = None
) -> dict[str, Any]:
    """Return a surface inside its clear aperture as a shape for `mi.load_dict`.

    Planes and conics are the patches of `surface_patches`, even aspheres the shape ``asphere``.
    Normals are on the side of negative z.

    Parameters
    ----------
    surface : Surface
        Any.
    semi_diameter : float, optional
        Radius of the aperture; the surface's own by default.
    to_world : (4, 4) array, optional
        Affine map of the surface's frame to the scene.

    Raises
    ------
    PrescriptionError
        If the radius is not finite or beyond the conic.

    Examples
    --------
    >>> from mitsuba_bezier.optics import Surface, surface_shape
    >>> surface_shape(Surface(1 / 50, semi_diameter=10, coefficients=(0, 1e-6)))["type"]
    'asphere'
    """
    frame = placement(to_world)
    if surface.is_conic:
        net = surface_patches(surface, semi_diameter).transform(frame)
        return {"type": "beziertriangle", "control_points": net}
    r = surface.semi_diameter if semi_diameter is None else semi_diameter
    try:
        EvenAsphere(surface.curvature, r, surface.conic, surface.coefficients)
    except GeometryError as error:
        raise PrescriptionError(str(error).replace("aperture:", "semi_diameter:", 1)) from None
    return {
        "type": "asphere",
        "curvature": surface.curvature,
        "conic": surface.conic,
        # as text, which keeps all digits
        "coefficients": " ".join(repr(float(a)) for a in surface.coefficients),
        "aperture": float(r),
        "flip_normals": True,
        "to_world": frame,
    }


def rim_patches(low: tuple[float, float], high: tuple[float, float]) -> BezierTriangles:
    """Return the edge of an element between two circles ``(radius, z)``: a cylinder or a cone.

    Normals point away from the axis.
    """
    (r0, z0), (r1, z1) = low, high
    if r0 == r1:
        quadric = np.diag([1.0, 1.0, 0.0, -r0 * r0])
    else:  # x^2 + y^2 = (r0 + s (z - z0))^2
        s = (r1 - r0) / (z1 - z0)
        at = r0 - s * z0
        quadric = np.diag([1.0, 1.0, -s * s, -at * at])
        quadric[2, 3] = quadric[3, 2] = -s * at
    return BezierTriangles(np.array(band(quadric, low, high)))


def annulus_patches(inner: float, outer: float) -> BezierTriangles:
    """Return a flat ring around the axis in the plane z = 0: a stop. Normals are along -z."""
    return stop_patches(inner, outer)


def clear_radii(lens: Lens) -> np.ndarray:
    """Return the radii ``(S,)`` of the surfaces: given ones, else somewhat more than the beams'."""
    given = np.array([s.semi_diameter for s in lens.surfaces])
    if np.isfinite(given).all():
        return given
    reach = np.array([s.reach() for s in lens.surfaces])
    return np.where(
        np.isfinite(given), given, np.minimum(_ROOM * used_semi_diameters(lens), 0.999 * reach)
    )


def black_paint() -> dict[str, Any]:
    """Return the BSDF of what makers blacken: edges, the plate of the stop, the barrel."""
    black = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [BLACK] * 3}}
    return {"type": "twosided", "b": black}


def lens_shapes(
    lens: Lens,
    wavelength: float | None = None,
    to_world: np.ndarray | None = None,
    edges: bool = True,
    stop: bool = True,
    dispersion: bool = False,
    coating: str = "none",
    blades: int = 0,
    blade_rotation: float = 0.0,
    absorption: bool = False,
) -> dict[str, dict[str, Any]]:
    """Return the shapes of a lens for a scene dictionary.

    Every surface stands once, as the border of the media on both sides, so that cemented ones
    have no gap. Edges of elements are matt black, as makers paint them.

    Parameters
    ----------
    lens : Lens
        Of planes, conics and even aspheres.
    wavelength : float, optional
        In micrometres, for the indices of the dielectrics; the reference wavelength by default.
    to_world : (4, 4) array, optional
        Rigid map from the lens to the scene.
    edges, stop : bool
        Whether the edges of elements, and the plate of the stop, are there.
    dispersion : bool
        Whether glass is `dispersive`, and not a dielectric of one index.
    coating : str
        Thin films on the surfaces that meet air, see `coating`; they need `dispersive` glass.
    blades, blade_rotation : int, float
        A polygonal iris whose corners lie on the round stop, as those of the sensor ``lens``.
    absorption : bool
        Whether glass absorbs as its catalogue says; that takes the integrator ``beziervolpath``.

    Returns
    -------
    dict
        ``surface-1``, ``edge-1``, ``stop``, ... to dictionaries that `mi.load_dict` takes.

    Raises
    ------
    PrescriptionError
        If a surface is no graph inside its aperture, its size is unknown, or neighbours cross.

    Examples
    --------
    >>> from mitsuba_bezier.optics import Abbe, Lens, Surface, lens_shapes
    >>> front = Surface(1 / 50, 4, Abbe(1.5168, 64.17), semi_diameter=10)
    >>> sorted(lens_shapes(Lens([front, Surface(-1 / 50, 47, semi_diameter=10)])))
    ['edge-1', 'surface-1', 'surface-2']
    """
    w = lens.wavelengths[lens.reference] if wavelength is None else wavelength
    world = placement(to_world)
    films(coating)  # an error, if there are no such films
    check_blades(blades, blade_rotation)
    if blades and not any(s.stop for s in lens.surfaces):
        raise PrescriptionError("stop: expected a surface that has the blades, got none")
    n, radii, media = lens.indices(w), clear_radii(lens), lens.media()
    frames, directions = world @ lens.frames(), lens.directions()
    # scene units in a millimetre
    unit = float(np.cbrt(abs(np.linalg.det(world[:3, :3])))) / lens.millimetres
    check_body(lens)
    shapes: dict[str, dict[str, Any]] = {}

    def add(name: str, net: BezierTriangles, frame: np.ndarray, bsdf: dict[str, Any]) -> None:
        shapes[name] = {
            "type": "beziertriangle",
            "control_points": net.transform(frame),
            "bsdf": bsdf,
        }

    def add_surface(i: int, bsdf: dict[str, Any]) -> None:
        shape = surface_shape(lens.surfaces[i], radii[i], frames[i])
        shapes[f"surface-{i + 1}"] = {**shape, "bsdf": bsdf}
        if absorption and not lens.surfaces[i].mirror:
            sides = (media[i], media[i + 1])
            # normals are on the side of the surface's negative z
            for name, medium in zip(("exterior", "interior"), sides[:: int(directions[i])]):
                fog = absorbing(medium, unit)
                if any(fog["sigma_t"]["value"]):
                    shapes[f"surface-{i + 1}"][name] = fog

    for i, s in enumerate(lens.surfaces):
        try:
            if s.mirror:
                # its back takes no light
                add_surface(i, _mirror())
            elif n[i] != n[i + 1]:
                # light may come from the other side
                sides = (i, i + 1) if lens.directions()[i] > 0 else (i + 1, i)
                outer, inner = (media[k] for k in sides)
                bsdf = {"type": "dielectric", "int_ior": n[sides[1]], "ext_ior": n[sides[0]]}
                if dispersion or coating != "none":
                    layers = coating if min(n[i], n[i + 1]) < 1.01 else "none"
                    bsdf = {"type": "dispersive", "material": spelled(inner)}
                    bsdf |= {"exterior": spelled(outer), "coating": layers}
                    if not dispersion:
                        bsdf |= {"material": f"{n[sides[1]]:.9f}", "exterior": f"{n[sides[0]]:.9f}"}
                add_surface(i, bsdf)
        except PrescriptionError as error:
            raise PrescriptionError(f"surface {i + 1}: {error}") from None
        if stop and s.stop and not s.mirror and n[i] == n[i + 1]:
            outer = max(1.5 * radii[i], radii[max(i - 1, 0)], radii[min(i + 1, len(radii) - 1)])
            add(
                "stop",
                stop_patches(radii[i], outer, blades, blade_rotation),
                frames[i],
                black_paint(),
            )
        if (
            edges
            and i + 1 < len(lens.surfaces)
            and n[i + 1] > max(n[0], 1.0) + 1e-6
            and not s.mirror
        ):
            low = (radii[i], float(s.sag(radii[i])))
            back = lens.surfaces[i + 1]
            high = (radii[i + 1], s.thickness + float(back.sag(radii[i + 1])))
            if high[1] - low[1] > 1e-9 * abs(radii[i]):
                add(
                    f"edge-{i + 1}",
                    rim_patches(low, high),
                    frames[i],
                    black_paint(),
                )
    return shapes


def _mirror() -> dict[str, Any]:
    return {"type": "twosided", "b": {"type": "conductor", "material": "none"}}
