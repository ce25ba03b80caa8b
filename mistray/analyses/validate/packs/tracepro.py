"""TracePro's sheet "ABg from RMS": A, B and g of a polished mirror from its roughness."""

from __future__ import annotations

from mistray.analyses.validate.declared import DeclaredRow, ReferenceFile
from mistray.analyses.validate.pack import Finder
from mistray.estimate import Estimate
from mistray.physics import abg

INPUT = {"rms_um": 0.005, "correlation_length_um": 100.0, "wavelength_um": 0.5, "index_step": 2.0, "reflectance": 0.95}
RAW_INTEGRAL = 0.015552516  # of the sheet, by which it normalises


def ours(file: ReferenceFile, rays: int | None, seed: int) -> Finder:
    """
    Return the function by which mistray computes the sheet's A (1/sr), B, g or TIS; the parameters are unused.

    B, g and TIS are dimensionless.
    """
    sheet = abg.abg_from_rms(**INPUT, raw_integral=RAW_INTEGRAL)

    def number(row: DeclaredRow) -> Estimate:
        cell = row.argument("cell")
        return Estimate(abg.tis(sheet.a, sheet.b, sheet.g) if cell == "tis_of_abg" else getattr(sheet, cell), 0.0)

    return number
