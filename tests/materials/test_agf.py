"""Materials as users give them: Zemax AGF files, CSV tables and strings, and what is said about wrong ones."""

import cmath
import math

import numpy as np
import pytest
import vectors
from oracles import glass
from oracles.small_scenes import write as write_file
from refusals import refused

from mistray import materials
from mistray.materials import LINE_C_NM, LINE_D_NM, LINE_F_NM, BulkScatter, complex_index, refractive_index, source
from mistray.materials.formulas import AGF_FORMULAS

N_BK7 = vectors.text("n_bk7.agf")
HEAD = N_BK7.partition("IT")[0]


@pytest.fixture
def write(tmp_path):
    """Write a file and give the material string of one of its glasses."""

    def write(text, name="N-BK7", encoding="utf-8"):
        return f"{write_file(tmp_path, text.encode(encoding), 'makers.agf')}:{name}"

    return write


def k_of(transmittance, thickness_mm, wavelength_nm):
    return -wavelength_nm * 1e-6 * math.log(transmittance) / (4 * math.pi * thickness_mm)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "latin-1"])
def test_index_and_transmittance_in_every_encoding(write, encoding):
    """The accent makes Latin-1 differ from UTF-8."""
    material = write(f"CC Test catalogue\n! a remarqué\n{N_BK7}".replace("\n", "\r\n"), encoding=encoding)
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


def test_transmittances_without_k_and_a_glass_among_others(write):
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
    # Whatever capitals and wrong lines; coefficients may go on in the next line; a changed file is read again
    other = N_BK7.replace("N-BK7", "OTHER").replace("1.03961212E+00", "1.2")
    text = other + N_BK7.replace(" 2.00179144E-02", "\n 2.00179144E-02") + "NM BAD 77 0 1.5 60\nCD one two\n"
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
        return str(write_file(tmp_path, text, "my glass.csv"))

    return write_csv


def test_columns_of_a_table_are_interpolated(write_csv):
    material = write_csv("# measured\nwavelength_nm,n,k\n500,1.52,1e-7\n\n400,1.54,3e-7\n# end\n600,1.51,0\n")
    assert complex_index(material, 450.0) == pytest.approx(1.53 + 2e-7j, abs=1e-14)
    assert complex_index(material, 600.0) == 1.51
    assert source(material).n_range_nm == source(material).k_range_nm == (400.0, 600.0)
    with refused("400 … 600 nm"):
        refractive_index(material, 399.0)
    assert complex_index(f"{material} extrapolate", 300.0) == 1.54 + 3e-7j
    assert complex_index(f"{material} k=0", 450.0).imag == 0
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


@pytest.mark.parametrize(
    ("text", "n"),
    [("air", 1), (" Vacuum ", 1), ("1.5168", 1.5168), ("1", 1), ("0.99971", 0.99971), ("1.5+0.01i", 1.5 + 0.01j),
     ("0.958 + 6.69j", 0.958 + 6.69j), ("1.5 k=1e-7", 1.5 + 1e-7j), ("air k=2e-9", 1 + 2e-9j),
     ("nd=1.544 Vd=56.1 k=0", 1.544), ("ND = 1.544, VD = 56.1  K = 3e-8", 1.544 + 3e-8j),
     ("1.5+0i", 1.5), ("2e0+.5i", 2 + 0.5j)],
)  # fmt: skip
def test_numbers(text, n):
    assert complex_index(text, LINE_D_NM) == pytest.approx(n, abs=1e-15)
    assert refractive_index(text, LINE_D_NM) == pytest.approx(complex(n).real, abs=1e-15)
    if "VD" not in text.upper():  # constants hold everywhere
        assert complex_index(text, 10.0) == complex_index(text, 1e6) == complex_index(f"{text} extrapolate", 1e6)


def test_nd_and_vd_come_back_and_tables_are_linear():
    nd, nf, nc = (refractive_index("nd=1.632 Vd=23.3", line) for line in (LINE_D_NM, LINE_F_NM, LINE_C_NM))
    assert (nd, (nd - 1) / (nf - nc)) == (pytest.approx(1.632, abs=1e-15), pytest.approx(23.3, rel=1e-12))
    text = "n(587.6)=1.53116 n(486.1)=1.5378 k=0"
    assert complex_index(text, 587.6) == 1.53116
    assert complex_index(text, 536.85) == pytest.approx((1.53116 + 1.5378) / 2, abs=1e-15)
    assert refractive_index("n( 550 ) = 1.5", 550.0) == refractive_index("n(550)=1.5 extrapolate", 800.0) == 1.5
    assert not source(text).page
    metal = "n(500)=0.2 k(500)=3 n(600)=0.3 k(700)=4"
    assert complex_index(metal, 550.0) == pytest.approx(0.25 + 3.25j, abs=1e-15)
    assert source(metal).k_range_nm == (500.0, 700.0)
    with refused("k of material .* 700 nm; append ' k=VALUE'"):
        complex_index("n(800)=0.2 k(500)=3 k(700)=4", 800.0)
    assert complex_index("n(500)=0.2 n(600)=0.3 k=3", 550.0) == pytest.approx(0.25 + 3j, abs=1e-15)


