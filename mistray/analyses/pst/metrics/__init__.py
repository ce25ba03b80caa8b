"""Point source transmittance as metrics and as data of fits, with derivatives."""
