"""Rows of a result as a frame, as records and as a table of a page."""

from __future__ import annotations

import math
from dataclasses import dataclass, make_dataclass

import pytest

from mistray.estimate import Estimate
from mistray.toolkit.rows import column, derived, frame, records, table

pytestmark = pytest.mark.quick


@dataclass(frozen=True)
class Wall:
    """A row."""

    name: str = column("name of the wall", empty="(none)")
    temperature_K: float = column("temperature, K", digits="g")
    power_W: Estimate = column("power, W", head="emitted [W]")
    lost: float = column("share that is lost", 0.0, percent=True, digits="g")
    shares: tuple[float, ...] = ()

    @derived.column("twice the power, W")
    def double_W(self) -> Estimate:
        """Twice the power."""
        return Estimate(2 * self.power_W.value, 2 * self.power_W.se)


ROWS = [Wall("front", 293.0, Estimate(3.0, 0.1), 0.5), Wall("", math.nan, Estimate(1.0, 0.2))]
COLUMNS = ["name", "temperature_K", "power_W", "power_W_se", "lost_percent", "double_W", "double_W_se"]


def test_frame_and_records() -> None:
    found = frame(Wall, ROWS)
    assert list(found.columns) == list(frame(Wall, []).columns) == COLUMNS
    assert found.power_W_se.tolist() == [0.1, 0.2]
    assert records(Wall, ROWS)[0] == dict(zip(COLUMNS, ("front", 293.0, 3.0, 0.1, 50.0, 6.0, 0.2), strict=True))


@dataclass(frozen=True)
class Gap:
    """A row with a number and its error in two fields, a number that may be absent, a flag, and several texts."""

    width: float = column("width")
    width_se: float = column("its error")
    space: int = column("number; -1: none", absent=-1)
    shut: bool = column("whether it is shut")
    between: tuple[str, ...] = column("what it lies between")


def test_errors_in_a_field_of_their_own_and_what_is_absent() -> None:
    rows = [Gap(1.0, 0.1, -1, True, ("a", "b")), Gap(2.0, 0.2, 3, False, ())]
    assert list(frame(Gap, rows).columns) == ["width", "width_se", "space", "shut", "between"]
    assert [row["between"] for row in records(Gap, rows)] == ["a b", ""]
    found = table(Gap, rows, only=("width", "space", "shut"))
    assert found.rows == [[Estimate(1.0, 0.1), "–", "yes"], [Estimate(2.0, 0.2), 3, ""]]
    assert [head.style for head in found.columns] == ["", "", "t"]
    assert "width_se" not in [head.head for head in table(Gap, rows).columns]


def test_annotations_may_be_types() -> None:
    plain = make_dataclass("Plain", [("power_W", Estimate, column("power, W")), ("name", str, column("name"))])
    assert list(frame(plain, []).columns) == ["power_W", "power_W_se", "name"]
    assert [head.style for head in table(plain, []).columns] == ["", "t"]


def test_table() -> None:
    found = table(Wall, ROWS, "walls")
    assert [(head.head, head.unit, head.style) for head in found.columns] == [
        ("name", "", "t"), ("temperature", "K", ""), ("emitted", "W", ""), ("lost", "%", ""),
        ("double", "W", ""),
    ]  # fmt: skip
    assert found.rows[0] == ["front", "293", Estimate(3.0, 0.1), "50", Estimate(6.0, 0.2)]
    wide = found.beside(table(Wall, ROWS, only=("name",)), found)
    assert [len(wide.columns), *map(len, wide.rows)] == [11, 11, 11]
    assert wide.rows[0][4:6] == [Estimate(6.0, 0.2), "front"]
    assert found.rows[1][:2] == ["(none)", "–"]
    assert [head.head for head in table(Wall, ROWS, only=("power_W", "name")).columns] == ["emitted", "name"]