def test_an_explicit_k_a_shift_of_n_and_extrapolation():
    """With other suffixes before or behind it."""
    assert complex_index("N-BK7", 400.0).imag > 0
    assert complex_index("N-BK7 k=0", 400.0) == complex_index("N-BK7", 400.0).real
    assert complex_index("PMMA k=0", 550.0).imag == 0
    expected = complex(refractive_index("N-BK7 Extrapolate", 280.0), 2e-7)
    for text in ("N-BK7 k=2e-7 extrapolate", "N-BK7   extrapolate k=2e-7"):
        assert complex_index(text, 280.0) == expected
    n, k = refractive_index("N-BK7", 550.0), complex_index("N-BK7", 550.0).imag
    assert complex_index("N-BK7 shift=-2e-3", 550.0) == complex(n - 2e-3, k)
    assert refractive_index("SCHOTT/N-BK7 shift = 0.25 k=0", 550.0) == n + 0.25
    assert refractive_index("air shift=-1e-4", 550.0) == 1 - 1e-4  # not an error, though glass has n of at least 1
    assert materials.shifted("N-BK7", 0.0) == materials.shifted("N-BK7 shift=0.5", -0.5) == "N-BK7"
    assert materials.shifted("N-BK7 k=0", np.float64(1e-5)) == "N-BK7 k=0 shift=1e-05"
    assert materials.shifted(" N-BK7 shift=0.5 k=0", 0.25) == "N-BK7 k=0 shift=0.75"
    # N-BK7 from 300 nm on: at 280 nm its Sellmeier formula and the k of 300 nm; a table of n keeps its end, too
    assert refractive_index("N-BK7 extrapolate", 280.0) == pytest.approx(glass.refractive_index("N-BK7", 280.0), 1e-12)
    assert complex_index("N-BK7 extrapolate", 280.0).imag == complex_index("N-BK7", 300.0).imag
    assert complex_index("Ag extrapolate", 5000.0) == complex_index("Ag", source("Ag").n_range_nm[1])
    assert refractive_index("nd=1.5 Vd=60 extrapolate", 350.0) > refractive_index("nd=1.5 Vd=60", 400.0)


@pytest.mark.parametrize(("text", "wavelength_nm", "message"), vectors.toml("material_refusals.toml")["refused"])
def test_errors_name_the_remedy(text, wavelength_nm, message):
    for function in (refractive_index, complex_index):
        with refused(message):
            function(text, wavelength_nm)


def test_scatter_in_the_volume():
    """The index is that of the material."""
    for text, material, expected in (
        ("N-BK7", "N-BK7", BulkScatter()),
        ("N-BK7 scatter=0.01", "N-BK7", BulkScatter(0.01, 0.0)),
        ("nd=1.544 Vd=56.1 k=0 scatter=1e-3 g=0.9", "nd=1.544 Vd=56.1", BulkScatter(1e-3, 0.9)),
        ("1.5 g=-0.5 scatter=2 extrapolate", "1.5", BulkScatter(2.0, -0.5)),
    ):
        assert materials.bulk_scatter(text) == expected
        assert refractive_index(text, 550.0) == refractive_index(material, 550.0)


@pytest.mark.parametrize("text", ["PMMA", "nd=1.544 Vd=56.1", "sapphire", "BSL7", "ohara/BSL7"])
def test_an_unknown_k_is_an_error_and_not_zero(text):
    """BSL7: its page has k = 0 at every wavelength, for want of data."""
    assert refractive_index(text, 550.0) > 1.4
    with refused(r"k is unknown.*append ' k=0'"):
        complex_index(text, 550.0)
    assert not source(text).k_known


def test_k_has_its_own_range():
    """YbF3: n from 400 to 14000 nm, k from 9016.8 nm on."""
    assert (source("YbF3").n_range_nm, source("YbF3").k_range_nm) == ((400.0, 14000.0), (9016.8, 13975.0))
    assert refractive_index("YbF3", 2000.0) == pytest.approx(1.49, abs=0.02)
    with refused(r"k of material 'YbF3': 2000 nm is outside its 9016\.8 … 13975 nm"):
        complex_index("YbF3", 2000.0)
    assert complex_index("YbF3 extrapolate", 2000.0).imag == complex_index("YbF3", 9016.8).imag
    assert complex_index("YbF3 k=0", 2000.0).imag == 0


@pytest.mark.parametrize(("text", "expected"), vectors.toml("tables.toml")["places of files"])
def test_resolved(text, expected):
    assert materials.resolved(text, lambda path: f"/data/{path}") == expected
