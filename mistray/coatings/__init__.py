"""Coatings: effect of an interface on the flux of s and p, from a recipe of layers, fixed R and T, or a table.

==================  ===================================================================================
`Bare`              no coating, Fresnel's equations
`Ideal`             the same R and T at all wavelengths and angles
`CoatingTable`      R, T and phases over wavelength and angle, from CSV or a Zemax TABLE
`Stack`, `Layer`    homogeneous layers with dispersion and absorption; `preset` knows some by name
==================  ===================================================================================

`read_coating`, `read_coating_file` and `write_table` read and write files, `spectrum` evaluates on a
grid of wavelengths and angles.

Each coating has `CoatingModel.response`, which returns a `Response`: fractions of the flux for s and p and the phases
between them, rad, in float64. Wavelengths are in vacuum, nm; N = n + ik with k > 0 absorbs.
"""

from mistray.coatings.files import coating_from_text, read_coating, write_table
from mistray.coatings.fitted_to_substrate import FittedPreset, fitted_preset
from mistray.coatings.presets import PRESETS, preset
from mistray.coatings.response import METAL_K, CoatingModel, Response
from mistray.coatings.simple import Bare, Ideal
from mistray.coatings.spectrum import CoatingSpectrum, spectrum
from mistray.coatings.stack import LAYER_PARAMETERS, Layer, Stack, layer_text, parse_layers
from mistray.coatings.table import CoatingTable
from mistray.coatings.zemax_coating_dat import CoatingFile, read_coating_file

# Their names before version 0.3
Coating, Fitted, Spectrum = CoatingModel, FittedPreset, CoatingSpectrum

__all__ = [
    "LAYER_PARAMETERS",
    "METAL_K",
    "PRESETS",
    "Bare",
    "Coating",
    "CoatingFile",
    "CoatingModel",
    "CoatingSpectrum",
    "CoatingTable",
    "Fitted",
    "FittedPreset",
    "Ideal",
    "Layer",
    "Response",
    "Spectrum",
    "Stack",
    "coating_from_text",
    "fitted_preset",
    "layer_text",
    "parse_layers",
    "preset",
    "read_coating",
    "read_coating_file",
    "spectrum",
    "write_table",
]


def __dir__() -> list[str]:
    return sorted(__all__)
