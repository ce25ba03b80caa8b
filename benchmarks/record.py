"""The kept record of the benchmarks, last.json: what a new run is compared with, and what README.md is written from."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from rows import Row

from mistray.errors import MistrayError
from mistray.replace_file import replace_file

FORMAT = 1
WORSE = 1.15  # a ratio that fell by this factor is named


@dataclass(frozen=True)
class Kept:
    """A row of the record: its part, when (UTC day) and on what machine it was measured."""

    part: str
    row: Row
    day: str
    machine: str

    @property
    def name(self) -> str:
        """Name in the record."""
        return f"{self.part}/{self.row.key}"


Record = dict[str, Kept]


def read(path: Path) -> Record:
    """
    Read the record; empty if there is none.

    Raises
    ------
    MistrayError
        If the file is no record of this format.
    """
    if not path.exists():
        return {}
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        if data["format"] != FORMAT:
            raise ValueError(f"format {data['format']}")
        kept = [_kept(entry) for entry in data["rows"]]
    except (ValueError, KeyError, TypeError) as error:
        raise MistrayError(f"{path}: no record of benchmarks ({error}); remove it to start a new one") from None
    return {one.name: one for one in kept}


def _kept(entry: Mapping[str, Any]) -> Kept:
    values = dict(entry)
    part, day, machine = (str(values.pop(key)) for key in ("part", "day", "machine"))
    if values["ratio"] is None:
        values["ratio"] = math.nan
    return Kept(part, Row(**values), day, machine)


def write(path: Path, record: Record) -> None:
    """Write the record; there is the old file or the new one, never a part."""

    def entry(kept: Kept) -> dict[str, Any]:
        values = asdict(replace(kept.row, series={key: list(points) for key, points in kept.row.series.items()}))
        values["ratio"] = None if math.isnan(kept.row.ratio) else kept.row.ratio
        return {"part": kept.part, **values, "day": kept.day, "machine": kept.machine}

    data = {"format": FORMAT, "rows": [entry(kept) for kept in record.values()]}
    replace_file(path, json.dumps(data, indent=1, ensure_ascii=False, allow_nan=False) + "\n", "benchmark record")


def worse(row: Row, before: Row | None) -> str:
    """
    A line about a ratio that got worse by more than 15 % since the kept run; empty if it did not.

    Worse is smaller, or larger where `Row.small`. A ratio that the kept run had and this one has not is no such thing:
    the row itself says why.
    """
    if before is None or math.isnan(row.ratio) or math.isnan(before.ratio) or min(row.ratio, before.ratio) <= 0:
        return ""
    factor = row.ratio / before.ratio if row.small else before.ratio / row.ratio
    if factor <= WORSE:
        return ""
    return f"SLOWER by {100 * (factor - 1):.0f} % than the kept run: {row.what}: {before.ratio:.3g} → {row.ratio:.3g}"


def merged(before: Record, parts: Iterable[str], new: Iterable[Kept]) -> Record:
    """
    The record after a run: rows of the parts that were run are replaced, the others stay.

    A row without a ratio (a program is not installed) does not push out one that was measured before.
    """
    again = set(parts)
    result = {name: kept for name, kept in before.items() if kept.part not in again}
    for kept in new:
        old = before.get(kept.name)
        keep_old = math.isnan(kept.row.ratio) and old is not None and not math.isnan(old.row.ratio)
        result[kept.name] = old if keep_old and old is not None else kept
    return result
