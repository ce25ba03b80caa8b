"""Base class of glass lookup for all lens files: user's replacements, absorption, notes and advice."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from os import PathLike

from mistray.errors import errors_of
from mistray.materials.mate import shown
from mistray.prescription.sequential.materials import usable
from mistray.ranges import TEXT, ByName, OfType, Several

FILE = OfType(str | PathLike, "must be the path of a file")
CATALOGUES = Several(FILE, least=0)
GLASSES = ByName(TEXT, "{'ODD-GLASS': 'N-BK7'}")


class FileGlasses:
    """
    Base class of finders of materials for the glass names of a lens file.

    Parameters
    ----------
    replaced : mapping of str to str
        Glass → material string that the user requests for it.
    wavelengths_nm : sequence of float
        Wavelengths of the lens, nm; a material must have an index at each.

    Attributes
    ----------
    notes : list of str
        Assumptions made, in the order of the calls; one that is made again is there again.
    """

    def __init__(self, replaced: Mapping[str, str], wavelengths_nm: Sequence[float]) -> None:
        self.notes: list[str] = []
        self._replaced = {name.upper(): material for name, material in replaced.items()}
        self._wavelengths_nm = wavelengths_nm

    def _asked_for(self, name: str) -> str | None:
        """Return the material string by which the user replaces a glass; None if the user does not replace it."""
        material = self._replaced.get(name.upper())
        if material is not None:
            self.notes.append(f"glass {name}: replaced by {material}, as asked")
        return material

    def _checked(self, material: str, name: str) -> str:
        """Return the material string, with k = 0 if k is unknown; raise `MistrayError` if a wavelength has no index."""
        with errors_of(f"glass '{shown([name])}'"):
            known = usable(material, self._wavelengths_nm)
        if known != material:
            self.notes.append(f"glass {name}: absorption unknown, taken to be 0")
        return known


def remedy(name: str) -> str:
    """Return advice, for an error message, on a glass that is in no catalogue."""
    word = shown([name])
    return (
        f"give its AGF file (glass_catalogues, --glass-catalogue) or a material for it (glasses={{'{word}': '…'}}, "
        f"--glass {word}=…)"
    )
