"""Report on which coatings, paint and scatter were put on surfaces, as JSON values and text."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from mistray.files.json_values import plain
from mistray.scene import Coated
from mistray.toolkit.tables.text import first_of

NAMES_SHOWN = 8  # surfaces in a line


def record(coated: Coated) -> dict[str, Any]:
    """Return the changes, the surfaces left alone and the notes as JSON-serialisable values."""
    changes = [
        {
            "surface": name,
            "recoated": change.recoated,
            "coating": _called(change.coating) if change.recoated else None,
            "scatter": [model.name or model.kind for model in change.scatter],
        }
        for name, change in coated.changes.items()
    ]
    return dict(plain({"changes": changes, "left": coated.left, "notes": coated.notes}))


def text(found: Mapping[str, Any], output: Path) -> str:
    """Return the changes of surfaces as text; those with the same coating and scatter share a line."""
    changes = found["changes"]
    looks = [([one["coating"]] if one["recoated"] else []) + one["scatter"] for one in changes]
    lines = _grouped((" + ".join(look) or "no scatter", one) for look, one in zip(looks, changes, strict=True))
    lines += _grouped((f"left alone, because it {item['why']}", item) for item in found["left"])
    lines += [f"note: {note}" for note in found["notes"]]
    count = f"{len(changes)} surface{'s' if len(changes) > 1 else ''}"
    return "\n".join([*lines, f"{output}: {count} changed; next: {shlex.join(['mistray', 'ghosts', str(output)])}"])


def _grouped(rows: Iterable[tuple[str, Mapping[str, Any]]]) -> list[str]:
    """Return one line for each distinct treatment, with the names of the surfaces that have it."""
    groups: dict[str, dict[str, None]] = {}
    for what, row in rows:
        groups.setdefault(what, {})[row["surface"]] = None
    return [f"{what}: {first_of(list(names), NAMES_SHOWN)}" for what, names in groups.items()]


def _called(coating: Any) -> str:
    if coating is None:
        return "bare"
    if coating.name is not None:
        return str(coating.name)
    if coating.R is None:
        return str(coating.table or coating.layers or coating.preset)
    return f"R = {coating.R:g}" + (f", T = {coating.T:g}" if coating.T else "") if coating.R or coating.T else "black"
