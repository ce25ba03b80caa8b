"""Off-axis telescope of four mirrors without obscuration, by a patent, with a shade around its stop."""
