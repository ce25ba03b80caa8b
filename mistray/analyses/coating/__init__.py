"""Coatings by themselves: reflectance and transmittance by wavelength and angle."""
