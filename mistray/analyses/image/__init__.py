"""Image quality of the direct light: wavefront, point spread and transfer functions, spots, distortion."""
