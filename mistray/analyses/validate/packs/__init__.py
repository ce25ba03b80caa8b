"""Packs of the validation: for each source of numbers, how ours are found, and which program is asked."""
