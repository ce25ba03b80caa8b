"""Mitsuba plugins of mistray, one folder per kind; `mistray._variant.register_plugins` imports every file."""
