"""Built-in packs of the validation, one for each source of reference numbers."""
