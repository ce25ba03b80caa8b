"""Common part of glasses of all lens files: replacements that the user asks for, a known k, notes and the remedy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from mistray.errors import MistrayError
from mistray.materials.mate import shown
from mistray.prescription.sequential.materials import usable


class FileGlasses:
    """
    Base of the finders of materials by the names of a lens file.

    Parameters
    ----------
    replaced : mapping of str to str
        Glass → material string that the user wants for it.
    wavelengths_nm : sequence of float
        Of the lens; a material must have an index at each.

    Attributes
    ----------
    notes : list of str
        What was assumed, each once.
    """

    def __init__(self, replaced: Mapping[str, str], wavelengths_nm: Sequence[float]) -> None:
        self.notes: list[str] = []
        self._replaced = {name.upper(): material for name, material in replaced.items()}
        self._wavelengths_nm = wavelengths_nm

    def _asked_for(self, name: str) -> str | None:
        """The material that the user wants for a glass."""
        material = self._replaced.get(name.upper())
        if material is not None:
            self._note(f"glass {name}: replaced by {material}, as asked")
        return material

    def _checked(self, material: str, name: str) -> str:
        """The material, with k = 0 where its absorption is unknown; raises if it has no index at a wavelength."""
        try:
            known = usable(material, self._wavelengths_nm)
        except MistrayError as error:
            raise MistrayError(f"glass '{shown([name])}': {error}") from None
        if known != material:
            self._note(f"glass {name}: absorption unknown, taken to be 0")
        return known

    def _note(self, text: str) -> None:
        if text not in self.notes:
            self.notes.append(text)


def remedy(name: str) -> str:
    """Return the remedy for a glass that is in no catalogue."""
    word = shown([name])
    return (
        f"give its AGF file (glass_catalogues, --glass-catalogue) or a material for it (glasses={{'{word}': '…'}}, "
        f"--glass {word}=…)"
    )
