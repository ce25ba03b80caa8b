"""From a material string to its n, its k and where they come from."""

from __future__ import annotations

import difflib
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

from mistray.errors import MistrayError
from mistray.materials import agf, user_table
from mistray.materials.catalogue import Entry, find
from mistray.materials.curve import Curve, constant, table
from mistray.materials.formulas import CAUCHY_RANGE_NM, cauchy_index
from mistray.materials.mate import read_mate
from mistray.materials.pages import read_page
from mistray.materials.spec import AbbeNumber, BulkScatter, Constant, Samples, Spec, UserFile, parse


@dataclass(frozen=True)
class Source:
    """
    Where the numbers of a material come from.

    Attributes
    ----------
    name : str
        What the string was found to mean, such as ``schott/F2``.
    page : str or None
        Page of the refractiveindex.info database or path of a file; None where the string itself holds the numbers.
    reference : str
        Literature, or what the string states.
    comment : str
        Sample and conditions, where the page tells.
    n_range_nm : tuple of two float or None
        Where n is known, nm; None if everywhere.
    k_range_nm : tuple of two float or None
        Where k is known, nm; None if everywhere or nowhere, see `k_known`.
    k_known : bool
        Whether there is a k at all.
    k_page, k_reference : str or None
        Where k comes from, if not from the same source as n.
    """

    name: str
    page: str | None
    reference: str
    comment: str
    n_range_nm: tuple[float, float] | None
    k_range_nm: tuple[float, float] | None
    k_known: bool
    k_page: str | None = None
    k_reference: str | None = None


@dataclass(frozen=True, eq=False)
class _Material:
    """n, k (None if unknown) and, in `describe`, where they come from."""

    n: Curve
    k: Curve | None
    name: str
    page: str | None
    reference: str
    comment: str = ""
    k_page: str | None = None
    k_reference: str | None = None


def refractive_index(material: str, wavelength_nm: float) -> float:
    """
    Real refractive index.

    Parameters
    ----------
    material : str
        See `mistray.materials`.
    wavelength_nm : float
        Vacuum wavelength, greater than 0, nm.

    Returns
    -------
    float
        n > 0; below 1 for some metals. k need not be known.

    Raises
    ------
    MistrayError
        If the name is unknown, a number is out of its range, a file is not understood, or the wavelength lies outside
        of the material's range.
    """
    spec = parse(material)
    _check_wavelength(spec, wavelength_nm)
    return _real(spec, _material(spec), wavelength_nm)


def nearest_known_nm(material: str, wavelength_nm: float, with_k: bool = False) -> float:
    """
    The wavelength nearest to another one at which n of a material is known, nm.

    Parameters
    ----------
    material : str
    wavelength_nm : float
    with_k : bool
        Known must be k, too, if it is known anywhere.

    Raises
    ------
    MistrayError
        If the string is not understood.
    """
    spec = parse(material)
    if spec.extrapolate:
        return wavelength_nm
    found = _material(spec)
    for curve in (found.n, *([found.k] if with_k and found.k is not None else [])):
        if curve.range_nm is not None:
            wavelength_nm = min(max(wavelength_nm, curve.range_nm[0]), curve.range_nm[1])
    return wavelength_nm


def bulk_scatter(material: str) -> BulkScatter:
    """Scatter inside of a material, from the suffixes ``scatter=`` and ``g=`` of its string; none without them."""
    return parse(material).bulk


def complex_index(material: str, wavelength_nm: float) -> complex:
    """
    Complex refractive index n + ik of the time dependence exp(-iωt): k ≥ 0, and k > 0 absorbs.

    Parameters
    ----------
    material : str
        See `mistray.materials`.
    wavelength_nm : float
        Vacuum wavelength, greater than 0, nm.

    Returns
    -------
    complex
        n + ik.

    Raises
    ------
    MistrayError
        As `refractive_index`, and if k is unknown: it is never taken for 0 unless the string says so.
    """
    spec = parse(material)
    _check_wavelength(spec, wavelength_nm)
    found = _material(spec)
    n = _real(spec, found, wavelength_nm)
    if found.k is None:
        where = f"{found.page} gives n only" if found.page else found.reference
        raise MistrayError(
            f"material '{spec.text}': k is unknown ({where}); append ' k=0' if its absorption does not matter, else "
            "' k=VALUE'"
        )
    remedy = "append ' k=VALUE', or use a wavelength inside"
    return complex(n, found.k.at(wavelength_nm, f"k of material '{spec.text}'", spec.extrapolate, remedy))


def table_nodes_nm(material: str) -> tuple[float, ...]:
    """Wavelengths of the tables of n and k of a material, nm; none where formulas or numbers give them."""
    found = _material(parse(material))
    return (*found.n.nodes_nm, *(found.k.nodes_nm if found.k is not None else ()))


def source(material: str) -> Source:
    """
    Page and literature reference of a material string.

    Raises
    ------
    MistrayError
        If the string is not understood.
    """
    spec = parse(material)
    found = _material(spec)
    return Source(
        name=found.name,
        page=found.page,
        reference=found.reference,
        comment=found.comment,
        n_range_nm=found.n.range_nm,
        k_range_nm=found.k.range_nm if found.k else None,
        k_known=found.k is not None,
        k_page=found.k_page,
        k_reference=found.k_reference,
    )


