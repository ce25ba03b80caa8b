"""Infrared materials by their usual names, each with the pages that cover it from 1 to 14 µm.

Some materials have one page for the visible and another for the infrared; the first that covers a wavelength is used.
If no page has the absorption, it is unknown, or stated here from an absorption coefficient α, k = αλ/(4π). The stated
values are typical of CVD material; no source was found that confirms them.
"""

from __future__ import annotations

import re

from mistray.materials.entry import Entry, by_wavelength

_CRYSTRAN = "specs/crystran/optical"
_SI_K = "main/Si/nk/Franta-25C"
_STATED = "round values of CVD material, unconfirmed"
# α = 0.0005/cm at 10.6 µm; α = 0.0006/cm at 3.8 µm (multispectral) and 0.2/cm at 10.6 µm
_ZNSE_K, _ZNS_K = ((10600.0, 4.2e-8),), ((3800.0, 1.8e-8), (10600.0, 1.7e-5))

BY_WAVELENGTH = [
    by_wavelength(
        Entry("Ge", "main/Ge/nk/Nunley"),
        Entry("Ge", "main/Ge/nk/Burnett", f"{_CRYSTRAN}/Ge"),
        Entry("Ge", "main/Ge/nk/Li-293K", f"{_CRYSTRAN}/Ge"),
    ),
    by_wavelength(
        Entry("Si", "main/Si/nk/Schinke"),
        Entry("Si", "main/Si/nk/Chandler-Horowitz", _SI_K),
        Entry("Si", "main/Si/nk/Salzberg", _SI_K),
    ),
    by_wavelength(
        Entry("ZnSe", "main/ZnSe/nk/Amotchkina", to_nm=888.0),
        Entry("ZnSe", "main/ZnSe/nk/Connolly", k_stated=_ZNSE_K, k_reference=_STATED),
    ),
    by_wavelength(
        Entry("ZnS", "main/ZnS/nk/Amotchkina", to_nm=1000.0),
        Entry("ZnS", "main/ZnS/nk/Debenham", k_stated=_ZNS_K, k_reference=_STATED),
    ),
    by_wavelength(
        Entry("CdTe", "main/CdTe/nk/Marple"),
        Entry("CdTe", "main/CdTe/nk/DeBell-300K"),
        Entry("CdTe", f"{_CRYSTRAN}/CdTe"),
    ),
    Entry("KRS-5", f"{_CRYSTRAN}/KRS5"),
    by_wavelength(
        Entry("CaF2", "main/CaF2/nk/Daimon-20", "specs/schott/misc/LITHOTEC-CAF2"),
        Entry("CaF2", "main/CaF2/nk/Malitson", f"{_CRYSTRAN}/CaF2"),
        Entry("CaF2", "main/CaF2/nk/Li", f"{_CRYSTRAN}/CaF2"),
    ),
    by_wavelength(
        Entry("BaF2", "main/BaF2/nk/Malitson", to_nm=2500.0),
        Entry("BaF2", "main/BaF2/nk/Malitson", f"{_CRYSTRAN}/BaF2"),
        Entry("BaF2", "main/BaF2/nk/Li", f"{_CRYSTRAN}/BaF2"),
    ),
    by_wavelength(Entry("MgF2 crystal", "main/MgF2/nk/Dodge-o"), Entry("MgF2 crystal", "main/MgF2/nk/Li-o")),
    by_wavelength(Entry("sapphire", "main/Al2O3/nk/Malitson-o"), Entry("sapphire", "main/Al2O3/nk/Malitson")),
]
"""Pinned materials whose pages are in the infrared, or extend into it."""

MAKERS: dict[str, tuple[str, ...]] = {"vitron": ("infrared",), "lightpath": ("infrared",), "ami": ("infrared",)}
"""Folders of pages by maker of chalcogenide glasses; the glasses of Schott are with its other glasses."""

_NAMES = {
    "Ge": "GERMANIUM GERMMW GERMLW",
    "Si": "SILICON SILICN",
    "ZnSe": "ZINC-SELENIDE",
    "ZnS": "ZNS_IR ZNS_BROAD ZNS_VIS CLEARTRAN ZINC-SULFIDE ZINC-SULPHIDE",
    "KRS-5": "KRS5",
    "MgF2 crystal": "MGF2-O",
    "lightpath/BD-2": "BD2 BLACK-DIAMOND-2",
    "lightpath/BD6": "BD-6 BLACK-DIAMOND-6",
    "ami/AMTIR-1": "AMTIR1",
    "ami/AMTIR-2": "AMTIR2",
    "ami/AMTIR-3": "AMTIR3",
    **{f"vitron/IG{number}": f"IG-{number}" for number in range(2, 7)},
    **{f"schott/IRG{number}": f"IRG-{number}" for number in range(22, 28)},
}


def plain(name: str) -> str:
    """Return a material name reduced to capitals and digits, so that ``ZNS_IR`` and ``ZnS-IR`` are equal."""
    return re.sub(r"[^A-Z0-9]", "", name.upper())


OTHER_NAMES = {plain(word): name for name, words in _NAMES.items() for word in words.split()}
"""Names of these materials here, by the names of lens files and makers in the form of `plain`."""


def without_page(name: str) -> str | None:
    """Return why an infrared glass of the name GASIR… has no data here, with a remedy; None for other names."""
    if not plain(name).startswith("GASIR"):
        return None
    return (
        "is a glass of Umicore, whose data are in no page of the database; give its AGF file (FILE.agf:NAME), or the "
        "indices of its data sheet (n(8000)=… n(10000)=… n(12000)=… k=0)"
    )
