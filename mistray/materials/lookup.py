"""Look-up of a material string: its n, its k and their sources."""

from __future__ import annotations

import difflib
import importlib.util
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from mistray.errors import MistrayError
from mistray.materials import agf, user_table
from mistray.materials.catalogue import PINNED, find, glasses
from mistray.materials.curve import Curve, constant, table
from mistray.materials.entry import Entry
from mistray.materials.formulas import CAUCHY_RANGE_NM, cauchy_index
from mistray.materials.infrared import MAKERS
from mistray.materials.mate import read_mate
from mistray.materials.pages import book, read_page
from mistray.materials.spec import (
    MITSUBA,
    AbbeNumber,
    BulkScatter,
    Constant,
    IndexSamples,
    MitsubaData,
    Name,
    Spec,
    UserFile,
    parse,
)
from mistray.read_file import count_as_read

CLEAR_K = 1e-3  # greatest k of a suggestion for a material that light passes


@dataclass(frozen=True)
class MaterialSource:
    """
    Source of the n and k of a material.

    Attributes
    ----------
    name : str
        Meaning of the string, such as ``schott/F2``.
    page : str or None
        Page of the refractiveindex.info database or path of a file; None if the string itself holds the numbers.
    reference : str
        Literature reference, or the numbers that the string states.
    comment : str
        Sample and conditions, if the page gives them.
    n_range_nm : tuple of two float or None
        Range of wavelengths in which n is known, nm; None if everywhere.
    k_range_nm : tuple of two float or None
        Range of wavelengths in which k is known, nm; None if everywhere or nowhere, see `k_known`.
    k_known : bool
        Whether k is known at all.
    k_page, k_reference : str or None
        Page and reference of k, if they differ from those of n.
    beyond : MaterialSource or None
        Source for wavelengths outside `n_range_nm`, if the name stands for several pages.

    Examples
    --------
    >>> glass = mistray.materials.source("N-BK7")
    >>> glass.n_range_nm, glass.k_known
    ((300.0, 2500.0), True)
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
    beyond: MaterialSource | None = None


@dataclass(frozen=True, eq=False)
class _Material:
    """
    Curves of n and k of one page or file over wavelength, with their sources.

    Attributes
    ----------
    n, k : Curve
        Real index and extinction coefficient over wavelength; k is None if unknown.
    name : str
        Name of the material.
    page, reference : str or None, str
        Page of the database, or path of a file, and literature of n.
    comment : str
        Comment of the page.
    k_page, k_reference : str or None
        Page and literature of k, if they differ from those of n.
    """

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
    Return the real refractive index of a material.

    Parameters
    ----------
    material : str
        Name of the material, see `mistray.materials`.
    wavelength_nm : float
        Vacuum wavelength, greater than 0, nm.

    Returns
    -------
    float
        Real index n > 0; below 1 for some metals. k need not be known.

    Raises
    ------
    MistrayError
        If the name is unknown, a value in the string is out of its range, a file is not understood, or the wavelength
        lies outside the material's range.

    Examples
    --------
    >>> print(f"{mistray.materials.refractive_index('N-BK7', 587.56):.4f}")
    1.5168
    >>> print(f"{mistray.materials.refractive_index('nd=1.62 Vd=36.4', 486.1):.4f}")
    1.6319
    """
    spec = parse(material)
    _check_wavelength(spec, wavelength_nm)
    return _real(spec, _material(spec, wavelength_nm), wavelength_nm)


