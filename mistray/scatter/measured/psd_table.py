"""Scatter model of a surface with a measured roughness spectrum."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from mistray.errors import MistrayError, errors_of
from mistray.files.number_rows import numbers, read_cells
from mistray.param import Param
from mistray.ranges import NOT_NEGATIVE, TEXT, Words
from mistray.scatter.radial import RadialTable
from mistray.scatter.rough_surface import RoughSurface

FREQUENCIES = {"frequency_1_um": 1.0, "frequency_1_mm": 1e-3}  # column → 1/µm
SPECTRA = {"psd_um4": 1.0, "psd_nm2_mm2": 1.0}  # column → µm⁴; nm² mm² is the same
BEYOND = ("error", "slope", "zero")
LARGEST_UM4 = 1e12


@dataclass(frozen=True)
class PsdTable(RoughSurface):
    """
    Isotropic surface with a tabulated two-dimensional roughness spectrum, µm⁴, for both events and from both sides.

    Between two frequencies of the table the spectrum is a power law; below the first it is constant. Light of the
    vacuum wavelength λ scatters at frequencies up to 2 n/λ, where n is the index on the side of the scattered light.
    Theories, equations and sources: `RoughSurface`.

    Attributes
    ----------
    frequency_1_um : (m,) tuple of float
        Spatial frequencies, 1/µm, > 0, ascending, at least two.
    psd_um4 : (m,) tuple of float
        Two-dimensional roughness spectrum, µm⁴, > 0. One µm⁴ is 1 nm² mm².
    beyond : {"error", "slope", "zero"}
        Spectrum above the last frequency: "error" refuses light that needs it, "slope" continues the power law of the
        last two frequencies, and "zero" assumes no roughness.
    scale : float
        Factor that multiplies the spectrum, ≥ 0.
    theory, substrate
        Options of `RoughSurface`.

    Raises
    ------
    MistrayError
        If a parameter or a value of the table is out of range. `lobes` raises it for a surface that is too rough for
        the theory at a wavelength, and for a table that ends too early.
    """

    frequency_1_um: tuple[float, ...]
    psd_um4: tuple[float, ...]
    beyond: str = Param("string", Words(BEYOND), "above the last frequency; ``slope``: the power law goes on").field(
        "error"
    )
    scale: float = Param("1", NOT_NEGATIVE, "factor that multiplies the spectrum").field(1.0)

    also = MappingProxyType(
        {
            "file": Param(
                "file", TEXT, "CSV of spatial frequencies and of the two-dimensional spectrum, see docs/scatter.md"
            )
        }
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        f, psd = np.array(self.frequency_1_um), np.array(self.psd_um4)
        if len(f) < 2 or f.shape != psd.shape:
            raise MistrayError(f"{self.title}: {f.size} frequencies and {psd.size} values; give two or more of each")
        if not (np.all(np.isfinite(f)) and np.all(np.diff(f) > 0) and f[0] > 0):
            raise MistrayError(f"{self.title}: the frequencies must be above 0 and ascend; sort them, each once")
        good = (psd > 0) & (psd <= LARGEST_UM4)
        if not np.all(good):
            k = int(np.argmin(good))
            raise MistrayError(
                f"{self.title}: spectrum {psd[k]:g} µm⁴ at {f[k]:g} 1/µm; give values > 0, and leave out what is below "
                f"the noise; no smooth surface has more than {LARGEST_UM4:g}"
            )

    @classmethod
    def of(cls, resolve: Callable[[str], str] = str, **properties: Any) -> PsdTable:
        """Return the model with given properties, see `Placement.of`; the CSV file `file` holds the spectrum."""
        if "file" not in properties:
            raise MistrayError(f"{cls.__name__}: file is missing; name a .csv file of the spectrum")
        return cls.read(resolve(properties.pop("file")), **properties)

    @classmethod
    def read(cls, path: str | Path, **options: Any) -> PsdTable:
        """
        Return the model with the roughness spectrum of a CSV file.

        The columns are frequency_1_um or frequency_1_mm, and psd_um4 or psd_nm2_mm2, with ascending frequencies. Lines
        that start with # are comments.

        Parameters
        ----------
        path : str or Path
            CSV file of the spectrum.
        **options
            Values of the other attributes.

        Raises
        ------
        MistrayError
            If the file is missing or has other columns, a cell is not a number, or for the reasons of the class.
        """
        what = f"PSD table '{path}'"
        (_, header), *below = read_cells(path, "PSD table") or [(0, [])]
        known = [(FREQUENCIES | SPECTRA).get(name) for name in header]
        if len(header) != 2 or header[0] not in FREQUENCIES or header[1] not in SPECTRA:
            raise MistrayError(
                f"{what}: its columns are {', '.join(header) or 'missing'}; give {' or '.join(FREQUENCIES)}, and "
                f"{' or '.join(SPECTRA)}"
            )
        rows = [numbers(row, 2, f"{what}, line {number}") for number, row in below]
        f, psd = (np.array(rows).reshape(-1, 2) * np.array(known, dtype=np.float64)).T
        options.setdefault("name", str(path))
        with errors_of(what):
            return cls(tuple(f.tolist()), tuple(psd.tolist()), **options)

    def psd(self, wavelength_nm: float) -> Callable[[np.ndarray], np.ndarray]:
        """Return the spectrum times `scale`, µm⁴, as a function of frequency, 1/µm; the wavelength has no effect."""
        log_f, log_psd = np.log(self.frequency_1_um), np.log(self.psd_um4)
        last = float((log_psd[-1] - log_psd[-2]) / (log_f[-1] - log_f[-2]))

        def spectrum(f: np.ndarray) -> np.ndarray:
            with np.errstate(divide="ignore"):
                x = np.log(np.asarray(f, dtype=np.float64))
            above = np.maximum(x - log_f[-1], 0.0)
            values = np.exp(np.interp(x, log_f, log_psd) + last * above)
            return self.scale * np.where((above > 0) & (self.beyond == "zero"), 0.0, values)

        return spectrum

    def relevant_rms_um(self, wavelength_nm: float, n: float) -> float:
        """
        Return the rms roughness, µm, that scatters into the half space of index n, see `RoughSurface`.

        Raise `MistrayError` if the table ends below 2 n/λ and `beyond` is "error".
        """
        highest = n / (wavelength_nm * 1e-3)
        if self.beyond == "error" and 2 * highest > self.frequency_1_um[-1]:
            raise MistrayError(
                f"{self.title}: it ends at {self.frequency_1_um[-1]:g} 1/µm, but light of {wavelength_nm:g} nm meets "
                f"frequencies up to {2 * highest:g} 1/µm; complete it, or set beyond to 'slope' or 'zero'"
            )
        spectrum = self.psd(wavelength_nm)
        table = RadialTable.of(lambda r: spectrum(r * highest))
        return highest * math.sqrt(float(table.within(np.array([1.0]))[0]))

    @property
    def is_smooth_as_glass(self) -> bool:
        """True if the factor `scale` of the spectrum is 0, so that nothing is scattered."""
        return self.scale == 0
