"""
Results in files: one archive of JSON and arrays, without pickle, from which no code can run.

An object is saved as its class and state, once, however often it is used. Scenes, tables of surfaces and runs are saved
as what they are made of again, see `mistray.execute.pickles`.
"""

from __future__ import annotations

import copyreg
import dataclasses
import functools
import importlib
import inspect
import io
import json
import math
import re
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
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

FORM = 3  # version of the content
TEXT = "result.json"  # entry of the archive
KIND = "kind"  # key of an object of JSON that stands for another value
MOST_BYTES = 4 << 30  # largest size of an unpacked result
_CLASS = re.compile(r"(mistray(?:\.[a-z]\w*)+):(_?[A-Z]\w*)")
_PLAIN = bool | int | float | str | tuple | None
_DAMAGES = (
    *(ValueError, KeyError, TypeError, AttributeError, IndexError, EOFError, MemoryError, RecursionError, ImportError),
    *(zipfile.BadZipFile, zlib.error, NotImplementedError, RuntimeError),
)


class _NotSaved(Exception):
    """Exception for a value that a result file cannot hold, such as a function; its text names the value."""


def save_result(result: Result, path: str | Path) -> Path:
    """
    Write a result to a file, complete or not at all, see `mistray.result.Result.save`.

    If it holds an object that a file cannot, or the file cannot be written, it raises `MistrayError`.
    """
    encoder = _Encoder()
    try:
        text = json.dumps({"form": FORM, "result": encoder.encoded(result)}, allow_nan=False)
    except _NotSaved as what:
        raise MistrayError(
            f"{type(result).__name__} cannot be saved: it holds {what}, and files hold what mistray knows; write its "
            "tables, or pickle it"
        ) from None
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(TEXT, text)
        for number, array in enumerate(encoder.arrays):
            with archive.open(f"{number}.npy", "w", force_zip64=True) as entry:
                np.lib.format.write_array(entry, array, allow_pickle=False)
    return replace_file(path, buffer.getvalue(), "result")


def load_result(path: str | Path) -> Result:
    """
    Return a result that `Result.save` has saved.

    Parameters
    ----------
    path : str or Path
        File of the result. Loading it runs no code from it. Scenes within it are read as `mistray.load` reads files.

    Returns
    -------
    Result
        Result with the numbers, tables and figures of the saved one.

    Raises
    ------
    MistrayError
        If there is no such file, it is damaged or not a result, or its format is that of another version of mistray.

    Examples
    --------
    >>> found = mistray.pst(mistray.load("lens_and_window"), [10, 30], rays=20_000)
    >>> _ = found.save("lens_pst.npz")
    >>> mistray.load_result("lens_pst.npz").field_deg
    array([10., 30.])
    """
    if not isinstance(path, str | Path):
        raise MistrayError(f"result is of type {type(path).__name__}; give a path, as of result.save(path)")
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
        found = _Decoder(arrays).decoded(written["result"]) if own else None
        if own and not isinstance(found, Result):
            raise TypeError
    if not isinstance(found, Result):
        raise MistrayError(f"result '{path}' was written by another version of mistray; compute it again")
    return found


@contextmanager
def _told(path: str | Path) -> Iterator[None]:
    """Turn what reading a missing, unreadable or damaged result file raises in a `with` block into a `MistrayError`."""
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