def nearest_known_nm(material: str, wavelength_nm: float, with_k: bool = False) -> float:
    """
    Return the wavelength, nm, nearest to a given one at which n of a material is known.

    It is the given one if the string has the suffix ``extrapolate``.

    Parameters
    ----------
    material : str
        Name of the material, see `mistray.materials`.
    wavelength_nm : float
        Given vacuum wavelength, nm.
    with_k : bool
        Whether k must be known there as well, if it is known anywhere.

    Raises
    ------
    MistrayError
        If the string is not understood.

    Examples
    --------
    >>> mistray.materials.nearest_known_nm("N-BK7", 200)
    300.0
    """
    spec = parse(material)
    if spec.extrapolate:
        return wavelength_nm
    nearest = []
    for found in _materials(spec):
        at = wavelength_nm
        for curve in (found.n, found.k if with_k else None):
            if curve is not None and curve.range_nm is not None:
                at = min(max(at, curve.range_nm[0]), curve.range_nm[1])
        nearest.append(at)
    return min(nearest, key=lambda at: abs(at - wavelength_nm))


def bulk_scatter(material: str) -> BulkScatter:
    """
    Return the bulk scatter (coefficient, 1/mm, and asymmetry g) that the suffixes of a material string state.

    Both are 0 without the suffix ``scatter=PER_MM``.

    Examples
    --------
    >>> mistray.materials.bulk_scatter("N-BK7 scatter=0.002 g=0.9")
    BulkScatter(per_mm=0.002, g=0.9)
    """
    return parse(material).bulk


def complex_index(material: str, wavelength_nm: float) -> complex:
    """
    Return the complex index n + ik for the time dependence exp(-iωt): k ≥ 0, and k > 0 absorbs.

    Parameters
    ----------
    material : str
        Name of the material, see `mistray.materials`.
    wavelength_nm : float
        Vacuum wavelength, greater than 0, nm.

    Returns
    -------
    complex
        Complex index n + ik.

    Raises
    ------
    MistrayError
        For the reasons of `refractive_index`, and if k is unknown: it is never assumed to be 0.

    Examples
    --------
    >>> silver = mistray.materials.complex_index("Ag", 550)
    >>> print(f"{silver:.2f}")
    0.06+3.60j
    """
    spec = parse(material)
    _check_wavelength(spec, wavelength_nm)
    found = _material(spec, wavelength_nm)
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
    """
    Return the wavelengths, nm, at which tables give n or k of a material; empty for formulas and constants.

    Examples
    --------
    >>> mistray.materials.table_nodes_nm("Ag")[:3]
    (187.9, 191.6, 195.3)
    >>> mistray.materials.table_nodes_nm("nd=1.5 Vd=60")
    ()
    """
    curves = [curve for found in _materials(parse(material)) for curve in (found.n, found.k) if curve is not None]
    return tuple(dict.fromkeys(node for curve in curves for node in curve.nodes_nm))


def source(material: str) -> MaterialSource:
    """
    Return the sources of n and k of a material string: page or file, literature reference and ranges, nm.

    If the name stands for several pages, they are those of the first one; `MaterialSource.beyond` has the others.

    Raises
    ------
    MistrayError
        If the string is not understood, or the page or the file that it names cannot be read.

    Examples
    --------
    >>> print(mistray.materials.source("N-BK7").reference)
    SCHOTT Zemax catalog 2017-01-20b (obtained from http://www.schott.com) See also SCHOTT glass data sheets
    """
    known: MaterialSource | None = None
    for found in reversed(_materials(parse(material))):
        known = MaterialSource(
            name=found.name,
            page=found.page,
            reference=found.reference,
            comment=found.comment,
            n_range_nm=found.n.range_nm,
            k_range_nm=found.k.range_nm if found.k else None,
            k_known=found.k is not None,
            k_page=found.k_page,
            k_reference=found.k_reference,
            beyond=known,
        )
    assert known is not None
    return known