def resolved(material: str, resolve: Callable[[str], str]) -> str:
    """
    The same material string with the path of its file, if it names one, replaced by ``resolve(path)``.

    For scenes, whose paths are relative to the scene file.
    """
    spec = parse(material)
    if not isinstance(spec.form, UserFile):
        return material
    entry = "" if spec.form.entry is None else f":{spec.form.entry}"
    return f"{resolve(spec.form.path)}{entry}{spec.suffix}"


def _check_wavelength(spec: Spec, wavelength_nm: float) -> None:
    if not wavelength_nm > 0:
        raise MistrayError(f"material '{spec.text}': wavelength {wavelength_nm:g} nm; it must be greater than 0")


def _real(spec: Spec, found: _Material, wavelength_nm: float) -> float:
    remedy = "use a wavelength inside, or a material that is known there"
    n = found.n.at(wavelength_nm, f"material '{spec.text}'", spec.extrapolate, remedy) + spec.shift
    if not n > 0:
        if spec.shift:
            raise MistrayError(
                f"material '{spec.text}': index {n:g} at {wavelength_nm:g} nm; it must be greater than 0, change the "
                "shift"
            )
        raise MistrayError(
            f"material '{spec.text}': index {n:g} at {wavelength_nm:g} nm; its data do not hold there, use another "
            "wavelength"
        )
    return n


def _material(spec: Spec) -> _Material:
    """The material of a string; an explicit k replaces that of the data."""
    form = spec.form
    if isinstance(form, Constant):
        k = form.k if spec.k is None else spec.k
        return _Material(constant(form.n), constant(k or 0.0), spec.text, None, "given in the string")
    if isinstance(form, AbbeNumber):
        found = _abbe(form)
    elif isinstance(form, Samples):
        found = _Material(table(*zip(*form.points, strict=True)), None, spec.text, None, "a table of n in the string")
    elif isinstance(form, UserFile):
        found = _from_file(form, spec.text)
    else:
        found = _from_pages(find(form.name))
    if spec.k is None:
        return found
    return _Material(
        found.n, constant(spec.k), found.name, found.page, found.reference, found.comment, None, "given in the string"
    )


@lru_cache(maxsize=256)
def _abbe(form: AbbeNumber) -> _Material:
    n = Curve(lambda wavelength_nm: cauchy_index(form.nd, form.vd, wavelength_nm), CAUCHY_RANGE_NM)
    return _Material(n, None, f"nd={form.nd:g} Vd={form.vd:g}", None, "nd and Vd give n only")


@lru_cache(maxsize=256)
def _from_pages(entry: Entry) -> _Material:
    if entry.nd_vd is not None:
        return replace(_abbe(AbbeNumber(*entry.nd_vd)), name=entry.name, reference=entry.page)
    page = read_page(entry.page)
    if page.n is None:
        raise MistrayError(f"material '{entry.name}': its page {entry.page} has k only; use another page")
    if entry.k_page is None:
        return _Material(page.n, page.k, entry.name, page.path, page.reference, page.comment)
    k_page = read_page(entry.k_page)
    return _Material(
        page.n, k_page.k, entry.name, page.path, page.reference, page.comment, k_page.path, k_page.reference
    )


def _from_file(form: UserFile, text: str) -> _Material:
    """The file is read again only when it has changed."""
    path = Path(form.path)
    try:
        status = path.stat()
        return _read_file(path.absolute(), form, status.st_mtime_ns, status.st_size)
    except OSError as error:
        raise MistrayError(
            f"material '{text}': {form.path}: {error.strerror}; a path is relative to the scene file, or to the "
            "current folder where there is none"
        ) from None


@lru_cache(maxsize=64)
def _read_file(path: Path, form: UserFile, mtime_ns: int, size: int) -> _Material:
    if form.entry is None:
        n, k = user_table.read_table(path)
        return _Material(n, k, path.name, str(path), f"table {path.name}")
    name = f"{path.name}:{form.entry}"
    if path.suffix.lower() == ".agf":
        n, k = agf.read_glass(path, form.entry)
        return _Material(n, k, name, str(path), f"AGF file {path.name}")
    return _Material(*_coating_material(path, form.entry), name, str(path), f"coating file {path.name}")


def _coating_material(path: Path, name: str) -> tuple[Curve, Curve]:
    """Material of a Zemax coating file; one row holds at every wavelength, as in OpticStudio."""
    tables = read_mate(path)
    found = [key for key in tables if key.lower() == name.lower()]
    if not found:
        close = difflib.get_close_matches(name, tables)
        remedy = f"did you mean {' or '.join(close)}?" if close else f"it holds {len(tables)} materials; check the name"
        raise MistrayError(f"coating file '{path}': no material '{name}'; {remedy}")
    wavelength_nm, n, k = tables[found[0]]
    if len(wavelength_nm) == 1:
        return constant(float(n[0])), constant(float(k[0]))
    return table(wavelength_nm, n), table(wavelength_nm, k)
