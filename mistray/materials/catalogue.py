"""Catalogue of materials: their names, and the database pages on which their n and k stand."""

from __future__ import annotations

import difflib
import os
from collections.abc import Iterable
from functools import cache, lru_cache
from itertools import chain
from pathlib import Path

from mistray.errors import MistrayError
from mistray.materials import infrared
from mistray.materials.entry import Entry
from mistray.materials.pages import SUPPLIERS, data_folder

_PMMA = "organic/(C5H8O2)n - poly(methyl methacrylate)/nk"
_PS = "organic/(C8H8)n - polystyrene/nk"
_PC = "organic/(C16H14O3)n - polycarbonate/nk"
_POLYMERS = "other/commercial polymers"
_PHONE = "Stray Light Analysis of a Mobile Phone Camera (with FRED), Table 5 (nd) and Figure 6 (Vd)"


_IR = {entry.name: entry for entry in infrared.BY_WAVELENGTH}

_PINNED = [
    # Crystals and glasses that have no single maker
    Entry("fused silica", "main/SiO2/nk/Malitson", "specs/schott/misc/LITHOSIL-Q"),
    _IR["sapphire"],
    _IR["CaF2"],
    _IR["BaF2"],
    _IR["MgF2 crystal"],
    Entry("LiF", "main/LiF/nk/Li"),
    _IR["KRS-5"],
    Entry("diamond", "main/C/nk/Phillip"),
    Entry("soda lime", "glass/misc/soda-lime/nk/Rubin-clear"),
    Entry("water", "main/H2O/nk/Hale"),
    # Plastics
    Entry("PMMA", f"{_PMMA}/Beadie"),
    Entry("PC", f"{_PC}/Sultanova"),
    Entry("PS", f"{_PS}/Sultanova"),
    Entry("SAN", "other/mixed organic/(C8H8)n-(C3H3N)m/nk/Sultanova"),
    Entry("NAS-21", f"{_POLYMERS}/NAS-21/nk/Sultanova"),
    Entry("Optorez 1330", f"{_POLYMERS}/Optorez1330/nk/Sultanova"),
    Entry("Zeonex E48R", f"{_POLYMERS}/ZeonexE48R/nk/Sultanova"),
    Entry("PET", "organic/(C10H8O4)n - polyethylene terephthalate/nk/Zhang"),
    Entry("PEI", "organic/(C37H24O6N2)n - polyetherimide/nk/Zhang"),
    Entry("COC", _PHONE, nd_vd=(1.5333, 56.1)),
    Entry("PSU", _PHONE, nd_vd=(1.634, 23.4)),
    # Metals and semiconductors
    Entry("Ag", "main/Ag/nk/Johnson"),
    Entry("Al", "main/Al/nk/Rakic"),
    Entry("Au", "main/Au/nk/Johnson"),
    Entry("Be", "main/Be/nk/Rakic-BB"),
    Entry("Co", "main/Co/nk/Johnson"),
    Entry("Cr", "main/Cr/nk/Johnson"),
    Entry("Cu", "main/Cu/nk/Johnson"),
    Entry("Fe", "main/Fe/nk/Johnson"),
    Entry("Ir", "main/Ir/nk/Schmitt-MS"),
    Entry("Mo", "main/Mo/nk/Kirillova"),
    Entry("Ni", "main/Ni/nk/Johnson"),
    Entry("Pd", "main/Pd/nk/Johnson"),
    Entry("Pt", "main/Pt/nk/Tselin"),
    Entry("Rh", "main/Rh/nk/Weaver"),
    Entry("Ti", "main/Ti/nk/Johnson"),
    Entry("W", "main/W/nk/Weaver"),
    Entry("brass", "other/alloys/Cu-Zn/nk/Querry-Cu70Zn30"),
    Entry("stainless steel", "other/alloys/stainless steel/nk/Karlsson-austenitic"),
    _IR["Si"],
    _IR["Ge"],
    _IR["CdTe"],
    # Coating materials: thin films where the database has one with k in the visible
    Entry("Al2O3", "main/Al2O3/nk/Franta"),
    Entry("AlN", "main/AlN/nk/Beliaev1"),
    Entry("CeF3", "main/CeF3/nk/Rodriguez-de Marcos"),
    Entry("GdF3", "main/GdF3/nk/Franta"),
    Entry("HfO2", "main/HfO2/nk/Franta"),
    Entry("ITO", "other/mixed crystals/In2O3-SnO2/nk/Konig"),
    Entry("LaF3", "main/LaF3/nk/Rodriguez-de Marcos"),
    Entry("MgF2", "main/MgF2/nk/Franta"),
    Entry("Nb2O5", "main/Nb2O5/nk/Franta"),
    Entry("Sc2O3", "main/Sc2O3/nk/Belosludtsev"),
    Entry("Si3N4", "main/Si3N4/nk/Beliaev"),
    Entry("SiO", "main/SiO/nk/Hass"),
    Entry("SiO2", "main/SiO2/nk/Franta-25C"),
    Entry("Ta2O5", "main/Ta2O5/nk/Franta-2015"),
    Entry("ThF4", "main/ThF4/nk/Heitmann"),
    Entry("TiN", "main/TiN/nk/Beliaev-sputtering"),
    Entry("TiO2", "main/TiO2/nk/Franta"),
    Entry("WO3", "main/WO3/nk/Kulikova"),
    Entry("Y2O3", "main/Y2O3/nk/Nigara"),
    Entry("YbF3", "main/YbF3/nk/Amotchkina"),
    _IR["ZnS"],
    _IR["ZnSe"],
    Entry("ZrO2", "main/ZrO2/nk/Synowicki"),
]

PINNED: dict[str, Entry] = {entry.name: entry for entry in _PINNED}
"""Materials that are not the glass of a maker, by name."""

