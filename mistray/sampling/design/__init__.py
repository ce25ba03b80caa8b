"""Design sequences: the orders of surfaces and events by which the direct image of a scene is formed."""
