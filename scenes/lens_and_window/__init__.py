"""Singlet of least spherical aberration and a plane window whose ghost the lens brings to a focus on the detector."""
