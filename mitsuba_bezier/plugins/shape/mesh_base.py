"""The base of `beziertriangle`: a mesh of Mitsuba's, of which nothing is met but the box.

Python can derive a shape in Mitsuba 3.9 only from `mi.Mesh`. All use of its interface, which 3.10
changes, is here (docs/mitsuba-3.10.md).
"""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np

__all__ = ["make_mesh_base"]

_INF = np.float32(np.inf)


def make_mesh_base() -> type:
    """Return the class for the variant that is set now."""

    class MeshBase(mi.Mesh):
        """A mesh without triangles that can be met, whose parameters are a derived class's."""

        def __init__(self, props: mi.Properties) -> None:
            self._plain_mesh = True  # to Mitsuba, which looks at it meanwhile
            super().__init__(props)
            self._plain_mesh = False

        def _keep_apart(self) -> None:
            """Keep Mitsuba's loader from merging shapes that share a BSDF into one plain mesh."""
            mi.Mesh.add_attribute(self, "face_bezier", 1, [0.0])

        def _set_box(self, box: np.ndarray) -> None:
            """Give the mesh the corners of the box, so that the scene's is right.

            All faces are degenerate: Embree and OptiX never hit them. Texture coordinates are set
            since without them a textured emitter is an error as soon as Dr.Jit records a call of
            any emitter, even one that is masked.
            """
            rounded = box.astype(np.float32)  # outwards: the surface is inside
            rounded[0] = np.where(rounded[0] > box[0], np.nextafter(rounded[0], -_INF), rounded[0])
            rounded[1] = np.where(rounded[1] < box[1], np.nextafter(rounded[1], _INF), rounded[1])
            corners = np.stack(np.meshgrid(*rounded.T, indexing="ij"), axis=-1).reshape(-1, 3)
            self._plain_mesh = True
            try:
                params = mi.traverse(self)
                params["vertex_positions"] = mi.Float(corners.ravel())
                params["vertex_texcoords"] = mi.Float([0.0] * 16)
                params["faces"] = mi.UInt32([0, 0, 0])
                params.update()
            finally:
                self._plain_mesh = False

        def traverse(self, cb: Any) -> None:
            if self._plain_mesh:
                super().traverse(cb)
            else:
                self._traverse(cb)

        def parameters_changed(self, keys: Any = ()) -> None:
            if self._plain_mesh:
                super().parameters_changed(keys)
            else:
                self._changed(keys)

        def _traverse(self, cb: Any) -> None:
            """Show the parameters of the derived class."""
            raise NotImplementedError

        def _changed(self, keys: Any) -> None:
            """Take over changed parameters of the derived class."""
            raise NotImplementedError

    return MeshBase
