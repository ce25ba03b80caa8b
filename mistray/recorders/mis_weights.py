"""
MIS weights of paths that several techniques find: forward rays, backward rays, and connections of backward rays.

The weights are those of the balance heuristic (E. Veach, Robust Monte Carlo methods for light transport simulation,
1997, section 9.2). Recorders ask for them by the protocols below.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import mitsuba as mi

from mistray.recorders.recorder import Departure, Visit


class MisWeights(NamedTuple):
    """
    MIS weights of a path for the techniques that find it; they add up to 1.

    Attributes
    ----------
    forward : mi.Float
        MIS weight of forward rays.
    backward : mi.Float
        MIS weight of backward rays. It is also the factor of a connected ray, whose throughput f/p_backward is that of
        a backward ray on the same path: f/p_connected · w_connected = f/p_backward · w_backward. 0 for a connected ray
        that leaves on another path than that of its light vertex.
    connected : mi.Float
        MIS weight of connections of backward rays to light vertices; 0 where there are none.
    """

    # w_i = n_i p_i/Σ n_k p_k, see `mistray.sampling.sharing.balance`

    forward: mi.Float
    backward: mi.Float
    connected: mi.Float


class MisWeighting(Protocol):
    """Interface to MIS weights of paths; see `mistray.sampling.sharing.balance.Balance`."""

    def backward(self, departure: Departure, cell: mi.UInt32, active: mi.Bool) -> MisWeights:
        """Return the MIS weights of the paths of backward rays that leave the scene within a cell of directions."""

    def forward(self, visit: Visit) -> MisWeights:
        """Return the MIS weights of the paths of forward rays that meet the detector; each starts from its cell."""


class StartMisWeighting(MisWeighting, Protocol):
    """Interface to MIS weights, and to the points where forward rays would start on the paths of backward rays."""

    def start_of(self, departure: Departure, cell: mi.UInt32, active: mi.Bool) -> list[mi.Float]:
        """Return the points in the unit cube of a cell where forward rays would start on the paths of backward rays."""

    def density(self, cell: mi.UInt32, point: list[mi.Float], active: mi.Bool) -> mi.Float:
        """Return the pdf of forward start rays at points in the unit cube of a cell."""
