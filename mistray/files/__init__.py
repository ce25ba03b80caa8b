"""Numbers in files of common formats: values that JSON knows, tables as Parquet, irradiance as FITS, EXR and NumPy."""
