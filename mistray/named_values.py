"""Strings of the form ``name=value``, as they stand in options, scene files and dicts."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable

from mistray.errors import MistrayError, nearest


def name_and_value(text: str) -> tuple[str, str] | None:
    """Return both sides of the first ``=``, without spaces around them; None if there is no ``=``, or no name."""
    name, sign, value = (part.strip() for part in text.partition("="))
    return (name, value) if sign and name else None


def named_values(
    parts: Iterable[str], owner: str, known: Collection[str] = (), like: str = "name=value"
) -> dict[str, str]:
    """
    Parse strings of the form ``name=value`` into a dict from name to value, both strings.

    Parameters
    ----------
    parts : iterable of str
        Strings ``name=value``.
    owner : str
        Owner of the values, for the start of messages.
    known : collection of str
        Allowed names; empty: all are.
    like : str
        Example of a valid text, for messages.

    Raises
    ------
    MistrayError
        If a string is not of the form ``name=value``, or a name is unknown or given twice.
    """
    found: dict[str, str] = {}
    for part in parts:
        pair = name_and_value(part)
        if pair is None:
            raise MistrayError(f"{owner}: '{part}' has no name; write {like}")
        name, value = pair
        if known and name not in known:
            raise MistrayError(f"{owner}: '{name}' is not one of its names; {nearest(name, known)}")
        if name in found:
            raise MistrayError(f"{owner}: {name} is given twice; give it once")
        found[name] = value
    return found


def number_of(text: str) -> float | None:
    """Parse a string as a number, "inf" and "nan" included; None if it is not one."""
    try:
        return float(text)
    except ValueError:
        return None


def finite_of(text: str) -> float | None:
    """Parse a string as a finite number; None if it is not one."""
    number = number_of(text)
    return number if number is not None and math.isfinite(number) else None


def as_number(text: str, name: str, owner: str) -> float:
    """
    Parse a string as a number, "inf" and "nan" included; raise `MistrayError` if it is not one.

    The message has the `name` of the value and its `owner`.
    """
    number = number_of(text)
    if number is None:
        raise MistrayError(f"{owner}: {name} is '{text}'; give a number")
    return number
