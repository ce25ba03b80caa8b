"""What commands and public names declare: options with their help, signatures with their defaults."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import re
from collections.abc import Callable, Iterator
from types import ModuleType
from typing import Any

import mistray

ADDRESS = re.compile(r" at 0x[0-9a-f]+")


def declared_options(command: Any) -> dict[str, Any]:
    """
    What a command says of itself and of each option.

    Parameters
    ----------
    command : mistray.toolkit.command.Command
    """
    options = {option.name: _option(option) for option in command.options}
    texts = {name: getattr(command, name) for name in ("name", "help", "description", "examples")}
    return {**texts, "options": options}


def _option(option: Any) -> dict[str, Any]:
    kind = option.type
    choices = list(kind) if isinstance(kind, tuple) else None
    return {
        "type": "choice" if choices else _text(kind),
        "range": str(kind) if type(kind).__name__ in ("Range", "Angles") else "",
        "nargs": _text(option.nargs),
        "default": _text(option.default),
        "choices": choices,
        "metavar": _text(option.metavar),
        "help": option.help,
        "extends": option.extends,
        "writes": _text(option.writes),
    }


def public_signatures() -> dict[str, dict[str, Any]]:
    """Signatures of all public names, by the package that has them."""
    found = {"mistray": signatures(mistray)}
    modules = [name for name in mistray.__all__ if isinstance(getattr(mistray, name), ModuleType)]
    for name in sorted([*modules, "trace"]):  # mistray.trace is the function
        found[f"mistray.{name}"] = signatures(importlib.import_module(f"mistray.{name}"))
    return found


def signatures(package: ModuleType) -> dict[str, Any]:
    """Signatures of the public names of a package; those of its public modules are named MODULE.NAME."""
    found: dict[str, Any] = {}
    for name in sorted(package.__all__):
        value = getattr(package, name)
        if not isinstance(value, ModuleType):
            found[name] = _signature(value)
        elif value.__name__.startswith("mistray.physics."):
            own = {key: one for key, one in vars(value).items() if not key.startswith("_") and _lives_in(value, one)}
            found |= {f"{name}.{key}": _signature(one) for key, one in sorted(own.items())}
        else:
            found[name] = "module"
    return found


def _lives_in(module: ModuleType, value: Any) -> bool:
    return callable(value) and getattr(value, "__module__", "") == module.__name__


def _signature(value: Any) -> Any:
    if inspect.isclass(value):
        return _of_class(value)
    return _parameters(value) if callable(value) else _text(value)


def _of_class(kind: type) -> dict[str, Any]:
    """Its constructor, the fields of a dataclass, and its public methods and properties."""
    found: dict[str, Any] = {"constructor": _parameters(kind)}
    if dataclasses.is_dataclass(kind):
        found["fields"] = {field.name: _default(field) for field in dataclasses.fields(kind) if field.name[0] != "_"}
    found["members"] = dict(sorted(_members(kind)))
    return found


def _members(kind: type) -> Iterator[tuple[str, Any]]:
    """Public methods, properties and constants; names of a subclass hide those of what it derives from."""
    seen: set[str] = set()
    for base in kind.__mro__:
        if not base.__module__.startswith("mistray"):
            continue
        for name, value in vars(base).items():
            if not name.startswith("_") and name not in seen:
                seen.add(name)
                yield name, _member(value)


def _member(value: Any) -> Any:
    if isinstance(value, classmethod | staticmethod):
        return {"is": type(value).__name__, "parameters": _parameters(value.__func__)}
    if inspect.isfunction(value):
        return {"is": "method", "parameters": _parameters(value)}
    if isinstance(value, property):
        return "property that can be set" if value.fset else "property"
    return "property" if inspect.isdatadescriptor(value) or hasattr(value, "__set_name__") else _text(value)


def _parameters(function: Callable[..., Any]) -> Any:
    try:
        found = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):  # of a compiled class
        return "not known"
    return [
        f"{one.name}, {one.kind.description}" + ("" if one.default is one.empty else f", default {_text(one.default)}")
        for one in found
    ]


def _default(field: dataclasses.Field[Any]) -> str:
    if field.default_factory is not dataclasses.MISSING:
        return f"made by {_text(field.default_factory)}"
    return "needed" if field.default is dataclasses.MISSING else f"default {_text(field.default)}"


def _text(value: Any) -> str:
    """A value as text, whatever module it lives in."""
    if inspect.isclass(value) or inspect.isfunction(value):
        return str(value.__qualname__)
    return ADDRESS.sub("", repr(value))
