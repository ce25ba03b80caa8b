"""A user's CSV table of n and k."""

from __future__ import annotations

import pytest
from oracles import glass
from refusals import refused

from mistray.materials import complex_index, refractive_index, source


@pytest.fixture
def write(tmp_path):
    def write(text):
        (tmp_path / "my glass.csv").write_text(text, encoding="utf-8")
        return str(tmp_path / "my glass.csv")

    return write


def test_n_and_k_are_interpolated(write):
    material = write("# measured\nwavelength_nm,n,k\n500,1.52,1e-7\n\n400,1.54,3e-7\n# end\n600,1.51,0\n")
    assert complex_index(material, 450.0) == pytest.approx(1.53 + 2e-7j, abs=1e-14)
    assert complex_index(material, 600.0) == 1.51
    assert source(material).n_range_nm == source(material).k_range_nm == (400.0, 600.0)
    with refused("400 … 600 nm"):
        refractive_index(material, 399.0)
    assert complex_index(f"{material} extrapolate", 300.0) == 1.54 + 3e-7j
    assert complex_index(f"{material} k=0", 450.0).imag == 0


def test_columns_in_any_order_and_no_k(write):
    material = write("\ufeffn, wavelength_nm\n1.5, 400\n1.4, 600\n")
    assert refractive_index(material, 500.0) == pytest.approx(1.45, abs=1e-15)
    with refused(r"k is unknown.*append ' k=0'"):
        complex_index(material, 500.0)
    material = write("wavelength_nm,n\n589.3,1.498\n")
    assert refractive_index(material, 589.3) == refractive_index(f"{material} extrapolate", 550.0) == 1.498
    with refused(r"589.3 … 589.3 nm"):
        refractive_index(material, 550.0)


@pytest.mark.parametrize(("step", "error"), [(20, 3.5e-4), (10, 1e-4)])
def test_error_of_the_interpolation_is_as_documented(write, step, error):
    """N-SF6, in the middle of the first step from 400 nm."""
    rows = [f"{nm},{glass.refractive_index('N-SF6', nm)}" for nm in range(400, 701, step)]
    at = 400 + step / 2
    found = refractive_index(write("wavelength_nm,n\n" + "\n".join(rows)), at)
    assert found - glass.refractive_index("N-SF6", at) == pytest.approx(error, rel=0.1)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("wavelength_nm,n\n", "no rows"),
        ("wavelength,n\n400,1.5\n", "line 1: columns 'wavelength,n'; it needs wavelength_nm,n"),
        ("wavelength_nm,n,n\n400,1.5,1\n", "line 1: columns"),
        ("wavelength_nm,n\n400,1.5\n500,x\n", "line 3: n = 'x' is no number"),
        ("# note\n\nwavelength_nm,n\n400,1.5,2\n", "line 4: 3 cells for 2 columns"),
        ("wavelength_nm,n\n400,1.5\n400,1.6\n", "line 3: wavelength 400 nm is there twice"),
        ("wavelength_nm,n\n-400,1.5\n", "line 2: wavelength_nm = -400; it must be finite and greater than 0"),
        ("wavelength_nm,n\n400,nan\n", "line 2: n = nan"),
        ("wavelength_nm,n,k\n400,1.5,-1e-7\n", r"line 2: k = -1e-07; it must be finite and at least 0 \(n \+ ik"),
    ],
)
def test_wrong_rows_are_named(write, text, message):
    with refused(f"my glass.csv'? ?.*{message}"):
        complex_index(write(text), 450.0)
