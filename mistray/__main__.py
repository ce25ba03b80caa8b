"""Entry point of ``python -m mistray``, which runs the ``mistray`` command."""

from __future__ import annotations

import sys

from mistray.supervisor import supervise


def main() -> int:
    """Run the command line in a child process and return its exit code; see `mistray.supervisor`."""
    supervise()
    from mistray.cli import main as run

    return run()


if __name__ == "__main__":
    sys.exit(main())
