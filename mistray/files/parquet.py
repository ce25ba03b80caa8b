"""Tables as Parquet files, with column types kept and a unit stored for each numeric column.

The field metadata of a numeric column holds ``unit``, taken from the end of its name as everywhere in mistray
("power_se_W": W, "rms_irradiance_W_mm2": W/mm²), "1" for pure numbers; the metadata of the file holds ``mistray``,
facts about its origin as JSON. `pandas.read_parquet` gives the same columns back; the index is left out.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mistray.errors import foreign_errors
from mistray.files.json_values import plain
from mistray.files.packages import format_package
from mistray.files.units import unit_of
from mistray.ranges import ANYTHING, ByName
from mistray.read_file import read_file
from mistray.replace_file import replace_file

if TYPE_CHECKING:
    import pandas as pd

FACTS = b"mistray"
FACTS_OF_TABLE = ByName(ANYTHING, "{'command': 'mistray ghosts plate'}")


def write_parquet(table: pd.DataFrame, path: str | Path, facts: Mapping[str, Any] | None = None) -> Path:
    """
    Write a table as Parquet.

    Parameters
    ----------
    table : DataFrame
        Table such as ``trace.paths.to_pandas()``; its index is left out.
    path : str or Path
        File to write; an existing file is replaced atomically.
    facts : mapping, optional
        Origin of the table, as JSON values.

    Returns
    -------
    Path
        Written file.

    Raises
    ------
    MistrayError
        If pyarrow is not installed, or the file cannot be written.

    Examples
    --------
    >>> import pandas as pd
    >>> t = mistray.trace(mistray.load("cooke_triplet"), rays=10_000)
    >>> file = mistray.report.write_parquet(t.paths.to_pandas(), "paths.parquet")
    >>> len(pd.read_parquet(file))
    16
    """
    FACTS_OF_TABLE.check_all("table", facts=facts)
    arrow = format_package("parquet")
    import pandas as pd
    import pyarrow.parquet

    made = arrow.Table.from_pandas(table, preserve_index=False)
    fields = [
        field.with_metadata({"unit": unit(field.name)}) if pd.api.types.is_numeric_dtype(table[field.name]) else field
        for field in made.schema
    ]
    known = {**(made.schema.metadata or {}), FACTS: json.dumps(plain(dict(facts or {})), allow_nan=False).encode()}
    sink = arrow.BufferOutputStream()
    pyarrow.parquet.write_table(made.cast(arrow.schema(fields, metadata=known)), sink)
    return replace_file(path, sink.getvalue().to_pybytes(), "table")


def read_parquet(path: str | Path, what: str = "table") -> pd.DataFrame:
    """
    Return the table in a Parquet file; `what` names it in messages.

    Raises
    ------
    MistrayError
        If pyarrow is not installed, or the file cannot be read as Parquet.
    """
    arrow = format_package("parquet")
    import pyarrow.parquet

    content = read_file(path, what)
    with foreign_errors(f"{what} '{path}'", "give a Parquet file"):
        return pyarrow.parquet.read_table(arrow.BufferReader(content)).to_pandas()


def unit(column: str) -> str:
    """Return the unit at the end of a column's name, "1" if it has none; a standard error has the unit of its value."""
    return unit_of(column)[1] or unit_of(column.removesuffix("_se"))[1] or "1"
