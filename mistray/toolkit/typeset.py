"""Numbers in print: powers of ten instead of exponents of a program, and no line break within a number or its unit."""

from __future__ import annotations

import re
from decimal import ROUND_HALF_EVEN, Decimal

from markupsafe import Markup, escape

NO_BREAK = "\u00a0"
_NUMBER = r"(-?\d+(?:\.\d+)?)e([+-]\d{2,3})"  # as Python formats it: who writes 1e4 means an option or a name
_BEFORE, _AFTER = r"(?<![\w.,+-])", r"(?!\.?\w)"
_PAIR = re.compile(rf"{_BEFORE}{_NUMBER} ± {_NUMBER}{_AFTER}")
_SINGLE = re.compile(rf"{_BEFORE}{_NUMBER}{_AFTER}")
_SIGNS = re.compile(r"(?<=[\d)⁰¹²³⁴⁵⁶⁷⁸⁹]) ([±…×→]) (?=[-−(]?[\d?])")
_UNITS = (
    "%|°|deg|mm|µm|nm|cm|m|mW|µW|W|lm|lx|cd|sr|rad|mrad|µrad|K|ms|s|min|h|MB|GB|px|lp|waves|times|bytes|pixels|"
    "rays|start rays|paths|segments|decades"
)
_UNIT = re.compile(rf"(?<=[\d)⁰¹²³⁴⁵⁶⁷⁸⁹]) (?=(?:{_UNITS})(?![A-Za-zµ_]))")
_THOUSANDS = re.compile(r"(?<=\d) (?=\d{3}(?!\d))")
_MINUS = re.compile(r"(?<![\w.)\]°'\"⁰¹²³⁴⁵⁶⁷⁸⁹-])-(?=\d)")
_SUBSCRIPT = re.compile(r"\bE_(det|⊥)")
_TAG = re.compile(r"(<[^>]*>)")
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def power_of_ten(exponent: int) -> str:
    """Return a power of ten as printed, such as "10⁻³"."""
    return f"10{str(exponent).translate(_RAISED)}"


def typeset(text: str) -> str:
    """
    Return text with its numbers as in print: "1.2e-06 ± 3e-08 W" becomes "(1.20 ± 0.03)·10⁻⁶ W".

    Blanks within a number and before its unit become no-break spaces. A hyphen before a number becomes a minus sign,
    and "log10" becomes "log₁₀"; other words remain unchanged.
    """
    text = _PAIR.sub(_pair, text)
    text = _SINGLE.sub(lambda found: _single(found[1], int(found[2])), text)
    text = _THOUSANDS.sub(NO_BREAK, text)
    text = _SIGNS.sub(rf"{NO_BREAK}\1{NO_BREAK}", text)
    text = _UNIT.sub(NO_BREAK, text)
    return _MINUS.sub("−", text).replace("log10", "log₁₀")


def typeset_html(text: str) -> Markup:
    """Return text, escaped, or `Markup` with its tags, as HTML with its numbers as in print, see `typeset`."""
    pieces = _TAG.split(text) if isinstance(text, Markup) else [str(escape(text))]
    whole = "".join(piece if piece.startswith("<") else typeset(piece) for piece in pieces)
    return Markup(_SUBSCRIPT.sub(r"E<sub>\1</sub>", whole))


def value_and_error(text: str) -> tuple[str, str]:
    """
    Return the value, and the error with its sign ±, as in print, from a number as `with_error` writes it.

    The error is empty if there is none.
    """
    pair = _PAIR.fullmatch(text)
    if pair is None:
        value, _, error = text.partition(" ± ")
        return typeset(value), f"±{NO_BREAK}{typeset(error)}" if error else ""
    value, error, power = _on_one_power(pair)
    return typeset(f"{value}·{power}"), f"±{NO_BREAK}{error}·{power}"


def _pair(found: re.Match[str]) -> str:
    """Return a value and its error on one power of ten."""
    value, error, power = _on_one_power(found)
    return f"({value} ± {error})·{power}"


def _on_one_power(found: re.Match[str]) -> tuple[str, str, str]:
    """Return a match of `_PAIR` as value and error, both over the larger of their powers of ten, and that power."""
    exponent = max(int(found[2]), int(found[4]))
    value, error = (Decimal(f"{found[k]}e{found[k + 1]}").scaleb(-exponent) for k in (1, 3))
    return f"{value.quantize(error, ROUND_HALF_EVEN):f}", f"{error:f}", power_of_ten(exponent)


def _single(mantissa: str, exponent: int) -> str:
    power = power_of_ten(exponent)
    return mantissa.replace("1", power) if mantissa in ("1", "-1") else f"{mantissa}·{power}"
