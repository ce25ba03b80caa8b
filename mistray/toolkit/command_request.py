"""Arguments and options of a command as one JSON object, its request: schema, reading from a file, and record.

A key is the keyword that the Python function has, or the name of the option with `_` in place of `-`.
"""

from __future__ import annotations

import dataclasses
import json
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NoReturn

from mistray.errors import MistrayError, errors_of, nearest
from mistray.files.json_values import plain
from mistray.light import Light
from mistray.ranges import FLAG, TEXT, ByName, Demand, Each, Range, Several, Words, demand_of
from mistray.read_file import read_file, read_text
from mistray.settings import Settings
from mistray.toolkit.arguments import Angles, Pairs, as_text
from mistray.toolkit.command import RECORDED, REQUEST, Command, Option
from mistray.toolkit.json_schema import DRAFT, property_of

RESULTS = Path(__file__).parent / "result_schemas"  # written by tests/result_schemas.py
OF_SCENE = (*dataclasses.fields(Settings), *dataclasses.fields(Light))  # their defaults are what the scene says


@dataclass(frozen=True)
class Keyword:
    """
    Key of the request of a command.

    Attributes
    ----------
    name : str
        Key.
    options : tuple of Option
        Option that sets it; for an object, the option of each of its fields.
    """

    name: str
    options: tuple[Option, ...]

    @property
    def whole(self) -> bool:
        """True if the value is an object whose fields are options of their own."""
        return self.options[0].within is not None

    @property
    def field(self) -> dataclasses.Field[Any]:
        """Request field that declares the key; for an option that no field declares, an equivalent one."""
        first = self.options[0]
        declared = first.within or first.of
        if declared is not None:
            return declared
        usual: Any = self.usual if self.demand is FLAG else first.default or None
        usual = dataclasses.MISSING if self.required else usual
        made: Any = self.demand.field(usual, f"false: {first.help}" if usual is True else first.help)
        made.name, made.type = self.name, ""
        field: dataclasses.Field[Any] = made
        return field

    @cached_property
    def demand(self) -> Demand:
        """Condition that the value of the key must meet."""
        first = self.options[0]
        declared = first.within or first.of
        return (demand_of(declared) if declared else None) or _demand(first)

    @property
    def usual(self) -> bool:
        """Value of a flag key, True or False, if its option is not given."""
        first = self.options[0]
        return first.name.startswith("--no-") if first.of is None else first.of.default is True

    @property
    def required(self) -> bool:
        """True if the command cannot run without the key."""
        first = self.options[0]
        return not first.name.startswith("-") and first.nargs not in ("?", "*")

    def schema(self) -> dict[str, Any]:
        """Return the JSON schema of the value."""
        return property_of(self.field, not self.required, self.options[0].of not in OF_SCENE)

    def parsed(self, value: Any) -> dict[str, Any]:
        """
        Return the value as argparse would, by option; raise `MistrayError` if it fails its demand.

        An empty string that is the default, and entries of an object that are None, give no option.
        """
        if value == "" == self.field.default:
            return {}
        found = self.demand.check(self.name, value)
        if self.whole:
            given = [option for option in self.options if option.of and value.get(option.of.name) is not None]
            return {one.dest: _as_parsed(one, getattr(found, one.of.name)) for one in given if one.of}
        first = self.options[0]
        if self.demand is FLAG:
            found = found is not self.usual
        return {first.dest: _as_parsed(first, value if isinstance(value, str) and first.nargs is None else found)}

    def told(self, values: Mapping[str, Any]) -> Any:
        """Return the value of the key as parsed from the options, for JSON; None if they were not given."""
        given = [option for option in self.options if _is_given(values.get(option.dest))]
        if not given:
            return None
        if self.whole:
            return {option.of.name: _as_json(values[option.dest]) for option in given if option.of}
        value = values[self.options[0].dest]
        if self.demand is FLAG:
            return not self.usual
        if not isinstance(self.demand, ByName):
            return _as_json(value)
        names = dict.fromkeys(name for name, _ in value)
        every = {name: [one for other, one in value if other == name] for name in names}
        several = isinstance(self.demand.of, Several)
        return {name: plain(ones if several and len(ones) > 1 else ones[-1]) for name, ones in every.items()}


def _demand(option: Option) -> Demand:
    """Return the condition on the value of a command-line option that no request field declares."""
    one: Demand
    match option.type:
        case Pairs(repeats=several):
            return ByName(Several(TEXT) if several else TEXT, str(option.metavar))
        case tuple():
            one = Words(option.type)
        case Angles():
            one = option.type.within
        case Range():
            one = option.type
        case _:
            one = FLAG if option.type is bool else TEXT
    if option.nargs in (None, "?"):
        return one
    if isinstance(one, Range):
        return Each(one, option.nargs if isinstance(option.nargs, int) else 0)
    return Several(one, least=0 if option.nargs == "*" else 1)


def _as_parsed(option: Option, value: Any) -> Any:
    """Return a checked value from a request file in the form in which argparse gives the option's value."""
    if isinstance(value, Mapping):
        return [(name, one) for name, ones in value.items() for one in (ones if isinstance(ones, tuple) else (ones,))]
    if option.type is Path:
        return [Path(one) for one in value] if isinstance(value, tuple) else Path(value)
    if isinstance(value, tuple):
        return [*value] or [""]  # see `OrAlone`
    return value


