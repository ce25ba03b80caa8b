"""A dusty, polished lens and a black screen before a small detector: one scatter at each of the three."""
