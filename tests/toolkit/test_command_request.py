"""Requests of commands as JSON: schemas of all of them, files, round trips, and files that are wrong."""

from __future__ import annotations

import inspect
import json
import math
import pickle
import re
import shlex
import sys
import tomllib
from collections.abc import Iterator
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
import stubs
import vectors
from command_line import Captured, fails, succeeds
from refusals import refused
from test_docs import ROOT, TITLED
from toolkit.right_values import needed, right

import mistray
from mistray.analyses.coating.request import CoatingRequest
from mistray.analyses.ghosts.request import GhostTables
from mistray.analyses.image.request import ImageRequest
from mistray.analyses.thermal.request import DetectorNoise, ThermalRequest
from mistray.analyses.view.request import ViewRequest
from mistray.cli.parsed_options import Options
from mistray.cli.program import COMMANDS, main
from mistray.errors import MistrayError
from mistray.ranges import ByName, Each, Interval, OfType, Range, Several, Words, demand_of, doc_of
from mistray.toolkit.arguments import Parser
from mistray.toolkit.command import REQUEST, Command
from mistray.toolkit.command_request import Keyword, asked, keywords, schema_of_request, schema_of_result, take_request
from mistray.toolkit.fields import Nested, Request, flat_fields

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
    names = sorted(option.name for option in (*options, *REQUEST.options))
    assert names == sorted(option.name for option in KNOWN[name].options)


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


WRONG = vectors.toml("refusals.toml")["requests"] | {"[" * 100_000: "it is nested too deeply"}


@pytest.mark.parametrize("text", WRONG)
def test_wrong_files(text: str, tmp_path: Path, capsys: Captured) -> None:
    file = tmp_path / "request.json"
    file.write_text(text, encoding="utf-8")
    told = fails(capsys, "ghosts", "--request", file)
    expected = WRONG[text]
    if not expected:  # what two keys say together
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


def test_a_command_that_prints_no_json_and_schemas_are_printed(capsys: Captured) -> None:
    assert fails(capsys, "completion", "--schema", "result").startswith("completion prints no JSON; --schema request")
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


ANALYSES = stubs.analyses()
REMEDY = re.compile(r"must|give|did you mean|use |write |choose from|as in")
NO_NUMBERS = ("x", b"1", True, np.True_, math.nan, 1j, {}, [], (1, 2), np.array([1.0, 2.0]), object())


def wrong_numbers(of: Range) -> Iterator[Any]:
    """Values that are no number of a range."""
    yield from NO_NUMBERS
    if math.isfinite(of.low):
        yield from (of.low if of.above else of.low - max(1.0, abs(of.low)), -math.inf)
    if math.isfinite(of.high):
        yield from (of.high if of.below else of.high + max(1.0, abs(of.high)), math.inf)
    if of.whole:
        yield from (of.low + 0.5, Decimal("1.5"), Fraction(1, 2))


def wrong(demand: Any) -> Iterator[Any]:
    """Values that do not meet a demand."""
    match demand:
        case Range():
            yield from wrong_numbers(demand)
        case Words():
            yield from (f"{demand.choices[0]}x", "", 3, b"x", [demand.choices[0]])
        case Interval():
            ends = right(demand.of), right(demand.of)
            yield from (1.0, ends, (*ends, 1.0), ("x", "y"), object(), math.nan)
        case Each():
            single = [value for value in wrong_numbers(demand.of) if not isinstance(value, list | tuple | np.ndarray)]
            yield from [[], object(), "x", *([value] for value in single)]
        case ByName():
            yield from (3, "x", {"": right(demand.of)}, {3: right(demand.of)}, {"a": next(wrong(demand.of))})
        case Several():
            yield from ([value] for value in wrong(demand.of))
            yield from [[]] if demand.least else []
        case Nested():
            yield from (3, "x", {"no_such_field": 1}, [])
        case OfType():
            yield from (3, 0.5, b"x", object(), [])
        case _:
            yield from (object(), b"x", {"no": 1}, 1j)


def call(name: str, /, **given: Any) -> Any:
    """Call an analysis with objects that say nothing in place of what it needs beside its fields."""
    function = stubs.named(name)
    others = [one for one in inspect.signature(function).parameters.values() if one.default is one.empty]
    words = {one.name: "x" for one in others if one.name not in ("scene", "metric")}
    return function(**words | needed(function.request) | given)


@pytest.mark.parametrize("name", ANALYSES)
def test_wrong_values(name: str, scene: Any) -> None:
    function = stubs.named(name)
    subject, first = next(iter(inspect.signature(function).parameters.items()))
    known = {subject: scene if first.annotation == "mi.Scene" else "plate" if subject == "scene" else None}
    bad, tried = [], 0
    for field, _ in flat_fields(function.request):
        for value in wrong(demand_of(field)):
            tried += 1
            try:
                call(name, **known, **{field.name: value})
            except MistrayError as error:
                text = str(error)
                if "\n" in text or field.name not in text or not REMEDY.search(text):
                    bad.append(f"{field.name}={value!r}: {text}")
            except Exception as error:
                bad.append(f"{field.name}={value!r}: {type(error).__name__}: {error}")
            else:
                bad.append(f"{field.name}={value!r} is taken")
    assert not bad, "\n".join(bad)
    assert tried > 3 * len(inspect.signature(function).parameters) / 2


