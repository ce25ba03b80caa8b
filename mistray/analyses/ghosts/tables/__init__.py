"""Tables of a ghost analysis, as text and as CSV files."""
