"""Saving and loading of results as archives of JSON and arrays, without pickle, so that loading runs no code."""

from __future__ import annotations

import dataclasses
import importlib
import io
import json
import math
import re
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from mistray.errors import MistrayError
from mistray.files.arrays import check_arrays
from mistray.notes import Code, Note
from mistray.read_file import open_input
from mistray.replace_file import replace_file
from mistray.result import Result

FORM = 1  # version of the content
TEXT = "result.json"  # entry of the archive
KIND = "kind"  # key of an object of JSON that stands for another value
MOST_BYTES = 4 << 30  # largest size of an unpacked result
_CLASS = re.compile(r"(mistray(?:\.[a-z]\w*)+):([A-Z]\w*)")
_DAMAGES = (
    *(ValueError, KeyError, TypeError, AttributeError, IndexError, EOFError, MemoryError, RecursionError, ImportError),
    *(zipfile.BadZipFile, zlib.error, NotImplementedError, RuntimeError),
)


class _NotSaved(Exception):
    """Raised for a value that cannot be stored in a file, such as rays or a scene."""


def save_result(result: Result, path: str | Path) -> Path:
    """Save a result to a file, completely or not at all, and return the path; see `mistray.result.Result.save`."""
    name = type(result).__name__
    arrays: list[np.ndarray] = []
    try:
        if not dataclasses.is_dataclass(type(result)):
            raise _NotSaved("rays")
        text = json.dumps({"form": FORM, "result": _encoded(result, arrays)}, allow_nan=False)
    except _NotSaved as what:
        raise MistrayError(
            f"{name} cannot be saved: it holds {what}, a file numbers and texts; write its tables, or pickle it"
        ) from None
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(TEXT, text)
        for number, array in enumerate(arrays):
            with archive.open(f"{number}.npy", "w", force_zip64=True) as entry:
                np.lib.format.write_array(entry, array, allow_pickle=False)
    return replace_file(path, buffer.getvalue(), "result")


def load_result(path: str | Path) -> Result:
    """
    Load a result that `Result.save` has saved.

    Parameters
    ----------
    path : str or Path
        File of the result. It holds numbers and texts only: to load it runs nothing of it.

    Returns
    -------
    Result
        Result with the numbers, tables and figures of the saved one.

    Raises
    ------
    MistrayError
        If there is no such file, it is damaged or no result, or another version of mistray has written it.

    Examples
    --------
    >>> found = mistray.pst(mistray.load("lens_and_window"), [10, 30], rays=20_000)
    >>> _ = found.save("lens_pst.npz")
    >>> mistray.load_result("lens_pst.npz").field_deg
    array([10., 30.])
    """
    with _told(path):
        with open_input(path, own=True) as file:
            content = file.read()
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            if sum(entry.file_size for entry in archive.infolist()) > MOST_BYTES:
                raise ValueError
            written = json.loads(archive.read(TEXT))
            count = len(archive.infolist()) - 1
            data = (check_arrays(archive.read(f"{number}.npy"), MOST_BYTES) for number in range(count))
            arrays = [np.lib.format.read_array(entry, allow_pickle=False) for entry in data]
        own = written["form"] == FORM
        found = _decoded(written["result"], arrays) if own else None
        if own and not isinstance(found, Result):
            raise TypeError
    if not isinstance(found, Result):
        raise MistrayError(f"result '{path}' was written by another version of mistray; compute it again")
    return found


@contextmanager
def _told(path: str | Path) -> Iterator[None]:
    """Convert any exception from reading a result file within a block into a one-line `MistrayError`."""
    try:
        yield
    except MistrayError as error:
        raise MistrayError(f"result '{path}': {error}") from None
    except FileNotFoundError:
        raise MistrayError(f"result '{path}': no such file; save one with result.save(path)") from None
    except OSError as error:
        raise MistrayError(f"result '{path}': {error.strerror or error}; check the path") from None
    except _DAMAGES:
        raise MistrayError(f"result '{path}' is damaged, or no result; save one with result.save(path)") from None


