"""Requests of commands as JSON: schemas of all of them, files, round trips, and files that are wrong."""

from __future__ import annotations

import json
import re
import shlex
import sys
import tomllib
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from command_line import Captured, fails, succeeds
from test_docs import ROOT
from test_docs_commands import TITLED

from mistray.cli.options import Options
from mistray.cli.program import COMMANDS, main
from mistray.errors import MistrayError
from mistray.ranges import Interval
from mistray.toolkit.arguments import Parser
from mistray.toolkit.command import REQUEST, Command
from mistray.toolkit.command_request import Keyword, asked, keywords, schema_of_request, schema_of_result, take_request

sys.path.insert(0, str(ROOT / "benchmarks"))
from command_calls import CALLS

KNOWN: dict[str, Command] = {module.COMMAND.name: module.COMMAND for module in COMMANDS}
NAMES = sorted(KNOWN)
ASKED = re.compile(r"^    mistray (\w+) --request (\w+\.\w+)$", re.MULTILINE)
VALUES = (
    *(True, False, 0, -1, 1, 2.5, 45, 1e308, 3e9, "", "x", " ", "R", "L1", "none"),
    *([], [1], [0.5, "x"], ["x"], ["x", ""], ["x", "x"], [1, 2], [2, 1], [1, 1], [1, 2, 3], [1, 2, 3, 4]),
    *({}, {"a": 1}, {"a": "x"}, {"": 1}, {"a": ["x"]}, [[1]], [None], {"x_mm": 1}),
)


def validator(schema: dict[str, Any]) -> Any:
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


def parsed(name: str, line: str) -> Options:
    parser = Parser(prog="mistray")
    KNOWN[name].declare(parser.add_subparsers(), print)
    options: Options = parser.parse_args([name, *shlex.split(line.replace("{port}", "1"))], Options())
    return options


def values(name: str, options: Options) -> dict[str, Any]:
    """What the options of a command say, with paths and all lists alike."""
    own = {option.dest: getattr(options, option.dest) for option in KNOWN[name].options}
    return {dest: value for dest, value in own.items() if dest not in ("request", "schema")}


@pytest.mark.parametrize("name", NAMES)
def test_every_schema(name: str) -> None:
    """It is valid and says what each key is; defaults fit it; the help has the same options."""
    schema = schema_of_request(KNOWN[name])
    properties = {key: one for key, one in schema["properties"].items() if key != "$schema"}
    usual = {key: one["default"] for key, one in properties.items() if "default" in one}
    assert not [error.message for error in validator(schema | {"required": []}).iter_errors(usual)]
    assert all(one["description"] for one in properties.values())
    assert "$comment" not in json.dumps(schema, allow_nan=False)
    options = [option for key in keywords(KNOWN[name]).values() for option in key.options]
    assert sorted(option.name for option in (*options, *REQUEST.options)) == sorted(
        option.name for option in KNOWN[name].options
    )


@pytest.mark.parametrize("name", NAMES)
def test_calls_with_every_option_go_to_json_and_back(name: str, tmp_path: Path) -> None:
    check = validator(schema_of_request(KNOWN[name]))
    for line in CALLS[name]:
        given = parsed(name, line)
        request = asked(KNOWN[name], given)
        file = tmp_path / "request.json"
        file.write_text(json.dumps({"verdict": "x", "request": request}, allow_nan=False), encoding="utf-8")
        assert not [error.message for error in check.iter_errors(request)], line
        again = parsed(name, "--request x")
        take_request(KNOWN[name], again, file)
        assert values(name, again) == values(name, given), line
        assert asked(KNOWN[name], again) == request, line


def taken(key: Keyword, value: Any) -> bool:
    try:
        key.parsed(value)
    except MistrayError as error:
        told = str(error)
    else:
        return True
    assert "\n" not in told
    assert key.name in told
    return False


@pytest.mark.parametrize("name", NAMES)
def test_schema_and_program_take_the_same(name: str) -> None:
    for key in keywords(KNOWN[name]).values():
        check = validator(key.schema())
        for value in VALUES:
            if isinstance(key.demand, Interval) and value in ([2, 1], [1, 1]):
                continue  # no schema says which number is larger
            assert check.is_valid(value) == taken(key, value), (key.name, value)


WRONG = {
    "{": "Expecting property name",
    "": "Expecting value",
    "[]": "it holds no object; write keys and values",
    "3": "it holds no object",
    "[" * 100_000: "it is nested too deeply",
    '{"scene": "plate", "rays": NaN}': "NaN is not a number of JSON",
    "{}": "scene is missing; give it there, or on the command line",
    '{"scen": "plate"}': "there is no key 'scen'; did you mean 'scene'?",
    '{"--field-deg": 1}': "there is no key '--field-deg'; did you mean 'field_deg'?",
    '{"stops": 1}': "there is no key 'stops'; it stands in the object 'look'",
    '{"look": {"stop": 1}}': "look: there is no argument 'stop'; did you mean 'stops'?",
    '{"scene": ""}': "scene is ''; it must be text",
    '{"rays": 0}': "rays is 0; it must be a whole number between 1",
    '{"field_deg": []}': "field_deg is empty; give at least one number",
    '{"rank": "rmss"}': "rank is 'rmss'; did you mean 'rms'?",
    '{"scatter": {"L*": 3}}': "scatter of 'L*' is 3; it must be text",
    '{"json": 1}': "json is 1; it must be true or false",
    '{"scene": "plate", "least_share": 0.1}': None,
}


