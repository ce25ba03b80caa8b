"""Pictures of ghosts, far fields and irradiance on walls."""
