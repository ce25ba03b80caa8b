"""Measured scatter: tables of BSDFs, and their file formats."""
