"""
Spectra of sources, and the few wavelengths that represent them in a trace.

A spectrum is named in words: spectral lines ("F d C"), a blackbody ("blackbody:3000"), sunlight outside the atmosphere
("am0"), daylight ("d65") or a table in a file. Lines are traced as they are. For a continuous spectrum, a band is
traced in parts of equal width. Each part is traced at its energy-weighted mean wavelength, with its energy as weight.
This is exact for quantities that depend linearly on wavelength within a part.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt

from mistray.errors import MistrayError
from mistray.named_values import number_of
from mistray.physics import planck
from mistray.ranges import TEMPERATURE_K, WAVELENGTH_NM, WEIGHT, Range
from mistray.read_file import read_text
from mistray.spectra.cie import LUMENS_PER_WATT, daylight, luminous_efficiency, observer
from mistray.spectra.lines import LINES

Array = npt.NDArray[np.float64]
DEFAULT_NM = 550.0  # of light whose wavelength nothing states
DEFAULT_BAND_NM = (400.0, 700.0)
DEFAULT_BANDS = 6
BANDS = Range(1, 200, whole=True)
AM0_FILE = Path(__file__).with_name("am0.csv")
KNOWN = "lines such as 'F d C', blackbody:T, am0, d65 or the name of a .csv file"
_POINTS, _SHARES = np.polynomial.legendre.leggauss(3)  # exact for a straight line times a quadratic one


@dataclass(frozen=True)
class SpectrumSamples:
    """
    Wavelengths that represent a spectrum in a trace, with their weights.

    Attributes
    ----------
    wavelengths_nm, weights : (n,) float64
        Wavelengths, nm, and their shares of the flux, which add up to 1.
    band : (Spectrum, float) or None
        Continuous spectrum that they represent, and the energy of the traced band, in the unit of `Spectrum.energy`;
        None for lines.
    """

    wavelengths_nm: Array
    weights: Array
    band: tuple[Spectrum, float] | None = None

    @property
    def lumens_per_watt(self) -> float:
        """
        Luminous flux of the whole spectrum per radiant flux of the traced band, lm/W: 683 lm/W ∫ V E dλ / ∫ E dλ.

        For lines it is 683 lm/W times the sum of V over the lines, by weight.
        """
        if self.band is None:
            return LUMENS_PER_WATT * float(self.weights @ luminous_efficiency(self.wavelengths_nm))
        whole, energy = self.band
        return whole.lumens / energy


@dataclass(frozen=True)
class Spectrum:
    """
    Continuous spectrum of light.

    Attributes
    ----------
    name : str
        Name as given by the user.
    low_nm, high_nm : float
        Ends of the range in which it is known, nm.
    nodes : callable
        Function from the ends of a band, nm, to wavelengths (m,), nm, and energies (m,), in the unit of `energy`, of a
        quadrature over it.
    band_nm : (float, float)
        Band that is traced by default, nm.
    """

    name: str
    low_nm: float
    high_nm: float
    nodes: Callable[[float, float], tuple[Array, Array]]
    band_nm: tuple[float, float] = DEFAULT_BAND_NM

    def energy(self, low_nm: float, high_nm: float) -> float:
        """
        Return the integral over a band, whose ends are in nm.

        Its unit is W/mm² for "am0" and W/(mm² sr) for a blackbody, else that of the values times nm.

        Raises
        ------
        MistrayError
            If the ends do not rise, or the spectrum is not known over the whole band.
        """
        self._check(low_nm, high_nm)
        return float(self.nodes(low_nm, high_nm)[1].sum())

    def light(self, band_nm: Sequence[float] | None = None, bands: int = DEFAULT_BANDS) -> SpectrumSamples:
        """
        Return the wavelengths and weights of equally wide parts of a band; dark parts are left out.

        Parameters
        ----------
        band_nm : two float, optional
            Ends of the band, nm; by default 400 … 700 nm, or the whole range of a table.
        bands : int
            Number of parts, 1 … 200.

        Raises
        ------
        MistrayError
            If an argument is out of range, the ends do not rise, the spectrum is not known over the whole band, or
            there is no light in it.
        """
        low, high = self._band(band_nm)
        edges = np.linspace(low, high, int(BANDS.check("bands", bands)) + 1)
        parts = [self.nodes(a, b) for a, b in pairwise(edges)]
        energy = np.array([values.sum() for _, values in parts])
        if not energy.sum() > 0:
            raise MistrayError(f"spectrum '{self.name}' has no light from {low:g} to {high:g} nm; give another band_nm")
        means = [float(where @ values) / values.sum() for where, values in parts if values.sum() > 0]
        weights = energy[energy > 0] / energy.sum()
        return SpectrumSamples(np.array(means), weights, (self, float(energy.sum())))

    @property
    def lumens(self) -> float:
        """Luminous flux of the whole spectrum, in the unit of `energy` with lm for W; 0 if none of it is visible."""
        visible = observer()[0]
        low, high = max(self.low_nm, float(visible[0])), min(self.high_nm, float(visible[-1]))
        if not low < high:
            return 0.0
        # 1 nm wide, as the table of the eye
        edges = np.unique(np.concatenate([[low, high], visible[(visible > low) & (visible < high)]]))
        parts = [self.nodes(a, b) for a, b in pairwise(edges)]
        return LUMENS_PER_WATT * float(sum(luminous_efficiency(where) @ values for where, values in parts))

    def _band(self, band_nm: Sequence[float] | None) -> tuple[float, float]:
        if band_nm is None:
            return self.band_nm
        if len(band_nm) != 2:
            raise MistrayError(f"band_nm has {len(band_nm)} values; give its two ends, such as 400 700")
        low, high = (float(WAVELENGTH_NM.check("band_nm", end)) for end in band_nm)
        self._check(low, high)
        return low, high

    def _check(self, low_nm: float, high_nm: float) -> None:
        if not low_nm < high_nm:
            raise MistrayError(f"band_nm is {low_nm:g} to {high_nm:g}; give the shorter wavelength first")
        if low_nm < self.low_nm or high_nm > self.high_nm:
            raise MistrayError(
                f"band_nm is {low_nm:g} to {high_nm:g}, and spectrum '{self.name}' is known from {self.low_nm:g} to "
                f"{self.high_nm:g} nm; give a band within"
            )


def spectrum(text: str) -> Spectrum:
    """
    Return a continuous spectrum given by its name.

    Parameters
    ----------
    text : str
        "blackbody:T" with a temperature in K, "am0", "d65", or a .csv file with two columns, wavelengths in nm and
        values in any unit per nm. A table is linear between its wavelengths, and unknown outside them.

    Raises
    ------
    MistrayError
        If the name is none of these, the temperature is missing or out of range, or the file cannot be read.
    """
    word = text.strip()
    if word.lower().endswith(".csv"):
        table = read_table(word)
        return _of_table(word, *table, (float(table[0][0]), float(table[0][-1])))
    kind, _, number = word.lower().partition(":")
    if kind == "am0" and not number:
        return _am0()
    if kind == "d65" and not number:
        return _of_table(word, *daylight(), DEFAULT_BAND_NM)
    if kind != "blackbody":
        raise MistrayError(f"spectrum '{text}' is not known; give {KNOWN}")
    kelvin = number_of(number)
    if kelvin is None:
        raise MistrayError(f"spectrum '{text}': give the temperature in K, such as blackbody:3000")
    replace(TEMPERATURE_K, above=True).check("temperature", kelvin, f"spectrum '{text}'")

    def nodes(low_nm: float, high_nm: float) -> tuple[Array, Array]:
        where, values = planck.band_nodes(kelvin, 1e-3 * low_nm, 1e-3 * high_nm)
        return 1e3 * where, values

    return Spectrum(word, WAVELENGTH_NM.low, WAVELENGTH_NM.high, nodes)


def light_of(
    text: str,
    band_nm: Sequence[float] | None = None,
    bands: int | None = None,
    weights: Sequence[float] | None = None,
) -> SpectrumSamples:
    """
    Return the wavelengths that represent a spectrum, continuous or of lines, and their weights.

    Parameters
    ----------
    text : str
        Names of lines, separated by spaces or commas, see `mistray.spectra.lines`; or a name for `spectrum`.
    band_nm, bands
        Band (nm) and number of parts of a continuous spectrum, see `Spectrum.light`.
    weights : sequence of float, optional
        Weight of each wavelength of the lines; by default all are equal.

    Raises
    ------
    MistrayError
        If the spectrum is not known, or an argument does not apply to it or is out of range.
    """
    words = [word for word in re.split(r"[\s,]+", text.strip()) if word]
    if not words or any(word not in LINES for word in words):
        if weights is not None:
            raise MistrayError(f"weights are given with spectrum '{text}', which has its own; leave them out")
        return spectrum(text).light(band_nm, DEFAULT_BANDS if bands is None else bands)
    if band_nm is not None or bands is not None:
        raise MistrayError(f"band_nm or bands is given with the lines '{text}'; leave it out")
    wavelengths = [nm for word in words for nm in LINES[word]]
    if len(set(wavelengths)) < len(wavelengths):
        raise MistrayError(f"spectrum '{text}' has a line twice; give it once")
    return of_lines(wavelengths, weights)


def of_lines(wavelengths_nm: Sequence[float], weights: Sequence[float] | None = None) -> SpectrumSamples:
    """
    Return spectral lines at given wavelengths, nm, as samples; weights are scaled to a sum of 1, and equal by default.

    Raises
    ------
    MistrayError
        If there is no wavelength, a wavelength or a weight is out of range, all weights are 0, or there are not as many
        weights as wavelengths.
    """
    lines = np.array([WAVELENGTH_NM.check("wavelength_nm", float(nm)) for nm in wavelengths_nm], dtype=np.float64)
    if not len(lines):
        raise MistrayError("wavelength_nm is empty; give at least one")
    shares = np.ones(len(lines))
    if weights is not None:
        shares = np.array([WEIGHT.check("weights", float(weight)) for weight in weights], dtype=np.float64)
    if len(shares) != len(lines):
        raise MistrayError(f"{len(shares)} weights for {len(lines)} wavelengths; give one for each")
    if not shares.sum() > 0:
        raise MistrayError(f"weights are {', '.join(f'{share:g}' for share in shares)}; give one above 0")
    shares /= shares.sum()
    return SpectrumSamples(lines, shares)


def read_table(path: str | Path) -> tuple[Array, Array]:
    """
    Read a table of a spectrum: wavelengths (n,), nm, and values (n,) ≥ 0, in any unit per nm.

    Lines that begin with # are comments. A first line may name the columns, the first of them ``nm`` or
    ``wavelength_nm``. Commas, semicolons, tabs or spaces separate the values.

    Raises
    ------
    MistrayError
        If the file cannot be read, or a line is not a wavelength and a value ≥ 0. It is also raised if the wavelengths
        do not rise, there are fewer than two, or all values are 0.
    """
    rows: list[tuple[float, float]] = []
    headed = False
    for number, line in enumerate(read_text(path, "spectrum").splitlines(), start=1):
        cells = [cell for cell in re.split(r"\s*[,;\t]\s*|\s+", line.strip()) if cell]
        if not cells or cells[0].startswith("#"):
            continue
        where = f"spectrum '{path}' line {number}"
        if not rows and not headed and number_of(cells[0]) is None:
            if cells[0].lower() not in ("nm", "wavelength_nm"):
                raise MistrayError(f"{where}: the first column is '{cells[0][:40]}'; give wavelength_nm")
            headed = True
            continue
        if len(cells) != 2 or None in map(number_of, cells):
            raise MistrayError(f"{where} is not a pair of a wavelength and a value; correct the line")
        wavelength, value = map(float, cells)
        WAVELENGTH_NM.check("wavelength_nm", wavelength, where)
        WEIGHT.check("value", value, where)
        if rows and not wavelength > rows[-1][0]:
            raise MistrayError(f"{where}: {wavelength:g} nm does not rise; sort the wavelengths, each once")
        rows.append((wavelength, value))
    if len(rows) < 2:
        raise MistrayError(f"spectrum '{path}' has {len(rows)} wavelengths; give two or more, each with a value")
    wavelengths, values = np.array(rows, dtype=np.float64).T
    if not values.max() > 0:
        raise MistrayError(f"spectrum '{path}': all values are 0; give one above 0")
    return wavelengths, values


@cache
def _am0() -> Spectrum:
    return _of_table("am0", *read_table(AM0_FILE), DEFAULT_BAND_NM)


def _of_table(name: str, wavelengths: Array, values: Array, band_nm: tuple[float, float]) -> Spectrum:
    """
    Return a spectrum that is linear between the wavelengths of a table, nm, with values in any unit per nm.

    `band_nm` is the band that is traced by default, nm.
    """

    def nodes(low_nm: float, high_nm: float) -> tuple[Array, Array]:
        inside = wavelengths[(wavelengths > low_nm) & (wavelengths < high_nm)]
        edges = np.concatenate([[low_nm], inside, [high_nm]])
        half = 0.5 * np.diff(edges)[:, None]
        where = (0.5 * (edges[1:] + edges[:-1])[:, None] + half * _POINTS).ravel()
        return where, (half * _SHARES).ravel() * np.interp(where, wavelengths, values)

    return Spectrum(name, float(wavelengths[0]), float(wavelengths[-1]), nodes, band_nm)
