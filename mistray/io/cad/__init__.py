"""Readers of CAD and mesh files (STEP, STL, OBJ, PLY, glTF), and a writer of STEP files."""
