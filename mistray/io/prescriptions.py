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
from mistray.prescription.coating import COATINGS, Coating
from mistray.prescription.model import Prescription


def from_zemax(
    path: str | Path,
    *,
    coatings: str | Path | Mapping[str, Coating] | None = None,
    configuration: int | str | None = None,
    glass_catalogues: str | Path | Sequence[str | Path] = (),
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
        If the file cannot be read, holds something without a counterpart, or the lens cannot be closed.

    Examples
    --------
    >>> from mistray.scenes.cooke_triplet.prescription import build
    >>> _ = mistray.prescription.write_zemax(mistray.prescription.to_sequential(build()), "triplet.zmx")
    >>> system = mistray.prescription.from_zemax("triplet.zmx", edges="ground")
    >>> [surface.name for surface in system.surfaces[:3]]
    ['L1_front', 'L1_rear', 'L2_front']
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
    glass_catalogues: str | Path | Sequence[str | Path] = (),
    glasses: Mapping[str, str] | None = None,
    **options: Any,
) -> Prescription:
    r"""
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
        If the file cannot be read, holds something without a counterpart, or the lens cannot be closed.

    Examples
    --------
    >>> from pathlib import Path
    >>> text = "RDM; LEN; EPD 8; DIM M; WL 588; YAN 0; SO 0 1E20; S 50 5 NBK7_SCHOTT; STO; S -50 46; SI 0 0; GO"
    >>> _ = Path("singlet.seq").write_text(text.replace("; ", "\n"))
    >>> singlet = mistray.prescription.from_codev("singlet.seq", edges="open")
    >>> [surface.name for surface in singlet.surfaces]
    ['S1', 'S2']
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
        Closed system, in mm.

    Raises
    ------
    MistrayError
        If the lens holds something without a counterpart, or cannot be closed.

    Examples
    --------
    >>> from optiland.samples.objectives import CookeTriplet
    >>> triplet = mistray.prescription.from_optiland(CookeTriplet())
    >>> [surface.name for surface in triplet.surfaces[:3]]
    ['S1', 'S2', 'S3']
    """
    given = options.pop("coatings", None)
    coatings = coatings_of(optic) | ({} if given is None else COATINGS.check("coatings", given))
    return to_prescription(optiland_table(optic), coatings=coatings, **options)


def from_oslo(
    path: str | Path,
    *,
    configuration: int = 1,
    glass_catalogues: str | Path | Sequence[str | Path] = (),
    glasses: Mapping[str, str] | None = None,
    **options: Any,
) -> Prescription:
    r"""
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

    Examples
    --------
    >>> from pathlib import Path
    >>> text = (
    ...     'LEN NEW "Singlet" 49 3; EBR 4; ANG 1; UNI 1; AIR; TH 1e20; NXT; GLA N-BK7; RD 50; TH 5; AP 10; AST; '
    ...     "NXT; AIR; RD -50; TH 46; AP 10; NXT; AIR; WV 0.588; WW 1; END 3"
    ... )
    >>> _ = Path("singlet.len").write_text(text.replace("; ", "\n"))
    >>> singlet = mistray.prescription.from_oslo("singlet.len", edges="ground")
    >>> [surface.name for surface in singlet.surfaces]
    ['S1', 'S2']
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
        If the lens holds something without a counterpart or cannot be closed, or a file cannot be read.

    Examples
    --------
    >>> from importlib.resources import files
    >>> triplet = mistray.prescription.from_rayoptics(files("rayoptics") / "models" / "Sasian Triplet.roa")
    >>> [surface.name for surface in triplet.surfaces[:3]]
    ['S1', 'S2', 'S3']
    """
    table = read_rayoptics(model) if isinstance(model, str | Path) else rayoptics_table(model)
    return to_prescription(table, **options)


def from_flaresim(path: str | Path, **options: Any) -> Prescription:
    r"""
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
        If the file cannot be read, or the lens has no real focus or cannot be closed.

    Examples
    --------
    >>> from pathlib import Path
    >>> rows = "50 5 1.5168 64.17 10 1; -50 1 1 0 10 0; stop 46 1 0 4.5 0"
    >>> _ = Path("singlet.lens").write_text("name: Singlet\nfocal_length: 49.2\nsurfaces:\n" + rows.replace("; ", "\n"))
    >>> singlet = mistray.prescription.from_flaresim("singlet.lens")
    >>> singlet.surfaces[0].coating.preset
    'mgf2_quarter_wave'
    """
    return to_prescription(read_flaresim(path), **options)
