"""Independent float64 oracles for the tests.

Pure numpy: nothing here imports mistray, mitsuba or drjit, so an error there cannot hide here. Units are mm, nm and W;
angles are radians inside and degrees only in names that end in ``_deg``.
"""
