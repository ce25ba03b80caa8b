"""Packages whose public names are imported from their modules on first use.

A command that prints a table needs neither Matplotlib nor the report of another command. The ``__init__`` of a package
has a table of modules and names for `lazy_package`; type checkers and editors read the stub beside it.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterable, Mapping
from types import ModuleType
from typing import Any


class _LazyPackage(ModuleType):
    """Module type of a package that imports a public name from its module at first use."""

    _homes: Mapping[str, str]

    def __getattr__(self, name: str) -> Any:
        if name not in self._homes:
            raise AttributeError(f"module '{self.__name__}' has no attribute '{name}'")
        value = getattr(importlib.import_module(self._homes[name]), name)
        setattr(self, name, value)
        return value

    def __setattr__(self, name: str, value: Any) -> None:
        # The import of a module binds it in its package, where a public name like that of the module comes first
        if not (isinstance(value, ModuleType) and name in self._homes):
            super().__setattr__(name, value)

    def __dir__(self) -> Iterable[str]:
        return sorted(self._homes)


def lazy_package(package: str, names: Mapping[str, Iterable[str]]) -> list[str]:
    """
    Make the names of a package importable without importing their modules yet.

    Parameters
    ----------
    package : str
        ``__name__`` of the package.
    names : mapping of str to iterable of str
        Module within the package, or the full name of one elsewhere → the public names that it defines. If a name is
        also that of its module, such as a function `view` of a module `view`, the package has the function.

    Returns
    -------
    list of str
        All names, for ``__all__``.
    """
    module = sys.modules[package]
    module.__class__ = _LazyPackage
    top = package.partition(".")[0]
    full = {home: home if home.startswith(f"{top}.") else f"{package}.{home}" for home in names}
    homes = {name: full[home] for home, own in names.items() for name in own}
    vars(module)["_homes"] = homes
    return sorted(homes)
