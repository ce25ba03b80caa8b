"""Files that are wrong: every reader says in one line which file it is, where, and what is wrong."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import vectors
from refusals import refused

from mistray.coatings import CoatingTable, read_coating_file
from mistray.files.intensities import read_intensities
from mistray.files.ray_sets import read_ray_set
from mistray.materials import complex_index
from mistray.mechanics import read_mechanics
from mistray.prescription import read_codev, read_grid, read_zemax
from mistray.scatter.measured.bsdf_csv import read_bsdf_csv
from mistray.scatter.measured.psd_table import PsdTable
from mistray.scatter.measured.zemax_abg import abg_from_catalogue
from mistray.scatter.measured.zemax_bsdf import read_zemax_bsdf
from mistray.spectra.spectrum import read_table

pytestmark = pytest.mark.quick
WRONG: dict[str, dict[str, Any]] = vectors.toml("wrong_files.toml")
READERS: dict[str, Callable[[Path], object]] = {
    "coating file": lambda path: read_coating_file(path)["A"],
    "coating table": CoatingTable.read,
    "glass catalogue": lambda path: complex_index(f"{path}:N-BK7", 450.0),
    "table of indices": lambda path: complex_index(str(path), 450.0),
    "spectrum of roughness": PsdTable.read,
    "ABg catalogue": lambda path: abg_from_catalogue(f"{path}:x"),
    "Zemax BSDF": read_zemax_bsdf,
    "BSDF table": read_bsdf_csv,
    "table of light": read_table,
    **dict.fromkeys(("IES file", "table of intensities"), read_intensities),
    "grid of heights": read_grid,
    "CODE V lens": read_codev,
    "Zemax lens": read_zemax,
    "OBJ file": read_mechanics,
    **dict.fromkeys(("ray set", "Zemax rays"), read_ray_set),
}


def cases() -> list[Any]:
    found = []
    for kind, table in WRONG.items():
        for text, *says in table.get("texts", []):
            text = text.replace("{good}", table.get("good", "")).replace("{long}", "x" * 500)
            found.append(pytest.param(kind, text, says, id=kind + says[0]))
        for old, new, *says in table.get("changes", []):
            found.append(pytest.param(kind, table["good"].replace(old, new, 1), says, id=kind + says[0]))
    return found


@pytest.mark.parametrize(("kind", "text", "says"), cases())
def test_one_line_names_file_and_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str, text: str, says: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    file, begins = WRONG[kind]["file"], WRONG[kind]["begins"]
    Path(file).write_bytes(text.encode("latin-1"))
    first, *more = (words.replace("{file}", file) for words in says)
    with refused(f"^{begins} '[^']*{re.escape(file)}'{re.escape(first)}", *more) as caught:
        READERS[kind](Path(file))
    assert len(str(caught.value)) < 400


@pytest.mark.parametrize("kind", ["coating table", "table of indices"])
def test_a_cell_too_long(tmp_path: Path, kind: str) -> None:
    """Beyond 131072 letters, Python's csv gives up with an error of its own."""
    file = tmp_path / "long.csv"
    file.write_text("wavelength_nm,n\n400," + "1" * 200_000)
    with refused("line 2: field larger than field limit .*; correct the line"):
        READERS[kind](file)
