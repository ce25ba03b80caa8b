"""What `--json` prints, as docs/json.md promises: one object, plain JSON, numbers that say their units."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NoReturn

from jsonschema import Draft202012Validator

from mistray.cli.program import COMMANDS
from mistray.toolkit.command_request import schema_of_result

DOCUMENT = Path(__file__).parents[1] / "docs" / "json.md"


def listed(heading: str) -> list[str]:
    """The words between backquotes of a section of docs/json.md."""
    text = DOCUMENT.read_text(encoding="utf-8")
    section = re.search(rf"^## {re.escape(heading)}$(.*?)(?=^## |\Z)", text, re.MULTILINE | re.DOTALL)
    assert section is not None, f"docs/json.md has no section '{heading}'"
    return re.findall(r"`([^`]+)`", section[1])


def says_unit(path: list[str], endings: list[str], pure: list[str]) -> bool:
    """Whether the keys that lead to a number tell its unit, or that it has none: in full, by its end or beginning."""
    names = [re.sub(r"_se(?=_|$)", "", key) for key in path]
    own = names[-2] if names[-1] in ("value", "se") and len(names) > 1 else names[-1]
    return (
        any(name == end[1:] or name.endswith(end) for name in names for end in endings)
        or any(f"{name}." in pure for name in names)
        or own in pure
        or any(own.endswith(word) if word[0] == "_" else word[-1] == "_" and own.startswith(word) for word in pure)
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


def unknown_keys(value: Any, schema: dict[str, Any], place: str = "") -> Iterator[str]:
    """The places of keys that a schema does not name where it names keys."""
    if isinstance(value, list):
        for item in value:
            yield from unknown_keys(item, schema.get("items", {}), place)
    elif isinstance(value, dict):
        named, others = schema.get("properties"), schema.get("additionalProperties", {})
        for key, item in value.items():
            if named is not None and key not in named:
                yield f"{place}.{key}"
            inner = (named or {}).get(key, others)
            yield from unknown_keys(item, inner if isinstance(inner, dict) else {}, f"{place}.{key}")


def check_schema(command: str, answer: dict[str, Any]) -> None:
    """Fail where what a command printed does not fit the schema that it prints."""
    schema = schema_of_result(next(module.COMMAND for module in COMMANDS if module.COMMAND.name == command))
    errors = [f"{error.json_path}: {error.message}"[:300] for error in Draft202012Validator(schema).iter_errors(answer)]
    errors += [f"{place} is unknown" for place in dict.fromkeys(unknown_keys(answer, schema))]
    assert not errors, f"{errors[:5]}: python tests/result_schemas.py {command}"


def read(text: str, command: str = "") -> dict[str, Any]:
    """The object that a command printed; fails where it is no such object, or does not fit its schema."""

    def refuse(name: str) -> NoReturn:
        raise AssertionError(f"{name} is no JSON")

    answer = json.loads(text, parse_constant=refuse)
    assert isinstance(answer, dict)
    assert isinstance(answer["files"], list)
    unknown = sorted(wrong(answer))
    assert not unknown, f"say the unit in the names, or list them in docs/json.md: {', '.join(unknown)}"
    if command:
        check_schema(command, answer)
    return answer
