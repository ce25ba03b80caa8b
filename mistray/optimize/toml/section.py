"""One table of a study in TOML; every message is one line with the file, the key and the remedy."""

from __future__ import annotations

import difflib
import math
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mistray.errors import MistrayError
from mistray.read_file import read_text
from mistray.renamed import by_new_names


class Section:
    """
    A table and where it stands.

    Parameters
    ----------
    title : str
        Name of the study, for messages.
    place : str
        Of the table in the study, with a dot behind it: ``optimizer.``, ``term[2].``; empty for the whole.
    content : mapping
    folder : Path
        Relative to which files are named.
    """

    def __init__(self, title: str, place: str, content: Mapping[str, Any], folder: Path) -> None:
        self.title, self.place, self.content, self.folder = title, place, content, folder

    @classmethod
    def of_file(cls, source: str | Path, kind: str) -> Section:
        """
        The whole of a TOML file.

        Parameters
        ----------
        source : str or Path
        kind : str
            What is in it, for messages.

        Raises
        ------
        MistrayError
            If the file is missing or no TOML.
        """
        path = Path(source)
        text = read_text(path, kind)
        try:
            content = tomllib.loads(text)
        except (tomllib.TOMLDecodeError, RecursionError) as error:
            raise MistrayError(f"{kind} '{path}': {error}; correct the TOML") from None
        return cls(f"{kind} '{path}'", "", content, path.parent)

    def fail(self, key: str, text: str) -> MistrayError:
        """An error about a key; an empty key means the table itself."""
        return MistrayError(f"{self.title}: {f'{self.place}{key}'.rstrip('.')} {text}")

    def renamed(self, names: Mapping[str, str]) -> Section:
        """The table with new names (old → new) in the place of old ones; each warns."""
        content = by_new_names(self.content, names, f"{self.title}: {self.place}")
        return Section(self.title, self.place, content, self.folder)

    def known(self, keys: Iterable[str]) -> None:
        """Refuse keys that are not among these."""
        choice = tuple(keys)
        for key in self.content:
            if key not in choice:
                raise self.fail(key, f"is unknown; {nearest(str(key), choice)}")

    def table(self, key: str) -> Section:
        """A table within this one; an empty one if it is missing."""
        value = self.content.get(key, {})
        if not isinstance(value, Mapping):
            raise self.fail(key, f"is {value!r}; write a section [{key}]")
        return Section(self.title, f"{self.place}{key}.", value, self.folder)

    def tables(self, key: str) -> list[Section]:
        """All tables of a list of them."""
        value = self.content.get(key, [])
        if not isinstance(value, list) or not all(isinstance(item, Mapping) for item in value):
            raise self.fail(key, f"is no list of sections; write each one as [[{key}]]")
        return [
            Section(self.title, f"{self.place}{key}[{number}].", item, self.folder)
            for number, item in enumerate(value, start=1)
        ]

    def number(self, key: str, default: float | None, low: float, high: float) -> float:
        """A number from `low` to `high`; with the default None it must be given."""
        value = self.content.get(key, default)
        if value is None:
            raise self.fail(key, f"is missing; it must be a number from {low:g} to {high:g}")
        if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
            raise self.fail(key, f"is {value!r}; it must be a number from {low:g} to {high:g}")
        return float(value)

    def positive(self, key: str, default: float) -> float:
        """A finite number above 0."""
        value = self.content.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < math.inf:
            raise self.fail(key, f"is {value!r}; it must be a number greater than 0")
        return float(value)

    def finite(self, key: str) -> float | None:
        """A finite number, or None if it is missing."""
        value = self.content.get(key)
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise self.fail(key, f"is {value!r}; it must be a finite number")
        return float(value)

    def whole(self, key: str, default: int, low: int, high: float) -> int:
        """A whole number from `low` to `high`."""
        value = self.number(key, default, low, high)
        if value != int(value):
            raise self.fail(key, f"is {value!r}; it must be a whole number")
        return int(value)

    def numbers(self, key: str, value: Any = None) -> tuple[float, ...]:
        """A number or a list of numbers, all finite; `value` instead of what stands at the key."""
        value = self.content.get(key) if value is None else value
        values = value if isinstance(value, list | tuple) else [value]
        if not values or any(isinstance(v, bool) or not isinstance(v, int | float) for v in values):
            raise self.fail(key, f"is {value!r}; give a number or a list of numbers")
        if not all(math.isfinite(v) for v in values):
            raise self.fail(key, f"is {value!r}; the numbers must be finite")
        return tuple(float(v) for v in values)

    def text(self, key: str, default: str | None = None) -> str:
        """A text that is not empty; with the default None it must be given."""
        value = self.content.get(key, default)
        if not isinstance(value, str) or not value:
            raise self.fail(key, "is missing; it must be text" if value is None else f"is {value!r}; it must be text")
        return value

    def flag(self, key: str, default: bool) -> bool:
        """True or false."""
        value = self.content.get(key, default)
        if not isinstance(value, bool):
            raise self.fail(key, f"is {value!r}; it must be true or false")
        return value

    def choice(self, key: str, default: str | None, choices: Sequence[str]) -> str:
        """One of some words."""
        value = self.content.get(key, default)
        if value is None:
            raise self.fail(key, f"is missing; choose from {', '.join(choices)}")
        if value not in choices:
            raise self.fail(key, f"is {value!r}; {nearest(str(value), choices)}")
        return str(value)

    def spaced(self, key: str, least: float, unit: str) -> tuple[float, ...] | None:
        """A number, a list of numbers, or start, stop and step; each once and at least `least`. None if missing."""
        value = self.content.get(key)
        if value is None:
            return None
        if isinstance(value, Mapping):
            inner = Section(self.title, f"{self.place}{key}.", value, self.folder)
            inner.known(("start", "stop", "step"))
            missing = [name for name in ("start", "stop", "step") if name not in value]
            if missing:
                raise self.fail(key, f"has no {missing[0]}; write {{start = 450, stop = 650, step = 25}}")
            start, stop = (inner.number(name, None, least, 1e9) for name in ("start", "stop"))
            step = inner.positive("step", 1.0)
            if stop < start:
                raise self.fail(key, f"goes from {start:g} to {stop:g} {unit}; stop must not be below start")
            return tuple(float(v) for v in start + step * np.arange(math.floor((stop - start) / step + 1e-9) + 1))
        result = self.numbers(key)
        if min(result) < least or len(set(result)) < len(result):
            kind = "positive " if least > 0 else ""
            raise self.fail(key, f"is {list(result)}; give {kind}numbers in {unit}, each once")
        return result


def nearest(word: str, choices: Sequence[str]) -> str:
    """What a wrong word may have meant, or all that there is."""
    close = difflib.get_close_matches(word, choices, n=1)
    return f"did you mean '{close[0]}'?" if close else f"choose from {', '.join(choices)}"
