"""Measured scatter: tables of BSDFs, and the files that hold them."""
