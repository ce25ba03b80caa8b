"""Runs the notebooks for the site, and keeps their results in out/notebooks until their code or mistray's changes.

    python docs/site/notebook_results.py [NAME ...]

`make docs` calls it before it builds the site. A page of a notebook that has no results of its code says so.
"""

from __future__ import annotations

import hashlib
import html
import json
import re
import sys
import tempfile
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
KEPT = ROOT / "out" / "notebooks"
TOKEN = "notebook-output-{name}-{cell}"
MOST_HTML = 300_000  # letters; what is larger, such as a 3-D view with its script, is named
MOST_LINES = 40  # of printed text
_ESCAPES = re.compile(r"\x1b\[[0-9;]*m")


def names() -> list[str]:
    """The notebooks, without the ending of their files."""
    return sorted(file.stem for file in (ROOT / "notebooks").glob("*.ipynb"))


def key(name: str) -> str:
    """Checksum of the code of a notebook and of all that computes its results."""
    from mistray.cache import code_fingerprint

    return hashlib.sha256("\0".join([code_fingerprint(), *code_of(name)]).encode()).hexdigest()


def code_of(name: str) -> list[str]:
    """The code cells of a notebook."""
    cells = json.loads((ROOT / "notebooks" / f"{name}.ipynb").read_text(encoding="utf-8"))["cells"]
    return ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]


def results(name: str) -> list[list[dict[str, Any]]] | None:
    """Outputs of the code cells of a notebook, in order; None if none are kept of its present code."""
    try:
        kept = json.loads((KEPT / f"{name}.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return kept["outputs"] if kept.get("key") == key(name) else None


def run(name: str) -> bool:
    """Run a notebook and keep the outputs of its code cells; False, with a line, if it needs what is not installed."""
    import nbformat
    from nbclient import NotebookClient
    from nbclient.exceptions import CellExecutionError

    notebook = nbformat.read(ROOT / "notebooks" / f"{name}.ipynb", as_version=4)
    with tempfile.TemporaryDirectory() as folder:
        client = NotebookClient(notebook, timeout=3000, kernel_name="python3", resources={"metadata": {"path": folder}})
        try:
            client.execute()
        except CellExecutionError as error:
            if error.ename != "ModuleNotFoundError":
                raise
            print(f"notebooks/{name}.ipynb: {error.evalue}; install it to see results", flush=True)
            return False
    outputs = [cell.get("outputs", []) for cell in notebook.cells if cell.cell_type == "code"]
    KEPT.mkdir(parents=True, exist_ok=True)
    (KEPT / f"{name}.json").write_text(json.dumps({"key": key(name), "outputs": outputs}), encoding="utf-8")
    return True


def last_picture(name: str) -> str | None:
    """The last PNG of a notebook's results, as base64."""
    outputs = [output for cell in results(name) or [] for output in cell]
    pictures = [output["data"]["image/png"] for output in outputs if "image/png" in output.get("data", {})]
    return pictures[-1] if pictures else None


def shown(outputs: list[dict[str, Any]], alternative: str) -> str:
    """Outputs of a cell as HTML; `alternative` is the text of its pictures."""
    found = "".join(_shown(output, alternative) for output in outputs)
    return f'<div class="outputs">{found}</div>' if found else ""


def _shown(output: dict[str, Any], alternative: str) -> str:
    if output["output_type"] == "stream":
        return _text(_joined(output["text"])) if output["name"] == "stdout" else ""
    data = output.get("data", {})
    if "image/png" in data:
        png = _joined(data["image/png"]).replace("\n", "")
        return f'<img class="wide" loading="lazy" alt="{html.escape(alternative)}" src="data:image/png;base64,{png}">'
    if "text/html" in data:
        page = _joined(data["text/html"])
        if len(page) <= MOST_HTML and "<script" not in page and "<iframe" not in page:
            return page
        return "<p><em>An interactive view, which the notebook shows.</em></p>"
    return _text(_joined(data["text/plain"])) if "text/plain" in data else ""


def _text(text: str) -> str:
    lines = _ESCAPES.sub("", text).rstrip().splitlines()
    left = len(lines) - MOST_LINES
    lines = [*lines[:MOST_LINES], *([f"… and {left} more lines"] if left > 0 else [])]
    return f'<pre class="output" tabindex="0">{html.escape(chr(10).join(lines))}</pre>' if any(lines) else ""


def _joined(text: str | list[str]) -> str:
    return text if isinstance(text, str) else "".join(text)


def main() -> int:
    """Run what is named, or what has no results of its present code."""
    given = sys.argv[1:]
    if unknown := set(given) - set(names()):
        raise SystemExit(f"{', '.join(sorted(unknown))}: no notebook of this name in notebooks/")
    for name in given or [name for name in names() if results(name) is None]:
        print(f"running notebooks/{name}.ipynb", flush=True)
        run(name)
    return 0


if __name__ == "__main__":
    sys.exit(main())
