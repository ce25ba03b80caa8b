"""Device tables of surfaces that are defined by an implicit function F = 0, a formula of their family."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.surfaces.surface import TracedSurface
from mistray.surfaces.upload import upload


class FamilyTable:
    """
    Device table of surfaces that are defined by an implicit function F = 0, a formula of their family.

    Without such surfaces the table is False and adds nothing to a kernel. Such a surface has `family` and `values`. Its
    family has `numbers`, the names of the parameters, and the functions `residual`, `gradient` and `coordinate`.

    Parameters
    ----------
    pieces : sequence of TracedSurface
        All analytic surfaces of the scene.
    count : int
        Number of all surfaces of the scene.
    """

    def __init__(self, pieces: Sequence[TracedSurface], count: int) -> None:
        own: list[Any] = [piece for piece in pieces if hasattr(piece, "family")]
        self.families = list(dict.fromkeys(piece.family for piece in own))
        self._vectors = -(-max((len(family.numbers) for family in self.families), default=0) // 4)
        numbers, rows = np.zeros(count, dtype=np.uint32), np.zeros((count, 4 * self._vectors))
        for piece in own:
            numbers[piece.index] = 1 + self.families.index(piece.family)
            values = [piece.values[name] for name in piece.family.numbers]
            rows[piece.index, : len(values)] = values
        if own:
            self._numbers, self._rows = upload(mi.UInt32, numbers), upload(mi.Float, rows)

    def __bool__(self) -> bool:
        return bool(self.families)

    def members(self, s: mi.UInt32, active: mi.Bool) -> Iterator[tuple[mi.Bool, Any]]:
        """Yield a mask of the lanes whose surface s belongs to a family, and the family, for each in the scene."""
        number = dr.gather(mi.UInt32, self._numbers, s, active) if self.families else None
        for k, family in enumerate(self.families, start=1):
            yield active & (number == k), family

    def holds(self, s: mi.UInt32, active: mi.Bool) -> mi.Bool:
        """Return a mask of the lanes whose surface s belongs to any of the families."""
        return active & (dr.gather(mi.UInt32, self._numbers, s, active) > 0) if self.families else mi.Bool(False)

    def numbers(self, family: Any, s: mi.UInt32, here: mi.Bool) -> dict[str, mi.Float]:
        """Return the parameter values of a family by name, for the lanes in `here` whose surface s belongs to it."""
        vectors = [
            dr.gather(mi.Vector4f, self._rows, self._vectors * s + k, here) for k in range(-(-len(family.numbers) // 4))
        ]
        values = (vector[k] for vector in vectors for k in range(4))
        return dict(zip(family.numbers, values, strict=False))
