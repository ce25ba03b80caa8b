"""Images of points: first-order optics, pupil functions, point spread and transfer functions."""
