"""Regions bounded by curves are covered once, exactly, by triangles that do not fold."""

from __future__ import annotations

import string

import numpy as np
import pytest

from mitsuba_bezier.errors import FileFormatError, GeometryError
from mitsuba_bezier.geometry import plane_fill
from mitsuba_bezier.geometry.bernstein import univariate
from mitsuba_bezier.geometry.plane_fill import fill_region, outline_area

K = 0.5522847498  # cubics close to a quarter of a circle


def ring(radius: float, x: float = 0.0, turn: int = 1) -> list[np.ndarray]:
    """A round outline of four cubics."""
    out = []
    for a in range(4):
        c, s = [(1, 0), (0, 1), (-1, 0), (0, -1)][a]
        p, t = np.array([c, s]), np.array([-s, c])
        out.append(radius * np.array([p, p + K * t, t + K * p, t]) + [x, 0])
    for k in range(4):  # closed to the last bit
        out[k][3] = out[(k + 1) % 4][0]
    return out if turn > 0 else [b[::-1] for b in out[::-1]]


def polygon(*points: tuple[float, float]) -> list[np.ndarray]:
    p = np.array(points, dtype=float)
    return [np.stack([a, b]) for a, b in zip(p, np.roll(p, -1, axis=0))]


STAR = polygon(*[
    ((1 if k % 2 else 0.4) * float(np.cos(k * np.pi / 5)),
     (1 if k % 2 else 0.4) * float(np.sin(k * np.pi / 5)))
    for k in range(10)
])  # fmt: skip
REGIONS = {
    "disk": [ring(1.0)],
    "clockwise": [ring(1.0, turn=-1)],
    "annulus": [ring(1.0), ring(0.6)],
    "thin": [ring(1.0), ring(0.97)],
    "island": [ring(1.0), ring(0.7, turn=-1), ring(0.3)],
    "two holes": [ring(2.0), ring(0.6, 1.0), ring(0.6, -1.0)],
    "beside": [ring(1.0), ring(1.0, 3.0), ring(0.4, 3.0)],
    "star": [STAR],
    "star in a disk": [ring(1.2), STAR],
    "lens": [[np.array([[0, 0], [1, 0.8], [2, 0.0]]), np.array([[2, 0], [1, -0.8], [0, 0.0]])]],
    "leaf": [[np.array([[0, 0], [1, 0.8], [2, 0.0]]), np.array([[2, 0], [1, 0.3], [0, 0.0]])]],
    "stem": [[  # a curve that ends along the side it meets, as in the letter n
        np.array([[0, 0], [0.3, 0]]), np.array([[0.3, 0], [0.3, 1.0]]),
        np.array([[0.3, 1.0], [0.3, 1.5], [0.8, 1.6]]), np.array([[0.8, 1.6], [0.8, 2.0]]),
        np.array([[0.8, 2.0], [0.0, 2.0]]), np.array([[0.0, 2.0], [0.0, 0.0]]),
    ]],
}  # fmt: skip


def inside(region: list[list[np.ndarray]], x: np.ndarray) -> np.ndarray:
    """Even-odd rule on fine polygons, an independent answer."""
    out = np.zeros(len(x), dtype=bool)
    t = np.linspace(0, 1, 400, endpoint=False)
    for contour in region:
        p = np.concatenate([univariate(len(b) - 1, t) @ b for b in contour])
        q = np.roll(p, -1, axis=0)
        for k in range(len(p)):
            crosses = (p[k, 1] > x[:, 1]) != (q[k, 1] > x[:, 1])
            if crosses.any():
                at = p[k, 0] + (x[:, 1] - p[k, 1]) * (q[k, 0] - p[k, 0]) / (q[k, 1] - p[k, 1])
                out ^= crosses & (x[:, 0] < at)
    return out


def covered(patches, x: np.ndarray) -> np.ndarray:
    """How many triangles of a fine tessellation hold each point."""
    v, f = patches.tessellate(24)
    count = np.zeros(len(x), dtype=int)
    for a, b, c in v[f][..., :2]:
        s = [(q[0] - p[0]) * (x[:, 1] - p[1]) - (q[1] - p[1]) * (x[:, 0] - p[0])
             for p, q in ((a, b), (b, c), (c, a))]  # fmt: skip
        count += (s[0] > 0) & (s[1] > 0) & (s[2] > 0)
    return count


