"""Write `models/twisted_block.vtu`: what a finite element program might give out.

Sixteen Lagrange hexahedra of order 3, with a temperature and a displacement at their nodes and a
material on each: ``python scenes/make_block.py``. The picture is made by

    mitsuba-bezier render scenes/models/twisted_block.vtu --color-by temperature --levels 12
        --isolines --edges --size 1360x900 --spp 512 -o field.exr
"""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np

from mitsuba_bezier.io.vtk.cell_types import hexahedron_lattice

ORDER = 3
CELLS = (4, 2, 2)


def array(name: str, values: np.ndarray, kind: str = "Float64", inside: str = "") -> str:
    """Return a DataArray."""
    rows = values.reshape(len(values), -1)
    lines = "\n".join(" ".join(f"{x:.9g}" for x in row) for row in rows.tolist())
    head = f'type="{kind}" Name="{name}" NumberOfComponents="{rows.shape[1]}" format="ascii"'
    return f"<DataArray {head}>\n{lines}\n{inside}</DataArray>"


def main() -> None:
    """Write the file."""
    lattice = hexahedron_lattice(ORDER, ORDER, ORDER)
    corners = ORDER * np.array(list(product(*map(range, CELLS))))
    places = corners[:, None] + lattice
    points, nodes = np.unique(places.reshape(-1, 3), axis=0, return_inverse=True)
    x, y, z = (points / ORDER - np.array(CELLS) / 2).T
    c, s = np.cos(0.35 * x), np.sin(0.35 * x)
    bent = np.stack([1.1 * x, y * c - z * s, y * s + z * c + 0.15 * np.sin(1.3 * x)], axis=1)
    temperature = 300 + 40 * np.sin(1.6 * x + 0.5) * np.cos(1.2 * y) + 25 * z
    displacement = np.stack([0 * x, 0.1 * np.sin(x), 0.3 * np.cos(0.8 * x)], axis=1)
    count, size = len(corners), len(lattice)
    key = '<InformationKey name="UNITS_LABEL" location="vtkDataArray">{}</InformationKey>\n'
    text = "\n".join(
        [
            '<VTKFile type="UnstructuredGrid" version="2.3" byte_order="LittleEndian">',
            "<UnstructuredGrid>",
            f'<Piece NumberOfPoints="{len(points)}" NumberOfCells="{count}">',
            "<PointData>",
            array("temperature", temperature, inside=key.format("K")),
            array("displacement", displacement, inside=key.format("m")),
            "</PointData>",
            "<CellData>",
            array("material", np.arange(count) % 3, "Int64"),
            "</CellData>",
            "<Points>",
            array("Points", bent),
            "</Points>",
            "<Cells>",
            array("connectivity", nodes.reshape(-1), "Int64"),
            array("offsets", size * np.arange(1, count + 1), "Int64"),
            array("types", np.full(count, 72), "UInt8"),
            "</Cells>",
            "</Piece>",
            "</UnstructuredGrid>",
            "</VTKFile>\n",
        ]
    )
    folder = Path(__file__).resolve().parent / "models"
    (folder / "twisted_block.vtu").write_text(text)


if __name__ == "__main__":
    main()
