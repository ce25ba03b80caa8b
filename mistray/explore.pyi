"""Public name of the live explorer, re-exported."""

# Written by tests/stubs.py from what the functions are when they run

from mistray.analyses.explorer.explorer import Explorer as Explorer

__all__ = ["Explorer"]
