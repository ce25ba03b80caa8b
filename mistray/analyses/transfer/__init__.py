"""Transfer functions (MTF) with scattered light and ghosts: how stray light lowers the contrast of an image."""
