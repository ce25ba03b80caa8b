"""Prints the lowest versions that pyproject.toml allows, as constraints of pip: ``make test-lowest`` installs them."""

from __future__ import annotations

import tomllib
from pathlib import Path

from packaging.requirements import Requirement

PYPROJECT = Path(__file__).parents[1] / "pyproject.toml"


def lowest() -> dict[str, str]:
    """Name of each package that mistray needs → lowest version that is allowed."""
    project = tomllib.loads(PYPROJECT.read_text(encoding="utf-8"))["project"]
    found = {}
    for text in project["dependencies"]:
        needed = Requirement(text)
        (found[needed.name],) = [one.version for one in needed.specifier if one.operator in (">=", "==")]
    return found


if __name__ == "__main__":
    print("\n".join(f"{name}=={version}" for name, version in lowest().items()))
