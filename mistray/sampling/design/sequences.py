"""
The design sequences of a scene: declared at its detectors, or else found by probes of the design field.

An *order* is the list of surfaces and events by which a probe reaches a detector (see
`mistray.sampling.design.probes`). Of these, the following are design sequences:

- Orders over optics: at least one lens face or declared mirror, and no wall (edges and bevels are walls). An opaque
  surface that reflects more than half of the light is a mirror in such an order.
- Orders that go the same ways at beam splitters are one *arm*. Its main order is that of most probes. An order over
  more lens faces and declared mirrors replaces it if at least `SEEN` of the probes follow it, because then the others
  bypass something. An order in which two partial reflections follow each other, or one beam splitter reflects twice, is
  a ghost and forms no arm. An order that bypasses the beam splitters of other arms forms none either.
- Orders of an arm are alternatives of its main one if they have the same events, step by step, at surfaces between the
  same materials: segments of a mirror, facets, strips of filters, the faces of a roof. The rings of edges may be passed
  or missed. So may plane-parallel plates that at least `PLATED` of the probes pass or miss: a filter over half of the
  beam, not the gap between two. Every combination of such alternatives is a sequence.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Iterable, Iterator
from itertools import combinations, product
from math import prod

import numpy as np

from mistray.errors import MistrayError
from mistray.events import LETTERS, REFLECTED, TOTAL, TRANSMITTED, event_of, kind_of, place_of
from mistray.ids import event_words
from mistray.recorders.design_sequences import Sequences
from mistray.sampling.design.probes import Order
from mistray.surfaces.optics import BACK_MEDIUM_SHIFT, DIFFRACTS, FRONT_MEDIUM_SHIFT, MEDIUM_MASK, MIRROR, OPAQUE, WALL
from mistray.surfaces.surfaces import SurfaceTable

SEEN = 0.05  # share of the probes of an arm that an order over more optics needs to be its main one
ARM = 0.02  # share of all probes of a detector that an arm needs
PLATED = 0.2  # share of the probes of an arm that pass, or miss, a plate that is no step of its design
MOST_COMBINED = 4096  # combinations of alternatives; beyond it, only orders that probes have found are used
MOST_RINGS = 8  # rings along an order up to which all subsets of them are sequences
FLAT, PARALLEL = 1e-5, 1e-3  # sag in units of the size, and rad, that the sides of a plane-parallel plate may have


def is_plane(table: SurfaceTable, surface: int) -> bool:
    """True if the sag of a surface varies by at most `FLAT` of its size; False for Mitsuba's own shapes."""
    if surface >= len(table.pieces):
        return False
    piece = table.pieces[surface]
    return bool(piece.z_range[1] - piece.z_range[0] <= FLAT * piece.size)


def chosen_orders(table: SurfaceTable, found: Counter[Order]) -> list[tuple[Order, list[Order]]]:
    """
    Return the arms by which probe rays reach a detector, one for each way through the beam splitters.

    An arm is a main order and its alternatives.

    Parameters
    ----------
    table : SurfaceTable
        Surfaces of the scene at one wavelength.
    found : Counter
        Orders, and the number of probes of each.

    Returns
    -------
    list of (main, orders)
        Main order of each arm, and all orders that are design sequences, the main one among them; the arm of most
        probes first. Empty if no order passes any optics.
    """
    # Imaging orders, grouped by what they do at beam splitters
    rules = _Rules(table)
    imaging = {order: count for order, count in found.items() if rules.images(order)}
    splitters = {place_of(code) for order in imaging for code in order if rules.splits(code)}
    arms: dict[Order, Counter[Order]] = {}
    for order, count in imaging.items():
        arm = tuple(code for code in order if place_of(code) in splitters)
        arms.setdefault(arm, Counter())[order] = count
    # Strong arms; the empty key is the order past the beam splitters of the others
    least = ARM * sum(found.values())
    kept = {arm: orders for arm, orders in arms.items() if orders.total() >= least}
    if len(kept) > 1:
        kept.pop((), None)
    strongest = sorted(kept.values(), key=lambda orders: -orders.total())
    return [_alternatives(rules, orders) for orders in strongest]


