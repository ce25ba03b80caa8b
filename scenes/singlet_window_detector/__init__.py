"""Biconvex singlet, plane window and reflecting detector: ten two-reflection ghosts in closed form."""
