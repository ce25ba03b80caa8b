"""Tables of a ghost analysis as text and CSV."""
