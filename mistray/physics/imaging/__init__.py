"""Images of points: pupil functions, point spread and transfer functions, and their closed forms."""
