"""Double Gauss of the patent US 2,673,491 (Tronnier), f = 50 mm, stopped down to f/4."""
