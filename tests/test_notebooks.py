"""The notebooks run, and are committed without what running them leaves behind."""

import re
from pathlib import Path

import nbformat
import peers
import pytest
import vectors
from nbclient import NotebookClient
from tiers import slow_unless

NOTEBOOKS = sorted((Path(__file__).parents[1] / "notebooks").glob("*.ipynb"))
CELL_SECONDS = 300
# Run after the last cell of a notebook: its claims
CLAIMS: dict[str, str] = vectors.toml("notebook_claims.toml")

# Run before the notebook of optiland, which the tests import without what it draws with
NOTED = re.compile(r".*MistrayWarning: .*\[[a-z-]+\]\n.*\n")  # a note of a result, and the line that has called
PEERS = f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r}); import peers; _ = peers.optiland('optic')"


def read(path: Path) -> nbformat.NotebookNode:
    return nbformat.read(path, as_version=4)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_committed_without_outputs_and_with_links_that_lead_somewhere(path):
    assert set(CLAIMS) <= {path.stem for path in NOTEBOOKS}
    notebook = read(path)
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
    notebook = read(path)
    if path.stem == "optiland":
        peers.need("optiland")
        notebook.cells.insert(0, nbformat.v4.new_code_cell(PEERS))
    notebook.cells.append(nbformat.v4.new_code_cell(CLAIMS.get(path.stem, "")))
    NotebookClient(notebook, timeout=CELL_SECONDS, resources={"metadata": {"path": str(tmp_path)}}).execute()
    outputs = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    assert any("image/png" in output.get("data", {}) for output in outputs), "no picture"
    widget = "application/vnd.jupyter.widget-view+json"
    assert any(widget in output.get("data", {}) for output in outputs) is (path.stem == "explorer")
    complaints = [output.text for output in outputs if output.output_type == "stream" and output.name == "stderr"]
    assert "".join(NOTED.sub("", text) for text in complaints) == ""
