"""The command line: parses, calls the functions of the package, prints."""

from mistray.cli.program import main

__all__ = ["main"]
