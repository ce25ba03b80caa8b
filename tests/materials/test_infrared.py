"""Materials of the infrared: indices against numbers that others print, absorption, names, and where the data end."""

import math
from pathlib import Path

import pytest
import vectors
from command_line import fails, succeeds
from refusals import refused
from singlet_files import plano_convex

from mistray.materials import complex_index, refractive_index, source

# Second pages of the database: other samples, mostly of other laboratories. There is none for IRG27. For MgF2 beyond
# 1700 nm the one that there is differs by 1 % of n - 1 at 4 µm; for CdTe at 10 µm, by 1.2 %: unconfirmed there.
SECOND = vectors.toml("second_pages.toml")["rows"]
# None of these sources states its accuracy. What is asked for is a focal length, which goes with 1/(n - 1).
FOCAL_LENGTH = 5e-4


@pytest.mark.parametrize(("name", "other", "wavelengths_nm"), SECOND)
def test_second_sources(name: str, other: str, wavelengths_nm: tuple[float, ...]) -> None:
    for nm in wavelengths_nm:
        assert refractive_index(name, nm) - 1 == pytest.approx(refractive_index(other, nm) - 1, rel=FOCAL_LENGTH), nm


def test_names_of_lens_files_and_makers() -> None:
    for name, others in {
        "Ge": "GERMANIUM germanium GERMLW",
        "Si": "SILICON",
        "ZnSe": "ZNSE",
        "ZnS": "ZNS_IR ZNS_BROAD zns-ir Cleartran",
        "CdTe": "CDTE",
        "KRS-5": "KRS5 krs-5",
        "sapphire": "SAPPHIRE",
        "schott/IRG26": "IRG26 irg-26 IRG26",
        "vitron/IG6": "IG6 IG-6",
        "ami/AMTIR-1": "AMTIR1 AMTIR-1 AMTIR_1",
        "ami/AMTIR-3": "AMTIR3",
        "lightpath/BD-2": "BD2 BD-2",
        "lightpath/BD6": "BD6 bd-6",
    }.items():
        for other in others.split():
            assert source(other).name == name


def test_pages_go_by_the_wavelength() -> None:
    """Germanium has a page of the visible and one of the infrared; in the visible it is what it always was."""
    first = source("Ge")
    assert first.beyond is not None
    assert [first.page, first.beyond.page] == ["main/Ge/nk/Nunley", "main/Ge/nk/Burnett"]
    assert complex_index("Ge", 1000.0) == complex_index("main/Ge/nk/Nunley", 1000.0)
    assert refractive_index("Ge", 9000.0) == refractive_index("main/Ge/nk/Burnett", 9000.0)
    assert refractive_index("Ge", 16000.0) == refractive_index("main/Ge/nk/Li-293K", 16000.0)
    assert complex_index("Ge k=0 shift=0.01", 9000.0) == complex(refractive_index("Ge", 9000.0) + 0.01, 0.0)


def test_absorption() -> None:
    """
    4πk/λ as docs/materials.md states it, k with two digits; no second source of these was found.

    Lattice bands of silicon against the page of D. Chandler-Horowitz and P. M. Amirtharaj; germanium absorbs more than
    the least that has been measured, 0.007/cm (J. Foley, S. K. Sharma, R. M. Wood, ASTM STP 37015, 1981).
    """

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
    lens = tmp_path / "lens.zmx"
    lens.write_text(plano_convex("GASIR2 0 0 4.0 800", "INFRARED", 10.0))
    assert "--glass GASIR2=" in fails(capsys, "import", lens, "-o", tmp_path / "lens.xml")


@pytest.mark.parametrize(
    ("glass", "n", "note"),
    [("GERMANIUM", 4.0043, ""), ("AMTIR3", 2.6023, "absorption unknown, taken to be 0"), ("ZNS_BROAD", 2.2008, "")],
)
def test_lens_files(glass: str, n: float, note: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The focal length of a plano-convex lens is 1/(c (n - 1))."""
    (tmp_path / "lens.zmx").write_text(plano_convex(f"{glass} 0 0 4.0 800", "INFRARED", 10.0))
    printed = succeeds(capsys, "import", tmp_path / "lens.zmx", "-o", tmp_path / "lens.xml")
    assert f"focal length {1 / (0.02 * (n - 1)):.4g}"[:16] in printed
    assert note in printed
    assert ("absorption" in printed) == bool(note)
