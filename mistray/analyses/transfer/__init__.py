"""Transfer functions of scattered light and ghosts: how stray light lowers the contrast of an image."""
