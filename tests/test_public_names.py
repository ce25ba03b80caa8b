"""Names that a Python user types: the version, and what the docstrings of functions refer to."""

import importlib.metadata
import re

import pytest

import mistray

pytestmark = pytest.mark.quick


def test_the_version_is_that_of_the_installed_package() -> None:
    assert mistray.__version__ == importlib.metadata.version("mistray")
    assert "__version__" in dir(mistray)


def test_what_the_docstring_of_trace_names_is_there() -> None:
    named = set(re.findall(r"`mistray\.trace\.(\w+)", mistray.trace.__doc__ or ""))
    assert {"Settings", "PolarizationChoice"} <= named
    assert [name for name in sorted(named) if not hasattr(mistray.trace, name)] == []
    assert mistray.trace.Trace is mistray.Trace  # type: ignore[attr-defined]
