"""What recorders ask of paths that rays of both directions may find: which share of one each of them counts."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import mitsuba as mi

from mistray.recorders.recorder import Departure, Visit


class PathShares(NamedTuple):
    """
    Shares of a path between the rays that find it; they add up to 1.

    Attributes
    ----------
    along : mi.Float
        Of rays with the light.
    against : mi.Float
        Of rays against it. A connection counts as much: its weight is that of such a ray, see
        `mistray.kernel.odds.Odds.linked`. 0 for one that has gone astray.
    connected : mi.Float
        Of rays against the light that are connected to points of it; 0 where there are none.
    """

    along: mi.Float
    against: mi.Float
    connected: mi.Float


class Weighing(Protocol):
    """Who counts a path that several rays may find; see `mistray.sampling.sharing.balance.Balance`."""

    def against(self, departure: Departure, cell: mi.UInt32, active: mi.Bool) -> PathShares:
        """Of rays against the light that leave the scene within a cell of directions."""

    def along(self, visit: Visit) -> PathShares:
        """Of rays with the light that meet the detector; each starts from its cell."""


class StartWeighing(Weighing, Protocol):
    """One that knows where rays with the light would have started on the paths of rays against it."""

    def start_of(self, departure: Departure, cell: mi.UInt32, active: mi.Bool) -> list[mi.Float]:
        """Points of the unit cube of a cell, see `mistray.sampling.plane_wave.wave_rays`."""

    def density(self, cell: mi.UInt32, point: list[mi.Float], active: mi.Bool) -> mi.Float:
        """Of the starts of rays with the light at these points."""
