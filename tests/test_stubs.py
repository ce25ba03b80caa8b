"""Stubs say what the functions are when they run, type checkers find wrong calls by them, public names exist."""

import importlib.metadata
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import stubs

import mistray

# Of a user, whose checker takes Mitsuba as it comes
SCRIPT = """\
import numpy as np
import mistray

scene = mistray.load("phone_camera")
mistray.ghosts(scene, [0, 10], rays=1000).notes
mistray.pst(scene, field_deg=np.arange(0, 80, 2))
mistray.ghosts(scene, rays="x")
mistray.analysis.objects(scene, half_angel_deg=20)
mistray.optimize.sensitivity("metric")
"""
SETTINGS = """\
[mypy]
follow_imports = silent
ignore_missing_imports = true
[mypy-mitsuba.*,drjit.*]
follow_imports = skip
follow_imports_for_stubs = true
"""
WRONG = [
    'script.py:7: error: Argument "rays" to "ghosts" has incompatible type "str"; expected "int | None"  [arg-type]',
    'script.py:8: error: Unexpected keyword argument "half_angel_deg" for "objects"; did you mean "half_angle_deg"',
    'script.py:9: error: Argument 1 to "sensitivity" has incompatible type "str"; expected "Metric"  [arg-type]',
]


@pytest.mark.core
@pytest.mark.parametrize("package", stubs.packages())
def test_a_stub_is_what_runs(package: str) -> None:
    kept = stubs.statements(stubs.place(package).read_text(encoding="utf-8"))
    now = stubs.statements(stubs.stub(package))
    assert [name for name in now | kept if now.get(name) != kept.get(name)] == [], "run: python tests/stubs.py"


def test_nothing_else_has_a_stub() -> None:
    """A stub hides the module beside it from the type checker."""
    assert sorted((stubs.ROOT / "mistray").rglob("*.pyi")) == sorted(map(stubs.place, stubs.packages()))
    assert (stubs.ROOT / "mistray" / "py.typed").is_file()


@pytest.mark.long
def test_a_user_is_told_of_wrong_calls(tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text(SCRIPT, encoding="utf-8")
    (tmp_path / "mypy.ini").write_text(SETTINGS, encoding="utf-8")
    path = {**os.environ, "MYPYPATH": str(stubs.ROOT)}
    command = [sys.executable, "-m", "mypy", "--strict", "--cache-dir", str(tmp_path / "cache"), "script.py"]
    done = subprocess.run(command, cwd=tmp_path, env=path, capture_output=True, text=True)
    told = re.findall(r"^script.*error.*", done.stdout, re.MULTILINE)
    assert len(told) == len(WRONG), done.stdout + done.stderr
    for line, start in zip(told, WRONG, strict=True):
        assert line.startswith(start)


@pytest.mark.quick
def test_the_version_is_that_of_the_installed_package() -> None:
    assert mistray.__version__ == importlib.metadata.version("mistray")
    assert "__version__" in dir(mistray)


@pytest.mark.quick
def test_what_the_docstring_of_trace_names_is_there() -> None:
    named = set(re.findall(r"`mistray\.trace\.(\w+)", mistray.trace.__doc__ or ""))
    assert {"Settings", "PolarizationChoice"} <= named
    assert [name for name in sorted(named) if not hasattr(mistray.trace, name)] == []
    assert mistray.trace.Trace is mistray.Trace  # type: ignore[attr-defined]