def _as_json(value: Any) -> Any:
    if isinstance(value, list):
        return [] if value == [""] else [_as_json(one) for one in value]
    return as_text(str(value)) if isinstance(value, str | Path) else plain(value)


def _is_given(value: Any) -> bool:
    return value is not None and value is not False and value != []


def keywords(command: Command) -> dict[str, Keyword]:
    """Return the keys of a command's request by name, in the order of its help, without those about request files."""
    found: dict[str, Keyword] = {}
    names = [option.dest for option in command.options]
    for option in command.options:
        if option in REQUEST.options:
            continue
        declared = option.within or option.of
        name = declared.name if declared else option.dest
        if name != option.dest and name in names:  # of another request of the command
            name = option.dest
        if option.of is None and option.name.startswith("--no-"):
            name = name.removeprefix("no_")
        before = found[name].options if name in found else ()
        found[name] = Keyword(name, (*before, option))
    return found


def schema_of_request(command: Command) -> dict[str, Any]:
    """Return the JSON schema (draft 2020-12) of the request of a command."""
    known = keywords(command)
    return {
        "$schema": DRAFT,
        "title": f"request of mistray {command.name}",
        "description": command.description.replace("\n", " "),
        "type": "object",
        "properties": {"$schema": {"type": "string"}} | {name: one.schema() for name, one in known.items()},
        "required": [name for name, one in known.items() if one.required],
        "additionalProperties": False,
    }


def schema_of_result(command: Command) -> dict[str, Any]:
    """
    Return the JSON schema of what a command prints with --json.

    For a command of another package it has only what all results have. Raise `MistrayError` if the command prints none.
    """
    if not any(option.name == "--json" for option in command.options):
        raise MistrayError(f"{command.name} prints no JSON; --schema request is that of its arguments")
    file = RESULTS / f"{command.name}.json"
    known: dict[str, Any] = json.loads(read_file(file, own=True)) if file.is_file() else {"type": "object"}
    asked_for = {name: value for name, value in schema_of_request(command).items() if name != "$schema"}
    files = {"type": "array", "items": {"type": "string"}, "description": "files that were written"}
    return {
        "$schema": DRAFT,
        "title": f"result of mistray {command.name}",
        **known,
        "properties": {**known.get("properties", {}), RECORDED: asked_for, "files": files},
        "required": [*known.get("required", ()), RECORDED, "files"],
    }


def take_request(command: Command, options: Any, path: Path) -> None:
    """
    Set the options of a command that are not given to what a file says.

    Parameters
    ----------
    command : Command
        Command whose options are set.
    options : argparse.Namespace
        Parsed options, which are changed.
    path : Path
        JSON file of a request, or TOML file if its name ends in .toml; or JSON that a command has printed or written.

    Raises
    ------
    MistrayError
        If the file cannot be read, it has an unknown key, a value fails its demand, or an argument is still missing.
    """
    known, text = keywords(command), read_text(path, "request")
    with errors_of(f"request '{path}'"):
        for name, value in _content(text, path.suffix.lower() == ".toml").items():
            if name not in known:
                raise MistrayError(f"there is no key '{name}'; {_nearest(name, known)}")
            if value is None:
                continue
            for dest, one in known[name].parsed(value).items():
                if not _is_given(getattr(options, dest)):
                    setattr(options, dest, one)
        missing = next((name for name, one in known.items() if one.required and one.told(vars(options)) is None), None)
        if missing is not None:
            raise MistrayError(f"{missing} is missing; give it there, or on the command line")


def _content(text: str, toml: bool) -> dict[str, Any]:
    """
    Return the mapping in the text of a TOML file if `toml`, else of a JSON file, without the key ``$schema``.

    Of the JSON that a command has printed it is the request. Anything else raises `MistrayError`.
    """
    try:
        content = tomllib.loads(text) if toml else json.loads(text, parse_constant=_refuse)
    except RecursionError:
        raise MistrayError("it is nested too deeply; write an object of keys and values") from None
    except ValueError as error:
        raise MistrayError(f"{str(error).partition(';')[0]}; correct the {'TOML' if toml else 'JSON'}") from None
    if isinstance(content, dict) and isinstance(content.get(RECORDED), dict):
        content = content[RECORDED]
    if not isinstance(content, dict):
        raise MistrayError('it holds no object; write keys and values, such as {"scene": "double_gauss"}')
    return {name: value for name, value in content.items() if name != "$schema"}


def _refuse(name: str) -> NoReturn:
    raise ValueError(f"{name} is not a number of JSON")


def _nearest(wrong: str, known: Mapping[str, Keyword]) -> str:
    """
    Return a suggestion for an unknown key: one of similar spelling, or that of the option with this name.

    For a key that belongs inside an object, it names that object; if nothing is similar, it lists all keys.
    """
    word = wrong.lstrip("-").replace("-", "_")
    options = {option.dest: name for name, one in known.items() for option in one.options}
    inside = {option.of.name: name for name, one in known.items() for option in one.options if one.whole and option.of}
    if word in inside:
        return f"it stands in the object '{inside[word]}'"
    return f"did you mean '{options[word]}'?" if word in options else nearest(word, known)


def asked(command: Command, options: Any) -> dict[str, Any]:
    """Return the request of a command as JSON-serialisable values: what its options say, but for their defaults."""
    return dict(_asked(command, vars(options)))


def _asked(command: Command, values: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for name, one in keywords(command).items():
        value = one.told(values)
        if value is not None:
            yield name, value
