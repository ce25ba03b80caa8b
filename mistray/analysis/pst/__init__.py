"""Point source transmittance: at all angles from one trace against the light, or angle by angle with it."""
