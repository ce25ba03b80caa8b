"""Prints the lowest versions that pyproject.toml allows, as constraints of pip: ``make test-lowest`` installs them."""

import tomllib
from collections import defaultdict
from pathlib import Path

from packaging.requirements import Requirement

PROJECT = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def lowest() -> dict[str, str]:
    """Name of each package that mistray and its extras need → lowest version that is allowed."""
    found = {}
    for _, needed in _requirements():
        (found[needed.name],) = [one.version for one in needed.specifier if one.operator in (">=", "==")]
    return found


def extras() -> dict[str, list[str]]:
    """Name of each such package → extras that need it; none for what mistray needs."""
    found = defaultdict(list)
    for extra, needed in _requirements():
        found[needed.name] += [extra] if extra else []
    return found


def _requirements() -> list[tuple[str, Requirement]]:
    groups = {"": PROJECT["dependencies"], **PROJECT["optional-dependencies"]}
    found = [(extra, Requirement(text)) for extra, texts in groups.items() for text in texts]
    return [(extra, needed) for extra, needed in found if needed.name != PROJECT["name"]]


if __name__ == "__main__":
    print("\n".join(f"{name}=={version}" for name, version in lowest().items()))
