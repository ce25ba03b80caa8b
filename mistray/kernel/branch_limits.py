"""Optional limits on branches of the ray tree, which add no code unless set; `branching` has Russian roulette."""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi

from mistray.kernel.interaction import Interaction, counts_as_reflection
from mistray.recorders.tallies import CONSECUTIVE, CONTROL, CUT_BRANCHES, GENERATIONS
from mistray.settings import BRANCHES, NO_LIMIT, Settings
from mistray.surfaces.optics import MIRROR

Cut = Callable[[int | mi.UInt32, mi.UInt32, mi.Float, mi.Bool], None]

# Run of consecutive hits of one surface in a word: the surface, and above it the number of hits
RUN_SHIFT, SURFACE_MASK = 16, 0xFFFF
NO_RUN = SURFACE_MASK
ABSORPTION = list(BRANCHES).index("A")


class BranchLimits:
    """
    Limits on branches of the ray tree: `ray_control`, `max_generations`, `cut_below` and `max_consecutive`.

    Parameters
    ----------
    settings : Settings
        Settings of the trace, after `Settings.with_unit`.
    cut : callable
        Function that records cut flux, see `mistray.recorders.recorder.Recorder.cut`.
    batch : mi.UInt32
        Index of the batch of each start ray.
    """

    def __init__(self, settings: Settings, cut: Cut, batch: mi.UInt32) -> None:
        self._record, self._batch = cut, batch
        self._allowed = frozenset(settings.allowed)
        self._controls = settings.ray_control != "allow_all"
        self._generations, self._consecutive = (
            dr.opaque(mi.UInt32, limit) if is_set else None
            for limit, is_set in (
                (settings.max_generations, settings.max_generations < NO_LIMIT),
                (settings.max_consecutive, settings.limits_consecutive),
            )
        )
        given = [*zip(settings.cut_below, settings.cut_below_W, strict=True)]
        self._below = [tuple(dr.opaque(mi.Float, limit) for limit in limits) for limits in given]
        self._cuts_branches, self._cuts_absorption = any(map(any, given[:ABSORPTION])), any(given[ABSORPTION])

    def _cut(self, channel: int | mi.UInt32, flux: mi.Float, active: mi.Bool) -> None:
        self._record(channel, self._batch, flux, active & (flux > 0))

    def _least(self, branch: int, scale: mi.Float) -> mi.Float:
        """Return the throughput below which branches of this index in `BRANCHES` end; `scale` is `StartRays.scale`."""
        relative, absolute = self._below[branch]
        return dr.maximum(relative * scale, absolute)

    def absorb(self, absorbed: mi.Float, active: mi.Bool, scale: mi.Float) -> tuple[mi.Float, mi.Bool]:
        """
        Return the throughput absorbed at hits, in units of a start ray's flux, and a mask of hits to count.

        Absorption that `ray_control` forbids, or that is below its threshold, is recorded as cut. Then the throughput
        is 0, and the hit does not count. `scale` is `StartRays.scale`.
        """
        if "A" not in self._allowed:
            self._cut(CONTROL, absorbed, active)
            return mi.Float(0), mi.Bool(False)
        if not self._cuts_absorption:
            return absorbed, mi.Bool(True)
        # A faint absorption is cut: it enters neither the surface nor the detector
        faint = absorbed < self._least(ABSORPTION, scale)
        self._cut(CUT_BRANCHES + ABSORPTION, absorbed, active & faint)
        return dr.select(faint, 0, absorbed), ~faint

    def follow(
        self, it: Interaction, generations: mi.UInt32, flux: tuple[mi.Float, ...], active: mi.Bool
    ) -> tuple[mi.Float, ...]:
        """
        Return a node's transmitted, reflected and scattered fluxes after the limits on event types and generations.

        Parameters
        ----------
        it : Interaction
            Interaction at the hits.
        generations : mi.UInt32
            Number of reflections and scatter events before the node.
        flux : tuple of four mi.Float
            Fluxes in units of the start ray's: transmitted, reflected, scattered by the surface, and scattered by the
            medium in front of it.
        active : mi.Bool
            Lanes whose cut flux enters the energy ledger.
        """
        # Events that `ray_control` allows: I total, M mirror and R other reflection, T transmission, r and t scatter
        if self._controls:
            total, mirror, other, through = (mi.Bool(letter in self._allowed) for letter in "IMRT")
            reflects = dr.select(it.tir, total, dr.select((it.word & MIRROR) != 0, mirror, other))
            scatters = mi.Bool(bool(self._allowed & set("rt")))  # one side of two: see `end`
            flux = self._keep(CONTROL, flux, (through, reflects, scatters, mi.Bool("t" in self._allowed)), active)
        # Generations: transmissions, total and design reflections are none
        if self._generations is not None:
            young = generations < self._generations
            kept = mi.Bool(True), young | ~counts_as_reflection(it), young, young
            flux = self._keep(GENERATIONS, flux, kept, active)
        return flux

    def _keep(
        self, channel: int, flux: tuple[mi.Float, ...], kept: tuple[mi.Bool, ...], active: mi.Bool
    ) -> tuple[mi.Float, ...]:
        parts = list(zip(flux, kept, strict=True))
        self._cut(channel, sum((dr.select(keep, 0, value) for value, keep in parts), mi.Float(0)), active)
        return tuple(dr.select(keep, value, 0) for value, keep in parts)

    def end(
        self,
        child: mi.Float,
        scatter: mi.Bool,
        by_medium: mi.Bool,
        reflect: mi.Bool,
        active: mi.Bool,
        contributes: mi.Bool,
        scale: mi.Float,
    ) -> mi.Float:
        """
        Return the flux of each branch, in units of the start ray's, or 0 where a limit on single branches ends it.

        Parameters
        ----------
        child : mi.Float
            Flux of the branch before these limits.
        scatter, by_medium, reflect : mi.Bool
            Whether the surface scattered the branch, whether the medium did, and whether it stays on the side of
            incidence.
        active, contributes : mi.Bool
            Lanes that have a branch, and lanes whose flux enters the energy ledger.
        scale : mi.Float
            See `StartRays.scale`.
        """
        active = active & contributes
        # One side of scatter refused: known only when the direction is sampled
        if len(self._allowed & set("rt")) == 1:
            refused = scatter & (reflect if "t" in self._allowed else ~reflect)
            self._cut(CONTROL, child, active & refused)
            child = dr.select(refused, 0, child)
        # Thresholds by kind of branch, in the order of `BRANCHES`
        if self._cuts_branches:
            scattered = scatter | by_medium
            back, on, scattered_back, scattered_on = (self._least(branch, scale) for branch in range(ABSORPTION))
            limit = dr.select(
                reflect, dr.select(scattered, scattered_back, back), dr.select(scattered, scattered_on, on)
            )
            number = dr.select(reflect, mi.UInt32(0), 1) + dr.select(scattered, mi.UInt32(2), 0)
            weak = child < limit
            self._cut(CUT_BRANCHES + number, child, active & weak)
            child = dr.select(weak, 0, child)
        return child

    def arrive(self, run: mi.UInt32, surface: mi.UInt32, flux: mi.Float, hit: mi.Bool, contributes: mi.Bool) -> mi.Bool:
        """
        Return the mask `hit` without rays that met one surface more often in a row than `max_consecutive` allows.

        `run` is the result of `run_after`. The `flux` of rays left out is recorded as cut, where it `contributes`.
        """
        if self._consecutive is None:
            return hit
        over = hit & ((run & SURFACE_MASK) == surface) & ((run >> RUN_SHIFT) >= self._consecutive)
        self._cut(CONSECUTIVE, flux, over & contributes)
        return hit & ~over

    def run_after(self, run: mi.UInt32, surface: mi.UInt32, by_medium: mi.Bool) -> mi.UInt32:
        """
        Return the count of consecutive hits of a surface, packed with the surface's index, after one more hit.

        Scatter in a medium resets it. Where `max_consecutive` sets no limit, `run` is returned as it is.
        """
        if self._consecutive is None:
            return run
        # Another surface starts a new run
        times = dr.select((run & SURFACE_MASK) == surface, run >> RUN_SHIFT, 0) + 1
        return dr.select(by_medium, NO_RUN, surface | (times << RUN_SHIFT))
