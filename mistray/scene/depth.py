"""How deep the elements of a scene file lie within each other: Mitsuba's reader dies of some thousand levels."""

from __future__ import annotations

from pathlib import Path
from xml.parsers import expat

from mistray.errors import MistrayError

DEEPEST = 100  # levels; scenes need about six


def check_depth(path: Path) -> None:
    """
    Refuse a scene file that would end the process.

    Parameters
    ----------
    path : Path
        What is wrong with it otherwise is left to its reader; included files are looked at by themselves.

    Raises
    ------
    MistrayError
        An element lies deeper than `DEEPEST` levels.
    """
    looked_at: set[Path] = set()
    waiting = [path]
    while waiting:
        file = waiting.pop()
        if file.resolve() not in looked_at and file.is_file():
            looked_at.add(file.resolve())
            waiting += [file.parent / name for name in _included(file)]


def _included(path: Path) -> list[str]:
    """Names of the files that a file includes."""
    depth = 0
    names: list[str] = []
    parser = expat.ParserCreate()

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > DEEPEST:
            raise MistrayError(
                f"scene '{path}', line {parser.CurrentLineNumber}: <{tag}> lies within {DEEPEST} other elements; close "
                "them first"
            )
        if tag == "include" and "filename" in attributes:
            names.append(attributes["filename"])

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1

    parser.StartElementHandler, parser.EndElementHandler = start, end
    try:
        parser.Parse(path.read_bytes(), True)
    except MistrayError:
        raise
    except (OSError, ValueError, LookupError, expat.ExpatError):  # Mitsuba will say what is wrong
        return []
    return names
