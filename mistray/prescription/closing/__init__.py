"""Conversion of a sequential lens to a closed system: surfaces, edges, bores, walls, stop and detector."""
