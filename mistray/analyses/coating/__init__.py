"""Coatings evaluated on their own: reflectance and transmittance by wavelength and angle."""
