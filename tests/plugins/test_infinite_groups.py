"""Surfaces that reach infinity are seen beside patches whose parameters are found by inversion.

The table of a group that says which members may have a point has cells out to its finite control
points only: a plane of four wedges has points beyond.
"""

from __future__ import annotations

import numpy as np
import pytest
from backend_cases import VARIANT

import mitsuba_bezier as mb

INFINITE = {
    "plane": mb.plane((0, 0, -1)),
    "paraboloid": mb.quadric_cover(
        [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, -0.5], [0, 0, -0.5, 0]], cover="lunes"
    ),
    "sheets": mb.quadric_cover(np.diag([1.0, 1, -1, 1])),
}
INVERTED = {
    "disk": mb.disk((0, 0, 5)),
    "can": mb.cylinder((0, 0, 4), capped=True),
    "tilted": mb.disk().transform(
        [[1, 0, 0, 0], [0, 0.6, -0.8, 0], [0, 0.8, 0.6, 6], [0, 0, 0, 1]]
    ),
}


@pytest.mark.parametrize("far", INFINITE)
@pytest.mark.parametrize("near", INVERTED)
def test_both_are_seen_as_they_are_alone(far, near):
    import mitsuba as mi

    mi.set_variant(VARIANT)
    rng = np.random.default_rng(3)
    origin = np.array([0.0, 0, 9]) + rng.uniform(-1, 1, (3, 2000)).T
    # at points near and far, up to a hundred units away
    target = rng.normal(size=(2000, 3)) * 10.0 ** rng.uniform(-1, 2, (2000, 1))
    target[:, 2] = -np.abs(target[:, 2])
    way = target - origin
    ray = mi.Ray3f(mi.Point3f(*map(mi.Float, origin.T)), mi.Vector3f(*map(mi.Float, way.T)))

    def distances(**nets):
        shapes = {name: mb.shape(net) for name, net in nets.items()}
        scene = mi.load_dict({"type": "scene", **shapes})
        t = np.array(scene.ray_intersect(ray).t)
        assert (np.array(scene.ray_test(ray)) == np.isfinite(t)).all()
        return t

    both = distances(far=INFINITE[far], near=INVERTED[near])
    alone = np.minimum(distances(far=INFINITE[far]), distances(near=INVERTED[near]))
    assert np.isfinite(alone).sum() > 500
    # float32: the same leaves from other origins round otherwise
    assert np.allclose(both, alone, rtol=1e-5, atol=0)
