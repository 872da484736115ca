"""Attributes and texture coordinates: their values, updates, errors."""

from __future__ import annotations

import re
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from backend_cases import VARIANT
from mitsuba_cases import ball_rays, bezier, numbers, ray_of, tensor

import mitsuba_bezier as mb
from mitsuba_bezier import io
from mitsuba_bezier.errors import BezierError, FileFormatError
from mitsuba_bezier.geometry import bernstein

PATCHES = 8  # octants


def random(*shape: int) -> np.ndarray:
    return np.random.default_rng(sum(shape)).random(shape)


FACE = random(PATCHES, 3)
CORNERS = random(PATCHES, 3, 2)
#: Roundings of sums of a few numbers below 1; parameters that are found by texture coordinates
#: lose up to two digits, as some of the triangles above are thin.
NEAR = 1e-4


@pytest.fixture(scope="module", autouse=True)
def variant() -> None:
    mi.set_variant(VARIANT)


def some_hits(shape: Any) -> tuple[Any, np.ndarray, np.ndarray]:
    ray = ray_of(*ball_rays(3000, 2, target=0.9))
    pi = shape.ray_intersect_preliminary(ray)
    return (
        shape.ray_intersect(ray),
        np.array(pi.prim_index).astype(int),
        numbers(pi.prim_uv).astype(np.float64),
    )


