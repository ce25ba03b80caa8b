"""A scatter model for mistray: a power of the cosine of the angle from the specular direction."""
