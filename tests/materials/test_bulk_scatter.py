"""The suffixes ``scatter=`` and ``g=`` of a material string."""

from __future__ import annotations

import re

import pytest

from mistray.errors import MistrayError
from mistray.materials import BulkScatter, bulk_scatter, complex_index, refractive_index


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("N-BK7", BulkScatter()),
        ("N-BK7 scatter=0.01", BulkScatter(0.01, 0.0)),
        ("nd=1.544 Vd=56.1 k=0 scatter=1e-3 g=0.9", BulkScatter(1e-3, 0.9)),
        ("1.5 g=-0.5 scatter=2 extrapolate", BulkScatter(2.0, -0.5)),
    ],
)
def test_strings(text: str, expected: BulkScatter) -> None:
    assert bulk_scatter(text) == expected


def test_the_index_is_that_of_the_material() -> None:
    assert refractive_index("N-BK7 scatter=0.01 g=0.9", 550.0) == refractive_index("N-BK7", 550.0)
    assert complex_index("1.5+0.01i scatter=0.01", 550.0) == 1.5 + 0.01j


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1.5 g=0.9", "'g=' without 'scatter='"),
        ("1.5 scatter=much", "scatter = 'much' is no number"),
        ("1.5 scatter=-1", "scatter is -1; it must lie"),
        ("1.5 scatter=1 g=1", "g = 1; the mean cosine"),
        ("1.5 scatter=1 scatter=2", "'scatter=' is given twice"),
    ],
)
def test_bad_input(text: str, message: str) -> None:
    with pytest.raises(MistrayError, match=re.escape(message)):
        bulk_scatter(text)
