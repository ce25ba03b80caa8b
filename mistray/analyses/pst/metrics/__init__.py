"""Point source transmittances as metrics, and as data of fits, with their derivatives."""
