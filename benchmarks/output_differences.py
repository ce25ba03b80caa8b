"""Differences of two records of outputs: texts must be the same, numbers as far as they are known."""

from __future__ import annotations

import difflib
import itertools
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

EXACT, CLOSE, ERRORS = 1e-9, 1e-5, 3.0  # relative, relative, in standard errors
MOST_SHOWN = 120  # characters of a value
# Differences that are wanted: what the line of one holds, and why
ON_PURPOSE: dict[str, str] = {}

NUMBER = re.compile(r"(?<![\w.])[-+−]?\d+\.?\d*(?:[eE][-+]?\d+)?(?![\w.]*\w)")
ERROR_OF = re.compile(r"_se(?=_|$)")

Told = dict[str, list[str]]
Change = tuple[str, Any, Any]  # place, before, after
_ABSENT = "nothing"


def differences(before: Mapping[str, Any], after: Mapping[str, Any], most: int) -> tuple[Told, Told]:
    """
    Lines for what differs, by call; and those that are on purpose, by their reason.

    Parameters
    ----------
    before, after : mapping
        Records of `same_outputs.py`.
    most : int
        Lines of one call.
    """
    found: Told = {}
    wanted: Told = {}
    for part in ("calls", "options", "signatures"):
        old, new = before[part], after[part]
        for name in [*old, *(one for one in new if one not in old)]:
            exact = part != "calls" or name.split()[0] in after["exact"]
            lines = []
            for place, a, b in unlike(old.get(name, _ABSENT), new.get(name, _ABSENT), exact):
                line = f"{name}: {place or part}: {_shown(a)} → {_shown(b)}"
                reason = next((why for what, why in ON_PURPOSE.items() if re.search(what, line)), None)
                (lines if reason is None else wanted.setdefault(reason, [])).append(line)
            if lines:
                more = [f"{name}: and {len(lines) - most} more"] if len(lines) > most else []
                found[f"{part} {name}"] = lines[:most] + more
    return found, wanted


def unlike(a: Any, b: Any, exact: bool, place: str = "", errors: tuple[Any, Any] = (0.0, 0.0)) -> Iterator[Change]:
    """
    What differs between two values of JSON.

    Parameters
    ----------
    a, b
    exact : bool
        Whether numbers have no error that is not told.
    place : str
        What they are.
    errors : tuple
        Standard errors of the numbers, of the same form.
    """
    if isinstance(a, dict) and isinstance(b, dict):
        yield from _unlike_tables(a, b, exact, place)
    elif isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
        for k, (one, other) in enumerate(zip(a, b, strict=True)):
            both = tuple(se[k] if isinstance(se, list) and len(se) > k else 0.0 for se in errors)
            yield from unlike(one, other, exact, f"{place}[{k}]", both)
    elif isinstance(a, str) and isinstance(b, str):
        yield from _unlike_texts(a, b, exact, place)
    elif _is_number(a) and _is_number(b):
        if not _agree(a, b, errors, exact):
            yield place, a, b
    elif a != b:
        yield place, a, b


def _unlike_tables(a: dict[str, Any], b: dict[str, Any], exact: bool, place: str) -> Iterator[Change]:
    """What differs between two objects; an error X_se is that of X beside it."""
    by_value = {ERROR_OF.sub("", key) if key != "se" else "value": key for key in a if "se" in key.split("_")}
    for key in [*a, *(key for key in b if key not in a)]:
        where = f"{place}.{key}" if place else key
        if key not in a or key not in b:
            yield where, a.get(key, _ABSENT), b.get(key, _ABSENT)
            continue
        error = by_value.get(key)
        if key in by_value.values():  # an error has none of its own: as the values are, so may it be
            yield from _unlike_errors(a[key], b[key], exact, where)
        else:
            yield from unlike(a[key], b[key], exact, where, (a.get(error, 0.0), b.get(error, 0.0)) if error else (0, 0))
    if list(a) != list(b) and a.keys() == b.keys():
        yield f"{place}: order", ", ".join(a), ", ".join(b)


def _unlike_errors(a: Any, b: Any, exact: bool, place: str) -> Iterator[Change]:
    """What differs between standard errors by more than a half."""
    if _is_number(a) and _is_number(b) and not exact:
        if abs(a - b) > 0.5 * max(abs(a), abs(b)):
            yield place, a, b
    elif isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
        for k, (one, other) in enumerate(zip(a, b, strict=True)):
            yield from _unlike_errors(one, other, exact, f"{place}[{k}]")
    else:
        yield from unlike(a, b, exact, place)


def _unlike_texts(a: str, b: str, exact: bool, place: str) -> Iterator[Change]:
    """Lines that differ; lines that are alike but for numbers are compared by these."""
    old, new = a.splitlines(), b.splitlines()
    matcher = difflib.SequenceMatcher(None, *([NUMBER.sub("#", line) for line in lines] for lines in (old, new)), False)
    several = len(old) > 1 or len(new) > 1
    for what, i, i_end, j, j_end in matcher.get_opcodes():
        pairs = max(i_end - i, j_end - j)
        for k in range(pairs):
            one = old[i + k] if i + k < i_end else _ABSENT
            other = new[j + k] if j + k < j_end else _ABSENT
            if what != "equal" or not _same_numbers(one, other, exact):
                yield (f"{place} line {i + k + 1}" if several else place), one, other


def _same_numbers(a: str, b: str, exact: bool) -> bool:
    """Whether the numbers of two texts agree; behind ± stands the error of the one before."""
    if a == b:
        return True
    found = [list(NUMBER.finditer(text)) for text in (a, b)]
    values = [[float(one[0].replace("−", "-")) for one in tokens] for tokens in found]
    told = [_errors(text, tokens) for text, tokens in zip((a, b), found, strict=True)]
    return all(
        any(se is None for se in ses) or _agree(*pair, ses, exact)
        for pair, ses in zip(zip(*values, strict=True), zip(*told, strict=True), strict=True)
    )


def _errors(text: str, tokens: Sequence[re.Match[str]]) -> list[float | None]:
    """The error of each number of a text; None for errors themselves."""
    between = [text[one.end() : after.start()].strip() for one, after in itertools.pairwise(tokens)]
    found: list[float | None] = [0.0] * len(tokens)
    for k, words in enumerate(between):
        if words == "±":
            found[k], found[k + 1] = float(tokens[k + 1][0]), None
    return found


def _agree(a: float, b: float, errors: Sequence[Any], exact: bool) -> bool:
    if a == b or (math.isnan(a) and math.isnan(b)):
        return True
    ses = [se for se in errors if _is_number(se) and math.isfinite(se)]
    relative = EXACT if exact else CLOSE
    return abs(a - b) <= max(relative * max(abs(a), abs(b)), ERRORS * math.hypot(*ses))


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _shown(value: Any) -> str:
    text = value if isinstance(value, str) else repr(value)
    return text if len(text) <= MOST_SHOWN else f"{text[: MOST_SHOWN - 1]}…"
