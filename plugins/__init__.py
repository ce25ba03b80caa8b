"""Mitsuba plugins of mistray, one folder per kind; `import mistray` or an import of this package registers them all.

The package is `mistray.plugins`; in a checkout it is `plugins`, too.
"""

from mistray._variant import ensure_variant, warn_without_plugins

if __name__ == "plugins":
    ensure_variant()
else:  # `import mistray` has registered them, if it could
    warn_without_plugins()
