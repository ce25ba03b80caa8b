"""Writes the table of packages into docs/support_matrix.md, from pyproject.toml and requirements-dev.lock.

    PYTHONPATH=tests python docs/make_support_matrix.py

The table stands below a comment that names this script. `tests/test_packaging.py` keeps the page current.
"""

from __future__ import annotations

import re
from pathlib import Path

from lowest import extras, lowest
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "support_matrix.md"
HEAD = "| package | lowest version | tested version | for |\n|---|---|---|---|\n"
TABLE = re.compile(r"(<!-- Packages, written by docs/make_support_matrix\.py -->\n\n)(?:\|.*\n)*")


def tested() -> dict[str, str]:
    """Canonical name of a package → version in the lock file."""
    lines = (ROOT / "requirements-dev.lock").read_text(encoding="utf-8").splitlines()
    pairs = [line.partition("==") for line in lines if "==" in line and not line.startswith("#")]
    return {canonicalize_name(name): version for name, _, version in pairs}


def table() -> str:
    """The table: what mistray needs, then what its extras do."""
    versions, needed_by = tested(), extras()
    rows = [
        f"| {name} | {version} | {versions.get(canonicalize_name(name), 'not tested')} "
        f"| {', '.join(f'`{extra}`' for extra in needed_by[name]) or 'mistray'} |\n"
        for name, version in lowest().items()
    ]
    return HEAD + "".join(rows)


def page() -> str:
    """The page with its table as it shall be."""
    return TABLE.sub(lambda found: found[1] + table(), PAGE.read_text(encoding="utf-8"))


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