@pytest.mark.parametrize("name", ANALYSES)
def test_an_analysis_is_its_request(name: str) -> None:
    """Its arguments are the fields and what its run takes; it and its request are pickled."""
    function = stubs.named(name)
    run = inspect.signature(function.run).parameters
    fields = {field.name: field for field, _ in flat_fields(function.request)}
    assert {*inspect.signature(function).parameters} == {*fields, *run} - {"request"}
    for word, field in fields.items():
        assert demand_of(field) is not None, word
        assert doc_of(field), word
        assert f"\n{word} : " in function.__doc__
    assert pickle.loads(pickle.dumps(function)) is function
    kind = function.request
    asked = kind(**needed(kind))
    assert pickle.loads(pickle.dumps(asked)) == asked
    # Its schema is one; what it is by default fits that, and is the same request after JSON
    schema = kind.json_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    given = json.loads(json.dumps(asked.to_dict()))
    assert kind.of(**given) == asked
    assert takes(kind, given)
    assert all(one["description"] for one in json.loads(json.dumps(schema, allow_nan=False))["properties"].values())
    assert not takes(kind, {"no_such_keyword": 1})


def test_odd_numbers() -> None:
    """Numbers of other types are numbers of Python in a request, and None is what is not given."""
    thermal, quick = stubs.named("mistray.analysis.thermal").request, stubs.named("mistray.analysis.study").request
    for number in (Decimal(300), Fraction(300), np.float32(300), np.int16(300), np.array(300)):
        found = thermal(temperature_K=number, rays=number, temperatures={"L1": number})
        assert (found.temperature_K, found.rays, found.temperatures) == (300, 300, {"L1": 300})
        assert {type(found.temperature_K), type(found.temperatures["L1"])} <= {int, float}
        assert type(found.rays) is int
    assert quick(quick=np.True_).quick is True
    assert thermal(temperature_K=None, settings=None) == thermal()
    assert thermal(band_um=np.array([3, 5])).band_um == (3.0, 5.0)
    with pytest.raises(MistrayError, match="coating is missing; give it: preset"):
        CoatingRequest(coating=None)


@pytest.mark.parametrize(("name", "given", "told"), vectors.toml("refusals.toml")["arguments beside the fields"])
def test_wrong_arguments_beside_the_fields(name: str, given: dict[str, Any], told: str, scene: Any) -> None:
    subject = "metric" if "metric" in inspect.signature(stubs.named(name)).parameters else "scene"
    known = {subject: scene} if "optimize." not in name else {"scene": "plate"} if subject == "scene" else {}
    with pytest.raises(MistrayError, match=told):
        call(name, **known | given)


NOISE = {"pixel_um": 15, "bandwidth_hz": 1e4, "detectivity": 1e11}


def takes(kind: type[Request], given: dict[str, Any]) -> bool:
    """Whether the schema of a request takes an object."""
    return bool(jsonschema.Draft202012Validator(kind.json_schema()).is_valid(given))


@pytest.mark.parametrize(
    ("kind", "given"),
    [
        (ThermalRequest, {"noise": NOISE, "temperatures": {"L*": 77}, "cut_below": "R=1e-6", "band_um": [3, 5]}),
        (ThermalRequest, {"wavelengths_um": 4, "rays": 1000, "seed": None, "splitting": "one"}),
        (GhostTables, {"alias": [["L1_*", "L1"]], "maps": "ghost", "colour": True, "look": {"stops": 2}}),
        (ViewRequest, {"path_ids": [0, "G"], "cut_deg": None, "selection": ""}),
    ],
)
def test_round_trips(kind: type[Request], given: dict[str, Any]) -> None:
    assert takes(kind, given)
    asked = kind.of(**given)
    plain = asked.to_dict()
    assert kind.of(**json.loads(json.dumps(plain))) == asked
    assert takes(kind, plain)
    with refused("alias 'part' stands for all surfaces"):
        GhostTables(alias=["part", ("L1_*", "L1")])


def test_values() -> None:
    assert ThermalRequest.of(noise=NOISE).noise == DetectorNoise(**NOISE)
    assert ImageRequest.of(**ImageRequest(reference_radius_mm=math.inf).to_dict()).reference_radius_mm == math.inf
    properties = ThermalRequest.json_schema()["properties"]
    assert properties["temperature_K"] == {
        "description": "temperature of everything without one of its own, K",
        "type": "number", "minimum": 0.0, "maximum": 1e6, "unit": "K", "default": 293.0,
    }  # fmt: skip
    assert properties["band_um"]["minItems"] == properties["band_um"]["maxItems"] == 2
    assert mistray.ghosts.request.json_schema()["properties"]["rank"]["enum"] == ["rms", "power", "peak"]


@pytest.mark.parametrize(("given", "told"), vectors.toml("refusals.toml")["arguments of thermal"])
def test_wrong_objects(given: dict[str, Any], told: str) -> None:
    """Both the schema and the request refuse them, the latter in one line."""
    assert not takes(ThermalRequest, given)
    with refused(f"^{re.escape(told)}"):
        ThermalRequest.of(**given)
