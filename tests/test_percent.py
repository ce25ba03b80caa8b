"""Shares as texts in percent."""

from __future__ import annotations

import pytest

from mistray.percent import percent_text

pytestmark = pytest.mark.quick


@pytest.mark.parametrize(
    ("share", "digits", "text"),
    [
        (0.0, 2, "0 %"),
        (0.00312, 2, "0.31 %"),
        (0.12345, 3, "12.3 %"),
        (0.9949, 2, "99 %"),
        (0.997, 2, "100 %"),
        (1.0, 3, "100 %"),
        (12.34, 2, "1234 %"),
        (-1.5, 2, "-150 %"),
        (1e-12, 2, "1e-10 %"),
        (float("inf"), 2, "– %"),
        (float("nan"), 2, "– %"),
    ],
)
def test_no_exponent_where_a_share_is_large(share: float, digits: int, text: str) -> None:
    assert percent_text(share, digits) == text
