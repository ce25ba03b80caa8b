"""Reader of OSLO lens files (.len), based on optiland (https://github.com/HarrisonKramer/optiland).

optiland reads the commands. Glasses are looked up here as for CODE V (see `mistray.io.codev.glasses`), since OSLO's
names have no maker either.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from mistray.errors import MistrayError
from mistray.io.codev.glasses import CodevGlasses
from mistray.io.glasses import CATALOGUES, GLASSES
from mistray.io.optiland import from_optiland
from mistray.materials import refractive_index
from mistray.named_values import number_of
from mistray.prescription.sequential.table import Sequential
from mistray.read_file import require_file


def read_oslo(
    path: str | Path,
    *,
    configuration: int = 1,
    glass_catalogues: str | Path | Sequence[str | Path] = (),
    glasses: Mapping[str, str] | None = None,
) -> Sequential:
    r"""
    Read an OSLO lens file.

    Parameters
    ----------
    path : str or Path
        The .len file.
    configuration : int
        Number of the configuration, from 1 on.
    glass_catalogues, glasses
        AGF files and replaced glasses, as in `mistray.io.codev.read.read_codev`.

    Returns
    -------
    Sequential
        Lens in mm. Its `notes` include the warnings of optiland about the file.

    Raises
    ------
    MistrayError
        If optiland 0.6.3 or later is missing, the file or a glass cannot be read, or it holds a command that optiland's
        reader or mistray does not know, since ignoring it would change the lens.

    Examples
    --------
    >>> from pathlib import Path
    >>> text = (
    ...     'LEN NEW "Singlet" 49 3; EBR 4; ANG 1; UNI 1; AIR; TH 1e20; NXT; GLA N-BK7; RD 50; TH 5; AP 10; AST; '
    ...     "NXT; AIR; RD -50; TH 46; AP 10; NXT; AIR; WV 0.588; WW 1; END 3"
    ... )
    >>> _ = Path("singlet.len").write_text(text.replace("; ", "\n"))
    >>> lens = mistray.prescription.read_oslo("singlet.len")
    >>> [row.radius for row in lens.rows]
    [50.0, -50.0, inf]
    """
    path = Path(path)
    catalogues = CATALOGUES.check("glass_catalogues", glass_catalogues)
    replaced = GLASSES.check("glasses", {} if glasses is None else glasses)
    require_file(path, "lens")
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        try:
            from optiland.fileio.oslo.reader.converter import OsloToOpticConverter
            from optiland.fileio.oslo.reader.parser import OsloDataParser
        except ImportError as error:
            missing = "" if error.name is None or error.name.startswith("optiland") else f" {error.name}"
            raise MistrayError(
                f"OSLO file '{path.name}': it is read by optiland, which cannot be imported ({error}); run: "
                f"pip install 'optiland>=0.6.3'{missing}"
            ) from None
        try:
            data = OsloDataParser(str(path), strict=True).parse()
            found = _Glasses(data, catalogues, replaced)
            reader = OsloToOpticConverter(
                data, strict=True, configuration=configuration, material_overrides=found.for_optiland()
            )
            lens = from_optiland(reader.convert())
        except Exception as error:  # whatever optiland meets in a file of somebody else's
            reason = " ".join(str(error).replace(f"{path}:", "line ").split()).rstrip(".")
            raise MistrayError(f"OSLO file '{path.name}': {reason}; correct it, or save it in another format") from None
    rows = tuple(replace(row, material=found.strings.get(found.name(row.number), row.material)) for row in lens.rows)
    texts = [" ".join(str(line.message).split()) for line in said if line.category is UserWarning]
    notes = (*lens.notes, *found.notes, *texts)
    return replace(lens, rows=rows, source=f"OSLO file {path.name}", notes=notes)


class _Glasses:
    """Lookup of the materials for the glass names in an OSLO file."""

    def __init__(self, data: Any, catalogues: Sequence[str | Path], replaced: Mapping[str, str]) -> None:
        self._data = data
        self._um = [float(um) for um in data.wavelengths["values"]]
        self._nm = [round(1e3 * um, 9) for um in self._um]
        known = CodevGlasses({}, catalogues, replaced, self._nm)
        names = {self.name(number) for number in data.surfaces} - {""}
        self.strings = {name: known.material(name) for name in sorted(names)}
        self.notes = list(known.notes)

    def name(self, number: int) -> str:
        """Return the name of the glass behind a surface; "" for air, mirrors and numeric indices."""
        words = str(self._data.surfaces.get(number, {}).get("material", "")).split()
        if len(words) != 2 or words[0] != "GLA":
            return ""
        name = words[1].strip('"')
        return name if number_of(name) is None else ""

    def for_optiland(self) -> dict[str, Any]:
        """Return optiland materials, keyed by glass name, with mistray's indices at the wavelengths of the file."""
        from optiland.materials.data import DataMaterial
        from optiland.materials.ideal import IdealMaterial

        found = {}
        for name, material in self.strings.items():
            index = [refractive_index(material, wavelength) for wavelength in self._nm]
            several = len(set(self._um)) > 1
            found[name] = DataMaterial.from_samples(self._um, index, name=name) if several else IdealMaterial(index[0])
        return found