def on_patches(ordinates: np.ndarray, patch: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Evaluate Bernstein polynomials with ordinates ``(P, K, C)``."""
    basis = bernstein.basis(bernstein.degree_of(ordinates.shape[1]), uv)
    return np.einsum("nk,nkc->nc", basis, ordinates[patch])


# ---------------------------------------------------------------- values


@pytest.mark.parametrize("by_texture", [False, True], ids=["uv", "texcoords"])
@pytest.mark.parametrize("degree", [1, 2, 4])
def test_values_of_attributes(degree, by_texture):
    more = {"texcoords": tensor(CORNERS)} if by_texture else {}
    colour = random(PATCHES, bernstein.size(degree), 3)
    weight = random(PATCHES, bernstein.size(degree))
    shape = mi.load_dict(
        bezier(
            face_colour=tensor(FACE),
            face_number=tensor(np.arange(PATCHES)),
            vertex_colour=tensor(colour),
            vertex_weight=tensor(weight),
            **more,
        )
    )
    si, patch, uv = some_hits(shape)
    # through the shape itself, and through the pointer that textures have
    for source in (shape, si.shape):
        assert dr.all(source.has_attribute("face_colour"))
        assert not dr.any(source.has_attribute("face_color"))
        assert np.array_equal(np.array(source.eval_attribute_1("face_number", si)), patch)
        got = numbers(source.eval_attribute_3("face_colour", si))
        assert np.abs(got - FACE[patch]).max() < NEAR
        got = numbers(source.eval_attribute_3("vertex_colour", si))
        assert np.abs(got - on_patches(colour, patch, uv)).max() < NEAR
        got = np.array(source.eval_attribute_1("vertex_weight", si))
        assert np.abs(got - on_patches(weight[..., None], patch, uv)[:, 0]).max() < NEAR
        # a spectrum of one number is that number for all wavelengths
        got = numbers(source.eval_attribute("vertex_weight", si))
        assert np.abs(got - on_patches(weight[..., None], patch, uv)).max() < NEAR


def test_attributes_in_a_texture_of_a_bsdf():
    reflectance = {"type": "mesh_attribute", "name": "face_colour", "scale": 0.5}
    shape = mi.load_dict(
        bezier(face_colour=tensor(FACE), bsdf={"type": "diffuse", "reflectance": reflectance})
    )
    si, patch, _uv = some_hits(shape)
    got = numbers(si.bsdf().eval_diffuse_reflectance(si))
    assert np.abs(got - 0.5 * FACE[patch]).max() < NEAR


def test_attributes_in_a_render():
    # in the light of an even sky a convex body's pixel shows its reflectance
    scene = mi.load_dict(
        {
            "type": "scene",
            "ball": bezier(
                face_colour=tensor(FACE),
                bsdf={
                    "type": "diffuse",
                    "reflectance": {"type": "mesh_attribute", "name": "face_colour"},
                },
            ),
            "sky": {"type": "constant"},
            "sensor": {
                "type": "orthographic",
                "to_world": mi.ScalarTransform4f().look_at([3, 3, 3], [0, 0, 0], [0, 0, 1])
                @ mi.ScalarTransform4f().scale(0.1),
                "film": {"type": "hdrfilm", "width": 4, "height": 4, "rfilter": {"type": "box"}},
            },
        }
    )
    image = np.array(mi.render(scene, integrator=mi.load_dict({"type": "bezierpath"}), spp=64))
    si = scene.shapes()[0].ray_intersect(ray_of([[3, 3, 3]], [[-1, -1, -1]]))
    seen = FACE[int(si.prim_index[0])]
    # the noise is that of the cosine, the same in all channels
    assert np.abs(image[..., :3].mean() / seen.mean() - 1) < 0.02
    assert np.abs(image[..., :3] / seen * seen[0] / image[..., :1] - 1).max() < 1e-4


def test_mono_and_spectral_variants():
    colour = np.broadcast_to([[[0.2, 0.5, 0.8]]], (PATCHES, 3, 3))
    for name in ("llvm_ad_mono", "llvm_ad_spectral"):
        if name not in mi.variants():
            continue
        mi.set_variant(name)
        try:
            shape = mi.load_dict(
                bezier(vertex_color=tensor(colour), face_grey=tensor(np.full(PATCHES, 0.3)))
            )
            ray = ray_of([[2, 2, 2]], [[-1, -1, -1]])
            ray.wavelengths = dr.full(type(ray.wavelengths), 550)
            si = shape.ray_intersect(ray)
            got = np.array(shape.eval_attribute("vertex_color", si)).ravel()
            if "mono" in name:
                expected = [0.2126 * 0.2 + 0.7152 * 0.5 + 0.0722 * 0.8]
            else:
                coefficients = mi.Vector3f(mi.srgb_model_fetch([0.2, 0.5, 0.8]))
                expected = np.array(mi.srgb_model_eval(coefficients, si.wavelengths)).ravel()
            # Mitsuba's weights of luminance have three digits
            assert np.abs(got - expected).max() < 1e-3
            grey = np.array(shape.eval_attribute("face_grey", si)).ravel()
            assert np.abs(grey - 0.3).max() < NEAR
        finally:
            mi.set_variant(VARIANT)


# ---------------------------------------------------------------- later changes


def test_attributes_added_and_removed_later():
    shape = mi.load_dict(bezier())
    shape.add_attribute("face_colour", 3, FACE.ravel().tolist())
    ordinates = random(PATCHES, 6, 1)
    shape.add_attribute("vertex_weight", 1, ordinates.ravel())
    si, patch, uv = some_hits(shape)
    assert np.abs(numbers(shape.eval_attribute_3("face_colour", si)) - FACE[patch]).max() < NEAR
    got = np.array(shape.eval_attribute_1("vertex_weight", si))
    assert np.abs(got - on_patches(ordinates, patch, uv)[:, 0]).max() < NEAR
    assert {"face_colour", "vertex_weight"} <= set(mi.traverse(shape).keys())
    shape.remove_attribute("face_colour")
    assert not dr.any(shape.has_attribute("face_colour"))
    assert "face_colour" not in mi.traverse(shape)


def test_updates_of_attributes_and_texture_coordinates():
    shape = mi.load_dict(
        bezier(
            face_colour=tensor(FACE),
            vertex_weight=tensor(random(PATCHES, 3)),
            texcoords=tensor(CORNERS),
        )
    )
    version = shape.version
    params = mi.traverse(shape)
    params["face_colour"] = tensor(1 - FACE)
    params.update()
    si, patch, _uv = some_hits(shape)
    got = numbers(shape.eval_attribute_3("face_colour", si))
    assert np.abs(got - (1 - FACE[patch])).max() < NEAR
    assert shape.version == version  # no structure is built anew for that

    ordinates, corners = random(PATCHES, 6, 1), CORNERS[::-1]
    params["vertex_weight"] = tensor(ordinates)
    params["texcoords"] = tensor(corners)
    params.update()
    si, patch, uv = some_hits(shape)
    c = corners[patch]
    expected = np.einsum("nk,nkc->nc", np.column_stack([uv, 1 - uv.sum(axis=1)]), c)
    assert np.abs(numbers(si.uv) - expected).max() < NEAR
    got = np.array(shape.eval_attribute_1("vertex_weight", si))
    assert np.abs(got - on_patches(ordinates, patch, uv)[:, 0]).max() < NEAR


def test_derivatives_by_attributes():
    shape = mi.load_dict(bezier(vertex_weight=tensor(random(PATCHES, 6))))
    params = mi.traverse(shape)
    dr.enable_grad(params["vertex_weight"])
    params.update()
    si, patch, uv = some_hits(shape)
    dr.backward(dr.sum(shape.eval_attribute_1("vertex_weight", si)))
    expected = np.zeros((PATCHES, 6))
    np.add.at(expected, patch, bernstein.basis(2, uv))
    got = np.array(dr.grad(params["vertex_weight"])).reshape(PATCHES, 6)
    assert np.abs(got - expected).max() < 1e-4 * expected.max()


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("face_colour", np.zeros((7, 3)), "face_colour: expected shape"),
        ("vertex_weight", np.zeros((PATCHES, 4)), "vertex_weight: expected shape"),
        ("vertex_weight", np.full((PATCHES, 3), np.nan), "vertex_weight: expected finite"),
        ("texcoords", np.zeros((PATCHES, 3, 3)), "texcoords: expected shape"),
        ("texcoords", np.zeros((PATCHES, 3, 2)), "texcoords: expected corners"),
    ],
)
def test_invalid_updates_keep_the_last_state(key, value, message):
    weight = random(PATCHES, 3, 1)
    shape = mi.load_dict(
        bezier(face_colour=tensor(FACE), vertex_weight=tensor(weight), texcoords=tensor(CORNERS))
    )
    params = mi.traverse(shape)
    params[key] = tensor(value)
    with pytest.raises(BezierError, match=re.escape(message)):
        params.update()
    si, patch, uv = some_hits(shape)
    assert np.abs(numbers(shape.eval_attribute_3("face_colour", si)) - FACE[patch]).max() < NEAR
    got = np.array(shape.eval_attribute_1("vertex_weight", si))
    assert np.abs(got - on_patches(weight, patch, uv)[:, 0]).max() < NEAR
    # ... and so do the parameters, from which the next update starts
    good = {"texcoords": 1 - CORNERS, "face_colour": 1 - FACE, "vertex_weight": 1 - weight}
    assert tuple(params[key].shape) == good[key].shape
    params[key] = tensor(good[key])
    params.update()
    si, patch, uv = some_hits(shape)
    if key == "texcoords":
        expected = on_patches(good[key], patch, uv)
        assert np.abs(numbers(si.uv) - expected).max() < NEAR
    elif key == "face_colour":
        assert np.abs(numbers(shape.eval_attribute_3(key, si)) - good[key][patch]).max() < NEAR
    else:
        expected = on_patches(good[key], patch, uv)[:, 0]
        assert np.abs(np.array(shape.eval_attribute_1(key, si)) - expected).max() < NEAR


# ---------------------------------------------------------------- files


@pytest.mark.parametrize("encoding", ["ascii", "appended"])
def test_files_carry_them(tmp_path, encoding):
    patches = mb.sphere(cover="octants")
    weight = random(PATCHES, 15, 1)
    tables = {"texcoords": CORNERS, "face_colour": FACE, "vertex_weight": weight}
    path = tmp_path / "ball.vtu"
    io.save(patches, path, encoding=encoding, attributes=tables)
    assert io.load(path) == patches
    back = io.load_attributes(path)
    assert set(back) == set(tables)
    for name, values in tables.items():
        # texture coordinates of the inner points are rounded combinations
        assert np.abs(back[name] - values).max() < 1e-15, name
    shape = mi.load_dict({"type": "beziertriangle", "filename": str(path)})
    si, patch, uv = some_hits(shape)
    assert np.abs(numbers(si.uv) - on_patches(CORNERS, patch, uv)).max() < NEAR
    assert np.abs(numbers(shape.eval_attribute_3("face_colour", si)) - FACE[patch]).max() < NEAR
    got = np.array(shape.eval_attribute_1("vertex_weight", si))
    assert np.abs(got - on_patches(weight, patch, uv)[:, 0]).max() < NEAR
    # parameters replace what the file says
    other = mi.load_dict(
        {"type": "beziertriangle", "filename": str(path), "texcoords": tensor(1 - CORNERS)}
    )
    si, patch, uv = some_hits(other)
    assert np.abs(numbers(si.uv) - on_patches(1 - CORNERS, patch, uv)).max() < NEAR


def test_several_pieces_and_shared_points(tmp_path):
    # two triangles that share an edge, and a third in another piece; ascii as a person writes it
    def piece(points: str, cells: str, count: int, uv: str, face: str) -> str:
        return f"""<Piece NumberOfPoints="{len(points.split()) // 3}" NumberOfCells="{count}">
        <PointData TCoords="where"><DataArray type="Float32" Name="where"
          NumberOfComponents="3">{uv}</DataArray></PointData>
        <CellData><DataArray type="Float32" Name="face_number">{face}</DataArray></CellData>
        <Points><DataArray type="Float32" NumberOfComponents="3">{points}</DataArray></Points>
        <Cells><DataArray type="Int32" Name="connectivity">{cells}</DataArray>
        <DataArray type="Int32" Name="offsets">{" ".join(str(3 * k + 3) for k in range(count))}
        </DataArray><DataArray type="UInt8" Name="types">{"76 " * count}</DataArray></Cells>
        </Piece>"""

    text = (
        '<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian">'
        "<UnstructuredGrid>"
        + piece("0 0 0 1 0 0 0 1 0 1 1 0", "0 1 2 1 3 2", 2, "0 0 9 1 0 9 0 1 9 1 1 9", "5 6")
        + piece("0 0 1 1 0 1 0 1 1", "0 1 2", 1, ".5 .5 9 .6 .5 9 .5 .7 9", "7")
        + "</UnstructuredGrid></VTKFile>"
    )
    path = tmp_path / "three.vtu"
    path.write_text(text.replace("<DataArray ", '<DataArray format="ascii" '))
    found = io.load_attributes(path)
    assert found["face_number"].tolist() == [[5], [6], [7]]
    expected = [
        [[0, 0], [1, 0], [0, 1]],
        [[1, 0], [1, 1], [0, 1]],
        [[0.5, 0.5], [0.6, 0.5], [0.5, 0.7]],
    ]
    assert np.abs(found["texcoords"] - expected).max() < 1e-7
    assert len(io.load(path)) == 3


@pytest.mark.parametrize(
    ("attributes", "message"),
    [
        ({"texcoords": np.zeros((7, 3, 2))}, "texcoords: expected shape (8, 3, 2), got (7, 3, 2)"),
        ({"face_a": np.zeros(8)}, "face_a: expected shape (8, C), got (8,)"),
        ({"vertex_a": np.zeros((8, 3, 1))}, "vertex_a: expected shape (8, 15, C), got (8, 3, 1)"),
        ({"colour": FACE}, 'attributes: expected names "texcoords", "face_..." or "vertex_..."'),
    ],
)
def test_what_cannot_be_written(tmp_path, attributes, message):
    with pytest.raises(FileFormatError, match=re.escape(message)):
        io.save(mb.sphere(cover="octants"), tmp_path / "a.vtu", attributes=attributes)


def test_files_without_them(tmp_path):
    mb.save(mb.sphere(), tmp_path / "plain.vtu")
    assert io.load_attributes(tmp_path / "plain.vtu") == {}
    io.save([mb.sphere(), mb.sphere().elevate()], tmp_path / "two.vtu")
    assert io.load_attributes(tmp_path / "two.vtu") == {}
    mb.save(mb.sphere(), tmp_path / "plain.bv")
    assert io.load_attributes(tmp_path / "plain.bv") == {}


# ---------------------------------------------------------------- errors


@pytest.mark.parametrize(
    ("properties", "parameter", "expected", "got"),
    [
        ({"face_a": np.zeros((7, 3))}, "face_a", "(8, 3), for 8 patches", "(7, 3)"),
        ({"face_a": np.zeros((8, 2))}, "face_a", "(8, 1) or (8, 3)", "(8, 2)"),
        ({"face_a": np.zeros((8, 1, 3))}, "face_a", "shape (8,)", "(8, 1, 3)"),
        ({"vertex_a": np.zeros((8, 7, 3))}, "vertex_a", "(m+1)(m+2)/2", "(8, 7, 3)"),
        ({"vertex_a": np.zeros((8, 1, 3))}, "vertex_a", "m >= 1", "(8, 1, 3)"),
        ({"vertex_a": np.zeros((9, 3, 3))}, "vertex_a", "8 patches", "(9, 3, 3)"),
        ({"vertex_a": np.zeros((8, 6, 2))}, "vertex_a", "C = 1 or 3", "(8, 6, 2)"),
        ({"vertex_a": np.zeros(8)}, "vertex_a", "shape (8, K)", "(8,)"),
        ({"face_a": 3.0}, "face_a", "a tensor", "3.0"),
        ({"face_a": np.full((8, 1), np.inf)}, "face_a", "finite numbers", "inf at (0, 0)"),
        ({"texcoords": np.zeros((8, 3))}, "texcoords", "(8, 3, 2)", "(8, 3)"),
        ({"texcoords": 1.0}, "texcoords", "a tensor", "1.0"),
        ({"texcoords": np.full((8, 3, 2), np.nan)}, "texcoords", "finite", "nan at (0, 0, 0)"),
        (
            {"texcoords": np.ones((8, 3, 2)), "vertex_a": np.zeros((8, 3))},
            "texcoords",
            'not on one line, for "vertex_a"',
            "at patch 0",
        ),
    ],
)
def test_bad_input(properties, parameter, expected, got):
    values = {k: tensor(v) if isinstance(v, np.ndarray) else v for k, v in properties.items()}
    with pytest.raises(RuntimeError) as error:
        mi.load_dict(bezier(**values))
    line = str(error.value).strip().splitlines()[-1]
    assert f"BezierError: {parameter}: expected " in line
    before, _, after = line.partition(", got ")
    assert expected in before + after and got in line, line


@pytest.mark.parametrize(
    ("name", "size", "count", "message"),
    [
        ("colour", 3, 24, 'name: expected an attribute "face_..." or "vertex_..."'),
        ("face_there", 3, 24, "name: expected the name of a new attribute"),
        ("face_a", 2, 16, "face_a: expected size 1 or 3"),
        ("face_a", 3, 23, "a multiple of 8 * size numbers, for 8 patches, got size 3 and 23"),
        ("face_a", 1, 16, "face_a: expected shape (8,)"),
        ("vertex_a", 1, 32, "vertex_a: expected shape (8, K)"),
        ("vertex_a", 1, 0, "and 0 numbers"),
    ],
)
def test_bad_attributes_added_later(name, size, count, message):
    shape = mi.load_dict(bezier(face_there=tensor(FACE)))
    with pytest.raises(BezierError, match=re.escape(message)):
        shape.add_attribute(name, size, np.zeros(count))


def test_an_attribute_of_another_size_than_asked_for():
    shape = mi.load_dict(bezier(face_there=tensor(FACE)))
    si, *_ = some_hits(shape)
    with pytest.raises(Exception, match="face_there: expected an attribute of size 1"):
        shape.eval_attribute_1("face_there", si)


@pytest.mark.parametrize("kind", ["point", "constant", "spot", "directional"])
def test_emitters_that_cannot_sit_on_a_shape(kind):
    with pytest.raises(RuntimeError, match="emitter: expected one that sits on a surface"):
        mi.load_dict(bezier(lamp={"type": kind}))


@pytest.mark.parametrize("name", ["texcords", "tex_coords", "facecolour"])
def test_misspelt_parameters(name):
    with pytest.raises(RuntimeError, match=f"unknown parameter '{name}'; did you mean"):
        mi.load_dict(bezier(**{name: 0.5}))


def test_textures_and_mesh_parameters_keep_their_meaning():
    shape = mi.load_dict(
        bezier(
            face_normals=True,
            vertex_paint={"type": "checkerboard"},
        )
    )
    assert dr.all(shape.has_attribute("vertex_paint"))
    assert mb.sphere().degree == shape.patches.degree
