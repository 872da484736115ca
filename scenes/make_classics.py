"""Write the Utah teapot, teacup and teaspoon: ``python scenes/make_classics.py``.

The bicubic patches are in ``newell_teaset.txt``, with their origin; each becomes two Bézier
triangles of degree 6. The z axis points up, normals point outward; the pot and the cup stand on
the plane z = 0.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mitsuba_bezier.geometry.tensor import tensor_to_triangles
from mitsuba_bezier.geometry.triangles import BezierTriangles
from mitsuba_bezier.io import save

__all__ = ["FOLDER", "bicubics", "main", "models"]

FOLDER = Path(__file__).resolve().parent / "models"
DATA = Path(__file__).resolve().parent / "newell_teaset.txt"

QUARTER = np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]])


def bicubics() -> dict[str, np.ndarray]:
    """Return the bicubic patches ``(P, 4, 4, 3)`` of the models by their names."""
    lines = [line.split() for line in DATA.read_text().splitlines()]
    lines = [words for words in lines if words and not words[0].startswith("#")]
    out = {}
    while lines:
        name, vertices, _vertices, patches, _patches = lines.pop(0)
        points = np.array([lines.pop(0) for _ in range(int(vertices))], float)
        nets = []
        for _ in range(int(patches)):
            times, *index = map(int, lines.pop(0))
            # rows and columns exchanged: then normals point outward
            net = points[index].reshape(4, 4, 3).swapaxes(0, 1)
            if times == 2:  # mirrored, and turned round to keep the side
                nets += [net, (net * [1, -1, 1])[:, ::-1]]
            else:
                for _turn in range(times):
                    nets.append(net)
                    net = net @ QUARTER
        out[name] = np.array(nets)
    return out


def models() -> dict[str, BezierTriangles]:
    """Return the models by the name of their file, without suffix."""
    out = {}
    for name, nets in bicubics().items():
        tensor = np.concatenate([nets, np.ones((*nets.shape[:3], 1))], axis=-1)
        net = tensor_to_triangles(tensor).control_points.copy()
        net[..., 3] = 1.0  # polynomial, without the rounding of a sum of shares
        out[name] = BezierTriangles(net)
    return out


def main() -> None:
    """Write all models."""
    for name, model in models().items():
        path = FOLDER / f"{name}.vtu"
        save(model, path)
        print(f"{path.name}: {len(model)} patches, {path.stat().st_size} bytes")


if __name__ == "__main__":
    main()