@pytest.mark.parametrize("name", REGIONS)
def test_regions_are_covered_once(name):
    region = REGIONS[name]
    patches = fill_region(region)
    areas = np.abs(outline_area(region))
    depth = plane_fill._depths(plane_fill._contours(region))
    whole = sum(a * (-1) ** d for a, d in zip(areas, depth))
    assert abs(patches.area().sum() - whole) < 1e-8 * areas.sum()  # area() is good to 1e-10 a patch
    # no fold: normals up everywhere, by the Bernstein coefficients of the Jacobian
    n = patches.degree
    for net in patches.control_points[..., :2]:
        assert plane_fill._jacobian(net, n).min() > -1e-12
    rng = np.random.default_rng(1)
    x = rng.uniform(-2.2, 4.2, (400, 2))
    times = covered(patches, x)
    expected = inside(region, x)
    # points within a chord's distance of the outline may differ, a few of 400
    assert (times == expected).sum() >= 396
    assert times.max() <= 1


def test_the_outline_is_exact():
    """A disk by cubics is no circle, but its edge is the cubic itself, to rounding."""
    patches = fill_region([ring(1.0)])
    edge = []
    t = np.linspace(0, 1, 33)
    for net in patches.control_points:
        for rows in ((0, 1, 3, 6), (6, 7, 8, 9), (9, 5, 2, 0)):
            own = univariate(3, t) @ net[list(rows), :2]
            if np.linalg.norm(own, axis=1).min() > 0.99:
                edge.append(own)
    x = np.concatenate(edge)
    every = np.concatenate([univariate(3, np.linspace(0, 1, 4001)) @ b for b in ring(1.0)])
    near = [np.linalg.norm(every - p, axis=1).min() for p in x]
    assert len(edge) >= 4 and max(near) < 4e-4  # half a step of the fine curve


def test_letters():
    pytest.importorskip("fontTools", reason="fonts need the extra 'figures'")
    pytest.importorskip("matplotlib", reason="its font")
    from mitsuba_bezier.io.fonts import text_outlines

    for letter in string.ascii_letters + string.digits + "&@%ßéβ∞":
        contours, size = text_outlines(letter)
        patches = fill_region(contours)
        assert patches.degree in (1, 2) and size[0] > 0
        assert abs(size[1] - 0.729) < 0.01  # DejaVu's capitals


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: fill_region([]), "at least one"),
        (lambda: fill_region([[np.eye(2)]]), "a closed outline"),
        (lambda: fill_region([[np.eye(2), np.eye(2)]]), "a closed outline"),
        (lambda: fill_region([[np.zeros((5, 2))] * 2]), "degree 1 to 3"),
        (lambda: fill_region([[np.full((2, 2), np.nan)] * 2]), "degree 1 to 3"),
        (lambda: fill_region([polygon((0, 0), (1, 1), (1, 0), (0, 1))]), "that do not cross"),
        (lambda: fill_region([ring(1.0), ring(1.0, 1.0)]), "that do not cross"),
    ],
)
def test_bad_regions(call, says):
    with pytest.raises(GeometryError) as caught:
        call()
    assert says in str(caught.value)


def test_bad_text(tmp_path):
    pytest.importorskip("fontTools", reason="fonts need the extra 'figures'")
    pytest.importorskip("matplotlib", reason="its font")
    from mitsuba_bezier.io.fonts import text_outlines

    for text in ("", "  ", None):
        with pytest.raises(GeometryError, match="text: expected characters"):
            text_outlines(text)
    with pytest.raises(GeometryError) as caught:
        text_outlines("a\U0001f980")
    assert "U+1F980" in str(caught.value) and "DejaVuSans.ttf" in str(caught.value)
    path = tmp_path / "font.ttf"
    path.write_bytes(b"no font at all")
    for bad in (path, tmp_path / "missing.ttf"):
        with pytest.raises(FileFormatError, match="font: expected a font"):
            text_outlines("a", bad)
