"""Transfer functions of scattered light and ghosts: what stray light does to the image of a point and to contrast."""
