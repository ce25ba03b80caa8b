"""Texts of the form ``name=value``, as they stand in options, scene files and dicts."""

from __future__ import annotations

from collections.abc import Collection, Iterable

from mistray.errors import MistrayError, nearest


def name_and_value(text: str) -> tuple[str, str] | None:
    """Return both sides of the first ``=``, without blanks around them; None if there is no ``=``, or no name."""
    name, sign, value = (part.strip() for part in text.partition("="))
    return (name, value) if sign and name else None


def named_values(
    parts: Iterable[str], owner: str, known: Collection[str] = (), like: str = "name=value"
) -> dict[str, str]:
    """
    Parse texts of the form ``name=value`` into a dict from name to value, both texts.

    Parameters
    ----------
    parts : iterable of str
        Texts ``name=value``.
    owner : str
        Owner of the values, for the start of messages.
    known : collection of str
        Allowed names; empty: all are.
    like : str
        Example of a valid text, for messages.

    Raises
    ------
    MistrayError
        If a text is not of the form ``name=value``, or a name is unknown or given twice.
    """
    found: dict[str, str] = {}
    for part in parts:
        pair = name_and_value(part)
        if pair is None:
            raise MistrayError(f"{owner}: '{part}' has no name; write {like}")
        name, value = pair
        if known and name not in known:
            raise MistrayError(f"{owner}: '{name}' is none of its names; {nearest(name, known)}")
        if name in found:
            raise MistrayError(f"{owner}: {name} is given twice; give it once")
        found[name] = value
    return found


def as_number(text: str, name: str, owner: str) -> float:
    """Convert the value of a named text to a float; raise `MistrayError` if it is not a number."""
    try:
        return float(text)
    except ValueError:
        raise MistrayError(f"{owner}: {name} is '{text}'; give a number") from None
