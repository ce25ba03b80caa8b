"""Parts from CAD and mesh files: STEP, STL, OBJ, PLY, glTF."""
