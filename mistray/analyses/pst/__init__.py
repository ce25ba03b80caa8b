"""Point source transmittance (PST): at all angles from one backward trace, or angle by angle from forward traces."""
