"""Materials of the infrared: indices against numbers that others print, absorption, names, and where the data end."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from mistray import MistrayError
from mistray.cli import main
from mistray.materials import complex_index, refractive_index, source

# n as a handbook or a data sheet prints it, and the digits to which two laboratories or melts agree
HANDBOOK = "W. J. Tropf, M. E. Thomas, T. J. Harris, Handbook of Optics II, chapter 33"
PRINTED = [
    # name, wavelength nm, n, within, source
    ("Ge", 10000.0, 4.0032, 1e-3, "Umicore, Electro-Optic Materials: germanium"),
    ("Ge", 4000.0, 4.0245, 1e-3, "Umicore, Electro-Optic Materials: germanium"),
    ("Ge", 8000.0, 4.0052, 1.2e-3, "Umicore, Electro-Optic Materials: germanium"),
    ("Si", 5000.0, 3.4223, 3e-4, "C. D. Salzberg and J. J. Villa, J. Opt. Soc. Am. 47, 244 (1957)"),
    ("Si", 10000.0, 3.4179, 4e-4, "C. D. Salzberg and J. J. Villa, J. Opt. Soc. Am. 47, 244 (1957)"),
    ("ZnSe", 10000.0, 2.4065, 2e-4, "II-VI, CVD zinc selenide"),
    ("ZnSe", 10600.0, 2.4028, 2e-4, "II-VI, CVD zinc selenide"),
    ("ZnSe", 5000.0, 2.4295, 2e-4, "II-VI, CVD zinc selenide"),
    ("ZnS", 10000.0, 2.2002, 1e-3, "Rohm and Haas, Cleartran"),
    ("ZnS", 4000.0, 2.2523, 1e-3, "Rohm and Haas, Cleartran"),
    ("CdTe", 10000.0, 2.6722, 2e-3, HANDBOOK),
    ("KRS-5", 10000.0, 2.3707, 2e-4, "W. S. Rodney and I. H. Malitson, J. Opt. Soc. Am. 46, 956 (1956)"),
    ("CaF2", 4000.0, 1.4096, 2e-4, HANDBOOK),
    ("CaF2", 8000.0, 1.3498, 3e-4, HANDBOOK),
    ("BaF2", 5000.0, 1.4510, 2e-4, HANDBOOK),
    ("BaF2", 10000.0, 1.4014, 3e-4, HANDBOOK),
    ("MgF2 crystal", 4000.0, 1.3488, 3e-4, HANDBOOK),
    ("sapphire", 4000.0, 1.6752, 3e-4, HANDBOOK),
    ("sapphire", 5000.0, 1.6240, 3e-4, HANDBOOK),
    ("IRG22", 10000.0, 2.4967, 2e-4, "Schott, IRG 22"),
    ("IRG23", 10000.0, 2.7870, 3e-4, "Schott, IRG 23"),
    ("IRG24", 10000.0, 2.6090, 3e-4, "Schott, IRG 24"),
    ("IRG25", 10000.0, 2.6032, 3e-4, "Schott, IRG 25"),
    ("IRG26", 10000.0, 2.7782, 3e-4, "Schott, IRG 26"),
    ("IRG27", 4000.0, 2.4168, 3e-4, "Schott, IRG 27"),
    # The maker's twin of the same composition: AMTIR-1 = IG2, AMTIR-3 = IG5 = IRG25 = BD-2, BD6 = IG6 = IRG26
    ("IG2", 10000.0, 2.4967, 1e-3, "Schott, IRG 22"),
    ("IG3", 10000.0, 2.7870, 1e-3, "Schott, IRG 23"),
    ("IG4", 10000.0, 2.6090, 1e-3, "Schott, IRG 24"),
    ("IG5", 10000.0, 2.6032, 1e-3, "Schott, IRG 25"),
    ("IG6", 10000.0, 2.7782, 1e-3, "Schott, IRG 26"),
    ("AMTIR-1", 10000.0, 2.4975, 1e-3, HANDBOOK),
    ("AMTIR-3", 10000.0, 2.6023, 1e-3, "Schott, IRG 25"),
    ("BD-2", 10000.0, 2.6032, 1e-3, "Schott, IRG 25"),
    ("BD6", 10000.0, 2.7782, 1e-3, "Schott, IRG 26"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "wavelength_nm", "n", "within", "by"), PRINTED)
def test_printed_indices(name: str, wavelength_nm: float, n: float, within: float, by: str) -> None:
    assert refractive_index(name, wavelength_nm) == pytest.approx(n, abs=within), by


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


@pytest.mark.parametrize(
    ("name", "wavelength_nm", "per_cm", "factor"),
    [
        ("Ge", 10600.0, 0.022, 1.5),  # Umicore: 0.02/cm
        ("Si", 10600.0, 1.0, 1.6),  # R. J. Collins and H. Y. Fan, Phys. Rev. 93, 674 (1954): lattice bands, about 1/cm
        ("ZnSe", 10600.0, 0.0005, 1.1),
        ("ZnS", 10600.0, 0.2, 1.1),
        ("CaF2", 8000.0, 0.17, 1.5),  # T. F. Deutsch, J. Phys. Chem. Solids 34, 2091 (1973)
    ],
)
def test_absorption_per_cm(name: str, wavelength_nm: float, per_cm: float, factor: float) -> None:
    """α = 4πk/λ, against what others print."""
    alpha = 4 * math.pi * complex_index(name, wavelength_nm).imag / (wavelength_nm * 1e-7)
    assert per_cm / factor < alpha < per_cm * factor


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
    with pytest.raises(MistrayError) as error:
        complex_index(name, wavelength_nm)
    assert f"'{nearest}'" in str(error.value)
    assert "extrapolate" not in str(error.value)
    assert refractive_index(nearest, wavelength_nm) > 1


def test_what_has_no_page_is_refused_by_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(MistrayError, match=r"GASIR1.*Umicore.*AGF file.*n\(8000\)"):
        refractive_index("GASIR1", 10000.0)
    lens = tmp_path / "lens.zmx"
    lens.write_text(LENS.format(glass="GASIR2"))
    assert main(["import", str(lens), "-o", str(tmp_path / "lens.xml")]) == 2
    assert "--glass GASIR2=" in capsys.readouterr().err


LENS = """MODE SEQ
UNIT MM
ENPD 20
GCAT INFRARED
FTYP 0 0 1 1
YFLN 0
WAVM 1 10.0 1
PWAV 1
SURF 0
  CURV 0.0
  DISZ INFINITY
SURF 1
  STOP
  CURV 0.02
  DISZ 4
  GLAS {glass} 0 0 4.0 800
  DIAM 12 1
SURF 2
  CURV 0.0
  DISZ 20
  DIAM 12 1
SURF 3
  CURV 0.0
  DISZ 0
  DIAM 5 1
"""


@pytest.mark.parametrize(
    ("glass", "n", "note"),
    [("GERMANIUM", 4.0032, ""), ("AMTIR3", 2.6023, "absorption unknown, taken to be 0"), ("ZNS_BROAD", 2.2002, "")],
)
def test_lens_files(glass: str, n: float, note: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The focal length of a plano-convex lens is 1/(c (n - 1))."""
    (tmp_path / "lens.zmx").write_text(LENS.format(glass=glass))
    assert main(["import", str(tmp_path / "lens.zmx"), "-o", str(tmp_path / "lens.xml")]) == 0
    printed = capsys.readouterr().out
    assert f"focal length {1 / (0.02 * (n - 1)):.4g}"[:16] in printed
    assert note in printed
    assert ("absorption" in printed) == bool(note)
