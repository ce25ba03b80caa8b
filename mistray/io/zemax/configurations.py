"""Selection of a configuration of a .zmx file: its values replace those that the file was saved with.

``MNUM n k`` gives the number of configurations and the one that the file was saved in. Lines ``OPERAND place
configuration value …`` behind the surfaces hold the differences. Operands, from OpticStudio's multi-configuration
editor:

====================================  =================================================================
``LTTL 0 k name``                     name of the configuration
``THIC``, ``CRVT``, ``CONN``          thickness, curvature, conic constant of surface `place`
``SDIA``                              semi-diameter of surface `place`
``APER``                              the value of the aperture of the system
``XFIE``, ``YFIE``                    field number `place`
``FVDX``, ``FVDY``, ``FVCX``, ``FVCY``  vignetting of field number `place`
``MOFF``                              a row that is switched off
====================================  =================================================================

A configuration with any other operand is refused, unless the file was saved in it. Solves and pickups are not carried
out: in another configuration they keep the values that the file was saved with, and the remark names them.
"""

from __future__ import annotations

from dataclasses import replace

from mistray.errors import errors_of
from mistray.io.conventions import choose_position
from mistray.io.zemax.lines import SOLVES, Sections, ZemaxLine, ZemaxSection

_OF_SURFACE = {"THIC": "DISZ", "CRVT": "CURV", "CONN": "CONI", "SDIA": "DIAM"}
_OF_FIELD = {
    "XFIE": "XFLN", "YFIE": "YFLN", "FVDX": "VDXN", "FVDY": "VDYN", "FVCX": "VCXN", "FVCY": "VCYN",
}  # fmt: skip
_APERTURES = ("ENPD", "FNUM", "OBNA")


def at_configuration(sections: Sections, given: int | str | None) -> str:
    """
    Write the values of a configuration into the lines of the system and the surfaces.

    Parameters
    ----------
    sections : Sections
        Sections of the file; the lines of configurations are removed from the last one.
    given : int, str or None
        Number of the configuration from 1 on, or its name; None means the one that the file was saved in.

    Returns
    -------
    str
        Remark on the configurations that are left out, and on solves that keep the values of the saved one; "" if
        there is only one configuration.

    Raises
    ------
    MistrayError
        If there is no such configuration, or it changes something that is not read.
    """
    head = sections.after.take("MNUM")
    count = head.whole(0, "the number of configurations", default=1) if head else 1
    saved = head.whole(1, "the configuration that the file was saved in", default=1) if head else 1
    rows = _rows(sections.after, head)
    names = {_whole(line, 1): _name(line) for line in rows if line.key == "LTTL"}
    with errors_of(head.where if head else "lens"):
        number, note = choose_position(given, saved, names, count, "configuration")
    if number == saved:
        return note
    for line in rows:
        if line.key not in ("LTTL", "MOFF") and _whole(line, 1) == number:
            _set(sections, line)
    solved = [f"{line.key} of {section.name}" for section in sections.surfaces for line in section.take_all(*SOLVES)]
    kept = f"; not solved anew, but as in configuration {saved}: {', '.join(solved)}" if solved else ""
    return note + kept


def _rows(after: ZemaxSection, head: ZemaxLine | None) -> list[ZemaxLine]:
    """Remove and return the lines of configuration operands, which follow the line MNUM; keep other lines."""
    found = []
    for line in after.take_rest():
        if head is not None and line.number > head.number and len(line.words) >= 3 and line.words[1].isdecimal():
            found.append(line)
        else:
            after.add(line)
    return found


def _whole(line: ZemaxLine, place: int) -> int:
    return line.whole(place, "a whole number")


def _name(line: ZemaxLine) -> str:
    """Return the name in an operand's line: the text between its first two quotes, else the third word."""
    parts = line.text.split('"')
    return parts[1].strip() if len(parts) > 2 else line.words[2]


def _set(sections: Sections, line: ZemaxLine) -> None:
    """
    Write the value of a configuration operand into the line of the lens data that it overrides.

    The value of a field beyond the last one is written, too. Raise `MistrayError` if the operand is not read or not
    complete, its surface does not exist, its field is below 1, or the system does not have one aperture to override.
    """
    place = _whole(line, 0)
    if line.key in _OF_SURFACE:
        if not 0 <= place < len(sections.surfaces):
            raise line.error(f"{line.key} of surface {place}; the lens has surfaces 0 to {len(sections.surfaces) - 1}")
        _replace(sections.surfaces[place], _OF_SURFACE[line.key], 0, repr(line.value(2)), line)
    elif line.key in _OF_FIELD:
        if place < 1:
            raise line.error(f"{line.key} of field {place}; they are numbered from 1 on")
        key = _OF_FIELD[line.key]
        old = {"XFLN": "XFLD", "YFLN": "YFLD"}.get(key, "")
        key = old if sections.system.has(old) and not sections.system.has(key) else key
        _replace(sections.system, key, place - 1, repr(line.value(2)), line)
    elif line.key == "APER":
        found = [key for key in _APERTURES if sections.system.has(key)]
        if len(found) != 1:
            which = f"{len(found)} of {', '.join(_APERTURES)}, and one is needed"
            raise line.error(f"'{line.shown}': the system has {which}; save this configuration")
        _replace(sections.system, found[0], 0, repr(line.value(2)), line)
    else:
        raise line.error(
            f"'{line.shown}': {line.key} is not read; open this configuration in OpticStudio and save the file"
        )


def _replace(section: ZemaxSection, key: str, place: int, word: str, line: ZemaxLine) -> None:
    """Replace the word at `place` in the line of a keyword; a missing or short line is extended."""
    old = section.take(key)
    words = list(old.words) if old else []
    words += ["0"] * (place + 1 - len(words))
    words[place] = word
    base = old or line
    section.add(replace(base, key=key, words=tuple(words), text=" ".join([key, *words])))
