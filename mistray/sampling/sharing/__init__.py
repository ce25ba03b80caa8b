"""Bidirectional sampling: start maps of forward rays, light vertices, and the MIS weights of both directions."""
