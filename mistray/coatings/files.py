"""Coatings read from files, and from the text that names them."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from mistray.coatings.presets import PRESETS, preset
from mistray.coatings.response import METAL_K, CoatingModel
from mistray.coatings.simple import Bare
from mistray.coatings.spectrum import CoatingSpectrum, spectrum
from mistray.coatings.stack import Stack, parse_layers
from mistray.coatings.table import CoatingTable
from mistray.coatings.zemax_coating_dat import read_coating_file
from mistray.errors import MistrayError
from mistray.materials import complex_index
from mistray.ranges import WAVELENGTH_NM, several
from mistray.replace_file import replace_file

_ZEMAX = re.compile(r"(.*\.dat):(.+)", re.IGNORECASE)


def read_coating(
    spec: str, design_nm: float = 550.0, mirror: bool = False, resolve: Callable[[str], str] = str
) -> CoatingModel:
    """
    Return a coating read from a file.

    Parameters
    ----------
    spec : str
        ``table.csv``, or ``COATING.DAT:NAME`` for a Zemax file.
    design_nm : float
        Wavelength for thicknesses in waves in a Zemax file, nm.
    mirror : bool
        Whether a Zemax coating is that of a mirror there: opaque, with the last layer as its substrate; without effect
        on a CSV table.
    resolve : callable
        Function that returns the path to open for the path in `spec`.

    Raises
    ------
    MistrayError
        If the string has neither form, or the file is missing or malformed.

    Examples
    --------
    >>> quarter_wave = mistray.coatings.coating_from_text("MgF2 0.25w")
    >>> mistray.coatings.write_table(quarter_wave, "mgf2.csv", [500, 550, 600], [0, 30], back="N-BK7")
    >>> table = mistray.coatings.read_coating("mgf2.csv")
    >>> found = mistray.coatings.spectrum(table, [550], [0], back="N-BK7")
    >>> print(f"R = {found.R.mean():.4f}")
    R = 0.0133
    """
    match = _ZEMAX.fullmatch(spec.strip())
    if match:
        file = read_coating_file(resolve(match[1]), design_nm)
        return file.mirror(match[2].strip()) if mirror else file[match[2].strip()]
    if spec.lower().endswith(".dat"):
        names = ", ".join(read_coating_file(resolve(spec), design_nm))
        raise MistrayError(f"coating file '{spec}': which coating? Write '{spec}:NAME' with one of {names or '(none)'}")
    if not spec.lower().endswith(".csv"):
        raise MistrayError(f"coating '{spec}' is not a file that mistray knows; give table.csv or COATING.DAT:NAME")
    return CoatingTable.read(resolve(spec))


def coating_from_text(text: str, design_nm: float = 550.0) -> CoatingModel:
    """
    Return the coating that a string names or describes.

    The string is ``bare``, a preset, a file as in `read_coating`, or layers as in `parse_layers`. Thicknesses in waves
    are those at `design_nm`, nm.

    Raises
    ------
    MistrayError
        If the string is none of these, or the file or a layer that it names is not valid.

    Examples
    --------
    >>> coating = mistray.coatings.coating_from_text("MgF2 0.25w", design_nm=550)
    >>> print(f"{coating.layers[0].thickness_nm:.1f} nm")
    99.4 nm
    >>> mistray.coatings.coating_from_text("bbar3").name
    'bbar3'
    """
    spec = text.strip()
    if spec == "bare":
        return Bare()
    if spec in PRESETS:
        return preset(spec, design_nm)
    if _ZEMAX.fullmatch(spec) or spec.lower().endswith((".csv", ".dat")):
        return read_coating(spec, design_nm)
    if " " not in spec:  # no layer is one word
        try:
            return preset(spec, design_nm)
        except MistrayError as error:
            raise MistrayError(
                f"{error}; or give a file (table.csv, COATING.DAT:NAME) or layers ('MgF2 99.64, 2.1 0.5w')"
            ) from None
    return Stack(parse_layers(spec, design_nm), name=spec)


def write_table(
    coating: CoatingModel,
    path: str | Path,
    wavelengths_nm: float | Sequence[float],
    angles_deg: float | Sequence[float],
    front: str = "air",
    back: str = "1.5168",
) -> None:
    """
    Write R, T and phases of a coating between two materials as a CSV file that `CoatingTable.read` reads.

    Parameters
    ----------
    coating : CoatingModel
        Coating to evaluate.
    path : str or Path
        File to write. An existing file is replaced; it stays on an error.
    wavelengths_nm : float or sequence of float
        Vacuum wavelengths, nm.
    angles_deg : float or sequence of float
        Angles of incidence in the material of lower index, degrees, for light from either side. If nothing is
        transmitted at any of them, as into a metal, they are those on the side of incidence.
    front, back : str
        Materials in front and behind, see `mistray.materials`.

    Raises
    ------
    MistrayError
        If a material is unknown at a wavelength, both are metals, an angle is outside 0 … 90°, or the file cannot be
        written.

    Examples
    --------
    >>> from pathlib import Path
    >>> quarter_wave = mistray.coatings.coating_from_text("MgF2 0.25w")
    >>> mistray.coatings.write_table(quarter_wave, "mgf2.csv", [500, 550, 600], [0, 30], back="N-BK7")
    >>> print(Path("mgf2.csv").read_text().splitlines()[0])
    # MgF2 0.25w between air (front) and N-BK7 (back)
    """
    wavelengths_nm = WAVELENGTH_NM.check_each("wavelengths_nm", wavelengths_nm, f"coating '{coating.name}'")
    angles_deg = several(angles_deg)
    seen: dict[str, CoatingSpectrum] = {}
    for side, material in (("front", front), ("back", back)):
        if all(complex_index(material, wavelength).imag <= METAL_K for wavelength in wavelengths_nm):
            of_side = partial(spectrum, coating, wavelengths_nm, angles_deg, front, back, side == "front")
            found = of_side(rarer=True)
            seen[side] = found if np.any(found.T) else of_side()  # `CoatingTable.response` takes no T as opaque
    if not seen:
        raise MistrayError(
            f"coating '{coating.name}' between '{front}' and '{back}': both are metals; no light gets there"
        )
    ahead, behind = seen.get("front", seen.get("back")), seen.get("back", seen.get("front"))
    assert ahead is not None
    assert behind is not None
    grid = np.meshgrid(ahead.wavelength_nm, ahead.angle_deg, indexing="ij")
    columns = dict(zip(("wavelength_nm", "angle_deg"), grid, strict=True))
    for share, values in (("R", ahead.R), ("T", ahead.T), ("R_back", behind.R)):
        columns |= {f"{share}_{pol}": values[:, :, k] for k, pol in enumerate("sp")}
    phases = {"phase_r_deg": ahead.phase_r, "phase_t_deg": ahead.phase_t, "phase_r_back_deg": behind.phase_r}
    columns |= {name: np.degrees(values) for name, values in phases.items()}
    rows = np.stack([values.ravel() for values in columns.values()], axis=1).tolist()
    text = io.StringIO()
    text.write(f"# {' '.join(coating.name.split()) or 'coating'} between {front} (front) and {back} (back)\n")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([repr(value) for value in row] for row in rows)
    replace_file(path, text.getvalue(), "coating table")
