"""Readers and writers of common file formats: JSON values, Parquet, ray sets, and irradiance as FITS, EXR, NPY."""
