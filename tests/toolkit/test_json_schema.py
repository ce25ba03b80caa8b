"""Requests as JSON: schemas that take what requests take, and round trips."""

import json
import math
import re
from typing import Any

import jsonschema
import pytest
import stubs
import vectors
from refusals import refused
from toolkit.right_values import needed

import mistray
from mistray.analyses.ghosts.request import GhostTables
from mistray.analyses.image.request import ImageRequest
from mistray.analyses.thermal.request import DetectorNoise, ThermalRequest
from mistray.analyses.view.request import ViewRequest
from mistray.toolkit.fields import Request

NOISE = {"pixel_um": 15, "bandwidth_hz": 1e4, "detectivity": 1e11}


def takes(kind: type[Request], given: dict[str, Any]) -> bool:
    """Whether the schema of a request takes an object."""
    return bool(jsonschema.Draft202012Validator(kind.json_schema()).is_valid(given))


@pytest.mark.parametrize("name", stubs.analyses())
def test_every_request(name: str) -> None:
    """The schema is one; what the request is by default fits it, and is the same request after JSON."""
    kind = stubs.named(name).request
    schema = kind.json_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    asked = kind(**needed(kind))
    given = json.loads(json.dumps(asked.to_dict()))
    assert kind.of(**given) == asked
    assert takes(kind, given)
    assert all(one["description"] for one in json.loads(json.dumps(schema, allow_nan=False))["properties"].values())
    assert not takes(kind, {"no_such_keyword": 1})


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