def resolved(material: str, resolve: Callable[[str], str]) -> str:
    """
    Return a material string with the path of its file, if it names one, replaced by ``resolve(path)``.

    Other strings are returned as they are. It is meant for scenes, whose paths are relative to the scene file.

    Examples
    --------
    >>> from pathlib import Path
    >>> mistray.materials.resolved("glass.csv", lambda path: Path("scene", path).as_posix())
    'scene/glass.csv'
    >>> mistray.materials.resolved("N-BK7", lambda path: Path("scene", path).as_posix())
    'N-BK7'
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
    name = f"material '{spec.text}'"
    if not (found.n.covers(wavelength_nm) or spec.extrapolate):
        raise MistrayError(
            f"{name}: {wavelength_nm:g} nm is outside its {_known(spec)}; {_remedy(spec, wavelength_nm)}"
        )
    n = found.n.at(wavelength_nm, name, spec.extrapolate, "") + spec.shift
    if not n > 0:
        where = f"{name}: index {n:g} at {wavelength_nm:g} nm"
        if spec.shift:
            raise MistrayError(f"{where}; it must be greater than 0, change the shift")
        raise MistrayError(f"{where}; its data do not hold there, use another wavelength")
    return n


def _known(spec: Spec) -> str:
    """
    Return the wavelength ranges in which the index n of a material is known, such as "400 … 700 nm"; "" if everywhere.

    Overlapping ranges are joined.
    """
    ends: list[list[float]] = []
    for low, high in sorted(found.n.range_nm for found in _materials(spec) if found.n.range_nm is not None):
        if ends and low <= ends[-1][1]:
            ends[-1][1] = max(ends[-1][1], high)
        else:
            ends.append([low, high])
    return " and ".join(f"{low:g} … {high:g} nm" for low, high in ends)


def _remedy(spec: Spec, wavelength_nm: float) -> str:
    """
    Return advice for a wavelength, nm, at which a material has no data.

    It names another page of the material that has data there, or else the clear material with the nearest index, if
    there is one.
    """
    inside = "use a wavelength inside"
    if not isinstance(spec.form, Name):
        return f"{inside}, or a material that is known there"
    pages = dict.fromkeys(page for entry in find(spec.form.name).chain for page in book(entry.page))
    others = [Entry(page, page) for page in pages]
    near = _nearest(spec, wavelength_nm, others)
    if near is not None:
        return f"{inside}, or '{near[0]}', which is known there"
    pinned = [entry for entry in PINNED.values() if entry.nd_vd is None]
    near = _nearest(spec, wavelength_nm, [*pinned, *(entry for maker in MAKERS for entry in glasses()[maker].values())])
    if near is None:
        return inside
    return f"{inside}; the nearest material that is known there is '{near[0]}' (n = {near[1]:.4g})"


def _nearest(spec: Spec, wavelength_nm: float, entries: Sequence[Entry]) -> tuple[str, float] | None:
    """Return name and n of the clear material known at a wavelength, nm, with the nearest n; None if there is none."""
    wanted = _real(spec, _material(spec, at := nearest_known_nm(spec.text, wavelength_nm)), at)
    near: list[tuple[float, str, float]] = []
    for entry in entries:
        for found in _from_pages(entry) if read_page(entry.page).n is not None else ():
            if found.n.covers(wavelength_nm):
                n = found.n.at(wavelength_nm, entry.name, False, "")
                dark = (
                    found.k is not None and found.k.covers(wavelength_nm) and found.k.evaluate(wavelength_nm) > CLEAR_K
                )
                if not dark:
                    near.append((abs(n - wanted), entry.name, n))
                break
    return min(near)[1:] if near else None


def _material(spec: Spec, wavelength_nm: float) -> _Material:
    """Return the curves of n and k for a wavelength, nm: of the first page that covers it, else of the nearest one."""
    found = _materials(spec)
    for one in found:
        if one.n.covers(wavelength_nm):
            return one
    return min(found, key=lambda one: min(abs(wavelength_nm - end) for end in one.n.range_nm or (0.0,)))


def _materials(spec: Spec) -> tuple[_Material, ...]:
    """Return the curves of n and k on each page of a material; an explicit k in its string replaces the page's k."""
    form = spec.form
    if isinstance(form, Constant):
        k = form.k if spec.k is None else spec.k
        return (_Material(constant(form.n), constant(k or 0.0), spec.text, None, "given in the string"),)
    found: tuple[_Material, ...]
    if isinstance(form, AbbeNumber):
        found = (_abbe(form),)
    elif isinstance(form, IndexSamples):
        curve_k = table(*zip(*form.k_points, strict=True)) if form.k_points else None
        reference = f"a table of n{' and k' if curve_k else ''} in the string"
        found = (_Material(table(*zip(*form.points, strict=True)), curve_k, spec.text, None, reference),)
    elif isinstance(form, MitsubaData):
        found = (_from_mitsuba(form.name),)
    elif isinstance(form, UserFile):
        found = (_from_file(form, spec.text),)
    else:
        found = _from_pages(find(form.name))
    if spec.k is None:
        return found
    given = constant(spec.k)
    return tuple(replace(one, k=given, k_page=None, k_reference="given in the string") for one in found)


