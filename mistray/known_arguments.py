"""Refusal of unknown keyword arguments, with one line that names the nearest known one."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from typing import Any, TypeVar

from mistray.errors import MistrayError, nearest

T = TypeVar("T", bound=Callable[..., Any])


def known_arguments(target: T) -> T:
    """
    Decorate a function, or a class for its constructor, so that wrong keyword arguments raise `MistrayError`.

    Without it Python raises a `TypeError`, which suggests no argument.
    """
    if not isinstance(target, type):
        return _checked(target, target.__name__)
    setattr(target, "__init__", _checked(vars(target)["__init__"], target.__name__))  # noqa: B010 - mypy refuses `=`
    return target


def _checked(function: Any, owner: str) -> Any:
    parameters = inspect.signature(function).parameters

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        wrong = next((name for name in kwargs if name not in parameters), "")
        if wrong:
            names = [name for name in parameters if name != "self"]
            raise MistrayError(f"{owner}: there is no argument '{wrong}'; {nearest(wrong, names)}")
        return function(*args, **kwargs)

    return call
