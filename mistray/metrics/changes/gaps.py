"""Gaps opened by a change of a scene: rims that met another surface before and do not after.

Light through such a gap enters behind the parts in front of it. A scene seldom has the outer walls that would stop it.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import mitsuba as mi
import numpy as np

from mistray.metrics.changes.outlines import TOUCH, Rim, SpaceOutline, outlines

TOLD = 3  # gaps named in a sentence


@dataclass(frozen=True)
class Gap:
    """
    Gap between two surfaces that met before a change.

    Attributes
    ----------
    surfaces : (str, str)
        Ids of both surfaces; a rim of the first lay on the second.
    gap_mm : float
        Greatest distance of this rim from the second surface after the change, mm.
    """

    surfaces: tuple[str, str]
    gap_mm: float

    def __str__(self) -> str:
        first, second = self.surfaces
        return f"'{first}' and '{second}', which met, are {self.gap_mm:.3g} mm apart"


@dataclass(frozen=True)
class _Contact:
    """
    Rim of a surface that lies on another surface.

    Rim number `rim` of surface `owner` lies on surface `other`. All three are indices from 0, those of surfaces into
    the outlines of the scene. `place`, (4,), holds x, y and z of the rim's middle in the world and its largest radius,
    mm.
    """

    owner: int
    rim: int
    other: int
    place: np.ndarray

    @property
    def pair(self) -> tuple[int, int]:
        return min(self.owner, self.other), max(self.owner, self.other)


class Contacts:
    """
    Pairs of surfaces that touch each other in a scene.

    Parameters
    ----------
    scene : mi.Scene
        Scene before the change.

    Attributes
    ----------
    surfaces : frozenset of str
        Ids of the surfaces that touch another one.
    """

    def __init__(self, scene: mi.Scene) -> None:
        self._found = outlines(scene)
        self._contacts = _contacts(self._found)
        self.surfaces = frozenset(self._found[k].name for contact in self._contacts for k in contact.pair)

    def opened(self, scene: mi.Scene, moved: Collection[str] | None = None) -> tuple[Gap, ...]:
        """
        Return the gaps in a changed scene, the widest first.

        Two surfaces are apart if neither has a rim within 1e-3 mm of the other and they do not cross. There is no gap
        if the rim lies on other opaque surfaces that lead to the other surface, as when a vane moves along a tube of
        several pieces. Of several pairs that part in one place, one is named: an opaque pair if possible, and the
        nearest of these.

        Parameters
        ----------
        scene : mi.Scene
            Changed scene; surfaces that it no longer has are ignored.
        moved : collection of str, optional
            Ids of all changed surfaces: only their contacts are examined. None: all contacts are.
        """
        if moved is None:
            return _opened(self._found, self._contacts, outlines(scene))
        if self.surfaces.isdisjoint(moved):
            return ()
        after = {one.name: one for one in (*self._found, *outlines(scene, moved))}
        some = [contact for contact in self._contacts if any(self._found[k].name in moved for k in contact.pair)]
        return _opened(self._found, some, list(after.values()))


def gaps_text(gaps: Sequence[Gap]) -> str:
    """
    Return a phrase that lists gaps for a message; "" if there are none.

    It has at most `TOLD` of them and the number of the others.
    """
    told = "; ".join(map(str, gaps[:TOLD]))
    return told + (f"; and {len(gaps) - TOLD} more" if len(gaps) > TOLD else "")


def _contacts(found: Sequence[SpaceOutline]) -> list[_Contact]:
    """Return the contacts of outlines in space: rims that lie on another surface with all of their points."""
    low, high = np.array([one.low for one in found]), np.array([one.high for one in found])
    contacts = []
    for i, one in enumerate(found):
        for number, rim in enumerate(one.rims):
            bottom, top = rim.points.min(axis=0), rim.points.max(axis=0)
            near = np.all((low <= bottom + TOUCH) & (high >= top - TOUCH), axis=1)
            near[i] = False
            contacts += [
                _Contact(i, number, k, _place(rim))
                for k in map(int, np.flatnonzero(near))
                if found[k].distance(rim.points).max() <= TOUCH
            ]
    return contacts


def _place(rim: Rim) -> np.ndarray:
    """Return the middle of a rim and its largest radius, (4,), mm, by which coinciding rims are recognised."""
    middle = rim.points.mean(axis=0)
    return np.append(middle, np.linalg.norm(rim.points - middle, axis=1).max())


def _opened(
    before: Sequence[SpaceOutline], contacts: Sequence[_Contact], after: Sequence[SpaceOutline]
) -> tuple[Gap, ...]:
    at = {one.name: k for k, one in enumerate(after)}
    here = {number: at[one.name] for number, one in enumerate(before) if one.name in at}
    scene = _Touching(after)
    apart: list[tuple[bool, float, _Contact]] = []
    held: set[tuple[int, int]] = set()
    for contact in contacts:
        if contact.owner not in here or contact.other not in here:
            continue
        a, b = here[contact.owner], here[contact.other]
        if len(after[a].rims) != len(before[contact.owner].rims):  # one has closed to a point
            continue
        rim = after[a].rims[contact.rim]
        far = after[b].away(rim)
        if far <= TOUCH or scene.touch(a, b) or scene.led(a, rim, b):
            held.add(contact.pair)
        else:
            apart.append((not (after[a].opaque and after[b].opaque), far, contact))
    # Of each pair the rim that is farthest away: a mesh has several around one opening
    widest = {item[2].pair: item for item in sorted(apart, key=lambda item: item[1]) if item[2].pair not in held}
    named: list[tuple[_Contact, Gap]] = []
    for _, far, contact in sorted(widest.values(), key=lambda item: item[:2]):
        if not any(_same_gap(scene, here, contact, other) for other, _ in named):
            named.append((contact, Gap((before[contact.owner].name, before[contact.other].name), far)))
    return tuple(sorted((gap for _, gap in named), key=lambda gap: -gap.gap_mm))


def _same_gap(scene: _Touching, here: dict[int, int], one: _Contact, other: _Contact) -> bool:
    """
    True if two gaps lie at one place, and each surface of one is, or touches, a surface of the other.

    `here` maps the indices of the contacts, before the change, to those of `scene`, after it.
    """
    if np.abs(one.place - other.place).max() > 2 * TOUCH:
        return False
    a, b = (here[k] for k in one.pair)
    c, d = (here[k] for k in other.pair)

    def hold(x: int, y: int) -> bool:
        return x == y or scene.touch(x, y)

    return (hold(a, c) and hold(b, d)) or (hold(a, d) and hold(b, c))


class _Touching:
    """Contacts between the outlines of a scene, given by index, each computed when first needed and then kept."""

    def __init__(self, found: Sequence[SpaceOutline]) -> None:
        self._found = found
        self._known: dict[tuple[int, int], bool] = {}
        self._low, self._high = np.array([one.low for one in found]), np.array([one.high for one in found])

    def touch(self, a: int, b: int) -> bool:
        """True if a rim of one of two surfaces, given by index, lies on the other or crosses it all around."""
        key = min(a, b), max(a, b)
        if key not in self._known:
            one, other = self._found[a], self._found[b]
            self._known[key] = self._near(a)[b] and (
                any(other.away(rim) <= TOUCH for rim in one.rims) or any(one.away(rim) <= TOUCH for rim in other.rims)
            )
        return self._known[key]

    def led(self, owner: int, rim: Rim, target: int) -> bool:
        """True if touching opaque surfaces other than `owner` lead from its rim to surface `target`, both by index."""
        near = self._near(owner)
        opaque = {k for k, one in enumerate(self._found) if one.opaque and k != owner}
        reached = {k for k in opaque if near[k] and self._found[k].away(rim) <= TOUCH}
        fresh = list(reached)
        while fresh:
            k = fresh.pop()
            if k == target or self.touch(k, target):
                return True
            more = {other for other in opaque - reached if self.touch(k, other)}
            reached |= more
            fresh += more
        return False

    def _near(self, a: int) -> np.ndarray:
        """Return a mask of surfaces, (n,), whose bounding box touches that of surface `a`."""
        return np.asarray(np.all((self._low <= self._high[a] + TOUCH) & (self._high >= self._low[a] - TOUCH), axis=1))
