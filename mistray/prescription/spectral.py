"""Wavelengths of a source in a prescription."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mistray.errors import MistrayError, errors_of
from mistray.ranges import WAVELENGTH_NM, WAVELENGTHS_NM, WEIGHTS, Each
from mistray.spectra.spectrum import SpectrumSamples, light_of, of_lines

DEFAULT_NM = (550.0,)


@dataclass(frozen=True, kw_only=True)
class Spectral:
    """
    Wavelengths of light, given one by one or by a spectrum; see docs/sources.md.

    Attributes
    ----------
    wavelength_nm : tuple of float
        Vacuum wavelengths, nm.
    weights : tuple of float or None
        Relative weight of each wavelength or line; ``None``: equal. A continuous spectrum has its own.
    spectrum : str or None
        Spectrum to use instead of `wavelength_nm`, see `mistray.spectra.spectrum.light_of`.
    band_nm : tuple of two float, or None
        Part of a continuous spectrum that is traced, nm; ``None``: 400 … 700 nm, or the whole range of a table.
    bands : int or None
        Number of parts that the band of a continuous spectrum is divided into; ``None``: 6.
    """

    wavelength_nm: tuple[float, ...] = WAVELENGTHS_NM.field(DEFAULT_NM)
    weights: tuple[float, ...] | None = WEIGHTS.field(None)
    spectrum: str | None = None
    band_nm: tuple[float, float] | None = Each(WAVELENGTH_NM, 2).field(None)
    bands: int | None = None

    @property
    def light(self) -> SpectrumSamples:
        """Traced wavelengths, nm, with their weights; raises `MistrayError` if the description is invalid."""
        if self.spectrum is None:
            if self.band_nm is not None or self.bands is not None:
                raise MistrayError("band_nm or bands is given without spectrum; give both")
            return of_lines(self.wavelength_nm, self.weights)
        if self.wavelength_nm != DEFAULT_NM:
            raise MistrayError("wavelength_nm and spectrum are given; give one of them")
        return light_of(self.spectrum, self.band_nm, self.bands, self.weights)

    def check_spectrum(self, owner: str) -> None:
        """Raise `MistrayError`, whose message begins with `owner`, if the description of the wavelengths is invalid."""
        with errors_of(owner):
            _ = self.light

    @property
    def spectral_properties(self) -> dict[str, Any]:
        """Properties of the source plugin that state the wavelengths, nm, with their weights, or the spectrum."""
        found: dict[str, Any] = {}
        if self.spectrum is not None:
            found["spectrum"] = self.spectrum
        else:
            one = len(self.wavelength_nm) == 1
            found["wavelength_nm"] = float(self.wavelength_nm[0]) if one else list_text(self.wavelength_nm)
        if self.weights is not None:
            found["weights"] = list_text(self.weights)
        if self.band_nm is not None:
            found["band_nm"] = list_text(self.band_nm)
        if self.bands is not None:
            found["bands"] = float(self.bands)
        return found


def list_text(values: tuple[float, ...]) -> str:
    """Return numbers as comma-separated text with all digits, as plugin properties expect."""
    return ", ".join(repr(float(value)) for value in values)
