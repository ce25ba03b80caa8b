"""What `--json` prints, as docs/json.md promises: one object, plain JSON, numbers that say their units."""

import json
import re
from pathlib import Path
from typing import Any, NoReturn

DOCUMENT = Path(__file__).parents[1] / "docs" / "json.md"


def listed(heading: str) -> list[str]:
    """The words between backquotes of a section of docs/json.md."""
    text = DOCUMENT.read_text(encoding="utf-8")
    section = re.search(rf"^## {re.escape(heading)}$(.*?)(?=^## |\Z)", text, re.MULTILINE | re.DOTALL)
    assert section is not None, f"docs/json.md has no section '{heading}'"
    return re.findall(r"`([^`]+)`", section[1])


def is_pure(name: str, pure: list[str]) -> bool:
    """Whether a name is among those of numbers without a unit, in full, by its end or by its beginning."""
    return any(
        name.endswith(word) if word.startswith("_") else name.startswith(word) if word.endswith("_") else name == word
        for word in pure
    )


def says_unit(path: list[str], endings: list[str], pure: list[str]) -> bool:
    """Whether the keys that lead to a number tell its unit, or that it has none."""
    names = [re.sub(r"_se(?=_|$)", "", key) for key in path]
    own = names[-2] if names[-1] in ("value", "se") and len(names) > 1 else names[-1]
    return (
        any(name == end[1:] or name.endswith(end) for name in names for end in endings)
        or any(f"{name}." in pure for name in names)
        or is_pure(own, pure)
    )


def wrong(value: Any, path: list[str] | None = None) -> set[str]:
    """The keys of numbers that tell no unit."""
    endings, pure = listed("Units"), listed("Numbers without a unit")
    found: set[str] = set()
    known: dict[str, bool] = {}  # a table has the same keys in every row

    def walk(value: Any, path: list[str]) -> None:
        if isinstance(value, dict):
            for key, item in value.items():
                if "unit" not in value or isinstance(item, dict | list):
                    walk(item, [*path, key])
        elif isinstance(value, list):
            for item in value:
                walk(item, path)
        elif isinstance(value, int | float) and not isinstance(value, bool):
            name = ".".join(path)
            if name not in known:
                known[name] = says_unit(path, endings, pure)
            if not known[name]:
                found.add(name)

    walk(value, path or [])
    return found


def read(text: str) -> dict[str, Any]:
    """The object that a command printed; fails where it is no such object."""

    def refuse(name: str) -> NoReturn:
        raise AssertionError(f"{name} is no JSON")

    answer = json.loads(text, parse_constant=refuse)
    assert isinstance(answer, dict)
    assert isinstance(answer["files"], list)
    unknown = sorted(wrong(answer))
    assert not unknown, f"say the unit in the names, or list them in docs/json.md: {', '.join(unknown)}"
    return answer
