"""
A mesh and the surface
======================

Left a glass ball of 512 triangles, right the same ball as eight patches. The mesh is smooth enough for
its outline at this distance, but not for what is seen through it.
"""

import mitsuba as mi
import mitsuba_bezier as mb

mi.set_variant("llvm_ad_rgb")
look_at = mi.ScalarTransform4f().look_at

# %%
# The same net, once cut into triangles and written as a mesh, once as it is.

left, right = mb.sphere((-1.1, 0, 1)), mb.sphere((1.1, 0, 1))
vertices, faces = left.tessellate(8)
mesh = mi.Mesh("ball", len(vertices), len(faces))
parameters = mi.traverse(mesh)
parameters["vertex_positions"] = vertices.ravel()
parameters["faces"] = faces.ravel()
parameters.update()
mesh.write_ply("ball.ply")

glass = {"type": "dielectric"}
scene = mi.load_dict(
    {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 12},
        "eye": {
            "type": "perspective",
            "fov": 32,
            "to_world": look_at([0, -8, 2.4], [0, 0, 0.95], [0, 0, 1]),
            "film": {"type": "hdrfilm", "width": 640, "height": 360},
        },
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": [0.45, 0.55, 0.7]}},
        "lamp": {
            "type": "rectangle",
            "to_world": look_at([-4, -4, 7], [0, 0, 0], [0, 0, 1]).scale(1.5),
            "emitter": {"type": "area", "radiance": 9.0},
        },
        "floor": mb.shape(
            mb.plane(),
            bsdf={"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.2, 0.25, 0.3]}},
        ),
        "wall": mb.shape(
            mb.cylinder((0, 3, 0), (5, 0.3), 1.2, capped=True),
            bsdf={"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.7, 0.2, 0.05]}},
        ),
        "mesh": {"type": "ply", "filename": "ball.ply", "face_normals": True, "bsdf": glass},
        "patches": mb.shape(right, bsdf=glass),
    }
)
mi.util.write_bitmap("mesh_or_surface.png", mi.render(scene, spp=64), write_async=False)
