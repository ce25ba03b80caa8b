"""Numbers on pages: digits follow the error, powers of ten are in print, and nothing breaks within a number."""

from __future__ import annotations

import math
import random
import re

import pytest
import vectors
from markupsafe import Markup

from mistray.estimate import Estimate
from mistray.toolkit.pages.markup import cell, number_cell
from mistray.toolkit.tables.text import SIGNIFICANT, with_error
from mistray.toolkit.typeset import NO_BREAK, typeset, typeset_html, value_and_error

pytestmark = pytest.mark.quick
LOWERED = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹−", "-0123456789-")
EDGES = (0.0, 5e-324, 1e-308, 1.0, 9.9995, 99999.5, 1e308, 1.4e308)


def pairs(count: int = 4000) -> list[tuple[float, float]]:
    """Values and errors of all sizes, edges included."""
    rng = random.Random(7)
    found = [(sign * value, se) for value in EDGES for se in (*EDGES, math.inf, math.nan) for sign in (1, -1)]
    for _ in range(count):
        value = rng.choice((1, -1)) * rng.random() * 10 ** rng.uniform(-307, 307)
        found.append((value, abs(value) * 10 ** rng.uniform(-9, 2)))
    return found


def digits(text: str) -> str:
    """The significant digits of a number as text."""
    return re.sub(r"e.*|\D", "", text).lstrip("0")


@pytest.mark.parametrize("most", [1, 2])
def test_digits_follow_the_error(most):
    """The error is never "0" and has as many digits as it may; the value is right to its last place, and not longer."""
    for value, se in pairs():
        text = with_error(Estimate(value, se), most)
        shown, _, error = text.partition(" ± ")
        if not math.isfinite(se):
            assert error == "?"
            continue
        last = 10.0 ** (int(f"{value:.{SIGNIFICANT - 1}e}".partition("e")[2]) - SIGNIFICANT + 1) if value else 0.0
        assert error or se <= 0.51 * last or value == se == 0, text
        assert not error or float(error) > 0, text
        assert len(digits(shown)) <= SIGNIFICANT or float(error) >= 1, text
        assert len(digits(error)) <= most or float(error) >= 1, text
        size = max(abs(value), se)
        assert abs(float(shown) / size - value / size) <= 0.51 * max(se, last) / size if size else shown == "0", text
        if error and "e" not in text and shown != "0":  # both end at the same place
            assert len(shown.partition(".")[2]) == len(error.partition(".")[2]), text
    assert {with_error(Estimate(value, 1.0)) for value in (math.nan, math.inf, -math.inf)} == {"–"}


def test_a_value_whose_error_is_too_small_to_show_has_all_its_digits():
    """An exact one ends with its last digit; a power of ten never stands without one."""
    for value, se, shown in (
        (1e-4, 1e-12, "1.0000·10⁻⁴"),
        (2.5e-4, 1e-12, "2.5000·10⁻⁴"),
        (1.0, 1e-7, "1.0000"),
        (12.5, 1e-5, "12.500"),
        (12345.0, 0.1, "12345"),
        (1e-4, 0.0, "1.0·10⁻⁴"),
        (-1e6, 0.0, "−1.0·10⁶"),
        (2.5e-4, 0.0, "2.5·10⁻⁴"),
        (0.5, 0.0, "0.5"),
        (0.0, 0.0, "0"),
        (1e-5, math.nan, "1.0·10⁻⁵"),
    ):
        assert value_and_error(with_error(Estimate(value, se)))[0] == shown


def test_numbers_in_print_have_the_same_value_and_sentences():
    for value, se in pairs():
        text = with_error(Estimate(value, se))
        shown = typeset(text)
        assert not re.search(r"\de[+-]?\d| ", shown), shown
        told, error = value_and_error(text)
        plain = re.sub(r"·?10(?=-?\d)(-?\d+)$", r"e\1", told.translate(LOWERED)) if "10" in told and "·" in told else ""
        first, _, second = text.partition(" ± ")
        if plain:
            assert float(plain) == pytest.approx(float(first), rel=1e-3, abs=float(second or 0) if second != "?" else 0)
        assert bool(error) == bool(second)
        assert "<small></small>" not in number_cell(Estimate(value, se))
    for text, shown in vectors.toml("tables.toml")["numbers in print"]:
        assert typeset(text).replace(NO_BREAK, " ") == shown
        assert not re.search(r"\d [±…\dWms]", typeset(text))
    # Names, files and dates are not numbers
    for text in ("wall_1e-03.xml", "L1e-03", "--rays 1e4", "R=1e-3", "2026-11-22", "5-10", "v1.2e-3b"):
        assert typeset(text) == text
    assert typeset_html("<a> 1e-03 of E_det") == "&lt;a&gt; 10⁻³ of E<sub>det</sub>"
    assert typeset_html(Markup("<b title='1e-03'>1e-03</b> &lt;")) == "<b title='1e-03'>10⁻³</b> &lt;"
    assert cell("1.5e-06") == '<td data-v="1.5e-06">1.5·10⁻⁶</td>'
    assert cell("a -> b", "t") == '<td class="t">a -&gt; b</td>'
