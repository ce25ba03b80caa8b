"""optiland and ray-optics as the tests import them: without what they draw and compile with.

``pip install --no-deps -r tests/peers.txt`` installs what their lenses need, without Qt, vtk (570 MB), and numba with
LLVM (200 MB). optiland imports vtk for its drawings, and numba for decorators of loops that are Python all the same;
where one of the two is not installed, a module that does nothing takes its place.
"""

import importlib
import sys
import warnings
from collections.abc import Callable
from importlib.util import find_spec
from types import ModuleType
from typing import Any

import pytest


def need(package: str) -> None:
    """Leave the test out where a package is not installed."""
    if find_spec(package) is None:
        pytest.skip(f"{package} is not installed: pip install --no-deps -r tests/peers.txt")


def optiland(module: str) -> ModuleType:
    """A module of optiland by its name in the package; the test is left out where that is not installed."""
    need("optiland")
    if not _there("vtk"):
        _stand_in("vtk.util.numpy_support", numpy_to_vtk=None, numpy_to_vtkIdTypeArray=None)
    if not _there("numba"):
        _stand_in("numba.extending", register_jitable=_as_it_is)
        vars(sys.modules["numba"]).update(jit=_as_it_is, njit=_as_it_is, prange=range)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return importlib.import_module(f"optiland.{module}")


def rayoptics(module: str) -> ModuleType:
    """A module of ray-optics by its name in the package; the test is left out where that is not installed."""
    need("rayoptics")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return importlib.import_module(f"rayoptics.{module}")


def _there(name: str) -> bool:
    return name in sys.modules or find_spec(name) is not None


def _stand_in(name: str, **contents: Any) -> None:
    """Make a module and those that it lies in, without files."""
    parts = name.split(".")
    for count in range(1, len(parts) + 1):
        module = ModuleType(".".join(parts[:count]))
        sys.modules[module.__name__] = module
        if count > 1:
            setattr(sys.modules[".".join(parts[: count - 1])], parts[count - 1], module)
    vars(sys.modules[name]).update(contents)


def _as_it_is(function: Callable | None = None, **_options: Any) -> Callable:
    return function if function is not None else lambda decorated: decorated