class _Encoder:
    """
    Conversion of values to those of JSON.

    Attributes
    ----------
    arrays : list of ndarray
        Arrays that the values of JSON refer to by index.
    """

    def __init__(self) -> None:
        self.arrays: list[np.ndarray] = []
        self._known: dict[int, tuple[int, Any]] = {}  # numbers of objects by id, which the objects keep from reuse

    def encoded(self, value: Any) -> Any:
        """Return a value in a JSON-serialisable form; raise `_NotSaved` for values that are not data."""
        inside = self.encoded
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
            case bytes():
                return {KIND: "bytes", "in": inside(np.frombuffer(value, np.uint8))}
            case Path():
                return {KIND: "path", "text": str(value)}
            case np.ndarray() if value.dtype.hasobject:
                return {KIND: "objects", "shape": [*value.shape], "items": [inside(item) for item in value.ravel()]}
            case np.ndarray():
                self.arrays.append(value)
                return {KIND: "array", "number": len(self.arrays) - 1}
            case pd.DataFrame():
                columns = {name: column.to_numpy() for name, column in value.items()}
                index = None if isinstance(value.index, pd.RangeIndex) else inside(value.index.to_numpy())
                return {KIND: "frame", "columns": inside(columns), "rows": len(value), "index": index}
            case range():
                return {KIND: "range", "ends": [value.start, value.stop, value.step]}
            case list():
                return [inside(item) for item in value]
            case set() | frozenset():
                return {KIND: type(value).__name__, "items": [inside(item) for item in value]}
            case tuple():
                of = {"of": _name(type(value))} if hasattr(value, "_fields") else {}
                return {KIND: "tuple", **of, "items": [inside(item) for item in value]}
        if type(value) is dict or (isinstance(value, Mapping) and not _is_own(type(value))):
            return {KIND: "dict", "items": [[inside(key), inside(item)] for key, item in value.items()]}
        return self._object(value)

    def _object(self, value: Any) -> Any:
        """
        Return an object of a class of its own in JSON form, or a reference to it if it was saved before.

        A class, a function, or an object that files cannot hold raises `_NotSaved`, with nothing kept of it.
        """
        if id(value) in self._known:
            return {KIND: "known", "number": self._known[id(value)][0]}
        if isinstance(value, type) or inspect.isroutine(value):
            raise _NotSaved(f"the {'class' if isinstance(value, type) else 'function'} {value.__name__}")
        kind, number, arrays = type(value), len(self._known), len(self.arrays)
        self._known[id(value)] = number, value
        reduce = copyreg.dispatch_table.get(kind) or vars(kind).get("__reduce__")
        if kind.__module__.partition(".")[0] == "drjit":
            from mistray.execute.pickles import reduced_array as reduce
        try:
            if reduce is None:
                return {KIND: "object", "number": number, "of": _name(kind), "state": self._state(value)}
            reduced: Any = reduce(value)
            make, given = reduced[:2]
            if make is type(None):
                raise _NotSaved("what stays in its process")
            return {KIND: "made", "number": number, "by": _maker(make), "given": [self._given(one) for one in given]}
        except _NotSaved:
            for _ in range(len(self._known) - number):
                self._known.popitem()
            del self.arrays[arrays:]
            raise

    def _given(self, value: Any) -> Any:
        """Return an argument of the function that rebuilds an object, in JSON form."""
        return {KIND: "maker", "of": _maker(value)} if inspect.isroutine(value) else self.encoded(value)

    def _state(self, value: Any) -> dict[str, Any]:
        """
        Return the attributes of an object in JSON form, by name.

        A value that files cannot hold becomes None in a field that is not compared and whose default is None. Elsewhere
        it raises `_NotSaved`.
        """
        kind = type(value)
        declared = {field.name: field for field in dataclasses.fields(value)} if dataclasses.is_dataclass(kind) else {}
        own = "__getstate__" in vars(kind) or not declared
        state = (value.__getstate__() if own else vars(value)) or {}
        names = [name for name, field in declared.items() if field.init]
        names += [name for name in state if not declared or name == "scene_name"]
        found = {}
        for name in names:
            one = state[name] if name in state else getattr(value, name)
            try:
                found[name] = self.encoded(one)
            except _NotSaved:
                if name not in declared or declared[name].compare or declared[name].default is not None:
                    raise
                found[name] = None
        return found