MAKERS: dict[str, tuple[str, ...]] = {
    "schott": ("optical", "obsolete", "misc", "infrared"),
    "ohara": ("optical",),
    "hoya": ("optical",),
    "cdgm": ("optical",),
    "hikari": ("optical",),
    "sumita": ("optical",),
    "lzos": ("optical",),
    **infrared.MAKERS,
}
"""Folders of pages by glass maker; a name without its maker is looked up in this order."""

_WORDS = {
    "acrylic": "PMMA",
    "alumina": "Al2O3",
    "aluminium": "Al",
    "aluminum": "Al",
    "chromium": "Cr",
    "copper": "Cu",
    "gold": "Au",
    "nickel": "Ni",
    "polycarbonate": "PC",
    "polystyrene": "PS",
    "silver": "Ag",
    "titanium": "Ti",
    "tungsten": "W",
}
"""Names of materials by the words for which they are suggested."""

_OPAQUE = ("PBT",)
"""Structural plastics without known index."""

_SHELVES = ("main/", "organic/", "glass/", "other/", SUPPLIERS)


@cache
def glasses() -> dict[str, dict[str, Entry]]:
    """Return the catalogue entries of all glasses, nested by maker and by name of the glass."""
    root = data_folder() / SUPPLIERS
    return {
        maker: {
            glass: Entry(f"{maker}/{glass}", f"{SUPPLIERS}{maker}/{folder}/{glass}")
            for folder in folders
            for glass in _pages(root / maker / folder)
            if glass != "about"
        }
        for maker, folders in MAKERS.items()
    }


def _pages(folder: Path) -> list[str]:
    """Return the names of the database pages in a folder, without suffix, sorted."""
    return [file.removesuffix(".yml") for file in sorted(os.listdir(folder)) if file.endswith(".yml")]


def names() -> list[str]:
    """
    Return the names of all materials: common ones first, then glasses with their makers in front.

    Examples
    --------
    >>> names = mistray.materials.names()
    >>> [name for name in names if name.endswith("/F2")]
    ['schott/F2', 'cdgm/F2', 'hikari/F2']
    """
    return [*PINNED, *(entry.name for catalogue in glasses().values() for entry in catalogue.values())]


@lru_cache(maxsize=1024)
def find(name: str) -> Entry:
    """
    Return the catalogue entry of a name.

    The name may have its maker in front (``schott/N-BK7``), or be that of a page (``main/Ag/nk/Yang``). A name spelt
    exactly as in a catalogue means that entry: ``LaF3`` is the fluoride, ``LAF3`` the glass. Otherwise case does not
    matter, and infrared materials also have the names that lens files use. A glass without its maker is that of the
    first maker in `MAKERS` who has it.

    Raises
    ------
    MistrayError
        If no entry has that name, if no data of the material are known, or if both a pinned material and a glass have
        the name when case is ignored. Whether a page exists is checked by `read_page`.
    """
    if name.startswith(_SHELVES) and ".." not in name:
        return Entry(name, name)
    name = name.replace("*", "star")  # the file of CDGM's H-K9L*
    maker, slash, glass = name.partition("/")
    if slash and maker.lower() in MAKERS:
        for key, entry in glasses()[maker.lower()].items():
            if key.lower() == glass.lower():
                return entry
        elsewhere = [hits[glass.lower()].name for hits in _by_lower_case()[1:] if glass.lower() in hits]
        close = [f"{maker.lower()}/{key}" for key in _close(glass, glasses()[maker.lower()])]
        raise _unknown(name, elsewhere or close)
    for catalogue in (PINNED, *glasses().values()):
        if name in catalogue:
            return catalogue[name]
    if name.upper() in _OPAQUE:
        raise MistrayError(
            f"material '{name}' is opaque and no index of it is known; leave the material out and give the interface "
            "its R, 0.07 say"
        )
    found = [hits[name.lower()] for hits in _by_lower_case() if name.lower() in hits]
    if not found and infrared.plain(name) in infrared.OTHER_NAMES:
        return find(infrared.OTHER_NAMES[infrared.plain(name)])
    if (why := infrared.without_page(name)) is not None:
        raise MistrayError(f"material '{name}' {why}")
    if not found:
        raise _unknown(name, _close(name, chain(*glasses().values(), PINNED)))
    if found[0].name in PINNED and len(found) > 1:
        other = found[1].name
        raise MistrayError(
            f"material '{name}' may be {found[0].name} or the glass {other}; write '{found[0].name}' or '{other}'"
        )
    return found[0]


@cache
def _by_lower_case() -> list[dict[str, Entry]]:
    return [{key.lower(): entry for key, entry in part.items()} for part in (PINNED, *glasses().values())]


def _unknown(name: str, close: list[str]) -> MistrayError:
    remedy = (
        f"did you mean {' or '.join(close)}? docs/materials.md lists the names"
        if close
        else "use air, a number, 'n+ki', 'nd=… Vd=…', a name (docs/materials.md lists them; glasses of "
        f"{', '.join(MAKERS)}), file.csv or file.agf:NAME"
    )
    return MistrayError(f"material '{name}' is unknown; {remedy}")


def _close(wanted: str, spellings: Iterable[str]) -> list[str]:
    """
    Return up to three of the names `spellings` that contain `wanted` or resemble it, the most likely first.

    For an everyday word such as "silver" it is the name of that material alone.
    """
    wanted = wanted.lower()
    if wanted in _WORDS:
        return [_WORDS[wanted]]
    spelt = {key.lower(): key for key in spellings}
    close = sorted((key for key in spelt if wanted in key), key=len) if len(wanted) > 2 else []
    close += [key for key in difflib.get_close_matches(wanted, spelt) if key not in close]
    return [spelt[key] for key in close[:3]]
