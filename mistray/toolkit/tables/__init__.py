"""Tables of results as rows for text, CSV and JSON."""
