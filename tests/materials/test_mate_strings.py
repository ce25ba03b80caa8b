"""Materials of a Zemax coating file by their material string."""

from __future__ import annotations

import pytest

from mistray.errors import MistrayError
from mistray.materials import complex_index, refractive_index, source

FILE = """! coating materials
MATE MGF2
0.40 1.385 0.0
0.60 1.375 -0.001
MATE FLAT
0.55 2.1 -0.02
"""


@pytest.fixture
def path(tmp_path):
    file = tmp_path / "COATING.DAT"
    file.write_text(FILE)
    return file


def test_the_sign_of_k_is_turned_and_tables_are_interpolated(path):
    assert complex_index(f"{path}:mgf2", 500.0) == pytest.approx(1.38 + 0.0005j, abs=1e-14)
    assert complex_index(f"{path}:MGF2 k=0", 500.0).imag == 0
    assert source(f"{path}:MGF2").k_range_nm == pytest.approx((400.0, 600.0))
    with pytest.raises(MistrayError, match="400 … 600 nm"):
        refractive_index(f"{path}:MGF2", 700.0)


def test_one_row_holds_everywhere(path):
    assert complex_index(f"{path}:Flat", 300.0) == complex_index(f"{path}:Flat", 3000.0) == 2.1 + 0.02j


def test_a_material_that_is_not_there(path):
    with pytest.raises(MistrayError, match="no material 'MGF'"):
        complex_index(f"{path}:MGF", 500.0)
    with pytest.raises(MistrayError, match="no material 'zzz'"):
        complex_index(f"{path}:zzz", 500.0)
    with pytest.raises(MistrayError, match=r"nowhere\.dat: No such file"):
        complex_index("nowhere.dat:MGF2", 500.0)
