"""Mitsuba plugins of mistray, one folder per kind: `import mistray` registers them all, and so does this package.

They are `mistray.plugins`; in a checkout they are found as `plugins` too.
"""

if __name__ == "plugins":
    from mistray._variant import ensure_variant

    ensure_variant()
