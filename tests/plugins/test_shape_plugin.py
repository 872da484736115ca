"""The shape plugin: its properties, its errors, sharing, updates, variants."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from backend_cases import VARIANT
from mitsuba_cases import analytic_sphere, ball_rays, bezier, numbers, ray_of, sphere_net, tensor

import mitsuba_bezier as mb

# float32 control points move the surface by a rounding (6e-8) of its size, and so does the ray
# parameter; seen at a slant of 1/10 or steeper that is 1e-6
T_ERROR = 2e-6


@pytest.fixture(scope="module", autouse=True)
def variant() -> None:
    mi.set_variant(VARIANT)


@contextmanager
def switched_to(name: str) -> Iterator[None]:
    mi.set_variant(name)
    try:
        yield
    finally:
        mi.set_variant(VARIANT)


def away_from_silhouette(o: np.ndarray, d: np.ndarray, t: np.ndarray, distance: np.ndarray) -> Any:
    """Return which rays hit steeper than 1/10, or clearly miss."""
    return np.where(np.isfinite(t), distance < 0.995, distance > 1 + 1e-5)


def check_against_quadric(shape: Any, matrix: np.ndarray, seed: int = 0) -> None:
    """Compare with the image of the unit sphere under an affine map, in float64."""
    o, d = ball_rays(20_000, seed)
    world_o = (o @ matrix[:3, :3].T + matrix[:3, 3]).astype(np.float32)
    world_d = (d @ matrix[:3, :3].T).astype(np.float32)
    inverse = np.linalg.inv(matrix)
    t, distance = analytic_sphere(
        world_o @ inverse[:3, :3].T + inverse[:3, 3], world_d @ inverse[:3, :3].T
    )
    pi = shape.ray_intersect_preliminary(ray_of(world_o, world_d))
    sure = away_from_silhouette(o, d, t, distance)
    assert sure.mean() > 0.9
    got = numbers(pi.t)[sure]
    assert (np.isfinite(got) == np.isfinite(t[sure])).all()
    hit = np.isfinite(got)
    assert hit.sum() > 5000
    # the rays' own parameter runs over about 2.5; the world is `stretch` times as large, and
    # its rounding is felt in units of the shortest axis
    sigma = np.linalg.svd(matrix[:3, :3], compute_uv=False)
    offset = 1 + np.abs(matrix[:3, 3]).max() / sigma[-1]
    assert np.abs(got[hit] - t[sure][hit]).max() < T_ERROR * sigma[0] / sigma[-1] * offset


# ---------------------------------------------------------------- properties


@pytest.mark.parametrize("cover", ["octants", "tetrahedral"])
def test_control_points_as_a_tensor(cover):
    shape = mi.load_dict(bezier(mb.sphere(cover=cover)))
    check_against_quadric(shape, np.eye(4))
    assert shape.primitive_count() == len(mb.sphere(cover=cover))


def test_one_net_without_the_patch_axis():
    net = mb.sphere(cover="octants").control_points[0]
    shape = mi.load_dict(bezier(net))
    si = shape.ray_intersect(ray_of([[2, 2, 2]], [[-1, -1, -1]]))
    assert shape.primitive_count() == 1 and list(si.is_valid()) == [True]


def test_float64_tensors_keep_their_digits():
    net = mb.sphere(cover="octants").control_points
    shape = mi.load_dict(
        {"type": "beziertriangle", "control_points": mi.TensorXf64(net.ravel(), shape=net.shape)}
    )
    assert np.array_equal(shape.patches.control_points, net)


def test_a_file_gives_the_same_shape(tmp_path):
    patches = mb.sphere(cover="tetrahedral")
    mb.save(patches, tmp_path / "ball.vtu")
    shape = mi.load_dict({"type": "beziertriangle", "filename": str(tmp_path / "ball.vtu")})
    assert shape.primitive_count() == len(patches)
    # the ascii digits and binary numbers of a file are those of float64
    assert np.array_equal(shape.patches.control_points, patches.control_points)
    check_against_quadric(shape, np.eye(4))


@pytest.mark.parametrize(
    "matrix",
    [
        pytest.param(np.diag([3.0, 0.5, 1.25, 1.0]), id="stretched"),
        pytest.param(np.diag([1.0, -2.0, 1.0, 1.0]), id="mirrored"),
        pytest.param(
            np.array([[1.0, 0.4, 0, 2], [-0.3, 1.5, 0.2, -1], [0.1, 0, 0.8, 0.5], [0, 0, 0, 1]]),
            id="sheared",
        ),
        pytest.param(
            np.array([[0, 1e3, 0, 4e3], [1e3, 0, 0, 0], [0, 0, 1e3, 1], [0, 0, 0, 1.0]]),
            id="large, mirrored",
        ),
    ],
)
@pytest.mark.parametrize("cover", ["octants", "tetrahedral"])
@pytest.mark.parametrize("flip", [False, True])
def test_to_world_and_flip_normals(matrix, cover, flip):
    shape = mi.load_dict(
        bezier(
            mb.sphere(cover=cover),
            to_world=mi.ScalarTransform4f(matrix.tolist()),
            flip_normals=flip,
        )
    )
    check_against_quadric(shape, matrix)
    # an outside stays an outside, also in a mirror; `flip_normals` turns it
    o, d = ball_rays(2000, 1, target=0.9)
    m = matrix[:3, :3]
    si = shape.ray_intersect(ray_of(o @ m.T + matrix[:3, 3], d @ m.T))
    valid = np.array(si.is_valid())
    assert valid.all()
    local = np.linalg.solve(m, numbers(si.p).T - matrix[:3, 3:]).T
    outward = local @ np.linalg.inv(m)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    cosine = np.einsum("ni,ni->n", numbers(si.n), outward)
    # 1e-4: the cosine of one degree; a wrong sign is -1
    assert np.abs(cosine * (-1 if flip else 1) - 1).max() < 1e-4


def test_nested_bsdf_emitter_and_medium():
    shape = mi.load_dict(
        bezier(
            bsdf={"type": "dielectric", "id": "glass"},
            interior={"type": "homogeneous", "albedo": 0.5},
            emitter={"type": "area", "radiance": {"type": "rgb", "value": [1, 2, 3]}},
        )
    )
    assert "Dielectric" in str(shape.bsdf())
    assert shape.is_emitter() and shape.is_medium_transition()
    assert shape.interior_medium() is not None and shape.exterior_medium() is None
    si = shape.ray_intersect(ray_of([[0, 0.1, 3]], [[0, 0, -1]]))
    assert np.allclose(np.array(shape.emitter().eval(si)).ravel(), [1, 2, 3])


# ---------------------------------------------------------------- errors

NET = (1, 6, 4)


def filled(shape: tuple[int, ...], value: float = 1.0, **entries: float) -> Any:
    values = np.full(shape, value)
    for number in entries.values():
        values[(0,) * len(shape)] = number
    return lambda: {"control_points": tensor(values)}


def with_net(**more: Any) -> Any:
    return lambda: {"control_points": sphere_net(), **more}


def scaled(*factors: float) -> Any:
    return lambda: {
        "control_points": sphere_net(),
        "to_world": mi.ScalarTransform4f(np.diag([*factors, 1.0]).tolist()),
    }


def projective() -> dict:
    matrix = np.eye(4)
    matrix[3, 2] = 0.25
    return {
        "control_points": sphere_net(),
        "to_world": mi.ScalarTransform4f(matrix.tolist()),
    }


@pytest.mark.parametrize(
    ("properties", "parameter", "expected", "got"),
    [
        (filled((1, 4, 4)), "control_points", "(n+1)(n+2)/2", "K = 4"),
        (filled((1, 1, 4)), "control_points", "degree n >= 1", "K = 1"),
        (filled((1, 6, 3)), "control_points", "shape (P, K, 4)", "(1, 6, 3)"),
        (filled((6, 3)), "control_points", "shape (P, K, 4)", "(6, 3)"),
        (filled((24,)), "control_points", "shape (P, K, 4)", "(24,)"),
        (filled((1, 1, 6, 4)), "control_points", "shape (P, K, 4)", "(1, 1, 6, 4)"),
        (filled((0, 6, 4)), "control_points", "at least one patch", "P = 0"),
        (filled(NET, first=np.nan), "control_points", "finite", "nan at patch 0, row 0"),
        (filled(NET, first=-np.inf), "control_points", "finite", "-inf at patch 0, row 0"),
        (filled(NET, 0.0), "control_points", "not the zero vector", "patch 0"),
        (lambda: {"control_points": 3.0}, "control_points", "tensor of shape (P, K, 4)", "3.0"),
        (lambda: {"control_points": "a"}, "control_points", "tensor of shape (P, K, 4)", "'a'"),
        (dict, "beziertriangle", '"control_points" and "filename"', "neither"),
        (with_net(filename="a.vtu"), "beziertriangle", '"control_points" and "filename"', "both"),
        (lambda: {"filename": 3}, "filename", "the name of a file", "3"),
        (lambda: {"filename": "a.xyz"}, "filename", ".vtu", "suffix '.xyz'"),
        (lambda: {"filename": "none.vtu"}, "filename", "can be read", "does not exist"),
        (with_net(flip_normals="yes"), "flip_normals", "true or false", "'yes'"),
        (with_net(to_world=3), "to_world", "a transformation", "3"),
        (scaled(1, 1, 0), "to_world", "regular", "flattens space"),
        (scaled(1, 1, np.nan), "to_world", "finite affine", "nan"),
        (projective, "to_world", "affine", "0.25"),
    ],
)
def test_bad_input(properties, parameter, expected, got):
    with pytest.raises(RuntimeError) as caught:
        mi.load_dict({"type": "beziertriangle", **properties()})
    # Mitsuba puts the traceback first; the last line is our message
    line = str(caught.value).strip().splitlines()[-1]
    assert f"{parameter}: expected " in line
    assert expected in line.split("expected ", 1)[1].rsplit(", got ", 1)[0]
    assert got in line.rsplit(", got ", 1)[1]


def write(path: Path, text: str) -> dict:
    path.write_text(text)
    return {"type": "beziertriangle", "filename": str(path)}


VTU = """<VTKFile type="UnstructuredGrid" version="2.2" byte_order="LittleEndian">
<UnstructuredGrid><Piece NumberOfPoints="3" NumberOfCells="1">
<Points><DataArray type="Float64" NumberOfComponents="3" format="ascii">
0 0 0 1 0 0 0 1 0</DataArray></Points>
<Cells><DataArray type="Int64" Name="connectivity" format="ascii">0 1 2</DataArray>
<DataArray type="Int64" Name="offsets" format="ascii">3</DataArray>
<DataArray type="UInt8" Name="types" format="ascii">{cell}</DataArray></Cells>
</Piece></UnstructuredGrid></VTKFile>"""


def test_bad_files(tmp_path):
    good = write(tmp_path / "good.vtu", VTU.format(cell=76))
    assert mi.load_dict(good).primitive_count() == 1
    for name, text, words in (
        ("empty.vtu", "", ()),
        ("cut.vtu", VTU.format(cell=76)[:300], ()),
        ("polyhedron.vtu", VTU.format(cell=42), ("VTK_POLYHEDRON",)),
    ):
        with pytest.raises(RuntimeError) as caught:
            mi.load_dict(write(tmp_path / name, text))
        line = str(caught.value).strip().splitlines()[-1]
        assert re.search("FileFormatError: filename: .*expected .*, got ", line), line
        assert name in line and all(word in line for word in words), line


def test_a_misspelt_property_is_an_error():
    with pytest.raises(RuntimeError, match="unknown parameter 'flip_normal'; did you mean"):
        mi.load_dict(bezier(flip_normal=True))
    with pytest.raises(RuntimeError, match="unknown parameter 'control_point'; did you mean"):
        mi.load_dict(bezier(control_point=1.0))


def test_errors_in_xml_name_the_parameter():
    scene = '<scene version="3.0.0"><shape type="beziertriangle">{}</shape></scene>'
    with pytest.raises(RuntimeError, match="got neither"):
        mi.load_string(scene.format(""))
    with pytest.raises(RuntimeError, match=r"filename: expected .*none\.vtu.* does not exist"):
        mi.load_string(scene.format('<string name="filename" value="none.vtu"/>'))


@pytest.mark.parametrize("kind", ["beziertriangle", "bezierpath"])
def test_scalar_variants_end_in_a_clear_error(kind):
    with switched_to("scalar_rgb"):
        with pytest.raises(RuntimeError) as caught:
            mi.load_dict({"type": kind})
        line = str(caught.value).strip().splitlines()[-1]
        assert "VariantError: variant: expected one of " in line and "llvm_ad_rgb" in line
        assert "got scalar_rgb, which cannot run a Dr.Jit kernel" in line


# ---------------------------------------------------------------- sharing a BSDF


def two_spheres_seen(scene: Any) -> None:
    """Check that spheres at x = -2 and x = 2 are both hit, and nothing between them."""
    shapes = [s for s in scene.shapes() if hasattr(s, "patches")]
    assert len(shapes) == 2 and len(scene.shapes()) == 2
    assert shapes[0].bsdf() is shapes[1].bsdf()
    si = mb.ray_intersect(scene, ray_of([[-2, 0.1, 5], [0, 0.1, 5], [2, 0.1, 5]], [[0, 0, -1]]))
    assert list(si.is_valid()) == [True, False, True]
    assert (
        numbers(si.shape == mi.ShapePtr(shapes[0])).tolist()
        != numbers(si.shape == mi.ShapePtr(shapes[1])).tolist()
    )
    image = np.array(mi.render(scene, spp=4, seed=1))
    left, right = image[:, : image.shape[1] // 2], image[:, image.shape[1] // 2 :]
    # about a twelfth of each half of the frame is a lit sphere
    assert (left.max(axis=-1) > 0.1).mean() > 0.02
    assert (right.max(axis=-1) > 0.1).mean() > 0.02


def test_two_shapes_that_share_a_bsdf_by_dict():
    move = mi.ScalarTransform4f().translate
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "bezierpath"},
            "sensor": {
                "type": "perspective",
                "fov": 60,
                "to_world": mi.ScalarTransform4f().look_at([0, 0, 8], [0, 0, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 32, "height": 32},
            },
            "light": {"type": "directional", "direction": [0, 0, -1]},
            "paint": {"type": "diffuse", "id": "paint"},
            "a": bezier(to_world=move([-2, 0, 0]), bsdf={"type": "ref", "id": "paint"}),
            "b": bezier(to_world=move([2, 0, 0]), bsdf={"type": "ref", "id": "paint"}),
        }
    )
    two_spheres_seen(scene)


SHARED = """<scene version="3.0.0">
<integrator type="bezierpath"/>
<sensor type="perspective"><float name="fov" value="60"/>
  <transform name="to_world"><lookat origin="0,0,8" target="0,0,0" up="0,1,0"/></transform>
  <film type="hdrfilm"><integer name="width" value="32"/><integer name="height" value="32"/></film>
