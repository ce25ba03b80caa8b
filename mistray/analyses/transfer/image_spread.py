"""Recorder of the light about the image of a point: flux by class and distance, and its Fourier sums."""

from __future__ import annotations

from collections.abc import Hashable
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import numpy as np
import numpy.typing as npt

from mistray.recorders.design_sequences import DesignKeys
from mistray.recorders.flux_maps.cells import PassingLight
from mistray.recorders.path_key import COUNT_MASK, NOT_DIFFRACTED
from mistray.recorders.recorder import Memory, Visit
from mistray.recorders.sampled import Sampled

if TYPE_CHECKING:
    from mistray.kernel.kernel_scene import KernelScene

CLASSES = ("direct", "ghosts", "scatter", "diffraction")
"""Direct image; unscattered light by other ways, such as ghosts and glints; scattered light; light that edges diffract,
otherwise on the way of the direct image."""
DIRECT, GHOSTS, SCATTER, DIFFRACTION = range(4)

PER_OCTAVE = 16  # rings: the mean radius of the light of a ring of a falling profile is then right to 0.1 %


class ImageSpread(PassingLight):
    """
    Recorder of light absorbed about a point, by class: flux on rings, and sums of exp(-2πi ν·r) over the rays.

    The Fourier sums are over the rays themselves, without rings or pixels, so that their only error is that of
    the finite number of rays.

    Parameters
    ----------
    name : str
        Name of the recorder in the trace.
    point_mm : (2,) float
        Point in the frame of the detector, mm.
    first_mm, last_mm : float
        Radius of the innermost disc, and largest radius of any light, mm; `PER_OCTAVE` rings per octave lie
        between them.
    frequencies : (m, 2) float64
        Frequencies ν, 1/mm, along x and y of the detector.
    design : DesignKeys
        Sequences of the direct image.

    Attributes
    ----------
    edges_mm : (n + 1,) float64
        Borders of the rings, mm, 0 first.
    by_line : dict
        Traced wavelength, nm → flux with its noise, W, see `rings` and `waves`.
    """

    def __init__(
        self,
        name: str,
        point_mm: tuple[float, float],
        first_mm: float,
        last_mm: float,
        frequencies: npt.NDArray[np.float64],
        design: DesignKeys,
    ) -> None:
        count = int(np.ceil(PER_OCTAVE * np.log2(last_mm / first_mm))) + 1
        self.edges_mm = np.concatenate([[0.0], first_mm * 2.0 ** (np.arange(count + 1) / PER_OCTAVE)])
        self._rings, self._waves = count + 1, len(frequencies)
        self._point, self._first, self._frequencies = point_mm, first_mm, np.asarray(frequencies, dtype=np.float64)
        self.by_line: dict[float, Sampled] = {}
        self._design = design
        super().__init__(name, len(CLASSES) * (self._rings + 2 * self._waves))

    @property
    def code(self) -> Hashable:
        """Key of the compiled kernel: the class, whether there are Fourier sums, and the design sequences."""
        return type(self).__name__, self._waves > 0, self._design.code

    def attach(self, scene: KernelScene) -> None:
        """Prepare for a trace of a scene at one wavelength, with all sums at zero."""
        super().attach(scene)
        self._line = scene.table.wavelength_nm
        self._at = [dr.opaque(mi.Float, float(v)) for v in self._point]
        self._inverse = dr.opaque(mi.Float, 1 / self._first)
        self._nu = [mi.Float(np.ascontiguousarray(self._frequencies[:, k], dtype=np.float32)) for k in range(2)]
        self._count, self._number = dr.opaque(mi.UInt32, self._rings), dr.opaque(mi.UInt32, self._waves)
        dr.eval(self._nu)

    @property
    def by_ray(self) -> bool:
        """False, as no lane needs memory for a single start ray."""
        return False

    def visit(self, visit: Visit, memory: Memory) -> None:
        """Add the light that the detector absorbs at each hit to its ring and to the Fourier sums."""
        here, state = visit.counted, visit.state
        kind = dr.select(self._design.hold(state["key"], False), mi.UInt32(DIRECT), GHOSTS)
        if visit.scatters:
            word = state["scatters"]
            spread = (word & COUNT_MASK) > 0
            bent = spread & (state["reflections"] == 0) & ((word & NOT_DIFFRACTED) == 0)
            kind = dr.select(bent, DIFFRACTION, dr.select(spread, SCATTER, kind))
        x, y = (place - at for place, at in zip(visit.position, self._at, strict=True))
        base = kind * (self._count + 2 * self._number)
        r = dr.sqrt(dr.fma(x, x, y * y)) * self._inverse
        ring = mi.Int32(dr.floor(PER_OCTAVE * dr.log2(dr.maximum(r, 0.5)))) + 1
        ring = mi.UInt32(dr.clip(dr.select(r < 1, 0, ring), 0, mi.Int32(self._count) - 1))
        self.add(visit.start, base + ring, visit.absorbed, here)
        if not self._waves:
            return
        first = base + self._count

        def add_wave(k: mi.UInt32, more: mi.Bool) -> tuple[mi.UInt32, mi.Bool]:
            turns = dr.fma(dr.gather(mi.Float, self._nu[0], k, more), x, dr.gather(mi.Float, self._nu[1], k, more) * y)
            s, c = dr.sincos(2 * dr.pi * (turns - dr.round(turns)))
            self.add(visit.start, first + 2 * k, visit.absorbed * c, more)
            self.add(visit.start, first + 2 * k + 1, -visit.absorbed * s, more)
            return k + 1, more & (k + 1 < self._number)

        start = dr.full(mi.UInt32, 0, dr.width(x)) if dr.width(x) > 1 else mi.UInt32(0)
        dr.while_loop((start, mi.Bool(here)), lambda k, more: more, add_wave, labels=("wave", "more"))

    def collect(self, unit: float) -> None:
        """Store the light at the traced wavelength and add it to the total. `unit` is the flux of a start ray, W."""
        before, self._flux = self._flux, None
        super().collect(unit)
        found = self.flux
        known = self.by_line.get(self._line)
        self.by_line[self._line] = found if known is None else known + found
        self._flux = found if before is None else before + found

    def _of(self, kind: int, wavelength_nm: float | None) -> Sampled:
        size = self._rings + 2 * self._waves
        light = self.flux if wavelength_nm is None else self.by_line[wavelength_nm]
        return light[kind * size : (kind + 1) * size]

    def rings(self, kind: int, wavelength_nm: float | None = None) -> Sampled:
        """
        Return the flux of the class at index `kind` of `CLASSES` in the innermost disc and each ring, W, (n,).

        It is that at `wavelength_nm`, a key of `by_line`, or by default the sum over wavelengths.
        """
        return self._of(kind, wavelength_nm)[: self._rings]

    def waves(self, kind: int, wavelength_nm: float | None = None) -> tuple[Sampled, Sampled]:
        """
        Return real and imaginary part of the Fourier sums of the class at index `kind` of `CLASSES`, W, (m,) each.

        They are those at `wavelength_nm`, a key of `by_line`, or by default the sums over wavelengths.
        """
        found = self._of(kind, wavelength_nm)[self._rings :]
        return found[0::2], found[1::2]
