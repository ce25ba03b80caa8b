"""Reading of a TOML table of a study with checks; errors are one line with file, key and remedy."""

from __future__ import annotations

import dataclasses
import math
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from mistray.errors import MistrayError, nearest
from mistray.ranges import POSITIVE, Demand, Range, demand_of, doc_of
from mistray.read_file import read_text

T = TypeVar("T")


def keys_of(kind: Any) -> tuple[str, ...]:
    """Return the keys of a TOML table that describes a dataclass: its fields that have a description."""
    return tuple(field.name for field in dataclasses.fields(kind) if doc_of(field))


class TomlSection:
    """
    Table within a TOML file, with the file's name and its place there for messages.

    Parameters
    ----------
    title : str
        Name of the study, for messages.
    place : str
        Place of the table in the study, with a final dot: ``optimizer.``, ``term[2].``; empty for the whole.
    content : mapping
        Values by key.
    folder : Path
        Folder to which file names are relative.
    """

    def __init__(self, title: str, place: str, content: Mapping[str, Any], folder: Path) -> None:
        self.title, self.place, self.content, self.folder = title, place, content, folder

    @classmethod
    def of(cls, source: str | Path | Mapping[str, Any], kind: str) -> TomlSection:
        """
        Return the section for a whole TOML file.

        Parameters
        ----------
        source : str, Path or mapping
            TOML file, or its content; file names in a mapping are relative to the current folder.
        kind : str
            Kind of content, for messages.

        Raises
        ------
        MistrayError
            If the source is of another type, or the file is missing or is not valid TOML.
        """
        if isinstance(source, Mapping):
            return cls(kind, "", source, Path())
        if not isinstance(source, str | Path):
            raise MistrayError(
                f"{kind} is of type {type(source).__name__}; give a TOML file, or a mapping of what is in it"
            )
        path = Path(source)
        text = read_text(path, kind)
        try:
            content = tomllib.loads(text)
        except (ValueError, RecursionError) as error:  # an integer of too many digits is no TOMLDecodeError
            raise MistrayError(f"{kind} '{path}': {str(error).partition(';')[0]}; correct the TOML") from None
        return cls(f"{kind} '{path}'", "", content, path.parent)

    def __contains__(self, key: str) -> bool:
        return key in self.content

    def inner(self, place: str, content: Mapping[str, Any]) -> TomlSection:
        """Return the section for a table `content` within this one, at `place`."""
        return TomlSection(self.title, f"{self.place}{place}.", content, self.folder)

    def fail(self, key: str, text: str) -> MistrayError:
        """
        Return the error for a key of this TOML table; the caller raises it.

        An empty key means the table itself.
        """
        return MistrayError(f"{self.title}: {f'{self.place}{key}'.rstrip('.')} {text}")

    def known(self, keys: Iterable[str]) -> None:
        """Raise `MistrayError` if the TOML table has a key that is not among the given ones."""
        choice = tuple(keys)
        for key in self.content:
            if key not in choice:
                raise self.fail(key, f"is unknown; {nearest(str(key), choice)}")

    def table(self, key: str) -> TomlSection:
        """
        Return the inner table at a key, empty if the key is missing.

        Raise `MistrayError` if the value is not a table.
        """
        value = self.content.get(key, {})
        if not isinstance(value, Mapping):
            raise self.fail(key, f"is {value!r}; write a section [{key}]")
        return self.inner(key, value)

    def tables(self, key: str) -> list[TomlSection]:
        """
        Return the list of tables at a key, empty if the key is missing.

        Raise `MistrayError` if it is not such a list.
        """
        value = self.content.get(key, [])
        if not isinstance(value, list) or not all(isinstance(item, Mapping) for item in value):
            raise self.fail(key, f"is not a list of sections; write each one as [[{key}]]")
        return [self.inner(f"{key}[{number}]", item) for number, item in enumerate(value, start=1)]

    def value(self, key: str, demand: Demand, default: Any = dataclasses.MISSING) -> Any:
        """
        Return the value of a key, checked against a demand; a number is a float unless the demand is for whole ones.

        If the key is missing, `default` is returned. A missing key without a default, or a value that is not allowed,
        raises `MistrayError`.
        """
        value = self.content.get(key)
        if value is None:
            if default is dataclasses.MISSING:
                raise self.fail(key, f"is missing; it {demand.demand}")
            return default
        found = demand.check(f"{self.place}{key}", value, self.title)
        return float(found) if isinstance(demand, Range) and not demand.whole else found

    def make(self, kind: type[T], read: Mapping[str, Any] | None = None, /, **missing: Any) -> T:
        """
        Return an object of a dataclass made from the table, see `keys_of`; its constructor checks the values.

        Parameters
        ----------
        kind : type
            Dataclass.
        read : mapping, optional
            Fields that are known already. None: keys that are not fields are refused.
        **missing
            Defaults of fields whose keys are missing, where they are not those of the class.

        Raises
        ------
        MistrayError
            If a key is unknown or missing, or its value is not allowed.
        """
        if read is None:
            self.known(keys_of(kind))
        found = dict(read or {})
        for field in dataclasses.fields(kind):  # type: ignore[arg-type]  # mypy knows no bound for dataclasses
            demand = demand_of(field)
            if demand is not None and field.name not in found:
                found[field.name] = self.value(field.name, demand, missing.get(field.name, field.default))
        try:
            return kind(**found)
        except MistrayError as error:
            raise MistrayError(f"{self.title}: {self.place}{error}") from None

    def numbers(self, key: str, value: Any = None) -> tuple[float, ...]:
        """
        Return a number or a list of numbers, all finite, as a tuple of float.

        It is `value`; None: the value of the key. Anything else raises `MistrayError`.
        """
        value = self.content.get(key) if value is None else value
        values = value if isinstance(value, list | tuple) else [value]
        if not values or any(isinstance(v, bool) or not isinstance(v, int | float) for v in values):
            raise self.fail(key, f"is {value!r}; give a number or a list of numbers")
        if not all(math.isfinite(v) for v in values):
            raise self.fail(key, f"is {value!r}; the numbers must be finite")
        return tuple(float(v) for v in values)

    def texts(self, key: str, form: str) -> tuple[str, ...]:
        """
        Return the non-empty strings in the list at a key.

        Anything else raises `MistrayError`, whose message asks for `form`.
        """
        value = self.content.get(key)
        if not isinstance(value, list) or not value or not all(isinstance(item, str) and item for item in value):
            raise self.fail(key, f"is {value!r}; give {form}")
        return tuple(value)

    def spaced(self, key: str, within: Range) -> tuple[float, ...]:
        """
        Return the distinct numbers of a key, given as a number, a list, or start, stop (included) and step.

        All must lie `within` the range. Anything else raises `MistrayError`, and a missing key `KeyError`.
        """
        value = self.content[key]
        if isinstance(value, Mapping):
            inner = self.inner(key, value)
            inner.known(("start", "stop", "step"))
            missing = [name for name in ("start", "stop", "step") if name not in value]
            if missing:
                raise self.fail(key, f"has no {missing[0]}; write {{start = 450, stop = 650, step = 25}}")
            start, stop = (inner.value(name, within) for name in ("start", "stop"))
            step = inner.value("step", POSITIVE)
            if stop < start:
                raise self.fail(key, f"goes from {start:g} to {stop:g} {within.unit}; stop must not be below start")
            return tuple(float(v) for v in start + step * np.arange(math.floor((stop - start) / step + 1e-9) + 1))
        result = tuple(within.check_each(f"{self.place}{key}", self.numbers(key), self.title))
        if len(set(result)) < len(result):
            raise self.fail(key, f"is {list(result)}; give numbers in {within.unit}, each once")
        return result
