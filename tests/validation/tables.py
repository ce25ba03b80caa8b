"""Tables of the validation reports, as docs/make_validation_tables.py writes them, read back."""

import re
from pathlib import Path

DOCS = Path(__file__).parents[2] / "docs" / "validation"


def read(file: str, name: str) -> list[dict[str, str]]:
    match = re.search(rf"<!-- {name} -->\n(.*?)<!-- end -->", (DOCS / file).read_text(encoding="utf-8"), re.DOTALL)
    assert match, f"{file} has no table '{name}'"
    lines = [[cell.strip() for cell in line.strip(" |").split(" |")] for line in match[1].strip().splitlines()]
    return [dict(zip(lines[0], cells, strict=True)) for cells in lines[2:]]


def value(cell: str) -> tuple[float, float]:
    """Value and standard error, 0 if there is none, of a cell that `number` of docs/make_validation_tables.py wrote."""
    match = re.fullmatch(r"\(?([-\d.,e+]+)(?: ± ([\d.]+))?\)?(?:e(-?\d+))?", cell)
    assert match, f"'{cell}' is not a number"
    scale = 10.0 ** int(match[3] or 0)
    return float(match[1].replace(",", "")) * scale, float(match[2] or 0) * scale
