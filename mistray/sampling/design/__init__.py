"""The sequences of surfaces by which a scene is made to form its images."""