def combined(table: SurfaceTable, arms: Iterable[tuple[Order, list[Order]]]) -> Sequences:
    """
    Return all design sequences of arms, see `chosen_orders`, with every combination of alternatives at each step.

    Rings of edges may be left out. Where orders of one pattern have more than `MOST_COMBINED` combinations, only those
    that probes have followed are sequences.
    """
    rules, lists = _Rules(table), set()
    for _, orders in arms:
        shapes: dict[Hashable, list[Order]] = {}
        for order in orders:
            for one in rules.without_some_rings(order):
                shapes.setdefault(rules.pattern(one), []).append(one)
        # The surfaces that stand for each other at a step combine freely
        for members in shapes.values():
            steps = [sorted(set(column)) for column in zip(*members, strict=True)]
            lists |= set(members if prod(map(len, steps)) > MOST_COMBINED else product(*steps))
    return tuple(sorted(lists))


def declared(table: SurfaceTable, detector: int) -> Sequences:
    """
    Return the design sequences that the interface of a detector declares; () if it declares none.

    See ``design_path`` of `interface`.

    Raises
    ------
    MistrayError
        For a surface that the scene does not have, a letter other than T, R and I, or an entry that stands for more
        than `MOST_COMBINED` sequences.
    """
    text = getattr(table.interfaces[detector], "design_path", "")
    numbers = {name: k for k, name in enumerate(table.ids)}
    whats = {LETTERS[what]: what for what in (TRANSMITTED, REFLECTED, TOTAL)}
    lists: set[Order] = set()
    for sequence in filter(str.strip, text.split(";")):
        # "a|b:T" is a step with two alternatives
        steps = []
        for word in event_words(sequence.strip()):
            names, _, letter = word.rpartition(":")
            if letter not in whats:
                raise MistrayError(
                    f"detector '{table.ids[detector]}': '{word}' of its design_path ends in none of :T :R :I; write "
                    "'surface:T'"
                )
            unknown = [name for name in names.split("|") if name not in numbers]
            if unknown:
                raise MistrayError(
                    f"detector '{table.ids[detector]}': its design_path names '{unknown[0]}', which is not a surface; "
                    "give ids of shapes"
                )
            steps.append([event_of(numbers[name], whats[letter]) for name in names.split("|")])
        if prod(map(len, steps)) > MOST_COMBINED:
            raise MistrayError(
                f"detector '{table.ids[detector]}': its design_path stands for {prod(map(len, steps))} sequences; give "
                f"at most {MOST_COMBINED}"
            )
        lists |= set(product(*steps))
    return tuple(sorted(lists))


def has_optics(table: SurfaceTable) -> bool:
    """True if a scene has a face that transmits, such as that of a lens or window, or a declared mirror."""
    return bool(_Rules(table).optical.any())


def _alternatives(rules: _Rules, orders: Counter[Order]) -> tuple[Order, list[Order]]:
    """Return the main order of an arm, and all its orders that are design sequences, the main one among them."""
    # Orders with the same powered surfaces; of the frequent ones those over most optics
    kinds: dict[tuple[Hashable, ...], Counter[Order]] = {}
    for order, count in orders.items():
        kinds.setdefault(rules.pattern(rules.powered(order)), Counter())[order] = count
    total = orders.total()
    most = max(kinds, key=lambda kind: kinds[kind].total())
    candidates = [most, *(kind for kind, members in kinds.items() if members.total() >= SEEN * total)]
    alike = kinds[max(candidates, key=lambda kind: (rules.optics_of(max(kinds[kind])), kinds[kind].total()))]
    # Among these, plates may be passed or missed if enough probes do
    shapes: dict[tuple[Hashable, ...], Counter[Order]] = {}
    for order, count in alike.items():
        shapes.setdefault(rules.pattern(rules.without_rings(order)), Counter())[order] = count
    main = max(shapes.values(), key=lambda members: members.total())
    kept = [members for members in shapes.values() if members is main or members.total() >= PLATED * total]
    return max(main, key=lambda order: (main[order], order)), [order for members in kept for order in members]


