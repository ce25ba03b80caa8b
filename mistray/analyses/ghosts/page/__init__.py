"""The report of a ghost analysis: its summary, its fields, its ledgers."""
