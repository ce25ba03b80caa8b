"""Live explorer: controls of a scene, whose stray light is estimated at once and traced in the background."""
