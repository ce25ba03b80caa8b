"""Transfer functions of scattered light and ghosts: effect of stray light on the image of a point and its contrast."""
