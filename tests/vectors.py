"""Files of tests/data: texts, and tables of numbers that tests compare with, whose comments name the source."""

import csv
import tomllib
from pathlib import Path
from typing import Any

import pandas as pd

DATA = Path(__file__).parent / "data"


def text(name: str) -> str:
    return (DATA / name).read_text(encoding="utf-8")


def toml(name: str) -> dict[str, Any]:
    return tomllib.loads(text(name))


def rows(name: str) -> list[dict[str, str]]:
    with (DATA / name).open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(line for line in stream if not line.startswith("#")))


def frame(name: str) -> pd.DataFrame:
    return pd.read_csv(DATA / name, comment="#", skipinitialspace=True)


def analytic(start: str, quantity: str) -> float:
    """The closed form of a quantity of the one case whose name starts so."""
    (row,) = (r for r in rows("analytic_cases.csv") if r["case"].startswith(start) and r["quantity"] == quantity)
    return float(row["closed_form"])
