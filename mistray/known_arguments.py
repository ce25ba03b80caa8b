"""Decorator that rejects unknown keyword arguments, with a one-line error that suggests the nearest known argument."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from typing import Any, TypeVar

from mistray.errors import refuse_unknown

T = TypeVar("T", bound=Callable[..., Any])


def known_arguments(target: T) -> T:
    """
    Decorate a function, or a class for its constructor, so that unknown keyword arguments raise `MistrayError`.

    The message suggests the nearest known argument.
    """
    if not isinstance(target, type):
        return _checked(target, target.__name__)
    setattr(target, "__init__", _checked(vars(target)["__init__"], target.__name__))  # noqa: B010 - mypy refuses `=`
    return target


def _checked(function: Any, owner: str) -> Any:
    names = [name for name in inspect.signature(function).parameters if name != "self"]

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        refuse_unknown(kwargs, names, f"{owner}: ")
        return function(*args, **kwargs)

    return call
