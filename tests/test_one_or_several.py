"""Arguments that take several ids, names or numbers take one, too; vectors and mappings say what they need."""

import contextlib
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
import pandas as pd
import pytest
from argument_calls import FIXED, NAMED, ONE, Call, made
from public_arguments import ARRAY, BY_NAME, SEVERAL, SINGLE, VECTOR, arguments
from refusals import refused
from result_calls import data

import mistray
from mistray.ranges import several

# Classes that the program makes
MADE = {
    *("BaffleTube", "Body", "Built", "CassegrainBaffles", "Coated", "CoatingFile", "CoatingSpectrum", "CoatingTable"),
    *("Departure", "DirectImage", "FieldSummary", "Grid", "MapStatistics", "MaterialSource", "Mechanics", "Parameter"),
    *("Response", "SortedPath", "SplitRow", "Start", "Step", "View", "Visit"),
}
# Arguments that are no matter of one or several, and why
LEFT_OUT = {
    **dict.fromkeys(("Evaluations.at(but)", "PathTable.chosen(by_ray)"), "internal"),
    **dict.fromkeys(("GhostReport.of(traces)", "GhostReport.of(not_traced)"), "given by the analysis"),
    **dict.fromkeys(("Metric.evaluate(observations)", "Metric.differentiate(observations)"), "from `observe`"),
    **dict.fromkeys(("Outline.with_numbers(numbers)", "Outline.contains(numbers)"), "from `Outline.numbers`"),
    **dict.fromkeys(("OutlineFigure.contains(n)",), "from `Outline.numbers`"),
    **dict.fromkeys(("Grid.of_values(step)", "Grid.of_values(middle)"), "given by a reader of files"),
    **dict.fromkeys(("Lobe(shares)",), "of authors of models"),
}
VALUE = "3|int|1 numbers"  # the value that is refused, or what it is
ODD: dict[str, Any] = {
    "None": lambda: None, "empty text": lambda: "", "0": lambda: 0, "-1": lambda: -1, "1e308": lambda: 1e308,
    "nan": lambda: float("nan"), "float32": lambda: np.float32(3), "0-d": lambda: np.array(3),
    "generator": lambda: (k for k in (1, 2)), "series": lambda: pd.Series([1, 2]), "set": lambda: {1},
    "object": object, "nested": lambda: [[1, 2], [3]], "bytes": lambda: b"ab", "empty": lambda: [],
    "words": lambda: ["a", 1], "mapping": lambda: {1: 2}, "true": lambda: True,
}  # fmt: skip


@pytest.fixture(scope="module", autouse=True)
def folder(tmp_path_factory: Any) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("one_or_several"))
        yield


@pytest.mark.quick
@pytest.mark.parametrize(
    ("given", "expected"),
    [
        *((3, [3]), (0, [0]), ("ab", ["ab"]), ("", [""]), ([], []), ((1, 2), [1, 2])),
        *((np.int64(4), [4]), (np.array(5), [5])),
    ],
)
def test_several(given: Any, expected: list[Any]) -> None:
    assert several(given) == expected
    assert several(iter(expected)) == expected


def is_formula(name: str) -> bool:
    """True for an argument in `mistray.physics`, whose names begin with that of their module."""
    return "." in name and name[0].islower()


def tiers_of(names: Iterable[str]) -> list[Any]:
    """Parameters of a test, those that trace in the long tier: not most constructors, and not formulas."""
    made = {n for n in names if "." not in n and n[0].isupper() and not n.startswith(("Explorer", "PstBands"))}
    return [pytest.param(n, marks=() if n in made or is_formula(n) else pytest.mark.long) for n in names]


def matters(name: str, kinds: set[str]) -> bool:
    """False for an array, whose shape the docstring says, and for a formula that takes no single value."""
    return kinds != {ARRAY} and (not is_formula(name) or {SEVERAL, SINGLE} <= kinds)


@pytest.mark.core
@pytest.mark.quick
def test_each_argument_is_called() -> None:
    """Each public argument for several values is in one of the tables; those of `ONE` say that they take one."""
    known = {**ONE, **dict.fromkeys(FIXED), **dict.fromkeys(NAMED), **LEFT_OUT}
    hints = dict(arguments(MADE))
    assert sorted({name for name, kinds in hints.items() if matters(name, kinds)} - known.keys()) == []
    assert sorted(known.keys() - hints.keys()) == []
    single = {name for name, kinds in hints.items() if SINGLE in kinds or kinds == {ARRAY}}
    fields = {name for name in ONE if name[0].isupper() and "." not in name}  # a dataclass keeps what its type says
    assert sorted(ONE.keys() - single - fields) == []
    assert sorted(name for name in FIXED if not {SEVERAL, VECTOR} & hints[name]) == []
    assert sorted(name for name in NAMED if BY_NAME not in hints[name]) == []


@pytest.mark.parametrize("name", tiers_of(ONE))
def test_one_is_a_list_of_one(name: str) -> None:
    if "oslo" in name or "optiland" in name:
        pytest.importorskip("optiland.optic", exc_type=ImportError)
    call, value = ONE[name]
    one = made(value)
    same = list(data(call([one])))
    assert list(data(call(one))) == same
    if isinstance(one, int | float | np.number) and not isinstance(one, bool):
        assert list(data(call(np.array(one)))) == same
    with contextlib.suppress(mistray.MistrayError):  # some go through their values twice
        assert list(data(call(iter([one])))) == same


@pytest.mark.parametrize("name", tiers_of(FIXED))
def test_what_cannot_be_single(name: str) -> None:
    with refused(VALUE, name.partition("(")[2][:-1].removesuffix("_deg").removesuffix("s")):
        FIXED[name](3)


@pytest.mark.parametrize("name", tiers_of(NAMED))
def test_what_must_be_a_mapping(name: str) -> None:
    with refused(VALUE):
        NAMED[name](3)


@pytest.mark.long
@pytest.mark.parametrize("name", [name for name in (*ONE, *FIXED, *NAMED) if not is_formula(name)])
def test_odd_values(name: str) -> None:
    """Each works, or is refused in one line; formulas take whatever has arithmetic, and check nothing."""
    call: Call = ONE[name][0] if name in ONE else {**FIXED, **NAMED}[name]
    wrong = []
    for what, value in ODD.items():
        try:
            call(value())
        except (mistray.MistrayError, IndexError) as error:  # an index ends the loop over a sequence
            if "\n" in str(error) or len(str(error)) > 600:
                wrong.append(f"{what}: {error}")
        except Exception as error:
            wrong.append(f"{what}: {type(error).__name__}: {error}")
    assert not wrong, "\n".join(line[:300] for line in wrong)
