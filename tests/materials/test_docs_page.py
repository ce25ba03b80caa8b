"""The tables of docs/materials.md say what the code does."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from mistray.errors import MistrayError
from mistray.materials import LINE_D_NM, complex_index, refractive_index, source
from mistray.materials.catalogue import MAKERS, PINNED

PAGE = (Path(__file__).parents[2] / "docs" / "materials.md").read_text(encoding="utf-8")


def rows(section: str) -> list[list[str]]:
    """Cells of the tables below a heading, without the tables' heads."""
    text = PAGE.partition(f"\n## {section}\n")[2].partition("\n## ")[0]
    lines = [line for line in text.splitlines() if line.startswith("| ")]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return [row for row in cells if row[0] not in ("name", "case", "string")]


MATERIALS = {row[0].strip("`"): row for row in rows("Pinned materials")}


@pytest.mark.parametrize("name", PINNED)
def test_row_of_a_material(name):
    _, _, n, k, n_range, k_range, page, reference = MATERIALS[name]
    found = source(name)
    if n == "unknown":
        with pytest.raises(MistrayError):
            refractive_index(name, 550.0)
    else:
        assert float(n) == pytest.approx(refractive_index(name, 550.0), abs=5.1e-5)
    if k == "unknown":
        with pytest.raises(MistrayError):
            complex_index(name, 550.0)
    else:
        assert float(k) == pytest.approx(complex_index(name, 550.0).imag, rel=0.05, abs=0)
    for printed, known in ((n_range, found.n_range_nm), (k_range, found.k_range_nm)):
        assert printed == ("unknown" if known is None else f"{known[0]:.6g} … {known[1]:.6g}")
    pages = re.findall(r"`(.+?)`", page)
    assert pages == [part for part in (found.page, found.k_page) if part]
    author, _, journal = reference.partition(", ")
    assert re.split(" and | et al", author)[0] in found.reference
    assert journal in found.reference


def test_pages_of_the_infrared():
    """Each page beyond the first of a name has its row, in the order in which they are asked."""
    listed = iter(rows("In the infrared"))
    for name in PINNED:
        found = source(name).beyond
        while found is not None:
            of, n_range, k_range, page, reference = next(listed)
            k_known = "unknown" if not found.k_known else "stated" if found.k_range_nm is None else found.k_range_nm
            assert of == f"`{name}`"
            assert n_range == "{:.6g} … {:.6g}".format(*found.n_range_nm)
            assert k_range == (k_known if isinstance(k_known, str) else "{:.6g} … {:.6g}".format(*k_known))
            assert re.findall(r"`(.+?)`", page) == [part for part in (found.page, found.k_page) if part]
            assert re.split(" and | et al", reference.partition(", ")[0])[0] in found.reference
            assert reference.partition(", ")[2] in found.reference
            found = found.beyond
    assert next(listed, None) is None


def test_materials_of_the_phone_camera_study():
    """Every nd of the study's Table 5 but that of its sapphire, which is 0.0033 off the crystal's."""
    table = rows("The materials of the phone camera study")
    assert [row[0].strip("`") for row in table] == ["sapphire", "COC", "PSU", "N-BK7"]
    for string, _, stated, here in table:
        nd = refractive_index(string.strip("`"), LINE_D_NM)
        assert float(here) == pytest.approx(nd, abs=5.1e-5)
        assert float(stated) == pytest.approx(nd, abs=3.4e-3 if string == "`sapphire`" else 5e-5)
    assert refractive_index("nd=1.7715 Vd=72.2", LINE_D_NM) == pytest.approx(1.7715, abs=1e-9)


@pytest.mark.parametrize("row", rows("When something is wrong"), ids=lambda row: row[0])
def test_message(row, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    name, wavelength = re.fullmatch(r"`(.+)`(?: at (\d+) nm)?", row[0]).groups()
    with pytest.raises(MistrayError) as caught:
        complex_index(name, float(wavelength or 550))
    assert str(caught.value) == row[1]


def test_lists():
    """Pinned materials and makers in their order; what is said to be missing is missing."""
    assert list(MATERIALS) == list(PINNED)
    listed = re.search(r"The makers are ((?:`\w+`(?:, | and )?)+)", PAGE)
    assert re.findall(r"`(\w+)`", listed[1]) == list(MAKERS)
    for name in ("cryolite", "AlF3"):
        with pytest.raises(MistrayError, match="unknown"):
            source(name)
    assert source("organic/(C5H8O2)n - poly(methyl methacrylate)/nk/Zhang-Mitsubishi").k_known
