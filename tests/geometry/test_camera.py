"""The camera map against Mitsuba's own sensor, and its vanishing points and horizons."""

from __future__ import annotations

import numpy as np
import pytest
from geometry_cases import apart, rotation

from mitsuba_bezier.errors import GeometryError
from mitsuba_bezier.geometry import projective as pg
from mitsuba_bezier.geometry.camera import (
    AXES,
    Camera,
    fov_of_focal_length,
    horizontal_fov,
    look_at,
)
from mitsuba_bezier.geometry.collineations import homology
from mitsuba_bezier.geometry.curves import BezierCurve

seeds = pytest.mark.parametrize("seed", range(10))


@pytest.fixture(scope="module")
def mi():
    """Mitsuba in a scalar variant, which needs no LLVM; the variant before is restored."""
    import mitsuba

    before = mitsuba.variant()
    mitsuba.set_variant("scalar_rgb")
    yield mitsuba
    if before is not None:
        mitsuba.set_variant(before)


def random_sensor(mi, rng, film: int, fov_axis: str):
    """A sensor description and the numbers in it; films of up to `film` pixels."""
    size = rng.integers(film // 4, film + 1, 2)
    crop = rng.integers(size // 3, size + 1)
    offset = rng.integers(0, size - crop + 1)
    shift = rng.uniform(-0.3, 0.3, 2)
    origin = rng.uniform(-3, 3, 3)
    to_world = look_at(origin, origin + rng.normal(size=3), rng.normal(size=3))
    if rng.random() < 0.25:
        to_world[:3, 0] *= -1  # a mirrored camera, which Mitsuba accepts
    fov = float(rng.uniform(30, 90))
    description = {
        "type": "perspective",
        "to_world": mi.ScalarTransform4f(to_world),
        "fov": fov,
        "fov_axis": fov_axis,
        "near_clip": 0.25,
        "far_clip": 64.0,
        "principal_point_offset_x": float(shift[0]),
        "principal_point_offset_y": float(shift[1]),
        "film": {
            "type": "hdrfilm",
            "width": int(size[0]),
            "height": int(size[1]),
            "crop_width": int(crop[0]),
            "crop_height": int(crop[1]),
            "crop_offset_x": int(offset[0]),
            "crop_offset_y": int(offset[1]),
        },
    }
    camera = Camera(to_world, fov, fov_axis, size, offset, crop, shift, 0.25, 64.0)
    return description, camera


def seen_points(mi, sensor, camera: Camera, rng, count: int):
    """Points on rays of the sensor (float32) and the pixels of those rays."""
    sample = rng.uniform(0, 1, (count, 2)).astype(np.float32)
    points = []
    for s in sample:
        ray, _weight = sensor.sample_ray(0.0, 0.5, mi.Point2f(*s.tolist()), mi.Point2f(0.5))
        distance = rng.uniform(0.5, 8)
        points.append(np.array(ray.o, dtype=float) + distance * np.array(ray.d, dtype=float))
    return np.array(points), sample * camera.crop_size


def projected(mi, sensor, points) -> np.ndarray:
    """Pixels of points within the film by the sensor's own projection, `sample_direction`."""
    out = []
    for p in points:
        it = mi.SurfaceInteraction3f()
        it.p = mi.Point3f(*p.tolist())
        sample, _weight = sensor.sample_direction(it, mi.Point2f(0.5))
        out.append(np.array(sample.uv, dtype=float))
    return np.array(out)


@pytest.mark.parametrize("fov_axis", AXES)
@seeds
def test_pixels_are_those_of_mitsuba(mi, seed, fov_axis):
    """To 1e-4 px, over random cameras, films, crop windows and principal points.

    Mitsuba computes in float32. On films up to 128 px (focal lengths up to 240 px, or 900 px where
    the film is high and narrow) its own rounding reaches 7e-5 px, the worst of 16 000 points; it
    grows with the film, and the next tests go on from there.
    """
    rng = np.random.default_rng([seed, AXES.index(fov_axis)])
    description, camera = random_sensor(mi, rng, 128, fov_axis)
    sensor = mi.load_dict(description)
    points, expected = seen_points(mi, sensor, camera, rng, 40)
    np.testing.assert_allclose(camera.pixels(points), expected, atol=1e-4)
    back = projected(mi, sensor, points)
    np.testing.assert_allclose(camera.pixels(points), back, atol=1e-4)


@seeds
def test_large_films(mi, seed):
    rng = np.random.default_rng(seed)
    description, camera = random_sensor(mi, rng, 4000, AXES[seed % 5])
    sensor = mi.load_dict(description)
    points, expected = seen_points(mi, sensor, camera, rng, 40)
    # float32 in units of the focal length or the film; 4e-7 was the worst of 16 000 points
    focal = camera.film_size[0] / (2 * np.tan(np.radians(camera.x_fov) / 2))
    bound = 1e-6 * max(focal, *camera.film_size)
    np.testing.assert_allclose(camera.pixels(points), expected, atol=bound)
    # Mitsuba's chain of transforms (sensor.h, perspective_projection) in its double type
    t = mi.ScalarProjectiveTransform4d
    size, crop, offset = camera.film_size, camera.crop_size, camera.crop_offset
    aspect = size[0] / size[1]
    chain = (
        t().scale([*(size / crop), 1])
        @ t().translate([*(-offset / size), 0])
        @ t().scale([-0.5, -0.5 * aspect, 1])
        @ t().translate([-1, -1 / aspect, 0])
        @ t().perspective(camera.x_fov, 0.25, 64.0)
    )
    sample = np.array(chain.matrix) @ np.linalg.inv(camera.to_world) @ pg.point(points).T
    shift = [description[f"principal_point_offset_{c}"] for c in "xy"] * size
    exact = (sample[:2] / sample[3]).T * crop - shift
    np.testing.assert_allclose(camera.pixels(points), exact, atol=1e-8)  # float64, 4000 px
    depth = camera.matrix @ pg.point(points).T
    np.testing.assert_allclose(depth[2] / depth[3], sample[2] / sample[3], atol=1e-12)


@seeds
def test_from_parameters(mi, seed):
    """The parameters of a sensor or scene give the same map as its description."""
    rng = np.random.default_rng(seed)
    description, camera = random_sensor(mi, rng, 128, AXES[seed % 5])
    scene = mi.load_dict({"type": "scene", "eye": description})
    for found in (
        Camera.from_parameters(mi.traverse(scene), "eye."),
        Camera.from_parameters(mi.traverse(scene.sensors()[0])),
    ):
        # float32 values (to_world, x_fov) against float64 ones, in matrices of size 250 px
        np.testing.assert_allclose(found.image_matrix, camera.image_matrix, rtol=0, atol=1e-3)
        np.testing.assert_allclose(found.matrix[2], camera.matrix[2], atol=1e-5)
        assert found.crop_size.tolist() == camera.crop_size.tolist()
        points, expected = seen_points(mi, scene.sensors()[0], found, rng, 20)
        np.testing.assert_allclose(found.pixels(points), expected, atol=1e-4)  # as above


def test_parameters_of_a_jit_variant():
    """These carry an axis of length 1; values of NumPy stand in for Dr.Jit's."""

    class Transform:
        matrix = look_at([1, 2, 3], [0, 0, 0])[..., None]

    sizes = {"film.size": [64, 32], "film.crop_offset": [8, 4], "film.crop_size": [16, 16]}
    numbers = {"x_fov": 40.0, "near_clip": 0.1, "far_clip": 10.0, "principal_point_offset_x": 0.1}
    values = {"to_world": Transform(), **sizes, **{k: [v] for k, v in numbers.items()}}
    camera = Camera.from_parameters(values)
    expected = Camera(
        Transform.matrix[..., 0], 40, "x", (64, 32), (8, 4), (16, 16), (0.1, 0), 0.1, 10
    )
    assert np.array_equal(camera.matrix, expected.matrix)


def test_thin_lens(mi):
    """Through the centre of the lens the map is that of a pinhole."""
    rng = np.random.default_rng(0)
    description, _camera = random_sensor(mi, rng, 128, "x")
    for c in "xy":
        del description[f"principal_point_offset_{c}"]
    sensor = mi.load_dict(description | {"type": "thinlens", "aperture_radius": 0.5})
    camera = Camera.from_parameters(mi.traverse(sensor))
    points, expected = seen_points(mi, sensor, camera, rng, 20)
    np.testing.assert_allclose(camera.pixels(points), expected, atol=1e-4)  # as above


@pytest.mark.parametrize("fov_axis", AXES)
@pytest.mark.parametrize("size", [(200, 100), (100, 200), (100, 100)])
def test_field_of_view(mi, fov_axis, size):
    film = {"type": "hdrfilm", "width": size[0], "height": size[1]}
    sensor = {"type": "perspective", "film": film}
    x_fov = mi.traverse(mi.load_dict(sensor | {"fov": 50.0, "fov_axis": fov_axis}))["x_fov"]
    assert horizontal_fov(50, fov_axis, size) == pytest.approx(x_fov, rel=1e-6)  # float32
    x_fov = mi.traverse(mi.load_dict(sensor | {"focal_length": "35mm"}))["x_fov"]
    fov = fov_of_focal_length(35)
    assert horizontal_fov(fov, "diagonal", size) == pytest.approx(x_fov, rel=1e-6)


@seeds
def test_look_at_is_mitsubas(mi, seed):
    origin, target, up = np.random.default_rng(seed).normal(size=(3, 3))
    expected = mi.ScalarTransform4f().look_at(origin.tolist(), target.tolist(), up.tolist())
    # float32, and target and origin may be close together
    np.testing.assert_allclose(look_at(origin, target, up), np.array(expected.matrix), atol=2e-6)


# ---------------------------------------------------------------- without Mitsuba


def random_camera(seed: int) -> Camera:
    rng = np.random.default_rng(seed)
    to_world = look_at(rng.normal(size=3), rng.normal(size=3), rng.normal(size=3))
    return Camera(
        to_world, rng.uniform(20, 100), "y", (320, 200), (10, 20), (200, 100), (0.1, -0.2)
    )


def test_a_camera_by_hand():
    # 90 degrees on a film of 200 x 100: focal length 100 px, centre at (100, 50)
    camera = Camera(look_at([0, 0, 0], [0, 0, 1]), 90, "x", (200, 100))
    pixels = camera.pixels([[0, 0, 1], [0.5, 0, 1], [0, 0.25, 1]])
    np.testing.assert_allclose(pixels, [[100, 50], [50, 50], [100, 25]], atol=1e-12)
    np.testing.assert_allclose(camera.direction([100, 50]), [0, 0, 1], atol=1e-15)
    assert camera.center.tolist() == [0, 0, 0, 1]
    depth = camera.matrix @ pg.point([[0, 0, 1e-2], [0, 0, 1e4]]).T
    np.testing.assert_allclose(depth[2] / depth[3], [0, 1], atol=1e-12)


@seeds
def test_pixel_rays_and_back(seed):
    camera = random_camera(seed)
    pixel = np.random.default_rng(seed).uniform(0, 300, (20, 2))
    direction = camera.direction(pixel)
    points = camera.to_world[:3, 3] + 2.5 * direction
    np.testing.assert_allclose(camera.pixels(points), pixel, atol=1e-10)  # 300 px, rounding
    depth = direction @ camera.to_world[:3, 2]
    np.testing.assert_allclose(depth, 1, rtol=1e-12)
    # the collineation is regular, so planes and points go back and forth
    assert np.linalg.cond(camera.matrix) < 1e7


@seeds
def test_vanishing_point_is_where_parallels_meet(seed):
    camera = random_camera(seed)
    rng = np.random.default_rng(seed)
    direction, p, q = rng.normal(size=(3, 3))
    lines = [
        pg.join(camera.image(pg.point(x)), camera.image(pg.point(x + direction))) for x in (p, q)
    ]
    vanishing = camera.vanishing_point(direction)
    assert apart(pg.meet(*lines), vanishing) < 1e-9  # two lines of the image, 1e-3 apart
    far = camera.image(pg.point(p + 1e9 * direction))
    assert apart(far, vanishing) < 1e-7  # at a distance of 1e9
    assert camera.vanishing_point(camera.to_world[:3, 2])[2] > 0  # ahead
    assert pg.is_ideal(camera.vanishing_point(camera.to_world[:3, 0]))  # parallel to the film


@seeds
def test_horizon(seed):
    camera = random_camera(seed)
    rng = np.random.default_rng(seed)
    plane = rng.normal(size=4)
    horizon = camera.horizon(plane)
    u, v = np.linalg.svd(plane[None, :3])[2][1:]
    for a in rng.uniform(0, 6, 5):
        vanishing = camera.vanishing_point(np.cos(a) * u + np.sin(a) * v)
        assert pg.incidence(horizon, vanishing) < 1e-12
    assert apart(pg.join(*camera.vanishing_point([u, v])), horizon) < 1e-10
    # the sign: above the ground are the rays that rise
    pixel = rng.uniform(0, 300, (20, 2))
    value = pg.point(pixel) @ horizon
    np.testing.assert_allclose(value, camera.direction(pixel) @ plane[:3], atol=1e-10)
    # parallel planes share it; the plane of the film's direction has the line at infinity
    assert apart(camera.horizon(plane + 3 * pg.IDEAL_PLANE), horizon) == 0
    ahead = np.append(camera.to_world[:3, 2], -1.0)
    assert apart(camera.horizon(ahead), pg.IDEAL_LINE) < 1e-12


@seeds
def test_relief_perspective_leaves_the_image_as_it_is(seed):
    camera = random_camera(seed)
    rng = np.random.default_rng(seed)
    m = homology(camera.center, rng.normal(size=4), 0.2)
    points = rng.normal(size=(30, 4))
    assert apart(camera.image(points @ m.T), camera.image(points)) < 1e-10
    # scene and camera moved together, by any collineation
    m = np.eye(4) + 0.3 * rng.normal(size=(4, 4))
    moved = camera.image_matrix @ np.linalg.inv(m)
    assert apart(points @ m.T @ moved.T, camera.image(points)) < 1e-9


@seeds
def test_image_of_a_curve(seed):
    camera = random_camera(seed)
    curve = BezierCurve(np.random.default_rng(seed).normal(size=(4, 4)))
    t = np.linspace(0, 1, 9)
    image = curve.project(camera.image_matrix)
    assert apart(image.evaluate(t), camera.image(curve.evaluate(t))) < 1e-10


@seeds
def test_mirrored_camera_swaps_left_and_right(seed):
    rng = np.random.default_rng(seed)
    to_world = np.eye(4)
    to_world[:3, :3] = rotation(rng, 3)
    mirrored = to_world @ np.diag([-1.0, 1, 1, 1])
    a, b = (Camera(m, 60, "x", (100, 50)) for m in (to_world, mirrored))
    pixel = rng.uniform(0, 50, (5, 2))
    swapped = pixel * [-1, 1] + [100, 0]
    np.testing.assert_allclose(b.pixels(a.direction(pixel)), swapped, atol=1e-11)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"to_world": np.diag([1, 1, 2, 1.0])}, "rigid"),
        ({"to_world": np.eye(3)}, "rigid"),
        ({"to_world": np.full((4, 4), np.nan)}, "finite"),
        ({"fov": 180}, "between 0 and 180"),
        ({"fov": 0}, "between 0 and 180"),
        ({"fov": np.nan}, "fov: expected finite"),
        ({"fov": "wide"}, "fov: expected numbers"),
        ({"fov_axis": "z"}, "one of x, y"),
        ({"film_size": (0, 5)}, "film_size"),
        ({"film_size": 5}, "film_size"),
        ({"crop_offset": (90, 0), "crop_size": (20, 20)}, "within the film"),
        ({"crop_offset": (-1, 0)}, "crop_offset"),
        ({"principal_point_offset": (0, np.inf)}, "principal_point_offset"),
        ({"near_clip": 0}, "near_clip"),
        ({"far_clip": 1e-3}, "far_clip"),
    ],
)
def test_bad_cameras(change, says):
    arguments = {"to_world": np.eye(4), "fov": 50, "film_size": (100, 50)} | change
    with pytest.raises(GeometryError, match=says):
        Camera(**arguments)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda c: c.pixels([[0, 0, -1]]), "in front"),
        (lambda c: c.pixels([[1, 0, 0]]), "in front"),
        (lambda c: c.pixels([[0, 0, 0]]), "the eye"),
        (lambda c: c.pixels([[0, 0, 1, 1]]), "three coordinates"),
        (lambda c: c.image([0, 0, 0, 2]), "the eye"),
        (lambda c: c.vanishing_point([0, 0, 0]), "zero vector"),
        (lambda c: c.horizon([0, 0, 0, 1]), "at infinity"),
        (lambda c: c.direction([1, 2, 3]), "two numbers"),
        (lambda c: look_at([0, 0, 0], [0, 0, 0]), "dependent vectors"),
        (lambda c: look_at([0, 0, 0], [0, 2, 0]), "dependent vectors"),
        (lambda c: look_at([0, 0], [0, 2]), "vectors of 3"),
        (lambda c: fov_of_focal_length(0), "millimetres"),
        (lambda c: Camera.from_parameters({}), "no 'to_world'"),
    ],
)
def test_bad_input(call, says):
    with pytest.raises(GeometryError, match=says):
        call(Camera(np.eye(4), 50, film_size=(100, 50)))
