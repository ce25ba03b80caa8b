"""Import of lens files and lenses of other programs as prescriptions, read and closed in one step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from mistray.io.codev.read import read_codev
from mistray.io.flaresim import read_flaresim

# Loaded here, because loading a module later would put it in the place of the public function of its name
from mistray.io.optiland import coatings_of
from mistray.io.optiland import from_optiland as optiland_table
from mistray.io.oslo import read_oslo
from mistray.io.rayoptics import from_rayoptics as rayoptics_table
from mistray.io.rayoptics import read_rayoptics
from mistray.io.zemax.read import read_zemax
from mistray.prescription.closing.system import to_prescription
from mistray.prescription.coating import Coating
from mistray.prescription.model import Prescription


def from_zemax(
    path: str | Path,
    *,
    coatings: str | Path | Mapping[str, Coating] | None = None,
    configuration: int | str | None = None,
    glass_catalogues: Sequence[str | Path] = (),
    glasses: Mapping[str, str] | None = None,
    **options: Any,
) -> Prescription:
    """
    Read a sequential Zemax file.

    Parameters
    ----------
    path : str or Path
        .zmx file.
    coatings : path, mapping of str to Coating, or None
        File COATING.DAT that holds the coatings of the lens, or coatings keyed by the names that the lens uses.
    configuration, glass_catalogues, glasses
        Configuration, AGF files and replaced glasses, as in `mistray.io.zemax.read.read_zemax`.
    **options
        Further arguments of `to_prescription`.

    Returns
    -------
    Prescription
        Closed system whose `provenance` lists every line of the file that had no effect.

    Raises
    ------
    MistrayError
        If the file cannot be read, or holds something without a counterpart.
    """
    by_name = coatings if isinstance(coatings, Mapping) else None
    file = None if coatings is None or isinstance(coatings, Mapping) else coatings
    chosen: Any = {"configuration": configuration, "glass_catalogues": glass_catalogues, "glasses": glasses}
    lens = read_zemax(path, coatings=file, **chosen)
    return to_prescription(lens, coatings=by_name, **options)


def from_codev(
    path: str | Path,
    *,
    radius_mode: bool | None = None,
    configuration: int | str | None = None,
    glass_catalogues: Sequence[str | Path] = (),
    glasses: Mapping[str, str] | None = None,
    **options: Any,
) -> Prescription:
    """
    Read a CODE V sequence file.

    Parameters
    ----------
    path : str or Path
        .seq file.
    radius_mode : bool or None
        Whether surfaces of a file without RDM are given by radius; ``None``: by curvature.
    configuration, glass_catalogues, glasses
        Zoom position, AGF files and replaced glasses, as in `mistray.io.codev.read.read_codev`.
    **options
        Further arguments of `to_prescription`.

    Returns
    -------
    Prescription
        Closed system whose `provenance` lists every line of the file that had no effect.

    Raises
    ------
    MistrayError
        If the file cannot be read, or holds something without a counterpart.
    """
    chosen: Any = {"configuration": configuration, "glass_catalogues": glass_catalogues, "glasses": glasses}
    lens = read_codev(path, radius_mode=radius_mode, **chosen)
    return to_prescription(lens, **options)


def from_optiland(optic: Any, **options: Any) -> Prescription:
    """
    Convert a lens of optiland.

    Coatings with constant R and T are kept. Fresnel coatings become bare surfaces.

    Parameters
    ----------
    optic : optiland.optic.Optic
        Lens to convert.
    **options
        Further arguments of `to_prescription`.

    Returns
    -------
    Prescription
        Closed system.

    Raises
    ------
    MistrayError
        If the lens holds something without a counterpart.
    """
    coatings = coatings_of(optic) | dict(options.pop("coatings", None) or {})
    return to_prescription(optiland_table(optic), coatings=coatings, **options)


def from_oslo(
    path: str | Path,
    *,
    configuration: int = 1,
    glass_catalogues: Sequence[str | Path] = (),
    glasses: Mapping[str, str] | None = None,
    **options: Any,
) -> Prescription:
    """
    Read an OSLO lens file with optiland.

    Parameters
    ----------
    path : str or Path
        .len file.
    configuration, glass_catalogues, glasses
        Configuration, AGF files and replaced glasses, as in `mistray.io.oslo.read_oslo`.
    **options
        Further arguments of `to_prescription`.

    Returns
    -------
    Prescription
        Closed system.

    Raises
    ------
    MistrayError
        If `mistray.io.oslo.read_oslo` raises, or the lens cannot be closed.
    """
    chosen: Any = {"glass_catalogues": glass_catalogues, "glasses": glasses}
    return to_prescription(read_oslo(path, configuration=configuration, **chosen), **options)


def from_rayoptics(model: Any, **options: Any) -> Prescription:
    """
    Convert a lens of ray-optics.

    Parameters
    ----------
    model : rayoptics.optical.opticalmodel.OpticalModel, str or Path
        Model in memory, or path of a .roa file.
    **options
        Further arguments of `to_prescription`.

    Returns
    -------
    Prescription
        Closed system.

    Raises
    ------
    MistrayError
        If the lens holds something without a counterpart, or a file cannot be read.
    """
    table = read_rayoptics(model) if isinstance(model, str | Path) else rayoptics_table(model)
    return to_prescription(table, **options)


def from_flaresim(path: str | Path, **options: Any) -> Prescription:
    """
    Read a lens file of FlareSim.

    Parameters
    ----------
    path : str or Path
        .lens file.
    **options
        Further arguments of `to_prescription`.

    Returns
    -------
    Prescription
        Lens whose `provenance` lists the assumptions, see `mistray.io.flaresim.read_flaresim`.

    Raises
    ------
    MistrayError
        If the file cannot be read, or the lens has no real focus.
    """
    return to_prescription(read_flaresim(path), **options)
