"""Evaluate coatings on their own: reflectance and transmittance by wavelength and angle."""
