"""Readers and writers of files: tables, ray sets, intensities, sags, sky pictures, irradiance, saved states."""