def _encoded(value: Any, arrays: list[np.ndarray]) -> Any:
    """
    Return a value in JSON form, its arrays moved to the list `arrays`.

    Raise `_NotSaved` for values that are no data.
    """

    def inside(item: Any) -> Any:
        return _encoded(item, arrays)

    match value:
        case Note():
            return {KIND: "note", "text": str(value), "code": value.code.name, "warns": value.warns}
        case Enum():
            return {KIND: "enum", "of": _name(type(value)), "name": value.name}
        case None | bool() | int() | str():
            return value
        case np.generic():
            return inside(value.item())
        case float():
            return value if math.isfinite(value) else {KIND: "float", "text": repr(value)}
        case complex():
            return {KIND: "complex", "parts": [inside(value.real), inside(value.imag)]}
        case Path():
            return {KIND: "path", "text": str(value)}
        case np.ndarray() if not value.dtype.hasobject:
            arrays.append(value)
            return {KIND: "array", "number": len(arrays) - 1}
        case pd.DataFrame():
            columns = {name: column.to_numpy() for name, column in value.items()}
            plain = {name: list(one) if one.dtype.hasobject else one for name, one in columns.items()}
            return {KIND: "frame", "columns": inside(plain), "rows": len(value)}
        case range():
            return {KIND: "range", "ends": [value.start, value.stop, value.step]}
        case Mapping():
            return {KIND: "dict", "items": [[inside(key), inside(item)] for key, item in value.items()]}
        case list():
            return [inside(item) for item in value]
        case tuple():
            of = {"of": _name(type(value))} if hasattr(value, "_fields") else {}
            return {KIND: "tuple", **of, "items": [inside(item) for item in value]}
    if not dataclasses.is_dataclass(value) or isinstance(value, type):
        raise _NotSaved(f"an object of class {type(value).__name__}")
    return {KIND: "object", "of": _name(type(value)), "fields": _fields(value, arrays)}


def _fields(value: Any, arrays: list[np.ndarray]) -> dict[str, Any]:
    """Return a dataclass's fields in JSON form; values that cannot be stored become None where the field allows it."""
    found = {}
    for field in dataclasses.fields(value):
        before = len(arrays)
        try:
            if field.init:
                found[field.name] = _encoded(getattr(value, field.name), arrays)
        except _NotSaved:
            if field.compare or field.default is not None:
                raise
            del arrays[before:]
            found[field.name] = None
    return found | ({"scene_name": value.scene_name} if isinstance(value, Result) and value.scene_name else {})


def _name(kind: type) -> str:
    name = f"{kind.__module__}:{kind.__qualname__}"
    if not _CLASS.fullmatch(name):
        raise _NotSaved(f"an object of class {kind.__name__}")
    return name


def _class(name: str) -> Any:
    """Return one of mistray's data classes by module and name; raise `ValueError` for any other."""
    found = _CLASS.fullmatch(name)
    kind: Any = getattr(importlib.import_module(found[1]), found[2]) if found else None
    if not isinstance(kind, type) or f"{kind.__module__}:{kind.__qualname__}" != name:
        raise ValueError
    if not (dataclasses.is_dataclass(kind) or issubclass(kind, Enum) or hasattr(kind, "_make")):
        raise ValueError
    return kind


def _decoded(value: Any, arrays: list[np.ndarray]) -> Any:
    """Return the value whose JSON form `_encoded` produced, with its arrays taken from the list `arrays`."""

    def inside(item: Any) -> Any:
        return _decoded(item, arrays)

    if isinstance(value, list):
        return [inside(item) for item in value]
    if not isinstance(value, dict):
        return value
    match value[KIND]:
        case "note":
            return Note(value["text"], Code[value["code"]], bool(value["warns"]))
        case "enum":
            return _class(value["of"])[value["name"]]
        case "float":
            return float(value["text"])
        case "complex":
            return complex(*map(inside, value["parts"]))
        case "path":
            return Path(value["text"])
        case "array":
            return arrays[value["number"]]
        case "frame":
            return pd.DataFrame(inside(value["columns"]), index=range(value["rows"]))
        case "range":
            return range(*value["ends"])
        case "dict":
            return {inside(key): inside(item) for key, item in value["items"]}
        case "tuple":
            items = tuple(map(inside, value["items"]))
            return _class(value["of"])._make(items) if "of" in value else items
        case "object":
            return _object(_class(value["of"]), {name: inside(item) for name, item in value["fields"].items()})
    raise ValueError


def _object(kind: Any, fields: dict[str, Any]) -> Any:
    """Return an instance of a dataclass with these field values; its constructor is not run."""
    made: Any = object.__new__(kind)
    if isinstance(made, Result) and "scene_name" in fields:
        made.of_scene(str(fields.pop("scene_name")))
    declared = {field.name: field for field in dataclasses.fields(kind)}
    own = {name: field.default_factory() for name, field in declared.items()
           if not field.init and field.default_factory is not dataclasses.MISSING}  # fmt: skip
    if {*fields} | {*own} != {*declared}:
        raise ValueError
    for name, value in (fields | own).items():
        object.__setattr__(made, name, value)
    return made
