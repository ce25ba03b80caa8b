"""Design sequences: the orders of surfaces by which the direct image of a scene is formed."""
