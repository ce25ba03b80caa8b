"""Fields × wavelengths × configurations of a scene, all traced in one call with the kernels compiled once."""
