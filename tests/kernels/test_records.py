"""Records of the device: what is packed by name is read by name."""

from __future__ import annotations

import drjit as dr
import numpy as np
import pytest
from backend_cases import Float, Float64, UInt

from mitsuba_bezier.kernels.arrays import upload
from mitsuba_bezier.kernels.closed_form.kinds import KINDS
from mitsuba_bezier.kernels.records import Record, bits, is_kind
from mitsuba_bezier.leaves.closed_form.kinds import CLOSED_FORM_KINDS
from mitsuba_bezier.leaves.records import CLOSED_FORMS, LeafKind

FIELDS = {"shift": (3,), "rows": (2, 4), "leaf": bits(), "words": bits((2,)), "least": ()}


@pytest.mark.parametrize(("number", "array"), [(np.float32, Float), (np.float64, Float64)])
def test_what_is_packed_is_read(number, array):
    fields = {k: v for k, v in FIELDS.items() if number is np.float32 or not isinstance(v, bits)}
    record = Record(number, **fields)
    assert record.size == 16  # whole packets
    rng = np.random.default_rng(1)
    values = {
        name: rng.integers(0, 2**32, (5, *shape), dtype=np.uint32)
        if isinstance(shape, bits)
        else rng.normal(size=(5, *shape)).astype(number)
        for name, shape in fields.items()
    }
    packed = record.pack(5, **values)
    assert packed.shape == (5, record.size) and packed.dtype == number
    order = np.array([4, 0, 3], dtype=np.uint32)
    read = record.gather(upload(array, packed), UInt(order))
    for name, expected in values.items():
        found = getattr(read, name)
        found = np.array([[np.array(x) for x in f] if isinstance(f, list) else np.array(f) for f in
                          (found if isinstance(found, list) else [found])])  # fmt: skip
        expected = expected[order].reshape(3, -1).T
        assert np.array_equal(found.reshape(expected.shape), expected), name


def test_a_part_of_a_record():
    record = Record(np.float32, **FIELDS)
    packed = record.pack(2, shift=[[1, 2, 3], [4, 5, 6]])
    read = record.gather(upload(Float, packed), dr.arange(UInt, 2), through="shift")
    assert np.array_equal(np.array(read.shift), [[1, 4], [2, 5], [3, 6]])
    assert not hasattr(read, "words")
    with pytest.raises(ValueError, match="far"):
        record.pack(2, far=1.0)


def test_masks_of_kinds():
    kinds = UInt([int(k) for k in LeafKind])
    for k in LeafKind:
        assert np.flatnonzero(np.array(is_kind(kinds, k))).tolist() == [int(k)]


def test_each_closed_form_is_in_both_tables():
    kinds = [kind for form in CLOSED_FORM_KINDS for kind in form.kinds]
    assert sorted(kinds) == sorted(CLOSED_FORMS)
    assert KINDS.keys() == CLOSED_FORMS
