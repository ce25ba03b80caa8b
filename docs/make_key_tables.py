"""Writes the tables of keys of TOML files into pages of docs/, from the fields that the files are read into.

    python docs/make_key_tables.py

Each table stands below a comment that names its sections. `tests/test_plugin_pages.py` keeps the pages current.
"""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import Any

from mistray.analyses.budget.allocation import PowerCost, StepCost
from mistray.analyses.budget.read_budget import BudgetStudy, Grades, Requirement
from mistray.analyses.optimize.study.model import CoatingKeys, Moved, Optimizer, Term, VariableGroup
from mistray.analyses.validate.declared import DeclaredRow, ReferenceFile
from mistray.ranges import demand_of, doc_of, number_text
from mistray.toolkit.analysis import range_text

DOCS = Path(__file__).parent
PAGES = ("optimization.md", "sensitivity.md", "validation/index.md")
SECTIONS: dict[str, tuple[type, ...]] = {
    "term": (Term,),
    "variable": (VariableGroup,),
    "variable.parameters": (Moved,),
    "coating": (CoatingKeys,),
    "optimizer": (Optimizer,),
    "require": (Requirement,),
    "choose": (Grades, StepCost),
    "choose.cost": (PowerCost,),
    "solver": (BudgetStudy,),
    "file": (ReferenceFile,),
    "row": (DeclaredRow,),
}
REQUIRED = ("term.goal",)  # in a file, though not in Python
HEAD = "| key | default | meaning |\n|---|---|---|\n"
TABLE = re.compile(r"(<!-- Keys of (.*), written by docs/make_key_tables\.py -->\n\n)(?:\|.*\n)*")
PAGE = re.compile(r"docs/(\w+)\.md")  # named in a sentence


def row(section: str, field: dataclasses.Field[Any]) -> str:
    """A key, its default, its sentence and its range."""
    key = f"{section}.{field.name}"
    default = (
        "–" if field.default in (dataclasses.MISSING, None, "", ()) or key in REQUIRED else value_text(field.default)
    )
    meaning = PAGE.sub(r"[\1](\1.md)", doc_of(field)).replace("|", r"\|")
    told = range_text(demand_of(field))
    return f"| `{key}` | {default} | {meaning}{f'; {told}' if told else ''} |\n"


def value_text(value: Any) -> str:
    """A value as a file has it."""
    if isinstance(value, bool):
        return str(value).lower()
    return f'`"{value}"`' if isinstance(value, str) else number_text(value)


def table(sections: str) -> str:
    """The table of some sections, named with commas between them."""
    fields = [
        (name, field) for name in sections.split(", ") for kind in SECTIONS[name] for field in dataclasses.fields(kind)
    ]
    return HEAD + "".join(row(*one) for one in fields if doc_of(one[1]))


def page(name: str) -> str:
    """A page with its tables as they shall be."""
    text = (DOCS / name).read_text(encoding="utf-8")
    return TABLE.sub(lambda found: found[1] + table(found[2]), text)


if __name__ == "__main__":
    for name in PAGES:
        (DOCS / name).write_text(page(name), encoding="utf-8")
