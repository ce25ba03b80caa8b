"""Point source transmittances as metrics and as data of a fit, with their derivatives."""
