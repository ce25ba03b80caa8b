"""First surfaces that light meets in a scene on its way to the detector, before and after a change.

The first surface of a path is the first that the light meets, whatever happens there. Light by a first surface that was
dark before has not come through the front: a gap has opened, or a shading part is gone.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mistray.estimate import Estimate
from mistray.ids import event_words
from mistray.percent import percent_text
from mistray.recorders.path_events import DIRECT

if TYPE_CHECKING:
    from mistray.trace import Trace

NONE = 0.01  # a surface counts as dark before if it had less than this fraction of its light after
LEAST, SURE = 1e-3, 3.0  # fraction of the light after, and standard errors, that a new first surface must exceed
SPOILS = 0.01  # fraction of the light after and before; more light by new first surfaces makes a decrease no gain
TOLD = 3  # surfaces named in a sentence, and places listed


@dataclass(frozen=True)
class Entering:
    """
    Light that first meets a surface which no light met first before a change of the scene.

    Attributes
    ----------
    surface : str
        Id of the first surface that the light meets; the detector's if it meets no other.
    share, share_se : float
        Fraction of the light after the change, and its standard error. The light is all stray light, with direct light
        by such surfaces.
    of_before : float
        Ratio of this light to all stray light before the change. After a change that removes most of the light, a large
        fraction of the rest may be new.
    """

    surface: str
    share: float
    share_se: float
    of_before: float


@dataclass(frozen=True)
class FirstLight:
    """
    Light on the detector, sorted by the first surface that it met in the scene.

    Attributes
    ----------
    power, variance, direct, strongest : dict of str to float
        Power of all paths and its variance, power of the direct image, and power of the strongest path, by surface, in
        W and W², or in any other unit and its square.
    unseen : float
        Upper bound of the power of each path that is left out, in the same unit.
    """

    power: Mapping[str, float]
    variance: Mapping[str, float]
    direct: Mapping[str, float]
    strongest: Mapping[str, float]
    unseen: float = 0.0

    @classmethod
    def of_trace(cls, t: Trace) -> FirstLight:
        """Return the light of a trace by its first surfaces, as flux that the detector absorbs, W."""
        events, kinds, power = t.paths.column("events"), t.paths.column("kind"), t.paths.column("power_W")
        first = first_surfaces(events)
        errors = {name: t.paths.power(np.flatnonzero(first == name))[1] ** 2 for name in dict.fromkeys(first)}
        return cls.of_paths(first, power, kinds == DIRECT, errors)

    @classmethod
    def of_paths(
        cls,
        first: np.ndarray,
        power: np.ndarray,
        direct: np.ndarray,
        variance: Mapping[str, float],
        unseen: float = 0.0,
    ) -> FirstLight:
        """
        Return the light of paths by their first surfaces.

        Parameters
        ----------
        first : (n,) array of str
            Id of the first surface of each path, see `first_surfaces`.
        power : (n,) float array
            Power of each path in any unit, in whose square the variance is.
        direct : (n,) bool array
            Whether each path belongs to the direct image.
        variance : mapping of str to float
            Variance of the power, by surface.
        unseen : float
            Upper bound of the power of each path that is left out, in the same unit.
        """
        here = {name: first == name for name in dict.fromkeys(first)}
        return cls(
            {name: float(power[some].sum()) for name, some in here.items()},
            dict(variance),
            {name: float(power[some & direct].sum()) for name, some in here.items()},
            {name: float(power[some].max()) for name, some in here.items()},
            unseen,
        )

    def plus(self, other: FirstLight) -> FirstLight:
        """
        Return the sum of this light and that of another, independent trace, by first surface.

        The strongest paths and `unseen` are not added: the larger value of both traces is kept.
        """
        strongest = {
            name: max(one.strongest.get(name, 0.0) for one in (self, other)) for name in (*self.power, *other.power)
        }
        return FirstLight(
            _added(self.power, other.power),
            _added(self.variance, other.variance),
            _added(self.direct, other.direct),
            strongest,
            max(self.unseen, other.unseen),
        )

    def since(self, before: FirstLight) -> tuple[Entering, ...]:
        """
        Return the surfaces that light meets first now but did not before, the strongest first.

        Parameters
        ----------
        before : FirstLight
            Light before the change, in the same unit and at the same field angle.

        Returns
        -------
        tuple of Entering
            New first surfaces; empty if either light is dark. A surface counts if less than 1 % of its light was there
            before, and if its light is at least 0.1 % of all light and three standard errors. If paths were left out
            before, one path must exceed `unseen`.
        """
        if not before.power or not self.power:
            return ()
        new = [
            name
            for name, value in self.power.items()
            if before.power.get(name, 0.0) < NONE * value
            and (name in before.power or self.strongest[name] > before.unseen)
        ]
        whole = sum(value - (0.0 if name in new else self.direct[name]) for name, value in self.power.items())
        stray = sum(value - before.direct[name] for name, value in before.power.items())
        found = [
            Entering(
                name,
                self.power[name] / whole,
                math.sqrt(self.variance[name]) / whole,
                self.power[name] / stray if stray > 0 else math.inf,
            )
            for name in new
        ]
        told = (one for one in found if one.share > max(LEAST, SURE * one.share_se))
        return tuple(sorted(told, key=lambda one: -one.share))


def together(entering: Iterable[Entering]) -> Estimate:
    """
    Return the fraction of the light after a change that enters by new first surfaces, with its standard error.

    Errors are added in quadrature.
    """
    found = list(entering)
    return Estimate(sum(one.share for one in found), math.sqrt(sum(one.share_se**2 for one in found)))


def spoils(entering: Iterable[Entering]) -> bool:
    """
    True if light by new first surfaces exceeds 1 % of the light, both before and after the change.

    A decrease is then no improvement.
    """
    found = list(entering)
    return min(together(found).value, sum(one.of_before for one in found)) > SPOILS


def entering_text(entering: Sequence[Entering]) -> str:
    """Return the end of a sentence: "93 % (± 1 %) of the light after first meets L3_front (80 %): none did before"."""
    share, se = together(entering)
    named = [f"{one.surface} ({percent_text(one.share)})" for one in entering[:TOLD]]
    more = [f"{len(entering) - TOLD} more"] if len(entering) > TOLD else []
    return (
        f"{percent_text(share, 3)} (± {percent_text(se)}) of the light after first meets "
        f"{', '.join([*named, *more])}: none did before"
    )


def entering_lines(entering: Mapping[str, Sequence[Entering]]) -> list[str]:
    """
    Return lines about light by new first surfaces: one for each of the worst places, one for the rest.

    There is no line if there is no such light.
    """
    ranked = sorted(entering.items(), key=lambda item: -sum(one.of_before for one in item[1]))
    lines = [
        f"{place}: {entering_text(here)}{'; less stray light is no gain here' if spoils(here) else ''}"
        for place, here in ranked[:TOLD]
    ]
    more = len(ranked) - TOLD
    return [*lines, f"{more} more with less of such light"] if more > 0 else lines


def first_surfaces(events: Iterable[str]) -> np.ndarray:
    """Return the id of the first surface of each event list, (n,) array of str."""
    return np.array([event_words(text)[0].rpartition(":")[0] for text in events], dtype=object)


def _added(one: Mapping[str, float], other: Mapping[str, float]) -> dict[str, float]:
    return {name: one.get(name, 0.0) + other.get(name, 0.0) for name in (*one, *(k for k in other if k not in one))}
