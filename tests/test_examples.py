"""Examples in docstrings: each public function and class has one, and it does what it says."""

from __future__ import annotations

import dataclasses
import doctest
import fnmatch
import importlib
import inspect
import re
import sys
from functools import lru_cache
from pathlib import Path
from typing import Any

import nbformat
import numpy as np
import peers
import pytest
import vectors
from nbclient import NotebookClient
from tiers import slow_unless

import mistray
from mistray.toolkit.fields import Request

SITE = Path(__file__).parents[1] / "docs" / "site"
# Examples that take long, one by one or together: reports, studies, searches, other processes
LONG = (
    *("mistray.analysis.*", "mistray.optimize.*", "mistray.recorders.*", "mistray.report.*", "mistray.sweeps.*"),
    *("mistray.[Ss]tudy", "mistray.first_level", "mistray.FirstLevel", "mistray.thermal", "mistray.ThermalReport"),
    *("mistray.[Tt]ransfer", "mistray.image_quality", "mistray.ImageQuality", "mistray.Explorer", "mistray.distribute"),
    *("mistray.[Ss]weep", "mistray.Objects", "mistray.View", "mistray.prescription.from_batoid"),
    *("mistray.prescription.*_optiland", "mistray.prescription.*_oslo", "mistray.prescription.from_rayoptics"),
)
# What examples import of programs that may not be installed
PEERS = {"optiland": "optic", "oslo": "optic", "rayoptics": "optical.opticalmodel"}


@lru_cache(maxsize=1)
def public() -> dict[str, Any]:
    """Public functions and classes by name, each once: of `mistray`, then of the packages that the reference shows."""
    sys.path.insert(0, str(SITE))
    try:
        packages = importlib.import_module("reference").PACKAGES
    finally:
        sys.path.remove(str(SITE))
    found: dict[int, tuple[str, Any]] = {}
    for package in ("mistray", *(f"mistray.{name}" for name in packages)):
        module = importlib.import_module(package)
        for name in module.__all__:
            value = getattr(module, name)
            if inspect.isroutine(value) or inspect.isclass(value):
                found.setdefault(id(value), (f"{package}.{name}", value))
    return dict(found.values())


def failures(name: str, value: Any) -> str:
    """Run the examples of a function, or of a class and its methods, and return what went wrong."""
    told: list[str] = []
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE, verbose=False)
    for test in doctest.DocTestFinder().find(value, name, module=False, globs={"mistray": mistray, "np": np}):
        runner.run(test, out=told.append)
    assert runner.tries
    return "".join(told)


@pytest.mark.quick
def test_each_public_name_has_an_example_and_each_attribute_a_line() -> None:
    without, idle = [], []
    for name, value in public().items():
        _, heading, text = (inspect.getdoc(value) or "").partition("Examples\n--------\n>>> ")
        without += [] if heading else [name]
        shown = inspect.isclass(value) or re.search(rf"\.{name.rpartition('.')[2]}\b", text)
        idle += [] if shown else [name]
    assert len(public()) > 250
    assert (without, idle) == ([], []), "give it an example under Examples, which calls a function that it belongs to"
    assert [pattern for pattern in LONG if not fnmatch.filter(public(), pattern)] == []
    # By its class or one that it is derived from; the field of a request has its sentence where it is declared
    silent = []
    for name, value in public().items():
        if inspect.isclass(value) and not issubclass(value, Request):
            docs = "\n".join(inspect.cleandoc(one.__doc__ or "") for one in value.__mro__)
            entries = re.findall(r"^(\w+(?:, \w+)*)(?: : .+)?\n {4}\S", docs, re.MULTILINE)
            described = {one for entry in entries for one in entry.split(", ")}
            fields = [field.name for field in dataclasses.fields(value)] if dataclasses.is_dataclass(value) else []
            own = getattr(value, "_fields", ()) if issubclass(value, tuple) else fields
            known = {field for field in own if field in described or field.replace("_se", "") in described}
            silent += [f"{name}.{field}" for field in own if field[0] != "_" and field not in known]
    assert silent == []


def marks_of(name: str) -> tuple[pytest.MarkDecorator, ...]:
    if any(fnmatch.fnmatchcase(name, pattern) for pattern in LONG):
        return (pytest.mark.long,)
    return pytest.mark.quick, pytest.mark.core


@pytest.mark.parametrize("name", [pytest.param(name, marks=marks_of(name)) for name in sorted(public())])
def test_an_example_runs(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for package, module in PEERS.items():
        if name.endswith(package):
            (peers.rayoptics if package == "rayoptics" else peers.optiland)(module)
    assert failures(name, public()[name]) == ""


@pytest.mark.quick
def test_a_wrong_example_is_told() -> None:
    def wrong() -> None:
        """
        >>> mistray.report.with_error(mistray.analysis.Estimate(2.0, 0.1))
        '2.00 ± 0.20'
        """

    assert "Got:\n    '2.00 ± 0.10'" in failures("wrong", wrong)


NOTEBOOKS = sorted((Path(__file__).parents[1] / "notebooks").glob("*.ipynb"))
CELL_SECONDS = 300
# Run after the last cell of a notebook: its claims
CLAIMS: dict[str, str] = vectors.toml("notebook_claims.toml")

# Run before the notebook of optiland, which the tests import without what it draws with
NOTED = re.compile(r".*MistrayWarning: .*\[[a-z-]+\]\n.*\n")  # a note of a result, and the line that has called
BEFORE = f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r}); import peers; _ = peers.optiland('optic')"


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_committed_without_outputs_and_with_links_that_lead_somewhere(path):
    assert set(CLAIMS) <= {path.stem for path in NOTEBOOKS}
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    for cell in notebook.cells:
        if cell.cell_type == "code":
            assert (cell.outputs, cell.execution_count) == ([], None), f"{path.name}: clear the outputs"
    assert set(notebook.metadata) <= {"kernelspec", "language_info"}
    assert notebook.metadata.kernelspec.name == "python3"
    assert set(notebook.metadata.language_info) == {"name"}
    text = "\n".join(cell.source for cell in notebook.cells if cell.cell_type == "markdown")
    for target in re.findall(r"\]\((?!https?:)([^)#]+)", text):
        assert (path.parent / target).exists(), target
    for target in re.findall(r"\b(?:docs|examples)/[\w/]+\.(?:md|py)", text):  # also without a link
        assert (path.parents[1] / target).is_file(), target


# Their studies are those of examples/, which have tests of their own in tests/analyses/optimize
STUDIES = ("baffle_vanes", "phone_camera_ar", "triplet_ar")
RUN = [pytest.param(path, id=path.stem, marks=slow_unless(path.stem not in STUDIES)) for path in NOTEBOOKS]


@pytest.mark.parametrize("path", RUN)
def test_runs(path, tmp_path):
    notebook = nbformat.read(path, as_version=4)
    if path.stem == "optiland":
        peers.need("optiland")
        notebook.cells.insert(0, nbformat.v4.new_code_cell(BEFORE))
    notebook.cells.append(nbformat.v4.new_code_cell(CLAIMS.get(path.stem, "")))
    NotebookClient(notebook, timeout=CELL_SECONDS, resources={"metadata": {"path": str(tmp_path)}}).execute()
    outputs = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    assert any("image/png" in output.get("data", {}) for output in outputs), "no picture"
    widget = "application/vnd.jupyter.widget-view+json"
    assert any(widget in output.get("data", {}) for output in outputs) is (path.stem == "explorer")
    complaints = [output.text for output in outputs if output.output_type == "stream" and output.name == "stderr"]
    assert "".join(NOTED.sub("", text) for text in complaints) == ""
