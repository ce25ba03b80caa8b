"""Light that is scattered from one direction into another, and a lobe as seen from both sides of a surface."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from mistray.physics.diffraction import obliquity
from mistray.plugins.bsdfs.sample_axis import SampleFrame
from mistray.scatter import Lobe


@dataclass(frozen=True)
class Pair:
    """
    Light from i that is scattered into s, local frame, with the indices on the sides of i and of the other one.

    Where a lobe is anisotropic, also how the sample lies.
    """

    i: mi.Vector3f
    s: mi.Vector3f
    n_in: mi.Float
    n_out: mi.Float
    sample: SampleFrame | None = None

    @property
    def eta(self) -> mi.Float:
        """n_in/n_out."""
        return self.n_in / self.n_out

    @property
    def from_back(self) -> mi.Bool:
        """Whether the light comes from the back."""
        return self.i.z > 0

    @property
    def reflected(self) -> mi.Bool:
        """Whether both directions lie on one side."""
        return self.i.z * self.s.z > 0

    @property
    def cos_i(self) -> mi.Float:
        """Cosine of incidence."""
        return dr.abs(self.i.z)

    @property
    def cos_s(self) -> mi.Float:
        """Cosine of scatter."""
        return dr.abs(self.s.z)

    def refracted(self) -> mi.Vector3f:
        """The refracted direction; z is 0 where there is none."""
        x, y = -self.eta * self.i.x, -self.eta * self.i.y
        return mi.Vector3f(x, y, -dr.mulsign(cosine(x, y), self.i.z))

    def centre(self, lobe: Lobe) -> mi.Vector3f:
        """The direction in the middle of a lobe."""
        if lobe.centre == "normal":
            return mi.Vector3f(0, 0, 1)
        if lobe.centre == "retro":
            return self.i
        return mi.Vector3f(-self.i.x, -self.i.y, self.i.z) if lobe.event == "reflection" else self.refracted()

    def r2(self, lobe: Lobe) -> mi.Float:
        """Squared distance of s from the centre of a lobe."""
        d = self.s - self.centre(lobe)
        return dr.squared_norm(d if lobe.measure == "angle" else d.xy)


@dataclass(frozen=True)
class Slot:
    """
    A lobe of a model for light from either side, or for one side only.

    Attributes
    ----------
    plugin : Scatterer
    lobes : tuple of Lobe or None
        For light from the front and from the back; alike but for profile, shares and depth.
    numbers : tuple of int
        Their places among the lobes of the model.
    tables : tuple of int
        Numbers of their tables.
    totals : tuple of float
        Of the tables; 0 where there is no lobe.
    """

    plugin: Any
    lobes: tuple[Lobe | None, Lobe | None]
    numbers: tuple[int, int]
    tables: tuple[int, int]
    totals: tuple[float, float]

    @property
    def lobe(self) -> Lobe:
        """The lobe of either side."""
        found = self.lobes[0] or self.lobes[1]
        assert found is not None
        return found

    @property
    def number(self) -> int:
        """Its place among the lobes of the model."""
        return self.numbers[0] if self.lobes[0] is not None else self.numbers[1]

    def of_side(self, from_back: mi.Bool, of: Callable[[Lobe], float]) -> mi.Float:
        """A number of the lobe for the side the light comes from; 0 where there is none."""
        front, back = (0.0 if lobe is None else of(lobe) for lobe in self.lobes)
        return mi.Float(front) if front == back else dr.select(from_back, mi.Float(back), mi.Float(front))

    def table(self, from_back: mi.Bool) -> mi.UInt32:
        """Number of the table for the side the light comes from."""
        front, back = self.tables
        return mi.UInt32(front) if front == back else dr.select(from_back, mi.UInt32(back), mi.UInt32(front))

    def total(self, from_back: mi.Bool) -> mi.Float:
        """Total of the table for the side the light comes from."""
        front, back = self.totals
        return mi.Float(front) if front == back else dr.select(from_back, mi.Float(back), mi.Float(front))

    def coefficient(self, x: mi.Float, from_back: mi.Bool) -> mi.Float:
        """c0 + c1 X + c2 X²."""
        c0, c1, c2 = (self.of_side(from_back, lambda lobe, k=k: lobe.shares[k]) for k in range(3))
        return c0 + x * (c1 + x * c2)

    def oblique(self, cos_i: mi.Float, from_back: mi.Bool) -> mi.Float:
        """As `Lobe.oblique`."""
        if self.lobe.measure == "cosines":
            return mi.Float(1)
        limit = self.of_side(from_back, lambda lobe: min(lobe.oblique_limit, 1e30))
        return dr.minimum(dr.rcp(dr.maximum(cos_i, 1e-30)), limit)


def cosine(x: mi.Float, y: mi.Float) -> mi.Float:
    """Z of a unit vector; 0 if there is none."""
    return dr.safe_sqrt(1 - dr.fma(x, x, y * y))


def factor(lobe: Lobe, pair: Pair) -> mi.Float:
    """The lobe's factor for two directions."""
    if lobe.factor == "edge":
        return obliquity(dr.abs(pair.centre(lobe).z), pair.cos_s, pair.r2(lobe))
    if lobe.factor == "cosine":
        return pair.cos_s
    if lobe.factor == "ghs":
        return 0.25 * dr.square(pair.cos_i + pair.cos_s)
    return pair.cos_i * pair.cos_s if lobe.factor == "rayleigh_rice" else mi.Float(1)
