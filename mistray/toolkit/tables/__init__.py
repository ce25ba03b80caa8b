"""Tables of results: rows for text, CSV and JSON."""
