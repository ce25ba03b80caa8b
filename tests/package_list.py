"""Writes the packages of pyproject.toml anew: `python tests/package_list.py`."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]


def packages() -> list[str]:
    """Return the names of all folders with an ``__init__.py``, in order."""
    found = [init.parent for top in ("mistray", "plugins", "scenes") for init in (ROOT / top).rglob("__init__.py")]
    names = [".".join(folder.relative_to(ROOT).parts) for folder in found]
    return sorted(name if name.split(".")[0] == "mistray" else f"mistray.{name}" for name in names)


def written(text: str) -> str:
    """Return the text of pyproject.toml with the list as it should be."""
    lines = "".join(f'    "{name}",\n' for name in packages())
    return re.sub(r"^packages = \[\n.*?^\]", lambda _: f"packages = [\n{lines}]", text, flags=re.DOTALL | re.MULTILINE)


if __name__ == "__main__":
    place = ROOT / "pyproject.toml"
    place.write_text(written(place.read_text(encoding="utf-8")), encoding="utf-8")
