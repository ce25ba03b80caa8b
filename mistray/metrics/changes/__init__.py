"""Side effects of a change of a scene: gaps that open, and light that enters by other surfaces."""
