"""Arguments of public functions, methods and constructors that take several values, found by their type hints."""

import ast
import dataclasses
import importlib
import inspect
import pkgutil
import sys
from collections.abc import Callable, Iterator
from typing import Any

import mistray
from mistray.result import Result
from mistray.toolkit.fields import flat_fields

SEVERAL, VECTOR, BY_NAME, ARRAY, SINGLE = "several", "vector", "by name", "array", "single"
BASES = {
    **dict.fromkeys(("Sequence", "Iterable", "Collection", "list", "set", "frozenset"), SEVERAL),
    **dict.fromkeys(("Mapping", "dict", "MutableMapping"), BY_NAME),
    **dict.fromkeys(("ndarray", "ArrayLike", "NDArray"), ARRAY),
}
MODULES = (
    *("analysis", "coatings", "explore", "io", "materials", "mechanics", "optimize", "prescription", "recorders"),
    *("report", "scatter", "scene", "sweeps", "trace"),
)


def kinds_of(hint: Any, names: dict[str, Any]) -> set[str]:
    """What a type hint allows: one value, several, a vector of a fixed length, a mapping, an array."""
    node = ast.parse(hint if isinstance(hint, str) else getattr(hint, "__name__", str(hint)), mode="eval").body
    return set(_kinds(node, names))


def _kinds(node: ast.expr, names: dict[str, Any]) -> Iterator[str]:
    if isinstance(node, ast.BinOp):
        yield from (*_kinds(node.left, names), *_kinds(node.right, names))
    elif isinstance(node, ast.Subscript):
        base = ast.unparse(node.value).rpartition(".")[2]
        if base == "tuple":
            yield SEVERAL if "..." in ast.unparse(node.slice) else VECTOR
        else:
            yield BASES.get(base, SINGLE)
    elif isinstance(node, ast.Name | ast.Attribute):
        alias = names.get(ast.unparse(node))
        text = str(alias) if alias is not None and not isinstance(alias, type) else ""
        if "[" in text and text.startswith(("collections.abc", "typing", "str |", "int |", "float |", "mistray.")):
            yield from _kinds(ast.parse(text.replace("<", "").replace(">", ""), mode="eval").body, {})
        else:
            yield BASES.get(ast.unparse(node).rpartition(".")[2], SINGLE)
    elif not (isinstance(node, ast.Constant) and node.value is None):
        yield SINGLE


def public_objects() -> dict[str, Any]:
    """Public functions and classes, by their names; those of `mistray.physics` with that of their module."""
    named: list[tuple[str, Any]] = []
    for module in MODULES:
        home = importlib.import_module(f"mistray.{module}")
        named += [(name, getattr(home, name)) for name in home.__all__]
    for home in pkgutil.walk_packages(mistray.physics.__path__, "mistray.physics."):
        last = home.name.rpartition(".")[2]
        if not home.ispkg and not last.startswith("_"):
            there = vars(importlib.import_module(home.name)).items()
            own = [(name, value) for name, value in there if getattr(value, "__module__", "") == home.name]
            named += [(f"{last}.{name}", value) for name, value in own if not name.startswith("_")]
    # Each object once, by its own name: some have another from before version 0.3
    of_mistray = [one for one in named if str(getattr(one[1], "__module__", "")).startswith("mistray")]
    named = [(name, value) for name, value in of_mistray if callable(value)]
    names = {id(value): name for name, value in named}
    names |= {id(value): name for name, value in named if name == getattr(value, "__name__", "")}
    return {name: value for name, value in named if names[id(value)] == name}


def arguments(made: set[str]) -> Iterator[tuple[str, set[str]]]:
    """
    All arguments with a hint of several values, vectors, mappings or arrays, as "function(argument)", with the kinds.

    `made` names classes that the program makes, whose constructors are left out.
    """
    for name, value in public_objects().items():
        if not isinstance(value, type):
            yield from _of_call(name, value)
            continue
        if not (issubclass(value, Result) or name in made):
            fields = dataclasses.fields(value) if dataclasses.is_dataclass(value) else ()
            for field in fields:
                if field.init:
                    yield from _of_hint(f"{name}({field.name})", field.type, _names(value))
            if not fields and inspect.isfunction(value.__init__):
                yield from _of_call(name, value.__init__)
        for method, function in _methods(value):
            yield from _of_call(f"{name}.{method}", function)


def _methods(kind: type) -> Iterator[tuple[str, Callable[..., Any]]]:
    package = kind.__module__.rpartition(".")[0]
    for base in kind.__mro__:
        for name, value in vars(base).items() if base.__module__.startswith(package) else ():
            function = getattr(value, "__func__", value)
            if inspect.isfunction(function) and (not name.startswith("_") or name in ("__call__", "__getitem__")):
                yield name, function


def _of_call(name: str, function: Any) -> Iterator[tuple[str, set[str]]]:
    # Requests check their own fields: tests/toolkit/test_command_request.py
    requested = {field.name for field, _ in flat_fields(function.request)} if hasattr(function, "request") else set()
    for parameter in inspect.signature(function).parameters.values():
        if parameter.annotation is not parameter.empty and parameter.name not in requested:
            yield from _of_hint(f"{name}({parameter.name})", parameter.annotation, _names(function))


def _of_hint(name: str, hint: Any, names: dict[str, Any]) -> Iterator[tuple[str, set[str]]]:
    found = kinds_of(hint, names)
    if found - {SINGLE}:
        yield name, found


def _names(value: Any) -> dict[str, Any]:
    return vars(sys.modules[inspect.unwrap(value).__module__])
