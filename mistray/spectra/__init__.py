"""Spectra of light: lines, blackbodies, sunlight and tables, and the wavelengths that stand for them in a trace."""
