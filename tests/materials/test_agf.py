"""Zemax AGF files and a user's CSV tables: indices, transmittances, encodings, and lines that are wrong."""

import cmath
import math

import pytest
from oracles import glass
from refusals import refused

from mistray.materials import LINE_D_NM, complex_index, refractive_index, source
from mistray.materials.formulas import AGF_FORMULAS

N_BK7 = """NM N-BK7 2 517642.251 1.5168 64.17 0 1 1
GC step 0.5 available
ED 7.1 8.3 2.51 -0.0009 0
CD 1.03961212E+00 6.00069867E-03 2.31792344E-01 2.00179144E-02 1.01046945E+00 1.03560653E+02 0 0 0 0
TD 1.86E-06 1.31E-08 -1.37E-11 4.34E-07 6.27E-10 0.17 20
OD 1.00 1.0 0.0 1.0 2.3 2.3
LD 0.3 2.5
IT 0.35 0.920 25.0
IT 0.40 0.992 25.0
IT 0.50 0.998 25.0
"""
HEAD = N_BK7.partition("IT")[0]


@pytest.fixture
def write(tmp_path):
    """Write a file and give the material string of one of its glasses."""

    def write(text, name="N-BK7", encoding="utf-8"):
        path = tmp_path / "makers.agf"
        path.write_bytes(text.encode(encoding))
        return f"{path}:{name}"

    return write


def k_of(transmittance, thickness_mm, wavelength_nm):
    return -wavelength_nm * 1e-6 * math.log(transmittance) / (4 * math.pi * thickness_mm)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "latin-1"])
def test_index_and_transmittance_in_every_encoding(write, encoding):
    """The accent makes Latin-1 differ from UTF-8."""
    text = f"CC Test catalogue\n! a remarqué\n{N_BK7}".replace("\n", "\r\n")
    material = write(text, encoding=encoding)
    assert refractive_index(material, LINE_D_NM) == pytest.approx(glass.refractive_index("N-BK7", LINE_D_NM), abs=1e-12)
    assert complex_index(material, 400.0).imag == pytest.approx(k_of(0.992, 25, 400), rel=1e-12)
    assert (source(material).n_range_nm, source(material).k_range_nm) == ((300.0, 2500.0), (350.0, 500.0))


def test_k_is_interpolated_and_absorbs(write):
    """Linear in k; the field exp(i 2π N z/λ) must fall with z, which fixes the sign."""
    material = write(N_BK7)
    n = complex_index(material, 375.0)
    assert n.imag == pytest.approx((k_of(0.92, 25, 350) + k_of(0.992, 25, 400)) / 2, rel=1e-12)
    assert 0.92 < abs(cmath.exp(2j * math.pi * n * 25.0 / 375e-6)) ** 2 < 0.992
    with refused("300 … 2500 nm"):
        refractive_index(material, 280.0)
    with refused(r"k of material .* outside its 350 … 500 nm"):
        complex_index(material, 600.0)
    assert complex_index(material + " extrapolate", 600.0).imag == complex_index(material, 500.0).imag


@pytest.mark.parametrize("order", [1, -1])
def test_of_two_thicknesses_the_more_exact_counts(write, order):
    """T × thickness: 25 mm where the glass is clear, 10 mm where little is left after 25 mm."""
    lines = ["IT 0.40 0.997 10.0", "IT 0.40 0.992 25.0", "IT 0.33 0.10 10.0", "IT 0.33 0.003 25.0"]
    material = write(HEAD + "\n".join(lines[::order]))
    assert complex_index(material, 400.0).imag == pytest.approx(k_of(0.992, 25, 400), rel=1e-12)
    assert complex_index(material, 330.0).imag == pytest.approx(k_of(0.10, 10, 330), rel=1e-12)


