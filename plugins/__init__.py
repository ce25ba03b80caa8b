"""Mitsuba plugins of mistray, one folder per kind; `import mistray` or an import of this package registers them all.

The package is `mistray.plugins`; in a checkout it is `plugins`, too.
"""

if __name__ == "plugins":
    from mistray._variant import ensure_variant

    ensure_variant()
