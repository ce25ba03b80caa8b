"""Cooled camera for 8 to 12 µm, f = 56 mm, F/2, whose cold stop is the stop."""
