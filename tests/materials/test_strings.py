"""What a material string may be, and what is said about a wrong one."""

import pytest
import vectors
from oracles import glass
from refusals import refused

from mistray.materials import (
    LINE_C_NM,
    LINE_D_NM,
    LINE_F_NM,
    BulkScatter,
    bulk_scatter,
    complex_index,
    refractive_index,
    resolved,
    shifted,
    source,
)


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
    assert nd == pytest.approx(1.632, abs=1e-15)
    assert (nd - 1) / (nf - nc) == pytest.approx(23.3, rel=1e-12)
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


def test_an_explicit_k_replaces_that_of_the_data():
    """With other suffixes before or behind it."""
    assert complex_index("N-BK7", 400.0).imag > 0
    assert complex_index("N-BK7 k=0", 400.0) == complex_index("N-BK7", 400.0).real
    assert complex_index("PMMA k=0", 550.0).imag == 0
    expected = complex(refractive_index("N-BK7 Extrapolate", 280.0), 2e-7)
    for text in ("N-BK7 k=2e-7 extrapolate", "N-BK7   extrapolate k=2e-7"):
        assert complex_index(text, 280.0) == expected


def test_a_shift_is_added_to_n():
    n, k = refractive_index("N-BK7", 550.0), complex_index("N-BK7", 550.0).imag
    assert complex_index("N-BK7 shift=-2e-3", 550.0) == complex(n - 2e-3, k)
    assert refractive_index("SCHOTT/N-BK7 shift = 0.25 k=0", 550.0) == n + 0.25
    assert refractive_index("air shift=-1e-4", 550.0) == 1 - 1e-4  # not an error, though glass has n of at least 1
    assert shifted("N-BK7", 0.0) == "N-BK7"
    assert shifted("N-BK7 k=0", 1e-5) == "N-BK7 k=0 shift=1e-05"
    assert shifted(" N-BK7 shift=0.5 k=0", 0.25) == "N-BK7 k=0 shift=0.75"
    assert shifted("N-BK7 shift=0.5", -0.5) == "N-BK7"


def test_extrapolation_goes_on_with_the_formula_and_keeps_the_end_of_a_table():
    """N-BK7 from 300 nm on: at 280 nm its Sellmeier formula and the k of 300 nm; a table of n keeps its end, too."""
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
        assert bulk_scatter(text) == expected
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
    assert source("YbF3").n_range_nm == (400.0, 14000.0)
    assert source("YbF3").k_range_nm == (9016.8, 13975.0)
    assert refractive_index("YbF3", 2000.0) == pytest.approx(1.49, abs=0.02)
    with refused(r"k of material 'YbF3': 2000 nm is outside its 9016\.8 … 13975 nm"):
        complex_index("YbF3", 2000.0)
    assert complex_index("YbF3 extrapolate", 2000.0).imag == complex_index("YbF3", 9016.8).imag
    assert complex_index("YbF3 k=0", 2000.0).imag == 0


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("N-BK7 k=0", "N-BK7 k=0"),
        ("My Glass.CSV  k=1e-7 extrapolate", "/data/My Glass.CSV  k=1e-7 extrapolate"),
        ("a/makers.agf:N-BK7", "/data/a/makers.agf:N-BK7"),
        ("C:/a.AGF:F2 extrapolate", "/data/C:/a.AGF:F2 extrapolate"),
        ("COATING.DAT:MGF2 k=0", "/data/COATING.DAT:MGF2 k=0"),
    ],
)
def test_resolved(text, expected):
    assert resolved(text, lambda path: f"/data/{path}") == expected
