"""Makes ``python -m mistray`` the same as ``mistray``."""

import sys

from mistray.cli import main

if __name__ == "__main__":
    sys.exit(main())
