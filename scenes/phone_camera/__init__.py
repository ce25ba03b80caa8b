"""Phone camera: window, five plastic aspheres, IR filter, detector, barrel."""
