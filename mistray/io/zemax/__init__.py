"""Zemax OpticStudio lens files (.zmx), read and written."""
