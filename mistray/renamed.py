"""Names of arguments, attributes and keys: old ones still work, with a warning; wrong ones say what was meant."""

from __future__ import annotations

import functools
import inspect
import math
import warnings
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from mistray.errors import MistrayError, MistrayWarning, nearest

T = TypeVar("T", bound=Callable[..., Any])


def renamed(**names: str) -> Callable[[T], T]:
    """
    Decorate what has new names for its arguments, or a class for its attributes as well.

    Parameters
    ----------
    **names
        Old name = new name; none: there are no old names. A call by the old name warns; one by both raises
        `MistrayError`, and so does one by a name that there is not.
    """

    def decorate(target: T) -> T:
        if not isinstance(target, type):
            return _by_either_name(target, names)
        for old, new in names.items():
            setattr(target, old, _attribute(target.__name__, old, new))
        init = vars(target).get("__init__")
        if init is not None and set(names.values()) & set(inspect.signature(init).parameters):
            setattr(target, "__init__", _by_either_name(init, names, target.__name__))  # noqa: B010 - mypy refuses `=`
        return target

    return decorate


def old_names(target: Any) -> dict[str, str]:
    """Old → new names of the arguments of a function that `renamed` has decorated; of others none."""
    return dict(getattr(target, "_old_names", {}))


def by_new_names(given: Mapping[str, Any], names: Mapping[str, str], owner: str) -> dict[str, Any]:
    """
    Arguments or keys by their new names, with a warning for each old one at the line that has called the caller.

    Parameters
    ----------
    given : mapping
    names : mapping of str to str
        Old → new.
    owner : str
        What has them, for messages, with what stands between it and the name: "ghosts: ".

    Raises
    ------
    MistrayError
        If something is given by both names.
    """
    found = dict(given)
    for old in [key for key in given if key in names]:
        new = names[old]
        if new in found:
            raise MistrayError(f"{owner}{old} is the old name of {new}, and both are given; leave out {old}")
        warnings.warn(f"{owner}{old} is an old name; write {new}", MistrayWarning, stacklevel=3)
        found[new] = found.pop(old)
    return found


def _by_either_name(function: Any, names: Mapping[str, str], title: str = "") -> Any:
    owner = f"{title or function.__name__}: "
    parameters = inspect.signature(function).parameters
    places = {name: number for number, name in enumerate(parameters)}
    passes_on = any(one.kind is one.VAR_KEYWORD for one in parameters.values())

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        if names.keys() & kwargs.keys():
            for old, new in names.items():
                if old in kwargs and places.get(new, math.inf) < len(args):
                    raise MistrayError(f"{owner}{old} is the old name of {new}, and both are given; leave out {old}")
            kwargs = by_new_names(kwargs, names, owner)
        wrong = "" if passes_on else next((name for name in kwargs if name not in parameters), "")
        if wrong:
            known = [name for name in parameters if name != "self"]
            raise MistrayError(f"{owner}there is no argument '{wrong}'; {nearest(wrong, known)}")
        return function(*args, **kwargs)

    vars(call)["_old_names"] = {**old_names(function), **names}
    return call


def _attribute(title: str, old: str, new: str) -> property:
    def value(self: Any) -> Any:
        warnings.warn(f"{title}.{old} is an old name; write {new}", MistrayWarning, stacklevel=2)
        return getattr(self, new)

    value.__doc__ = f"Old name of `{new}`."
    return property(value)
