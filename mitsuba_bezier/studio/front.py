"""What stands before the picture: legs, curves, schemes, Farin points, the point S."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from ..errors import BezierError
from ..geometry import bernstein
from ..geometry.collineations import central_projection
from ..geometry.curves import BezierCurve
from ..geometry.four_sided import boundary_curve
from ..geometry.isoparametric import boundary_curve_of
from ..geometry.projective import is_ideal
from ..geometry.quadric_patches import QuadricTriangle, characterize
from .state import State

__all__ = ["Front", "front_of"]

Colour = tuple[int, int, int]

INK, LEGS, SCHEME, TANGENT, REST = (20, 20, 24), (96, 96, 104), (24, 90, 170), (200, 60, 20), (
    130, 100, 160,
)  # fmt: skip
FARIN = (30, 150, 70)

#: The eye and the wall of the figure `curve_projection`.
EYE, WALL = np.array([0, -2.8, 2.7, 1.0]), np.array([0, 1.0, 0, -1.6])

#: Places on a curve that are joined by chords, and how far it is followed, in sizes of the net.
PARTS, REACH = 96, 40.0

#: How near boundary conics must come to S to meet there: a white net's rounding is 1e-12.
MEETS = 1e-6


@dataclass
class Front:
    """Lines by name: polylines ``(N, 3)``, colour and width; marks; a sentence."""

    lines: dict[str, tuple[list[np.ndarray], Colour, float]] = field(default_factory=dict)
    marks: dict[str, tuple[np.ndarray, Colour]] = field(default_factory=dict)
    says: str = ""
    #: names of what is no control point, and where they are written
    notes: list[tuple[str, np.ndarray]] = field(default_factory=list)

    def draw(self, name: str, pieces: list[np.ndarray], colour: Colour, width: float) -> None:
        """Add polylines."""
        parts = [x for x in pieces if len(x) > 1]
        if parts:
            self.lines[name] = parts, colour, width

    def segments(self, name: str) -> np.ndarray:
        """Return the segments of a line, ``(N, 2, 3)``."""
        parts = [np.stack([x[:-1], x[1:]], axis=1) for x in self.lines[name][0]]
        return np.concatenate(parts).astype(np.float32)

    def mark(self, name: str, x: np.ndarray, colour: Colour) -> None:
        """Add points ``(N, 3)``, or homogeneous ones, of which the finite are shown."""
        if x.shape[1] == 4:
            used = x[x.any(axis=1)]
            finite = used[~is_ideal(used)] if len(used) else used
            x = finite[:, :3] / finite[:, 3:]
        if len(x):
            self.marks[name] = x, colour


def followed(curve: BezierCurve, centre: np.ndarray, reach: float) -> list[np.ndarray]:
    """Return polylines along a curve; where it goes to infinity it is cut."""
    t = np.linspace(0, 1, PARTS + 1)
    h = curve.evaluate(t)
    size = np.abs(h).max(axis=1)
    good = np.abs(h[:, 3]) > 1e-9 * np.maximum(size, 1e-300)
    x = h[:, :3] / np.where(good, h[:, 3], 1.0)[:, None]
    good &= np.linalg.norm(x - centre, axis=1) < reach
    breaks = ~good[:-1] | ~good[1:] | (np.sign(h[:-1, 3]) != np.sign(h[1:, 3]))
    out, first = [], 0
    for end in [*np.flatnonzero(breaks).tolist(), len(t) - 1]:
        piece = x[first : end + 1][good[first : end + 1]]
        if len(piece) > 1:
            out.append(piece)
        first = end + 1
    return out


def _rest(curve: BezierCurve) -> BezierCurve | None:
    """Return the rest of a conic, of which a quadratic curve is an arc."""
    return BezierCurve(curve.control_points * [[1], [-1], [1]]) if curve.degree == 2 else None


def front_of(
    state: State, shows: tuple[str, ...] = (), t: float = 0.4, uv: tuple[float, float] = (0.3, 0.3)
) -> Front:
    """Return what stands before the picture.

    Parameters
    ----------
    state : State
    shows : tuple of str
        As of `Preset`.
    t, uv : float, pair of float
        Where the scheme of a curve, and of a triangle, is drawn.
    """
    out = Front()
    x = state.places
    centre = x.mean(axis=0)
    size = float(np.ptp(x, axis=0).max()) or 1.0
    reach = REACH * size
    legs = []
    for a, b in state.legs():
        vector = state.is_vector(a), state.is_vector(b)
        if not any(vector):
            legs.append(x[[a, b]])
        elif not all(vector):
            start, way = (b, a) if vector[0] else (a, b)
            direction = x[way] - state.anchor
            legs.append(np.stack([x[start], x[start] + reach * direction / _norm(direction)]))
    arrows = [np.stack([state.anchor, x[k]]) for k in range(len(x)) if state.is_vector(k)]
    out.draw("legs", legs, LEGS, 2.0)
    out.draw("vectors", arrows, TANGENT, 3.0)
    if state.curve:
        _curve(out, state, shows, t, centre, reach)
    else:
        _triangle(out, state, shows, uv, centre, reach)
    return out


def _norm(v: np.ndarray) -> float:
    return float(np.linalg.norm(v)) or 1.0


def _curve(
    out: Front, state: State, shows: tuple[str, ...], t: float, centre: np.ndarray, reach: float
) -> None:
    curve = BezierCurve(state.net)
    out.draw("curve", followed(curve, centre, reach), INK, 5.0)
    rest = _rest(curve)
    if "conics" in shows and rest is not None:
        out.draw("rest", followed(rest, centre, reach), REST, 1.6)
        w = state.net[:, 3]
        # the discriminant of the weight: the conic's points at infinity
        ratio = w[1] ** 2 - w[0] * w[2]
        near = 1e-9 * (w**2).max()
        if w[1] == 0:
            kind = "line"
        else:
            kind = "parabola" if abs(ratio) <= near else "hyperbola" if ratio > 0 else "ellipse"
        out.says = f"The conic is {'an' if kind == 'ellipse' else 'a'} {kind}."
    if "scheme" in shows:
        scheme = curve.de_casteljau(t)
        last = len(scheme) - 2
        for r, level in enumerate(scheme[1:-1], 1):
            pieces = [p for a, b in pairwise(level) for p in _straight(a, b, centre, reach)]
            out.draw(f"scheme{r}", pieces, TANGENT if r == last else SCHEME, 2.5)
            out.mark(f"scheme{r}", level, SCHEME)
        out.mark("at", scheme[-1], TANGENT)
    if "farin" in shows:
        legs = state.net[:-1], state.net[1:]
        if all(a.any() and b.any() and (a + b).any() for a, b in zip(*legs)):
            out.mark("farin", curve.farin_points(), FARIN)
    if "plane" in shows and state.degree > 1:
        level = curve.de_casteljau(t)[-3]
        if not is_ideal(level).any():
            a, b, c = level[:, :3] / level[:, 3:]
            middle, u = (a + b + c) / 3, (c - a) / _norm(c - a)
            v = (b - a) - ((b - a) @ u) * u
            v /= _norm(v)
            s = 0.25 * reach / REACH
            square = [middle + s * (i * u + j * v) for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
            out.draw("plane", [np.array([*square, square[0]])], REST, 2.0)
    if "projection" in shows:
        try:
            image = curve.project(central_projection(EYE, WALL))
        except BezierError:
            return  # a control point in the eye
        net = image.control_points
        out.draw("image", followed(image, centre, reach), TANGENT, 4.0)
        rays = [np.stack([EYE[:3], p[:3] / p[3]]) for p in net if p.any() and not is_ideal(p)]
        out.draw("rays", rays, REST, 1.2)
        polygon = [p for a, b in pairwise(net) for p in _straight(a, b, centre, reach)]
        out.draw("image legs", polygon, LEGS, 1.6)
        out.mark("image", net, TANGENT)
        out.mark("eye", EYE[None], INK)
        out.notes.append(("S", EYE[:3]))
        y = -WALL[3] / WALL[1]
        wall = np.array([[-4, y, -2], [4, y, -2], [4, y, 3], [-4, y, 3], [-4, y, -2.0]])
        out.draw("wall", [wall], LEGS, 1.2)
        w = image.weights / (image.weights[0] or 1.0)
        out.says = "Weights of the images: " + ", ".join(f"{v:.2f}" for v in w) + "."


def _straight(a: np.ndarray, b: np.ndarray, centre: np.ndarray, reach: float) -> list[np.ndarray]:
    """Return the leg between two points, which may be at infinity."""
    if not (a.any() and b.any()):
        return []
    return followed(BezierCurve([a, b]), centre, reach)


def _triangle(
    out: Front,
    state: State,
    shows: tuple[str, ...],
    uv: tuple[float, float],
    centre: np.ndarray,
    reach: float,
) -> None:
    patches = state.patches
    edges = [boundary_curve_of(patches, 0, edge) for edge in range(3)]
    pieces = [p for c in edges if c is not None for p in followed(c, centre, reach)]
    out.draw("boundary", pieces, INK, 3.0)
    if "scheme" in shows:
        scheme = patches.de_casteljau(0, uv)
        for r, level in enumerate(scheme[1:-1], 1):
            n = bernstein.degree_of(len(level))
            last = r == len(scheme) - 2
            pieces = []
            for rows in bernstein.net_triangles(n).tolist():
                for a, b in zip(rows, rows[1:] + rows[:1]):
                    pieces += _straight(level[a], level[b], centre, reach)
            out.draw(f"scheme{r}", pieces, TANGENT if last else SCHEME, 2.5)
            out.mark(f"scheme{r}", level, SCHEME)
        out.mark("at", scheme[-1], TANGENT)
    if "conics" in shows and state.degree == 2:
        found = _characterised(state)
        if found is None:
            return
        meets = found.meeting is not None and found.meeting < MEETS
        pieces = []
        for edge in range(3):
            rest = _rest(boundary_curve(state.net, edge))
            pieces += followed(rest, centre, reach) if rest is not None else []
        out.draw("rest", pieces, REST, 1.6)
        s = found.center
        if meets and s is not None and not is_ideal(s):
            out.mark("S", s[None], TANGENT)
            out.notes.append(("S", s[:3] / s[3]))
            _tangents(out, state, s, 0.3 * reach / REACH)
        out.says = _verdict(found, meets)


def _characterised(state: State) -> QuadricTriangle | None:
    try:
        return characterize(state.net)
    except BezierError:
        return None


def _verdict(found: QuadricTriangle, meets: bool) -> str:
    if found.name is not None:
        where = ""
        if meets and found.center is not None:
            s = found.center
            where = (
                "; S is an ideal point"
                if is_ideal(s)
                else "; S = ({:.2f}, {:.2f}, {:.2f})".format(*(s[:3] / s[3]))
            )
        return f"It lies on a quadric: {found.name}{where}."
    if found.meeting is None:
        return "It lies on no quadric."
    return f"It lies on no quadric: the boundary conics miss one point by {found.meeting:.2g}."


def _tangents(out: Front, state: State, s: np.ndarray, size: float) -> None:
    """Draw the tangents of the boundary conics in S, which lie in one plane."""
    pieces = []
    for edge in range(3):
        b = boundary_curve(state.net, edge).control_points
        # S on the rest of the conic, by the ratio of its distances from the two end tangents
        frame = np.linalg.lstsq(b.T, s, rcond=None)[0]
        if abs(frame[1]) < 1e-12 or not np.isfinite(frame).all():
            continue
        t = frame[1] / (frame[1] + 2 * frame[0]) if frame[1] + 2 * frame[0] else np.inf
        p, q = _tangent_leg(b, t)
        way = q[:3] * p[3] - p[:3] * q[3]  # of the line from p to q
        way = size * way / _norm(way)
        pieces.append(np.stack([s[:3] / s[3] - way, s[:3] / s[3] + way]))
    out.draw("tangents", pieces, TANGENT, 2.5)


def _tangent_leg(b: np.ndarray, t: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the last leg of de Casteljau's scheme of a conic at any t, also infinite."""
    if not np.isfinite(t):
        return b[1] - b[0], b[2] - b[1]
    return (1 - t) * b[0] + t * b[1], (1 - t) * b[1] + t * b[2]
