"""JSON schemas of what commands print with `--json`, from what their calls with all options print.

`python tests/result_schemas.py [COMMAND…]` writes them for `mistray COMMAND --schema result`. Texts and units come from
the rows of tables and from the ends of names, see docs/json.md; tests hold outputs against them.
"""

from __future__ import annotations

import functools
import json
import re
import shlex
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mistray.files.units import unit_of

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "mistray" / "toolkit" / "result_schemas"
sys.path.insert(0, str(ROOT / "benchmarks"))
SCALARS = {bool: "boolean", int: "number", float: "number", str: "string"}
ADDED = ("request", "files")  # by the command line
# Objects whose keys are names of surfaces, steps, percentiles and the like, or of the settings of a trace
BY_NAME = {
    *("absorbed_W", "absorbed_in_W", "cut_W", "facts", "settings", "gaps", "holds", "edge_widths", "percentiles"),
    *("tables", "left_out", "values", "sampling", "grid", "left", "entrances"),
}
LIST = re.compile(r"\[[^\[\]{}]*\]")  # of words: on one line
NAME = re.compile(r"[A-Za-z]\w*")


class Seen:
    """What was found at one place of the outputs: kinds of values, keys of objects, and what is within."""

    def __init__(self, name: str = "") -> None:
        self.name, self.kinds, self.objects = name, set[str](), 0
        self.keys: dict[str, tuple[int, Seen]] = {}
        self.items: Seen | None = None
        self.by_name = name in BY_NAME

    def add(self, value: Any) -> None:
        """Add one value."""
        if value is None:
            self.kinds.add("null")
        elif isinstance(value, dict):
            self.kinds.add("object")
            self.objects += 1
            self.by_name |= not all(NAME.fullmatch(key) for key in value)
            for key, one in value.items():
                count, seen = self.keys.get(key, (0, Seen(key)))
                seen.add(one)
                self.keys[key] = count + 1, seen
        elif isinstance(value, list):
            self.kinds.add("array")
            self.items = self.items or Seen(self.name)
            for one in value:
                self.items.add(one)
        else:
            self.kinds.add(SCALARS[type(value)])

    def schema(self) -> dict[str, Any]:
        """Return the JSON schema of the values."""
        kinds = sorted(self.kinds | ({"null"} if self.kinds & {"number", "string"} else set()))
        found: dict[str, Any] = {"type": kinds[0] if len(kinds) == 1 else kinds} if kinds else {}
        unit = unit_of(re.sub(r"_se(?=_|$)", "", self.name))[1]  # without the part that says that it is an error
        if unit and "number" in self.kinds:
            found["unit"] = unit
        if "object" in self.kinds:
            found |= self._members()
        if self.items is not None:
            found["items"] = self.items.schema()
        return found

    def _members(self) -> dict[str, Any]:
        if not self.by_name:
            described = descriptions(self.keys)
            properties = {key: described.get(key, {}) | seen.schema() for key, (_, seen) in self.keys.items()}
            required = [key for key, (count, _) in self.keys.items() if count == self.objects]
            return {"properties": properties, "required": required}
        if any("object" in seen.kinds for _, seen in self.keys.values()) and self.name not in ("facts", "settings"):
            every = Seen()
            for _, seen in self.keys.values():
                every.merge(seen)
            return {"additionalProperties": every.schema()}
        return {"additionalProperties": True}

    def merge(self, other: Seen) -> None:
        """Add what was found at another place."""
        self.kinds |= other.kinds
        self.objects += other.objects
        for key, (count, seen) in other.keys.items():
            before, own = self.keys.get(key, (0, Seen(key)))
            own.merge(seen)
            self.keys[key] = before + count, own
        if other.items is not None:
            self.items = self.items or Seen(self.name)
            self.items.merge(other.items)


def descriptions(keys: Any) -> dict[str, dict[str, str]]:
    """The descriptions of columns, where the keys of an object are those of a class of rows."""
    fitting = [known for known in tables() if {*known} <= {*keys}]
    known = max(fitting, key=len, default={})
    return {key: {"description": text} for key, text in known.items()}


@functools.cache
def tables() -> list[dict[str, str]]:
    """The descriptions by column of every class of rows with three columns or more."""
    import dataclasses
    import importlib
    import pkgutil

    import mistray.analyses
    from mistray.toolkit.rows import _declared, described

    for module in pkgutil.walk_packages(mistray.analyses.__path__, "mistray.analyses."):
        if module.name.rpartition(".")[2] in ("result", "rows", "tables", "run", "edit_ranking", "narcissus", "netd"):
            importlib.import_module(module.name)
    modules = [module for name, module in sys.modules.items() if name.startswith("mistray.")]
    kinds = {one for module in modules for one in vars(module).values() if isinstance(one, type)}
    kinds = {kind for kind in kinds if dataclasses.is_dataclass(kind) and len(_declared(kind)) > 2}
    return [described(kind) for kind in sorted(kinds, key=lambda kind: kind.__qualname__)]


def outputs(name: str) -> Iterator[dict[str, Any]]:
    """What the calls of a command print with --json."""
    from command_calls import CALLS, PREPARED
    from same_outputs import free_port, ran, working_folder

    with working_folder():
        for line in PREPARED.get(name, ()):
            ran(shlex.split(line))
        for line in CALLS[name]:
            words = shlex.split(line.format(scenes=ROOT / "scenes", port=free_port()))
            words = [name, *(word for word in words if word not in ("--quiet", "--json", "--force")), "--json"]
            if "nonsense://x" in words:
                continue
            code, out, err = ran(words if name in ("doctor", "cache") or "--resume" in words else [*words, "--force"])
            if code:
                print(f"mistray {' '.join(words)}: {err}", file=sys.stderr)
            else:
                yield json.loads(out)


def main(names: list[str]) -> None:
    """Write the schemas of some commands, or of all that print JSON."""
    from mistray.cli.program import COMMANDS

    known = [module.COMMAND.name for module in COMMANDS if any(one.name == "--json" for one in module.COMMAND.options)]
    for name in names or known:
        seen = Seen()
        for output in outputs(name):
            seen.add({key: value for key, value in output.items() if key not in ADDED})
        text = json.dumps(seen.schema(), indent=1, ensure_ascii=False)
        text = LIST.sub(lambda found: " ".join(found[0].split()).replace("[ ", "[").replace(" ]", "]"), text)
        (FOLDER / f"{name}.json").write_text(f"{text}\n", encoding="utf-8")
        print(name, len(text), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
