"""Reader and writer of Zemax OpticStudio lens files (.zmx)."""
