"""Measured scatter models: tables of BSDFs or roughness spectra, and readers of their file formats."""
