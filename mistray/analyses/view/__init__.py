"""View of a scene and its rays in three dimensions, as a web page."""
