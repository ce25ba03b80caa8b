"""States of polarisation of light: Stokes parameters and Jones vectors."""
