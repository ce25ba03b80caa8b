"""Tables of ghosts as text and CSV."""
