"""A plane-parallel plate in a collimated beam: the closed form of multiple reflections."""
