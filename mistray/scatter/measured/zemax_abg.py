"""ABg catalogue of Zemax OpticStudio (ABG_DATA.DAT).

    NAME name
    WAVE wavelength            µm at which A and B hold; 0, or no line: the same at all wavelengths
    angle A B g                one line for each angle of incidence, degrees; the word ABG may stand before it

These are the fields of its dialog "ABg Scatter Data Catalogs" (OpticStudio user guide), which does not describe the
file. A line of another form is an error that names it. Lines that begin with ! or # are comments. OpticStudio
interpolates between angles; mistray has one A, B and g for all angles and refuses an entry whose lines differ.
"""

from __future__ import annotations

import difflib
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mistray.errors import MistrayError, errors_of
from mistray.files.number_rows import numbers, read_lines
from mistray.scatter.abg import ABg

NAMED = re.compile(r"(.+\.dat):(.+)", re.IGNORECASE)
UM = 1e3  # nm


@dataclass
class AbgEntry:
    """
    ABg parameters of one surface in an ABg catalogue.

    Attributes
    ----------
    name : str
        Name of the entry.
    line : int
        Number of the line at which the entry begins.
    wavelength_um : float
        Vacuum wavelength at which A and B hold, µm; 0 if they hold at all wavelengths.
    rows : list of tuple
        Angle of incidence, degrees, then A, 1/sr, B and g as in `ABg`; one tuple for each line.
    """

    name: str
    line: int
    wavelength_um: float = 0.0
    rows: list[tuple[float, float, float, float]] = field(default_factory=list)


def read_abg_data(path: str | Path) -> dict[str, AbgEntry]:
    """
    Read the entries of an ABg catalogue.

    Returns
    -------
    dict of str to AbgEntry
        Entries by name in capitals: names ignore case.

    Raises
    ------
    MistrayError
        If the file is missing, a line is malformed or out of range, or a name occurs twice or has no line of values.
        The message gives the number of a wrong line.
    """
    found: dict[str, AbgEntry] = {}
    entry = None
    for number, line in read_lines(path, "ABg catalogue"):
        where, words = f"ABg catalogue '{path}', line {number}", line.split()
        if not words or words[0][0] in "!#":
            continue
        key = words[0].upper()
        if key == "NAME":
            name = " ".join(words[1:])
            if not name or name.upper() in found:
                raise MistrayError(f"{where}: NAME {name or 'without a name'}; give each entry a name of its own")
            entry = found[name.upper()] = AbgEntry(name, number)
        elif entry is None:
            raise MistrayError(
                f"{where}: '{line.strip()}' before the first NAME; begin an entry with NAME and its name"
            )
        elif key == "WAVE":
            (entry.wavelength_um,) = numbers(words[1:], 1, where)
            if entry.wavelength_um < 0:
                raise MistrayError(f"{where}: wavelength {entry.wavelength_um:g} µm; give µm, or 0 for all wavelengths")
        else:
            angle, a, b, g = numbers(words[1:] if key == "ABG" else words, 4, f"{where}, angle A B g")
            if not 0 <= angle <= 90:
                raise MistrayError(f"{where}: angle of incidence {angle:g}°; give 0 … 90°")
            entry.rows.append((angle, a, b, g))
    for entry in found.values():
        if not entry.rows:
            raise MistrayError(f"ABg catalogue '{path}', line {entry.line}: '{entry.name}' has no line angle A B g")
    return found


def abg_from_catalogue(spec: str, **placement: Any) -> ABg:
    """
    Return the ABg scatter model of an entry of a catalogue.

    Parameters
    ----------
    spec : str
        File and name of the entry, ``ABG_DATA.DAT:NAME``.
    **placement
        Options of `mistray.scatter.lobe.Placement`.

    Raises
    ------
    MistrayError
        If `spec` has another form, the file is not valid, the name is not in it, or A, B and g of the entry change with
        the angle or are out of range.
    """
    match = NAMED.fullmatch(spec.strip())
    if match is None:
        raise MistrayError(f"ABg catalogue '{spec}': which entry? Write ABG_DATA.DAT:NAME")
    path, name = match[1], match[2].strip()
    entries = read_abg_data(path)
    entry = entries.get(name.upper())
    if entry is None:
        close = difflib.get_close_matches(name.upper(), entries, n=1)
        names = ", ".join(item.name for item in entries.values())
        hint = f"did you mean '{entries[close[0]].name}'? There are" if close else "there are"
        raise MistrayError(f"ABg catalogue '{path}': no entry '{name}'; {hint} {names or 'none'}")
    where = f"ABg catalogue '{path}', line {entry.line}"
    if len({row[1:] for row in entry.rows}) > 1:
        raise MistrayError(
            f"{where}: A, B and g of '{entry.name}' change with the angle of incidence; write one line for the angle "
            "that counts, or a table (plugin tabulated)"
        )
    _, a, b, g = entry.rows[0]
    with errors_of(where):
        return ABg(a, b, g, reference_nm=entry.wavelength_um * UM or None, **placement)
