"""Saved states of runs: arrays and plain facts in one NumPy archive, which is replaced as a whole."""

from __future__ import annotations

import io
import json
import re
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mistray.errors import MistrayError
from mistray.files.arrays import check_arrays
from mistray.read_file import open_input
from mistray.replace_file import replace_file

FORM = 7  # version of the content
_FACTS, _ARRAY = "facts", "array_"  # entries of the file; the prefix separates names of arrays from all others
_DAMAGES = (
    *(ValueError, KeyError, TypeError, AttributeError, IndexError, EOFError, MemoryError, RecursionError),
    *(zipfile.BadZipFile, zlib.error),
)
_HASH = re.compile("[0-9a-f]{16,}")
_ABSENT = "absent"
MOST_BYTES = 4 << 30  # largest size of an unpacked state
_MOST_LISTED = 6  # values of a list that a message quotes


def save_state(path: str | Path, arrays: Mapping[str, np.ndarray], facts: Mapping[str, Any]) -> Path:
    """
    Save the state of a run to a file, which is replaced as a whole: a killed process leaves the old one.

    Parameters
    ----------
    path : str or Path
        NumPy archive (.npz), readable without mistray. The folder is made if it is missing.
    arrays : mapping of str to array
        Numbers or text; no objects.
    facts : mapping
        Plain values; "signature" holds all that must agree when the run is continued, see `require_same`.

    Returns
    -------
    Path
        Saved file.

    Raises
    ------
    MistrayError
        If an array holds objects, the folder cannot be made, or the file cannot be written.
    """
    entries = {_ARRAY + name: np.asarray(values) for name, values in arrays.items()}
    objects = [name for name, values in arrays.items() if np.asarray(values).dtype.hasobject]
    if objects:
        raise MistrayError(f"state '{path}': array '{objects[0]}' holds objects; give numbers or text")
    # NumPy archive in memory: facts as JSON, arrays under their prefix
    text = json.dumps({"form": FORM, "facts": dict(facts)}, default=_plain)
    buffer = io.BytesIO()
    np.savez(buffer, **{_FACTS: np.array(text)}, **entries)  # type: ignore[arg-type]
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise MistrayError(f"state '{path}': {error.strerror}; choose another folder") from None
    return replace_file(path, buffer.getvalue(), "state")


def load_state(path: str | Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """
    Return the arrays and the facts that `save_state` saved.

    Returns
    -------
    arrays, facts : dict
        Arrays by name, and facts by name.

    Raises
    ------
    MistrayError
        If the file does not exist or cannot be read, it is not a state or is damaged, or it was written by another
        version of mistray.
    """
    try:
        with open_input(path, own=True) as file:
            content = file.read()
        with np.load(check_arrays(content, MOST_BYTES), allow_pickle=False) as archive:
            written = json.loads(str(archive[_FACTS][()]))
            arrays = {name.removeprefix(_ARRAY): archive[name] for name in archive.files if name.startswith(_ARRAY)}
        form, facts = written["form"], dict(written["facts"])
    except FileNotFoundError:
        raise MistrayError(f"state '{path}': no such file; run once without resuming, or check the path") from None
    except OSError as error:
        raise MistrayError(f"state '{path}': {error.strerror or error}; check the path") from None
    except MistrayError as error:
        raise MistrayError(f"state '{path}': {error}") from None
    except _DAMAGES:
        raise MistrayError(f"state '{path}' is damaged or no state; remove it and run without resuming") from None
    if form != FORM:
        raise MistrayError(f"state '{path}' was written by another version of mistray; run without resuming")
    return arrays, facts


def require_same(path: str | Path, facts: Mapping[str, Any], signature: Mapping[str, Any]) -> None:
    """
    Check that a saved state belongs to the run that is to be continued.

    Parameters
    ----------
    path : str or Path
        File, for the message.
    facts : mapping
        Facts that `load_state` has returned.
    signature : mapping
        Required content of ``facts["signature"]``: plain values, mappings of such and lists. Values of 16 and more
        hexadecimal digits count as hashes, which a message does not quote.

    Raises
    ------
    MistrayError
        If anything differs; the message names the first difference with both values, hashes last.
    """
    saved = _flat(facts.get("signature", {}))
    here = _flat(json.loads(json.dumps(dict(signature), default=_plain)))
    differing = []
    for name in dict.fromkeys((*here, *saved)):
        old, new = saved.get(name, _ABSENT), here.get(name, _ABSENT)
        if _differ(old, new):
            differing.append((_are_hashes(old, new), name, old, new))
    if differing:  # hashes last: one often differs because of a setting that is listed by itself
        _, name, old, new = min(differing, key=lambda item: item[0])
        raise MistrayError(
            f"state '{path}' belongs to another run: {_difference(name, old, new)}; use another file, or run without "
            "resuming"
        )


def _flat(values: Any, name: str = "") -> dict[str, Any]:
    """Return the values of nested mappings as one mapping, under names such as "settings.seed"."""
    if not isinstance(values, dict):
        return {name: values}
    flat: dict[str, Any] = {}
    for key, value in values.items():
        flat |= _flat(value, f"{name}.{key}" if name else str(key))
    return flat


def _are_hashes(*values: Any) -> bool:
    return all(isinstance(value, str) and _HASH.fullmatch(value) for value in values)


def _differ(old: Any, new: Any) -> bool:
    if isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        return any(map(_differ, old, new))
    return bool(old != new) and repr(old) != repr(new)  # NaN is not equal to itself


def _difference(name: str, old: Any, new: Any) -> str:
    if _are_hashes(old, new):
        return f"the {name} is another one or has changed"
    if isinstance(old, list) and isinstance(new, list):
        if len(old) == len(new) > _MOST_LISTED:
            k = next(k for k in range(len(old)) if _differ(old[k], new[k]))
            return f"value {k + 1} of {name} was {_text(old[k])} and is {_text(new[k])}"
        if max(len(old), len(new)) > _MOST_LISTED:
            return f"{name} had {len(old)} values ({_text(old)}) and has {len(new)} ({_text(new)})"
    return f"{name} was {_text(old)} and is {_text(new)}"


def _text(value: Any) -> str:
    if isinstance(value, list):
        if len(value) > _MOST_LISTED:
            return f"{_text(value[0])} … {_text(value[-1])}"
        return f"[{', '.join(map(_text, value))}]"
    return f"{value:.9g}" if isinstance(value, float) else str(value)


def _plain(value: Any) -> Any:
    """Return NumPy's numbers and arrays as Python's numbers and lists, and anything else as text, for JSON."""
    if hasattr(value, "tolist"):
        return value.tolist()
    return str(value)
