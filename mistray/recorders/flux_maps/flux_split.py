"""Split of the light that meets surfaces: absorbed, specular and scattered, reflected and transmitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.recorders.flux_maps.cells import SurfaceLight
from mistray.recorders.recorder import Memory, Visit
from mistray.surfaces.surfaces import SurfaceTable
from mistray.surfaces.upload import upload

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class SplitRow:
    """
    Fluxes into which the light that meets one surface is split, each with its standard error, W.

    Attributes
    ----------
    surface, part : str
        Id of the surface, and name of the part that it belongs to.
    incident : (float, float)
        Incident flux on both sides; light that comes back contributes again.
    absorbed, specular_reflection, specular_transmission, scattered_reflection, scattered_transmission : (float, float)
        Fluxes that add up to `incident`, whatever `ray_control` and `cut_below` leave out. Totally reflected light is a
        specular reflection.

    Examples
    --------
    >>> split = mistray.recorders.FluxSplit("split", surfaces="detector")
    >>> t = mistray.trace(mistray.load("lens_and_window"), rays=10_000, recorders=[split])
    >>> (row,) = split.rows
    >>> print(f"{row.absorbed[0] / row.incident[0]:.2f} of the light is absorbed")
    0.80 of the light is absorbed
    """

    surface: str
    part: str
    incident: tuple[float, float]
    absorbed: tuple[float, float]
    specular_reflection: tuple[float, float]
    specular_transmission: tuple[float, float]
    scattered_reflection: tuple[float, float]
    scattered_transmission: tuple[float, float]

    @property
    def closure(self) -> float:
        """Relative closure error, (sum of the fluxes - incident)/incident; 0 where there is no light."""
        parts = sum(getattr(self, name)[0] for name in SHARES[1:])
        return (parts - self.incident[0]) / self.incident[0] if self.incident[0] else 0.0


SHARES = tuple(f.name for f in fields(SplitRow))[2:]


class FluxSplit(SurfaceLight):
    """
    Recorder of the split of light at surfaces: absorbed, specular and scattered, reflected and transmitted flux.

    It is given to `mistray.trace` among ``recorders``. The split fractions are those of the surface: R, T and TIS at
    the angle, side and polarisation of each ray. They do not depend on whether the trace follows the light further or a
    limit cuts it, and have no noise of their own. Lenses, mirrors, walls, meshes and Mitsuba's own shapes are treated
    alike.

    Parameters
    ----------
    name : str
        Name in the trace, see `mistray.trace.Trace.recorders`.
    surfaces : str or sequence of str
        Patterns of ids of surfaces or of parts, with ``*``, ``?`` and ``[…]``; none: all surfaces.

    Raises
    ------
    MistrayError
        If the name is blank; during the trace, if a pattern names no surface or an earlier trace was of other surfaces.

    Examples
    --------
    >>> split = mistray.recorders.FluxSplit("split", surfaces="L1_*")
    >>> t = mistray.trace(mistray.load("lens_and_window"), rays=10_000, recorders=[split])
    >>> for row in split.rows[:2]:
    ...     print(f"{row.surface}: {row.specular_reflection[0] / row.incident[0]:.3f} reflected")
    L1_front: 0.042 reflected
    L1_rear: 0.042 reflected
    """

    kind, unit = "flux split", "W"

    kernel_by = ("cells",)

    def __init__(self, name: str, surfaces: str | Sequence[str] = ()) -> None:
        super().__init__(name, surfaces, len(SHARES))

    def lay_out(self, table: SurfaceTable) -> None:
        """Allocate one sum for each flux of `SplitRow` and each surface that matches the patterns."""
        numbers = self.chosen(table)
        self.resize(len(SHARES) * len(numbers))
        # Number of each chosen surface plus one; 0 for the others
        place = np.zeros(table.count, dtype=np.uint32)
        place[numbers] = np.arange(1, len(numbers) + 1)
        self._place, self._rims = upload(mi.UInt32, place), table.wall_rims

    def visit(self, visit: Visit, memory: Memory) -> None:
        """
        Add the incident flux of hits, and its absorbed, specular and scattered parts, to the sums by surface.

        At the rims of walls all light is absorbed.
        """
        it, budget = visit.interaction, visit.shares
        place = dr.gather(mi.UInt32, self._place, visit.surface, visit.active)
        active = visit.active & (place > 0)
        on = active
        if self._rims.some:  # there walls absorb all light
            on = active & ~self._rims.at_rim(visit.surface, it.local, active)
        # Split fractions of the specular beams: R and T, without the scattered flux
        reflected, transmitted = it.R, it.T
        if budget is not None:
            reflected, transmitted = it.R * budget.reflection.kept, it.T * budget.transmission.kept
        # Cells in the order of `SHARES`
        cell = (place - 1) * len(SHARES)
        self.add(visit.start, cell, visit.weight, active)
        self.add(visit.start, cell + 1, visit.weight * dr.maximum(visit.loss, 0), active)
        self.add(visit.start, cell + 2, visit.weight * reflected, on)
        self.add(visit.start, cell + 3, visit.weight * transmitted, on)
        if budget is not None:
            self.add(visit.start, cell + 4, visit.weight * budget.reflection.scattered, on)
            self.add(visit.start, cell + 5, visit.weight * budget.transmission.scattered, on)

    @property
    def rows(self) -> list[SplitRow]:
        """
        Split of the light at each surface, in the order of the scene; fluxes in W.

        Raises
        ------
        MistrayError
            If nothing has been traced yet.
        """
        value, se = self.image
        return [
            SplitRow(surface, part, *zip(value[k].tolist(), se[k].tolist(), strict=True))
            for k, (surface, part) in enumerate(self._names)
        ]

    def to_pandas(self) -> pd.DataFrame:
        """
        Return a table with one row per surface.

        The columns are ``surface``, ``part``, and for each flux of `SplitRow` ``…_W`` and its standard error
        ``…_se_W``, both in W.

        Raises
        ------
        MistrayError
            Before the first trace.
        """
        import pandas as pd

        value, se = self.image
        table = pd.DataFrame(self._names, columns=["surface", "part"])
        for k, name in enumerate(SHARES):
            table[f"{name}_W"], table[f"{name}_se_W"] = value[:, k], se[:, k]
        return table

    @property
    def power(self) -> tuple[float, float]:
        """Total flux that meets all chosen surfaces and its standard error, W."""
        # `incident` is the first share of each surface
        return self.flux[:: len(SHARES)].whole

    @property
    def image(self) -> tuple[np.ndarray, np.ndarray]:
        """Fluxes of each surface, in the order of `SHARES`, and their standard errors, (surfaces, 6) each, W."""
        return self.flux.reshaped(-1, len(SHARES)).with_se
