"""Conversion of a sequential lens to a closed system in the world: surfaces, edges, bores, walls, stop, detector."""
