"""Wrong values of every field of every analysis, from what the fields demand: one line with name, value and remedy."""

import inspect
import math
import pickle
import re
from collections.abc import Iterator
from decimal import Decimal
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
import stubs
import vectors
from toolkit.right_values import needed, right

from mistray.analyses.coating.request import CoatingRequest
from mistray.errors import MistrayError
from mistray.ranges import ByName, Each, Interval, OfType, Range, Several, Words, demand_of, doc_of
from mistray.toolkit.fields import Nested, flat_fields

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
    asked = function.request(**needed(function.request))
    assert pickle.loads(pickle.dumps(asked)) == asked


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