class _Decoder:
    """
    Conversion of values of JSON, made by `_Encoder`, to what they were.

    Parameters
    ----------
    arrays : list of ndarray
        Arrays that the values refer to.
    """

    def __init__(self, arrays: list[np.ndarray]) -> None:
        self._arrays = arrays
        self._known: dict[int, Any] = {}

    def decoded(self, value: Any) -> Any:
        """Return the value that `_Encoder` encoded; raise one of `_DAMAGES` for a damaged file."""
        inside = self.decoded
        if isinstance(value, list):
            return [inside(item) for item in value]
        if not isinstance(value, dict):
            return value
        match value[KIND]:
            case "note":
                return Note(value["text"], Code[value["code"]], bool(value["warns"]))
            case "enum":
                return _class(value["of"], Enum)[value["name"]]
            case "float":
                return float(value["text"])
            case "complex":
                return complex(*map(inside, value["parts"]))
            case "bytes":
                return bytes(inside(value["in"]))
            case "path":
                return Path(value["text"])
            case "objects":
                found = np.empty(value["shape"], dtype=object)
                found.ravel()[:] = [*map(inside, value["items"])]
                return found
            case "array":
                return self._arrays[value["number"]]
            case "frame":
                index = range(value["rows"]) if value["index"] is None else inside(value["index"])
                return pd.DataFrame(inside(value["columns"]), index=index)
            case "range":
                return range(*value["ends"])
            case "dict":
                return {inside(key): inside(item) for key, item in value["items"]}
            case "set":
                return {*map(inside, value["items"])}
            case "frozenset":
                return frozenset(map(inside, value["items"]))
            case "tuple":
                items = tuple(map(inside, value["items"]))
                return _class(value["of"], tuple)._make(items) if "of" in value else items
            case "maker":
                return _makers()[value["of"]]
            case "made":
                given = [*map(inside, value["given"])]
                self._known[value["number"]] = made = _makers()[value["by"]](*given)
                return made
            case "known":
                return self._known[value["number"]]
            case "object":
                return self._object(value)
        raise ValueError

    def _object(self, value: Any) -> Any:
        """
        Return an instance of a class with its state, as copies are made: nothing is computed or checked.

        `ValueError` is raised if the state of a dataclass lacks a field, or has another attribute than its fields. So
        it is if the state of another class has a name that `_is_part_of` refuses.
        """
        kind = _class(value["of"])
        self._known[value["number"]] = made = object.__new__(kind)
        state = {name: self.decoded(item) for name, item in value["state"].items()}
        if dataclasses.is_dataclass(kind):
            declared = {field.name: field for field in dataclasses.fields(kind)}
            own = {name: field.default_factory() for name, field in declared.items()
                   if not field.init and field.default_factory is not dataclasses.MISSING}  # fmt: skip
            allowed = {*declared, "scene_name"} if isinstance(made, Result) else {*declared}
            if not {*declared} <= {*state} | {*own} <= allowed:
                raise ValueError
            state |= own
        elif any(_is_part_of(kind, name) for name in state):
            raise ValueError
        for name, one in state.items():
            object.__setattr__(made, name, one)
        return made


def _is_own(kind: type) -> bool:
    return kind.__module__.partition(".")[0] == "mistray"


def _is_part_of(kind: type, name: str) -> bool:
    """
    True if a class has an attribute of a name that an instance's saved state must not override.

    It is also True for any name with two leading underscores.
    """
    own = inspect.getattr_static(kind, name, None)
    return name.startswith("__") or not isinstance(own, _PLAIN | functools.cached_property)


def _name(kind: type) -> str:
    name = f"{kind.__module__}:{kind.__qualname__}"
    if not _CLASS.fullmatch(name):
        raise _NotSaved(f"an object of class {kind.__name__}")
    return name


def _class(name: str, base: type = object) -> Any:
    """
    Return a class of mistray by its name, "module:Class".

    Raise `ValueError` for any other class, or one that does not derive from `base`. If it does not exist, raise what
    its import raises.
    """
    found = _CLASS.fullmatch(name)
    kind: Any = getattr(importlib.import_module(found[1]), found[2]) if found else None
    if not isinstance(kind, type) or f"{kind.__module__}:{kind.__qualname__}" != name or not issubclass(kind, base):
        raise ValueError
    return kind


@functools.cache
def _makers() -> dict[str, Callable[..., Any]]:
    """Return the functions that rebuild scenes, surface tables and runs, by name."""
    from mistray._variant import ensure_variant

    ensure_variant()
    from mistray.execute.pickles import MAKERS

    return {f"{one.__module__}:{one.__qualname__}": one for one in MAKERS}


def _maker(make: Any) -> str:
    name = f"{getattr(make, '__module__', '')}:{getattr(make, '__qualname__', '')}"
    if name not in _makers():
        raise _NotSaved(f"an object that {name.rpartition(':')[2]} makes")
    return name