@pytest.mark.parametrize("text", WRONG)
def test_wrong_files(text: str, tmp_path: Path, capsys: Captured) -> None:
    file = tmp_path / "request.json"
    file.write_text(text, encoding="utf-8")
    told = fails(capsys, "ghosts", "--request", file)
    expected = WRONG[text]
    if expected is None:  # what two keys say together
        assert told.startswith("--least-share is about the path analysis")
    else:
        assert told.startswith(f"request '{file}': {expected}")


def test_no_files(tmp_path: Path, capsys: Captured) -> None:
    for path, words in ((tmp_path, "Is a directory"), (tmp_path / "none.json", "No such file"), ("", "names nothing")):
        assert words in fails(capsys, "ghosts", "--request", path)
    (tmp_path / "a.toml").write_text("scene = ")
    assert "correct the TOML" in fails(capsys, "ghosts", "--request", tmp_path / "a.toml")
    (tmp_path / "a.json").write_bytes(b"\xff")
    assert "UTF-8" in fails(capsys, "ghosts", "--request", tmp_path / "a.json")
    assert "invalid choice: 'plate'" in fails(capsys, "ghosts", "--schema", "plate")
    assert "required: SCENE" in fails(capsys, "ghosts")


def test_options_beside_a_request_go_before(tmp_path: Path) -> None:
    file = tmp_path / "request.toml"
    file.write_text(
        'scene = "plate"\nfield_deg = [1, 2]\nrays = 100\npath_analysis = "power_W"\ncolour = true\n'
        '[look]\nstops = 1\nblock = 4\n[scatter]\n"L*" = ["abg A=1", "none"]\n'
    )
    options = parsed("ghosts", f"double_gauss --request {file} --rays 1e3 --stops 2 --scatter 'a=none'")
    take_request(KNOWN["ghosts"], options, file)
    assert asked(KNOWN["ghosts"], options) == {
        "scene": "double_gauss", "field_deg": [1, 2], "rays": 1000, "path_analysis": "power_W", "colour": True,
        "look": {"stops": 2, "block": 4}, "scatter": {"a": "none"},
    }  # fmt: skip


def test_a_run_can_be_repeated_from_its_json(tmp_path: Path, capsys: Captured, monkeypatch: Any) -> None:
    monkeypatch.chdir(tmp_path)
    request = {"scene": "plate", "field_deg": 5, "rays": 1000, "json": True, "out": "out"}
    Path("a.json").write_text(json.dumps(request))
    first = json.loads(succeeds(capsys, "ghosts", "--request", "a.json"))
    assert first["request"] == request | {"field_deg": [5]}
    written = json.loads(Path("out/ghosts.json").read_text())
    assert written["request"] == first["request"]
    assert "exists" in fails(capsys, "ghosts", "--request", "out/ghosts.json")
    again = json.loads(succeeds(capsys, "ghosts", "--request", "out/ghosts.json", "--out", "again"))
    powers = [one["fields"][0]["worst_paths"][0]["power_W"] for one in (first, again)]
    assert powers[0] == pytest.approx(powers[1], rel=1e-5)
    assert again["request"] == first["request"] | {"out": "again"}


@pytest.mark.parametrize("name", [name for name in NAMES if name != "completion"])
def test_every_schema_of_a_result(name: str) -> None:
    """It is valid, lists keys, and is held against what the command prints in tests/test_every_command.py."""
    schema = schema_of_result(KNOWN[name])
    validator(schema)
    assert {"request", "files"} < {*schema["properties"]}
    assert {"request", "files"} <= {*schema["required"]}


def test_a_command_that_prints_no_json(capsys: Captured) -> None:
    assert fails(capsys, "completion", "--schema", "result").startswith("completion prints no JSON; --schema request")


def test_schemas_are_printed(capsys: Captured) -> None:
    for words in ((), ("request",)):
        assert json.loads(succeeds(capsys, "thermal", "--schema", *words)) == schema_of_request(KNOWN["thermal"])
    assert main(["thermal", "no_such_scene", "--schema"]) == 0


def test_the_files_of_the_docs_fit_the_schemas(tmp_path: Path) -> None:
    text = (ROOT / "docs" / "drive.md").read_text(encoding="utf-8")
    files = dict(TITLED.findall(text))
    asked_for = dict(reversed(pair) for pair in ASKED.findall(text))
    assert asked_for.keys() == files.keys()
    for file, name in asked_for.items():
        content = tomllib.loads(files[file]) if file.endswith(".toml") else json.loads(files[file])
        validator(schema_of_request(KNOWN[name])).validate(content)
        (tmp_path / file).write_text(files[file])
        options = parsed(name, "--request x")
        take_request(KNOWN[name], options, tmp_path / file)
        assert asked(KNOWN[name], options).keys() == content.keys()
