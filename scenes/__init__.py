"""Optical systems that ship with mistray: one folder each, with scene.xml, its prescription and SOURCE.md.

Every ``<name>/prescription.py`` has a function ``build()`` that returns the `mistray.prescription.Prescription`;
``python -m mistray.scenes`` writes the XML files from them.
"""