def test_transmittances_that_tell_no_k(write):
    """Exactly 1, none at all, and the 0 of a filter glass, which says that k is large, not how large."""
    assert source(write(N_BK7 + "IT 0.60 1.0 25.0\n")).k_range_nm == (350.0, 500.0)
    for lines in ("IT 0.4 1.0 10\nIT 0.7 1.0 10\n", ""):
        with refused("k is unknown"):
            complex_index(write(HEAD + lines), 550.0)
    assert complex_index(f"{write(HEAD)} k=1e-8", 550.0).imag == 1e-8
    material = write(N_BK7 + "IT 0.42 0.0 25.0\n")
    for wavelength_nm in (401.0, 420.0, 499.0):
        with refused("have no value at"):
            complex_index(material, wavelength_nm)
    assert complex_index(material, 400.0).imag == pytest.approx(k_of(0.992, 25, 400), rel=1e-12)


def test_a_glass_among_others(write):
    """Whatever capitals and wrong lines; coefficients may go on in the next line; a changed file is read again."""
    other = N_BK7.replace("N-BK7", "OTHER").replace("1.03961212E+00", "1.2")
    own = N_BK7.replace(" 2.00179144E-02", "\n 2.00179144E-02")
    text = other + own + "NM BAD 77 0 1.5 60\nCD one two\n"
    assert refractive_index(write(text, "n-bk7"), LINE_D_NM) == pytest.approx(1.5168, abs=1e-5)
    assert refractive_index(write(text, "Other"), LINE_D_NM) > 1.56
    for name in ("N-BK8", "zzz"):
        with refused(f"no glass '{name}'"):
            refractive_index(write(text, name), LINE_D_NM)
    material = write(text.replace("1.03961212E+00", "1.13961212E+00"))
    assert refractive_index(material, LINE_D_NM) > 1.5268


@pytest.mark.parametrize("number", AGF_FORMULAS)
def test_every_formula_is_read_from_a_file(write, number):
    _, count, formula = AGF_FORMULAS[number]
    c = [2.3, *(0.01 + 0.001 * i for i in range(count - 1))]
    line = " ".join(str(v) for v in c)
    text = f"NM X {number} 0 1.5 60\nCD {line}{' 0' * (10 - count)}\nLD 0.4 0.7\n"
    assert refractive_index(write(text, "X"), 550.0) == pytest.approx(formula(c, 0.55), rel=1e-15)


@pytest.fixture
def write_csv(tmp_path):
    def write_csv(text):
        (tmp_path / "my glass.csv").write_text(text, encoding="utf-8")
        return str(tmp_path / "my glass.csv")

    return write_csv


def test_n_and_k_are_interpolated(write_csv):
    material = write_csv("# measured\nwavelength_nm,n,k\n500,1.52,1e-7\n\n400,1.54,3e-7\n# end\n600,1.51,0\n")
    assert complex_index(material, 450.0) == pytest.approx(1.53 + 2e-7j, abs=1e-14)
    assert complex_index(material, 600.0) == 1.51
    assert source(material).n_range_nm == source(material).k_range_nm == (400.0, 600.0)
    with refused("400 … 600 nm"):
        refractive_index(material, 399.0)
    assert complex_index(f"{material} extrapolate", 300.0) == 1.54 + 3e-7j
    assert complex_index(f"{material} k=0", 450.0).imag == 0


def test_columns_in_any_order_and_no_k(write_csv):
    material = write_csv("\ufeffn, wavelength_nm\n1.5, 400\n1.4, 600\n")
    assert refractive_index(material, 500.0) == pytest.approx(1.45, abs=1e-15)
    with refused(r"k is unknown.*append ' k=0'"):
        complex_index(material, 500.0)
    material = write_csv("wavelength_nm,n\n589.3,1.498\n")
    assert refractive_index(material, 589.3) == refractive_index(f"{material} extrapolate", 550.0) == 1.498
    with refused(r"589.3 … 589.3 nm"):
        refractive_index(material, 550.0)


@pytest.mark.parametrize(("step", "error"), [(20, 3.5e-4), (10, 1e-4)])
def test_error_of_the_interpolation_is_as_documented(write_csv, step, error):
    """N-SF6, in the middle of the first step from 400 nm."""
    rows = [f"{nm},{glass.refractive_index('N-SF6', nm)}" for nm in range(400, 701, step)]
    at = 400 + step / 2
    found = refractive_index(write_csv("wavelength_nm,n\n" + "\n".join(rows)), at)
    assert found - glass.refractive_index("N-SF6", at) == pytest.approx(error, rel=0.1)
