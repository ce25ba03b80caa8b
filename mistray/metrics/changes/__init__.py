"""Side effects of a change of a scene: gaps that open, light that enters by other surfaces."""
