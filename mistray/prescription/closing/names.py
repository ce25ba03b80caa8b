"""Names for the surfaces and bodies of a lens file in a scene, and notes on names that had to change."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from mistray.materials.mate import shown
from mistray.prescription.sequential.table import Sequential

STOP, DETECTOR = "stop_front", "detector"
"""Ids of the plate of a stop and of the plane at the image, whatever the file calls their rows."""

_SIGNS = re.compile(r"[^\w+-]+")
_RESERVED = re.compile(
    r"(stop|stop_front|barrel|barrel_\d+_wall(_\d+)?|board|board_(left|right|top|bottom)|detector|ground_edge|L\d+|"
    r"integrator|source|type)",
    re.IGNORECASE,
)
_FACE = re.compile(r"(.+)_(?:front|rear|back)")
# Faces that the closing of a lens adds to a body, a mirror or an aperture, by their names
_ADDED = re.compile(r"(.+)_(?:(?:edge|flange_\d|bevel_\d|bore)(?:_\d+)?|rear|rim|frame|aperture|obscuration(?:_\d+)?)")
_BEGIN = "names of the file that are others here: "
_PAIR = re.compile(r"'([^']+)' is '([^']+)'")


@dataclass
class Names:
    """
    Names of all rows and bodies of a lens.

    Attributes
    ----------
    rows : dict of int to str
        Names, keyed by the index of the row.
    renamed : dict of str to list of str
        Name in the file that could not be kept → names in the scene; empty if the row has no surface.
    """

    rows: dict[int, str]
    renamed: dict[str, list[str]]
    _taken: set[str] = field(default_factory=set)
    _stems: set[str] = field(default_factory=set)

    def body(self, first: int, last: int, count: int) -> str:
        """
        Return a name for a body between two rows.

        The name is the stem of a row's name before ``_front``, ``_rear`` or ``_back``, if it is free. Else it is L and
        a number that no other name uses.

        Parameters
        ----------
        first, last : int
            Indices of its rows.
        count : int
            Number of bodies so far, including this one.
        """
        if not self._taken:
            self._taken = set(self.rows.values())
            self._stems = {match[1] for name in self._taken if (match := _FACE.fullmatch(name))}
        body = ""
        for name in (self.rows[first], self.rows[last]):
            own = _FACE.fullmatch(name)
            if own and not body and own[1] not in self._taken and (not _RESERVED.fullmatch(own[1]) or own[1][0] == "L"):
                body = own[1]
        while not body:
            if f"L{count}" not in self._taken and f"L{count}" not in self._stems:
                body = f"L{count}"
            count += 1
        self._taken.add(body)
        return body

    def note(self) -> list[str]:
        """Return a list with one note on the names that had to be changed; empty if there are none."""
        pairs = [
            f"'{old}' " + (f"is {' and '.join(repr(name) for name in new)}" if new else "has no surface")
            for old, new in self.renamed.items()
        ]
        return [_BEGIN + ", ".join(pairs)] if pairs else []


def names_of(lens: Sequential, has_effect: Callable[[int], bool]) -> Names:
    """
    Return names for all rows of a lens, and the labels that surfaces could not keep.

    A label is kept, with _ for spaces and signs, if it is unique and not the name of a generated part. Otherwise the
    name is S and the number of the row.

    Parameters
    ----------
    lens : Sequential
        Lens whose rows get names.
    has_effect : callable
        Function of the index of a row: whether it refracts or reflects light, so that it becomes a surface.
    """
    slugs = [_SIGNS.sub("_", row.label).lstrip("_+-").rstrip("_") for row in lens.rows]
    counts, numbers = Counter(slugs), {row.number for row in lens.rows}
    mirrors = {slug for slug, row in zip(slugs, lens.rows, strict=True) if row.mirror}
    stems = {*slugs, *(match[1] for slug in slugs if (match := _FACE.fullmatch(slug)))}

    def kept(slug: str, number: int) -> bool:
        if not slug or counts[slug] > 1 or _RESERVED.fullmatch(slug):
            return False
        if re.fullmatch(r"S\d+", slug):
            return int(slug[1:]) == number or int(slug[1:]) not in numbers
        added = _ADDED.fullmatch(slug)
        if added is None:
            return True
        if slug.endswith("_rear"):  # the back of a mirror, else the face of a lens
            return added[1] not in mirrors and not re.fullmatch(r"S\d+", added[1])
        return added[1] not in stems and not re.fullmatch(r"[LS]\d+", added[1])

    names: dict[int, str] = {}
    renamed: dict[str, list[str]] = {}
    for k, (row, slug) in enumerate(zip(lens.rows, slugs, strict=True)):
        names[k] = slug if kept(slug, row.number) else f"S{row.number}"
        here: str | None = names[k]
        if row.kind == "image":
            here = DETECTOR
        elif row.kind != "surface" or not has_effect(k):
            here = STOP if row.stop else None
        if row.label and row.label != here and row.kind != "coordinate_break":
            new = renamed.setdefault(shown([row.label.replace("'", "’")]), [])
            new += [here] if here else []
    return Names(names, renamed)


def renamed_in(text: str) -> Mapping[str, str]:
    """Return changed names from a text with `Names.note`: name in the file → first one in the scene; else empty."""
    return {
        old: new
        for line in text.splitlines()
        if _BEGIN in line
        for old, new in _PAIR.findall(line.partition(_BEGIN)[2])
    }
