"""States of polarisation of light."""