</sensor>
<emitter type="directional"><vector name="direction" value="0,0,-1"/></emitter>
<bsdf type="diffuse" id="paint"/>
<shape type="beziertriangle"><string name="filename" value="{file}"/><ref id="paint"/>
  <transform name="to_world"><translate x="-2"/></transform></shape>
<shape type="beziertriangle"><string name="filename" value="{file}"/><ref id="paint"/>
  <transform name="to_world"><translate x="2"/></transform></shape>
</scene>"""


def test_two_shapes_that_share_a_bsdf_by_xml(tmp_path):
    mb.save(mb.sphere(cover="tetrahedral"), tmp_path / "ball.vtu")
    two_spheres_seen(mi.load_string(SHARED.format(file=tmp_path / "ball.vtu")))
    (tmp_path / "scene.xml").write_text(SHARED.format(file="ball.vtu"))  # relative to the scene
    two_spheres_seen(mi.load_file(str(tmp_path / "scene.xml")))


# ---------------------------------------------------------------- traverse and update


def depth(shape: Any) -> float:
    """Return where a ray from z = 5 straight down meets the shape, infinite for a miss."""
    pi = shape.ray_intersect_preliminary(ray_of([[0.1, 0.2, 5.0]], [[0.0, 0.0, -1.0]]))
    return float(numbers(pi.t)[0])


def expected_depth(radius: float = 1.0, z: float = 0.0) -> float:
    return 5.0 - z - float(np.sqrt(radius**2 - 0.05))


def test_parameters_are_listed_and_update():
    scene = mi.load_dict({"type": "scene", "ball": bezier(bsdf={"type": "diffuse"})})
    shape = next(s for s in scene.shapes() if hasattr(s, "patches"))
    params = mi.traverse(scene)
    names = {k for k, _ in params}
    assert {"ball.control_points", "ball.to_world", "ball.bsdf.reflectance.value"} <= names
    assert not any("vertex" in n or "faces" in n for n in names)  # the mesh is no one's business
    assert params["ball.control_points"].shape == (8, 15, 4)
    assert depth(shape) == pytest.approx(expected_depth(), abs=T_ERROR)

    net = np.array(params["ball.control_points"]).reshape(8, 15, 4)
    net[..., :3] *= 2
    params["ball.control_points"] = tensor(net)
    params.update()
    assert depth(shape) == pytest.approx(expected_depth(2.0), abs=2 * T_ERROR)
    assert np.allclose(np.array(scene.bbox().max), 2, atol=1e-5)

    params["ball.to_world"] = mi.Transform4f().translate([0, 0, 1])
    params.update()
    assert depth(shape) == pytest.approx(expected_depth(2.0, 1.0), abs=2 * T_ERROR)
    assert scene.bbox().max[2] == pytest.approx(3.0, abs=1e-5)
    hit = mb.ray_intersect(scene, ray_of([[0.1, 0.2, 5.0]], [[0.0, 0.0, -1.0]]))
    assert float(hit.t[0]) == pytest.approx(expected_depth(2.0, 1.0), abs=2 * T_ERROR)

    # other degree, other number of patches
    params["ball.control_points"] = sphere_net("tetrahedral")
    params.update()
    assert shape.primitive_count() == 10
    assert depth(shape) == pytest.approx(expected_depth(1.0, 1.0), abs=T_ERROR)


def test_an_update_that_changes_nothing_keeps_float64_values():
    net = mb.sphere(cover="octants").control_points
    shape = mi.load_dict(
        {"type": "beziertriangle", "control_points": mi.TensorXf64(net.ravel(), shape=net.shape)}
    )
    params = mi.traverse(shape)
    params["to_world"] = mi.Transform4f().translate([0, 0, 1])
    params.update()
    moved = net.copy()
    moved[..., 2] += moved[..., 3]
    assert np.array_equal(shape.patches.control_points, moved)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("control_points", lambda: tensor(np.ones((1, 7, 4))), "control_points: .*K = 7"),
        ("control_points", lambda: tensor(np.ones((1, 6, 3))), r"control_points: .*\(1, 6, 3\)"),
        ("control_points", lambda: tensor(np.full((1, 6, 4), np.nan)), "control_points: .*nan"),
        ("control_points", lambda: tensor(np.zeros((1, 6, 4))), "control_points: .*zero"),
        (
            "to_world",
            lambda: mi.Transform4f(mi.Matrix4f(np.diag([1, 1, 0, 1.0]).tolist())),
            "to_world: .*flattens",
        ),
        (
            "to_world",
            lambda: mi.Transform4f(mi.Matrix4f(np.diag([1, 1, np.inf, 1.0]).tolist())),
            "to_world: .*inf",
        ),
    ],
)
def test_an_invalid_update_keeps_the_last_state(key, value, message):
    shape = mi.load_dict(bezier(to_world=mi.ScalarTransform4f().translate([0, 0, 0.5])))
    before = depth(shape)
    box = np.array(shape.bbox().max)
    params = mi.traverse(shape)
    params[key] = value()
    with pytest.raises(Exception, match=message):
        params.update()
    assert depth(shape) == before
    assert np.array_equal(np.array(shape.bbox().max), box)
    # what the parameters show is the state that is in force, and it can be changed
    assert params["control_points"].shape == (8, 15, 4)
    assert np.isfinite(np.array(params["to_world"].matrix)).all()
    params["to_world"] = mi.Transform4f()
    params.update()
    assert depth(shape) == pytest.approx(expected_depth(), abs=T_ERROR)


# ---------------------------------------------------------------- facts Mitsuba asks for


def test_bounding_boxes():
    # the hull of the octants' control points is the cube; that of the tetrahedral cover is larger
    shape = mi.load_dict(bezier(to_world=mi.ScalarTransform4f().translate([3, 0, 0])))
    for box in (shape.bbox(), mi.load_dict({"type": "scene", "s": shape}).bbox()):
        assert np.allclose(np.array(box.min), [2, -1, -1], atol=1e-6)
        assert np.allclose(np.array(box.max), [4, 1, 1], atol=1e-6)


def test_the_box_of_an_unbounded_patch_is_finite():
    # a quadrant of the plane: two control vectors
    net = [[[0, 0, 0, 1], [1, 0, 0, 0], [0, 1, 0, 0]]]
    shape = mi.load_dict(bezier(net))
    box = shape.bbox()
    assert np.isfinite(np.array(box.min)).all() and np.isfinite(np.array(box.max)).all()
    pi = shape.ray_intersect_preliminary(
        ray_of([[500, 700, 10], [-1, 1, 10], [3, 2, -7]], [[0, 0, -1], [0, 0, -1], [0, 0, 1]])
    )
    assert numbers(pi.t).tolist() == [10.0, np.inf, 7.0]


def test_area_and_text():
    shape = mi.load_dict(bezier(to_world=mi.ScalarTransform4f().scale(2), bsdf={"type": "plastic"}))
    # 1e-6: float32 control points and a float32 result
    assert float(shape.surface_area()[0]) == pytest.approx(16 * np.pi, rel=1e-6)
    for text in (str(shape), repr(shape), str(mi.load_dict({"type": "scene", "s": shape}))):
        assert "BezierTriangle[" in text and "degree = 4" in text and "SmoothPlastic" in text


# ---------------------------------------------------------------- variants


def test_switching_variants_back_and_forth():
    old = mi.load_dict(bezier())
    for name in ("llvm_ad_mono", VARIANT, "scalar_rgb", VARIANT):
        mi.set_variant(name)
        if name.startswith("scalar"):
            continue
        assert depth(mi.load_dict(bezier())) == pytest.approx(expected_depth(), abs=T_ERROR)
    assert depth(old) == pytest.approx(expected_depth(), abs=T_ERROR)


@pytest.mark.parametrize(
    "lines",
    [
        ("import mitsuba_bezier", "import mitsuba as mi", "mi.set_variant('llvm_ad_rgb')"),
        (
            "import mitsuba_bezier._runtime as r; r.prepare()",  # settles LLVM, registers nothing
            "import mitsuba as mi",
            "mi.set_variant('scalar_rgb')",
            "mi.set_variant('llvm_ad_rgb')",
        ),
    ],
)
def test_orders_of_import(python, lines):
    code = "\n".join(
        (
            *lines,
            "net = [0, 0, 0, 1, 1, 0, 0, 1, 0, 1, 0, 1]",
            "shape = mi.load_dict({'type': 'beziertriangle',",
            "    'control_points': mi.TensorXf(net, shape=(1, 3, 4))})",
            "ray = mi.Ray3f(mi.Point3f(0.2, 0.3, 1), mi.Vector3f(0, 0, -1))",
            "print(shape.ray_intersect_preliminary(ray).t[0])",
        )
    )
    done = python(code)
    assert done.returncode == 0, done.stderr
    assert float(done.stdout) == pytest.approx(1.0, abs=1e-6)


def test_gradients_may_be_enabled_on_parameters():
    params = mi.traverse(mi.load_dict(bezier()))
    dr.enable_grad(params["control_points"])
    params.update()  # nothing of the primal code may stumble over it
    assert dr.grad_enabled(params["control_points"])


def test_the_interface_of_meshes_is_used_in_one_module():
    # Mitsuba 3.10 changes it: docs/mitsuba-3.10.md
    used = r"mi\.Mesh\b(?!`)|\"vertex_positions\"|\"vertex_texcoords\"|\"faces\"|face_bezier"
    root = Path(mb.__file__).parent
    names = {
        p.name for p in (root / "plugins").rglob("*.py") if re.search(used, p.read_text("utf-8"))
    }
    assert names == {"mesh_base.py"}