class _Rules:
    """Rules that decide which orders of events over the surfaces of a scene are design sequences."""

    def __init__(self, table: SurfaceTable) -> None:
        words = table.optics.host_words
        mirror, ring = (words & MIRROR) != 0, (words & DIFFRACTS) != 0
        self._table, self._opaque, self._mirror, self._ring = table, (words & OPAQUE) != 0, mirror, ring
        self._wall = ((words & WALL) != 0) & ~mirror & ~ring
        sensors = np.isin(np.arange(table.count), table.detectors)
        self.optical = (~self._opaque | mirror) & ~self._wall & ~ring & ~sensors
        # Sorted, so that a face matches its alternatives whichever way round it is declared
        self._media = np.sort(
            np.stack([(words >> FRONT_MEDIUM_SHIFT) & MEDIUM_MASK, (words >> BACK_MEDIUM_SHIFT) & MEDIUM_MASK]), axis=0
        )

    def images(self, order: Order) -> bool:
        """True if light of an event sequence may form an image: it passes optics, meets no wall and is no ghost."""
        places = [place_of(code) for code in order]
        if not any(self.optical[k] for k in places) or any(self._wall[k] for k in places):
            return False
        # Ghosts: a surface met again without a full reflection since, or a second reflection at a beam splitter
        split: set[int] = set()
        since: dict[int, bool] = {}  # surface → whether the light was wholly reflected since it met it
        for code in order:
            place = place_of(code)
            if not since.get(place, True) or (code in split and self.splits(code)):
                return False
            split.add(code)
            if self._turns(code):
                since = dict.fromkeys(since, True)
            since[place] = False
        return True

    def _turns(self, code: int) -> bool:
        """True if an event is a total reflection, or a specular reflection at a mirror or an opaque surface."""
        what, place = kind_of(code), place_of(code)
        return what == TOTAL or (what == REFLECTED and bool(self._opaque[place] or self._mirror[place]))

    def splits(self, code: int) -> bool:
        """True if an event is a reflection at a transparent surface, or the transmission of a partial mirror."""
        what, place = kind_of(code), place_of(code)
        return not self._opaque[place] and what == (TRANSMITTED if self._mirror[place] else REFLECTED)

    def optics_of(self, order: Order) -> int:
        """Return the number of events of `powered` that are transmissions, or are at declared mirrors."""
        steps = self.powered(order)
        return sum(kind_of(code) == TRANSMITTED or bool(self._mirror[place_of(code)]) for code in steps)

    def without_rings(self, order: Order) -> Order:
        """Return an event sequence without the events at ring-shaped edge faces of lenses."""
        return tuple(code for code in order if not self._ring[place_of(code)])

    def powered(self, order: Order) -> Order:
        """Return an event sequence without the events at ring-shaped edge faces and plane-parallel plates."""
        kept: list[int] = []
        for code in self.without_rings(order):
            if kept and self._plate(kept[-1], code):
                kept.pop()
            else:
                kept.append(code)
        return tuple(kept)

    def _plate(self, first: int, second: int) -> bool:
        """True if two consecutive events are the passage of light through a plane-parallel plate."""
        a, b = place_of(first), place_of(second)
        passes = kind_of(first) == kind_of(second) == TRANSMITTED
        if not passes or a == b or not is_plane(self._table, a) or not is_plane(self._table, b):
            return False
        return bool(np.linalg.norm(np.cross(*self._table.rotations[[a, b], :, 2])) < PARALLEL)

    def pattern(self, order: Order) -> tuple[Hashable, ...]:
        """Return a hashable key for each step of an event sequence; sequences of equal keys are alternatives."""
        return tuple(self._step(code) for code in order)

    def _step(self, code: int) -> Hashable:
        """
        Return the kind of event at a step, with what alternatives of the step must have in common.

        These are the media on both sides. For a reflection at an opaque surface it is the coating, or that all are
        mirrors.
        """
        what, place = kind_of(code), place_of(code)
        if what == REFLECTED and self._opaque[place]:
            # Undeclared mirrors are alternatives only where they have the same coating
            return what, True if self._mirror[place] else self._table.interfaces[place].coating
        return what, *self._media[:, place].tolist()

    def without_some_rings(self, order: Order) -> Iterator[Order]:
        """
        Yield an event sequence with every subset of its ring-shaped edge faces left out, the empty one included.

        With more than `MOST_RINGS` such faces only the sequence itself is yielded.
        """
        rings = [k for k, code in enumerate(order) if self._ring[place_of(code)]]
        if len(rings) > MOST_RINGS:
            yield order
            return
        for count in range(len(rings) + 1):
            for left_out in combinations(rings, count):
                yield tuple(code for k, code in enumerate(order) if k not in left_out)