@lru_cache(maxsize=256)
def _abbe(form: AbbeNumber) -> _Material:
    n = Curve(lambda wavelength_nm: cauchy_index(form.nd, form.vd, wavelength_nm), CAUCHY_RANGE_NM)
    return _Material(n, None, f"nd={form.nd:g} Vd={form.vd:g}", None, "nd and Vd give n only")


@lru_cache(maxsize=256)
def _from_pages(entry: Entry) -> tuple[_Material, ...]:
    return tuple(_from_page(one) for one in entry.chain)


def _from_page(entry: Entry) -> _Material:
    if entry.nd_vd is not None:
        return replace(_abbe(AbbeNumber(*entry.nd_vd)), name=entry.name, reference=entry.page)
    page = read_page(entry.page)
    if page.n is None:
        raise MistrayError(f"material '{entry.name}': its page {entry.page} has k only; use another page")
    n = page.n
    if entry.to_nm is not None and n.range_nm is not None:
        n = replace(n, range_nm=(n.range_nm[0], entry.to_nm))
    found = _Material(n, page.k, entry.name, page.path, page.reference, page.comment)
    if entry.k_stated:
        k = replace(table(*zip(*entry.k_stated, strict=True)), range_nm=None)
        return replace(found, k=k, k_reference=entry.k_reference)
    if entry.k_page is None:
        return found
    k_page = read_page(entry.k_page)
    return replace(found, k=k_page.k, k_page=k_page.path, k_reference=k_page.reference)


@lru_cache(maxsize=64)
def _from_mitsuba(name: str) -> _Material:
    """
    Return the curves of n and k in the tables that come with Mitsuba, see its plugin `conductor`.

    Raise `MistrayError` if Mitsuba has no tables of the name.
    """
    found = importlib.util.find_spec("mitsuba")
    folder = Path(found.origin if found is not None and found.origin else "").parent / "data" / "ior"
    names = sorted(file.name.removesuffix(".eta.spd") for file in folder.glob("*.eta.spd"))
    if name not in names:
        near = difflib.get_close_matches(name, names, n=3, cutoff=0.0)
        hint = f"the nearest are {', '.join(MITSUBA + one for one in near)}" if near else "install mitsuba anew"
        raise MistrayError(f"material '{MITSUBA}{name}': Mitsuba has no tables of it; {hint}")
    n, k = (table(*np.loadtxt(folder / f"{name}.{part}.spd", unpack=True)) for part in ("eta", "k"))
    return _Material(n, k, f"{MITSUBA}{name}", None, f"tables {name}.eta.spd and {name}.k.spd of Mitsuba")


def _from_file(form: UserFile, text: str) -> _Material:
    """
    Return the curves of n and k in a user's file, which is read again only if it has changed.

    Raise `MistrayError` if the file cannot be read, or its content is not valid.
    """
    path = Path(form.path)
    try:
        status = path.stat()
        count_as_read(path)
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
    """
    Return the curves of n and k of a material in a Zemax coating file; a single row holds at every wavelength.

    Raise `MistrayError` if the file has no material of that name.
    """
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
