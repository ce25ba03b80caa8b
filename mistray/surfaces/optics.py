"""Optical properties of surfaces for the kernel: flag words, refractive indices, media, tables of R and T.

A coating is evaluated on the host in float64 and enters the kernel as a table over the angle of incidence. So the cost
of a hit does not depend on the number of its layers. A table has two parts:

- *refraction*: uniform nodes in the cosine of the angle in the rarer of the two materials, 0 … 1. In this variable R
  and T are smooth from either side, the critical angle of the denser side is the node 0;
- *total reflection*: uniform nodes in w = y/(y + ρ cos θ), 0 … 1, where ρ ≥ 1 is the ratio of the indices, θ the angle
  in the denser material and y² = ρ² sin² θ - 1. R is analytic in y at the critical angle (w = 0) and in cos θ at
  grazing incidence (w = 1), and w is in both.

The kernel interpolates linearly. Nodes are added until the error, estimated at the midpoints, is below `TABLE_ERROR`,
or their number reaches `LAST_INTERVALS`. No stack that we tried (40 random layers) needs so many in the refraction
part. In total reflection a thick stack can have guided modes, whose dips are too narrow for any table. The error of the
tables is `Trace.coating_error`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.coatings import METAL_K, Bare, Response, Stack
from mistray.coatings.fitted_to_substrate import unfitted
from mistray.errors import MistrayError, errors_of
from mistray.materials import bulk_scatter, complex_index
from mistray.materials.spec import GAS_INDEX
from mistray.messages import Message
from mistray.notes import Note
from mistray.scatter.edge_diffraction import EdgeDiffraction
from mistray.surfaces.upload import upload

if TYPE_CHECKING:
    from mistray.surfaces.bodies import Bodies

# Kinds of surfaces, the lowest bits of their words
FRESNEL, IDEAL, TABLED = 0, 1, 2
OPAQUE, MIRROR, DETECTOR, STOCK, ASPHERIC, WALL = (1 << bit for bit in range(2, 8))
FRONT_MEDIUM_SHIFT, BACK_MEDIUM_SHIFT, MEDIUM_MASK = 8, 20, 0x7FF
ONE_CHILD = 1 << 19  # one child of a hit, drawn at random, is followed
DARK = 1e-12  # fraction of the light left after the length of a body, below which the body is dark
DIFFRACTS = 1 << 31  # the light that it scatters in transmission is diffracted
THIN, SHALLOW = 1e-3, 0.1  # optical depths: of a thin medium, and up to which the series of what it takes is exact
NO_LOSS = 4e-7  # absorptance 1 - R - T below which it counts as rounding
TABLE_ERROR = 1e-6  # of R, T and the Stokes coefficients, by linear interpolation
BEYOND_STEP = 1e-6  # of the cosine, from the critical angle to where all light is reflected
FIRST_INTERVALS, LAST_INTERVALS = 256, 1 << 14
AT_ONCE = 1024  # intervals
# Channels of a table: R for light from the front and from the back, T; in Stokes mode four numbers for each
REFLECTION_FRONT, REFLECTION_BACK, TRANSMISSION = range(3)


Sides = tuple[bool, bool]  # in front and behind
LIT: Sides = (False, False)


@dataclass(frozen=True)
class AngleTable:
    """
    Reflectance and transmittance of one surface at one wavelength, tabulated over the angle of incidence.

    Attributes
    ----------
    refraction : (a, 3, c) float64
        R from the front, R from the back and T, at uniform nodes of the cosine in the rarer material. c = 1 for
        unpolarised light (mean of s and p). c = 4 in Stokes mode: values for s and p, and real and imaginary part of
        the product of the amplitude of s with the conjugate amplitude of p.
    total : (b, 3, c) float64
        Values in the same order, for light from the denser side, at uniform nodes of w; zeros where there is no
        critical angle.
    refraction_error, total_error : float
        Largest interpolation error of either part, as estimated at the midpoints of its nodes.
    """

    refraction: np.ndarray
    total: np.ndarray
    refraction_error: float
    total_error: float


def absorption_per_mm(n: Any, wavelength_nm: float) -> Any:
    """Return the absorption coefficients 4πk/λ, 1/mm, of materials with indices n + ik (Beer and Lambert)."""
    return 4e6 * np.pi * np.imag(n) / wavelength_nm


def is_dark(n: Any, wavelength_nm: float, length_mm: Any) -> Any:
    """
    Return a mask of bodies, of complex indices and lengths (mm), that absorb all light.

    No light passes a metal, however thin the body that rays describe. In other materials exp(-4πkd/λ) must be below
    `DARK`.
    """
    depth = absorption_per_mm(n, wavelength_nm) * np.where(np.imag(n) > 0, length_mm, 0.0)
    return (np.imag(n) > METAL_K) | (depth > -math.log(DARK))


def node_cosines(n_front: float, n_back: float, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return the cosines of the angle of incidence at the nodes of a table of R and T.

    Parameters
    ----------
    n_front, n_back : float
        Real refractive indices of the materials in front and behind.
    x : (m,) float64
        Variable of either part, 0 … 1.

    Returns
    -------
    front, back : (m,) float64
        Cosines of the refraction part, in the front and in the back material.
    dense : (m,) float64
        Cosines of the total-reflection part, in the denser material.
    """
    rho = max(n_front, n_back) / min(n_front, n_back)
    denser = np.sqrt(1 - (1 - x * x) / rho**2)
    front, back = (denser, x) if n_front > n_back else (x, denser)
    return front, back, (1 - x) / np.hypot(x, 1 - x) * np.sqrt(rho * rho - 1) / rho


def _channels(response: Response, reflection: bool, stokes: bool) -> np.ndarray:
    """Return R or T of a coating as table columns, (m, c): s, p and products for Stokes vectors, else their mean."""
    values, phase = (response.R, response.phase_r) if reflection else (response.T, response.phase_t)
    if not stokes:
        return values.mean(axis=1, keepdims=True)
    product = np.sqrt(values[:, 0] * values[:, 1]) * np.exp(1j * phase)
    return np.column_stack([values, product.real, product.imag])


def total_variable(sin2_t: Any, eta: Any, cos_i: Any) -> Any:
    """
    Return the variable w, 0 … 1, by which R in total reflection is tabulated; 0 where light is refracted.

    Parameters
    ----------
    sin2_t : mi.Float
        Square of the sine of refraction, (n_i/n_t)² sin² θ; at least 1 in total reflection.
    eta, cos_i : mi.Float
        Ratio of the indices n_i/n_t, and the cosine of the angle of incidence.
    """
    y = dr.sqrt(dr.maximum(sin2_t - 1, 0))
    return dr.select(y > 0, y / (y + eta * cos_i), 0)


def angle_table(
    coating: Any, wavelength_nm: float, n_front: complex, n_back: complex, opaque: bool, stokes: bool, dark: Sides = LIT
) -> AngleTable:
    """
    Return the table of R and T of a coating over the angle of incidence.

    It has as many nodes as `TABLE_ERROR` requires, at most `LAST_INTERVALS` + 1 in each part. Without a critical angle,
    and for an opaque surface, the part for total reflection holds zeros.

    Parameters
    ----------
    coating : coating
        Coating of the surface, see `mistray.coatings`.
    wavelength_nm : float
        Vacuum wavelength, nm.
    n_front, n_back : complex
        Complex indices of the materials in front and behind.
    opaque : bool
        Whether light that enters is absorbed. Cosines are then those on the side of incidence, and T is 0.
    stokes : bool
        Whether each channel has four values, for Stokes vectors, instead of one.
    dark : (bool, bool)
        Whether no light travels in front, and behind. R from there is never read: it is that from the other side.
    """
    # Layers are identified by the names of their materials, and the data in a file may have changed
    indices = coating.indices(wavelength_nm) if isinstance(coating, Stack) else ()
    return _known_table(coating, indices, wavelength_nm, (n_front, n_back), opaque, stokes, dark)


@lru_cache(maxsize=512)
def _known_table(
    coating: Any, _indices: Any, nm: float, sides: tuple[complex, complex], opaque: bool, stokes: bool, dark: Sides
) -> AngleTable:
    """Return the table that `angle_table` describes, cached by coating, layer indices, as files change, and media."""
    n_front, n_back = sides

    def refraction(x: np.ndarray) -> np.ndarray:
        at_front, at_back = (x, x) if opaque else node_cosines(n_front.real, n_back.real, x)[:2]
        rows = refraction_rows(coating, nm, sides, opaque, stokes, at_front, at_back)
        for side in np.flatnonzero(dark):
            rows[:, side] = rows[:, 1 - side]
        return rows

    def total(x: np.ndarray) -> np.ndarray:
        cosines = node_cosines(n_front.real, n_back.real, x)[2]
        return total_rows(coating, nm, sides, stokes, cosines)

    first, first_error = _refined(refraction)
    if opaque or n_front.real == n_back.real:  # there is no critical angle
        return AngleTable(first, np.zeros((2, *first.shape[1:])), first_error, 0.0)
    second, second_error = _refined(total)
    return AngleTable(first, second, first_error, second_error)


def refraction_rows(
    coating: Any,
    wavelength_nm: float,
    sides: tuple[complex, complex],
    opaque: bool,
    stokes: bool,
    at_front: np.ndarray,
    at_back: np.ndarray,
) -> np.ndarray:
    """
    Return R from the front and the back, and T, of a coating in refraction, (m, 3, c), as rows of a table.

    `at_front` and `at_back` are the cosines of incidence in the front and in the back material, (m,) each. `sides` are
    their indices; other parameters as in `angle_table`. T is 0 if the surface is `opaque`; next to an absorbing medium
    it is at most 1 - R.
    """

    def side(cosines: np.ndarray, from_front: bool) -> Response:
        if opaque and sides[0 if from_front else 1].imag > METAL_K:  # nothing travels in a metal; it is never read
            from_front = not from_front
        answer: Response = coating.response(wavelength_nm, *sides, cosines, from_front)
        return answer

    front, back = side(at_front, True), side(at_back, False)
    through = _channels(front, False, stokes)
    if opaque:
        through = 0 * through
    elif sides[0].imag or sides[1].imag:  # out of an absorbing medium R + T may exceed 1 by about k/n
        shares = 1 - np.maximum(_channels(front, True, stokes), _channels(back, True, stokes))
        through[:, :2] = np.minimum(through, shares)[:, :2]
    return np.stack([_channels(front, True, stokes), _channels(back, True, stokes), through], axis=1)


def total_rows(
    coating: Any, wavelength_nm: float, sides: tuple[complex, complex], stokes: bool, cosines: np.ndarray
) -> np.ndarray:
    """Return rows of total reflection, T = 0, (m, 3, c), at cosines in the denser material; see `refraction_rows`."""
    if not isinstance(coating, (Bare, Stack)):  # whose R has no step at the critical angle
        cosines = cosines * (1 - BEYOND_STEP)
    row = _channels(coating.response(wavelength_nm, *sides, cosines, sides[0].real > sides[1].real), True, stokes)
    return np.stack([row, row, np.zeros_like(row)], axis=1)


def unpolarized_shares(
    coating: Any,
    wavelength_nm: float,
    sides: tuple[complex, complex],
    opaque: bool,
    from_front: bool,
    cosines: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """
    Return R and T of a coating for unpolarised light, (m,) each, at cosines of incidence: the means of s and p.

    At an opaque surface T is 0, and so is R for light out of a metal. `sides` are the indices in front and behind.
    """
    if opaque and sides[0 if from_front else 1].imag > METAL_K:  # nothing comes out of a metal
        return np.zeros_like(cosines), np.zeros_like(cosines)
    answer = coating.response(wavelength_nm, *sides, cosines, from_front)
    return answer.R.mean(axis=1), 0 * cosines if opaque else answer.T.mean(axis=1)


def _refined(values: Callable[[np.ndarray], np.ndarray]) -> tuple[np.ndarray, float]:
    """Return values of a function at enough uniform nodes of 0 … 1 (of a constant: 0 and 1 alone), and their error."""
    intervals = FIRST_INTERVALS
    # All of the first levels in one call, which costs as much as a thousand values
    known = values(np.linspace(0.0, 1.0, AT_ONCE + 1))
    while True:
        if 2 * intervals <= AT_ONCE:
            fine = known[:: AT_ONCE // (2 * intervals)]
        else:
            fine = np.empty((2 * intervals + 1, *known.shape[1:]))
            fine[::2] = known
            fine[1::2] = values((np.arange(intervals) + 0.5) / intervals)
            known = fine
        middle = float(np.max(np.abs(fine[1::2] - 0.5 * (fine[:-1:2] + fine[2::2]))))
        if middle == 0:  # a constant
            return fine[[0, -1]], 0.0
        # The error at the midpoints falls with the square of the spacing; doubled where it does not yet
        error = 0.5 * middle
        if error <= TABLE_ERROR or 2 * intervals >= LAST_INTERVALS:
            return fine, error
        intervals *= 2


def _index_beside(bsdf: Any, side: int, wavelength_nm: float) -> complex | None:
    """
    Return the refractive index of the medium on one side of an opaque surface, 0 in front or 1 behind.

    None if the scene does not declare a medium: air on both sides is the default of an interface. None, too, for a
    metal or a material without data at this wavelength, because no light travels there.
    """
    if not bsdf.declared[side] or bsdf.materials == ("air", "air"):
        return None
    try:
        n = complex_index((bsdf.front, bsdf.back)[side], wavelength_nm)
    except MistrayError:
        return None
    return None if n.imag > METAL_K else complex(n)


class Optics:
    """
    Optical properties of all surfaces at one wavelength.

    Parameters
    ----------
    ids : sequence of str
        Names of the surfaces, for error messages.
    bsdfs : sequence
        ``interface`` plugins of the surfaces.
    flags : (s,) uint32
        Bits of the words that follow from the geometry.
    bodies : Bodies
        Thicknesses of the bodies; measured only if a medium absorbs so much that it may be dark.
    wavelength_nm : float
        Vacuum wavelength, nm.
    stokes : bool
        Whether the tables hold s, p and their phases.

    Attributes
    ----------
    words : mi.UInt32
        Kind, flag bits and media of each surface.
    host_words : (s,) uint32
        Copy of `words` on the host.
    indices : mi.Float
        Refractive index in front and behind, and R and T of an ideal coating, for each surface, (s, 4). An opaque
        surface has the indices 1; R and T are 0 for other coatings.
    places : mi.UInt32
        First row and last interval of the refraction part and of the total-reflection part of each table, (s, 4).
    table : mi.Float
        Rows of `row_floats` values, of all tables.
    kinds : set of int
        Kinds of coatings that occur in the scene.
    media : list of str
        Names of the materials; the first one is "unknown". Their positions in this list identify media elsewhere.
    declared : (s, 2) int
        Positions in `media` of the materials in front and behind; 0 where an opaque surface declares none, or where no
        light can be.
    extinction : mi.Float
        Extinction coefficient of each medium, for absorption and scatter, 1/mm.
    albedo : mi.Float
        Single-scattering albedo of each medium: scattered fraction of the extinction.
    media_n : mi.Float
        Real refractive index of each medium; 1 if it is unknown.
    host_media_n : (m,) float64
        Copy of `media_n` on the host.
    host_scattering : (m,) float64
        Scattering coefficient of each medium, 1/mm.
    asymmetry : mi.Float
        Asymmetry parameter g of each medium, see `mistray.physics.henyey_greenstein`.
    one_child : bool
        Whether a hit on some surface has one child instead of all.
    diffracts : bool
        Whether some surface is the ring of a diffracting edge.
    absorbs, scatters : bool
        Whether any medium attenuates light, and whether any medium scatters it.
    error : float
        Largest interpolation error of the tables, see `AngleTable`.
    notes : list of Note
        Notes on media that were treated as opaque (of metals thin ones only), and on presets on foreign substrates.
    """

    def __init__(
        self,
        ids: Sequence[str],
        bsdfs: Sequence[Any],
        flags: np.ndarray,
        bodies: Bodies,
        wavelength_nm: float,
        stokes: bool,
    ) -> None:
        self.wavelength_nm, self.stokes = wavelength_nm, stokes
        self.bsdfs = list(bsdfs)
        self.row_floats = 12 if stokes else 4
        count = len(bsdfs)
        self.host_indices = np.zeros((count, 4))
        self.host_places = np.zeros((count, 4), dtype=np.uint32)
        words = np.array(flags, dtype=np.uint32)
        self.rows = 0
        self.kinds: set[int] = set()
        self.media = ["unknown"]
        absorption, scattering, asymmetry, real = [0.0], [0.0], [0.0], [1.0]
        numbers: dict[tuple[float, ...], int] = {}
        declared = np.zeros((count, 2), dtype=np.int64)

        def number(n: complex, spec: str) -> int:
            """Return the position of a medium in `media`; media of equal refractive index and scatter have the same."""
            cloud = bulk_scatter(spec)
            key = (round(n.real, 9), float(f"{n.imag:.9g}"), cloud.per_mm, cloud.g)
            if key not in numbers:
                numbers[key] = len(self.media)
                self.media.append(spec.strip())
                absorption.append(absorption_per_mm(n, wavelength_nm))
                real.append(n.real)
                scattering.append(cloud.per_mm)
                asymmetry.append(cloud.g)
            return numbers[key]

        self.error = 0.0
        rows: list[np.ndarray] = []
        self.tables: list[AngleTable | None] = []
        self.complex_indices = [self._sides(name, bsdf) for name, bsdf in zip(ids, bsdfs, strict=True)]
        dark, self.notes = self._dark(ids, bodies)
        self.notes += self._unfitted()
        for i, bsdf in enumerate(bsdfs):
            sides = self.complex_indices[i]
            opaque = bsdf.opaque or bool(dark[i].any())
            kind = self._kind(bsdf, bool(dark[i].any()), max(n.imag for n in sides))
            self.kinds.add(kind)
            words[i] |= kind | (OPAQUE if opaque else 0) | (MIRROR if bsdf.mirror else 0)
            words[i] |= ONE_CHILD if bsdf.one_child else 0
            words[i] |= DIFFRACTS if any(isinstance(model, EdgeDiffraction) for model in bsdf.scatter) else 0
            # An opaque surface transmits nothing: there is no refraction, and one index is enough
            self.host_indices[i, :2] = (1.0, 1.0) if opaque else (sides[0].real, sides[1].real)
            self.host_places[i] = self.rows, 1, self.rows, 1
            table = None
            if kind == IDEAL:
                self.host_indices[i, 2:] = bsdf.coating.R, bsdf.coating.T
            elif kind == TABLED:
                unlit = bool(dark[i, 0]), bool(dark[i, 1])
                table = angle_table(bsdf.coating, wavelength_nm, *sides, opaque, stokes, unlit)
                self.error = max(self.error, table.refraction_error, table.total_error)
                both = [self._rows(part) for part in (table.refraction, table.total)]
                self.host_places[i] = self.rows, len(both[0]) - 1, self.rows + len(both[0]), len(both[1]) - 1
                rows += both
                self.rows += sum(map(len, both))
            if kind != TABLED:  # a row of its own, for the gradient
                rows.append(np.zeros((2, self.row_floats)))
                self.rows += 2
            self.tables.append(table)
            if not opaque:
                declared[i] = [number(n, spec) for n, spec in zip(sides, (bsdf.front, bsdf.back), strict=True)]
                words[i] |= (declared[i, 0] << FRONT_MEDIUM_SHIFT) | (declared[i, 1] << BACK_MEDIUM_SHIFT)
        # Media that opaque surfaces declare come last: the kernel uses no medium beside them
        for i in np.flatnonzero(words & OPAQUE).tolist():
            for side, spec in enumerate((bsdfs[i].front, bsdfs[i].back)):
                n = _index_beside(bsdfs[i], side, wavelength_nm) if not dark[i, side] else None
                if n is not None:
                    declared[i, side] = number(n, spec)
        self.declared = declared
        if len(self.media) > MEDIUM_MASK:
            raise MistrayError(f"the scene has {len(self.media) - 1} materials; at most {MEDIUM_MASK - 1} are possible")
        for detector in np.flatnonzero(words & DETECTOR).tolist():
            if self._absorbs_nothing(detector):
                raise MistrayError(
                    f"detector '{ids[detector]}' absorbs nothing (R + T = 1); give its interface R (and T = 0)"
                )
        self.host_words = words
        self.one_child = bool(np.any(words & ONE_CHILD))
        self.diffracts = bool(np.any(words & DIFFRACTS))
        self.words = upload(mi.UInt32, words)
        self.indices = upload(mi.Float, self.host_indices)
        self.places = upload(mi.UInt32, self.host_places)
        self.table = upload(mi.Float, np.concatenate(rows))
        self.host_scattering = np.array(scattering)
        extinction = np.array(absorption) + scattering
        self.extinction = upload(mi.Float, extinction)
        self.albedo = upload(mi.Float, np.array(scattering) / np.maximum(extinction, np.finfo(float).tiny))
        self.asymmetry = upload(mi.Float, np.array(asymmetry))
        self.host_media_n = np.array(real)
        self.media_n = upload(mi.Float, self.host_media_n)
        self.absorbs, self.scatters = bool(extinction.any()), any(scattering)
        dr.eval(self.words, self.indices, self.places, self.table)
        dr.eval(self.extinction, self.albedo, self.asymmetry, self.media_n)

    def _sides(self, name: str, bsdf: Any) -> tuple[complex, complex]:
        """Return the complex indices in front of and behind a surface; 1 if it is opaque without a multilayer."""
        if bsdf.opaque and not isinstance(bsdf.coating, Stack):
            return 1 + 0j, 1 + 0j
        with errors_of(f"surface '{name}'"):
            front, back = bsdf.complex_indices(self.wavelength_nm)
        return complex(front), complex(back)

    def _dark(self, ids: Sequence[str], bodies: Bodies) -> tuple[np.ndarray, list[Note]]:
        """Return a mask of surface sides, (s, 2), on which no light travels, and notes about them for the user."""
        n = np.array(self.complex_indices)
        if not n.imag.any():
            return np.zeros(n.shape, dtype=bool), []
        # A medium that scatters sends light back before it has crossed the body
        scatters = [[bulk_scatter(spec).per_mm > 0 for spec in (bsdf.front, bsdf.back)] for bsdf in self.bsdfs]
        may_be = (n.imag > METAL_K) | ~np.array(scatters)
        doubtful = may_be & is_dark(n, self.wavelength_nm, bodies.size)
        # One answer for all surfaces of a body: its least thickness. An open body counts as the size of the scene
        length = np.full(n.shape, bodies.size)
        closed = np.zeros(n.shape, dtype=bool)
        for i in np.flatnonzero(doubtful.any(axis=1)).tolist():
            thickness = bodies.thickness(i)
            closed[i] = np.isfinite(thickness)
            length[i, closed[i]] = thickness[closed[i]]
        for index in np.unique(n):
            same = closed & (n == index)
            length[same] = length[same].min(initial=np.inf)
        dark = may_be & is_dark(n, self.wavelength_nm, length)
        passed = np.exp(-absorption_per_mm(n, self.wavelength_nm) * length)
        notes: dict[tuple[str, bool], Note] = {}
        for i, side in np.argwhere(dark):
            bsdf = self.bsdfs[i]
            medium, where = ((bsdf.front, "in front of"), (bsdf.back, "behind"))[side]
            metal, clear = n[i, side].imag > METAL_K, passed[i, side] > DARK
            facts = {"medium": medium, "where": where, "surface": ids[i], "nm": self.wavelength_nm}
            if metal and clear:
                note = Message.CLEAR_METAL.note(**facts, passed=passed[i, side], length=length[i, side])
            elif not metal:
                why = f"its {length[i, side]:.3g} mm" if closed[i, side] else "it, and no surface closes its body"
                note = Message.OPAQUE_MEDIUM.note(**facts, why=why)
            else:
                continue
            notes.setdefault((medium, bool(closed[i, side])), note)
        return dark, list(notes.values())

    def _unfitted(self) -> list[Note]:
        """Return notes on coating presets that lie on a substrate other than the one they were designed for."""
        found: dict[Note, None] = {}
        for bsdf, sides in zip(self.bsdfs, self.complex_indices, strict=True):
            outside, inside = sorted((0, 1), key=lambda side: sides[side].real)
            in_gas = isinstance(bsdf.coating, Stack) and not bsdf.opaque and sides[outside].real < GAS_INDEX
            if in_gas and (text := unfitted(bsdf.coating, bsdf.materials[inside])):
                found[Message.UNFITTED_PRESET.note(False, what=text)] = None
        return list(found)

    def _kind(self, bsdf: Any, dark: bool, k: float) -> int:
        if bsdf.ideal:
            return IDEAL
        # The kernel's own equations leave out k, an error of R of about k²; of a dark body they have no index
        exact = k * k <= TABLE_ERROR and not dark
        return FRESNEL if isinstance(bsdf.coating, Bare) and exact else TABLED

    @cached_property
    def mostly_reflects(self) -> np.ndarray:
        """Mask of opaque surfaces, (s,), whose better side reflects more than half the light at normal incidence."""
        found = np.zeros(len(self.bsdfs), dtype=bool)
        for i in np.flatnonzero(self.host_words & OPAQUE).tolist():
            if self.bsdfs[i].ideal:
                found[i] = self.host_indices[i, 2] > 0.5
            else:
                found[i] = max(self.shares(i, from_front, np.ones(1))[0][0] for from_front in (True, False)) > 0.5
        return found

    def attenuate(
        self, flux: mi.Float, medium: mi.UInt32, length: mi.Float, active: mi.Bool
    ) -> tuple[mi.Float, mi.Float, mi.Float]:
        """
        Return the flux left at the end of segments in media, and the flux scattered and absorbed along them.

        `medium` is a position in `media`, and `length` that of the segments, mm. All fluxes have the unit of `flux`.
        """
        depth = dr.gather(mi.Float, self.extinction, medium, active) * dr.select(active, length, 0)
        left, shallow = flux * dr.exp(-depth), depth < SHALLOW
        # A difference would round away what a thin medium takes, a fifth of it at a depth of 1e-7
        series = depth * dr.fma(-depth, 1 / 2 - depth * (1 / 6 - depth / 24), 1)
        taken, clouded = dr.select(shallow, flux * series, flux - left), mi.Float(0)
        left = dr.select(shallow, flux - taken, left)
        if self.scatters:
            clouded = taken * dr.gather(mi.Float, self.albedo, medium, active)
            taken = taken - clouded
        return left, clouded, taken

    def response(self, surface: int, from_front: bool, cosines: np.ndarray) -> Response:
        """
        Return the exact R and T (s and p) of a surface's coating from one side, at cosines of incidence, (m,).

        At an opaque surface, the side of a metal has those of the other side.
        """
        sides = self.complex_indices[surface]
        if self.host_words[surface] & OPAQUE and sides[0 if from_front else 1].imag > METAL_K:
            from_front = not from_front  # nothing travels in a metal
        answer: Response = self.bsdfs[surface].coating.response(self.wavelength_nm, *sides, cosines, from_front)
        return answer

    def shares(self, surface: int, from_front: bool, cosines: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """
        Return the exact R and T of a surface in unpolarised light, (m,) each, at cosines of incidence, (m,).

        At an opaque surface T is 0, and so is R for light out of a metal, in which none travels.
        """
        opaque = bool(self.host_words[surface] & OPAQUE)
        coating, sides = self.bsdfs[surface].coating, self.complex_indices[surface]
        return unpolarized_shares(coating, self.wavelength_nm, sides, opaque, from_front, cosines)

    def _rows(self, part: np.ndarray) -> np.ndarray:
        """Return a table of R and T as rows in the kernel's column order, (nodes, row_floats)."""
        if self.stokes:
            return part.reshape(len(part), 12)
        return np.concatenate([part[:, :, 0], np.zeros((len(part), 1))], axis=1)

    def _absorbs_nothing(self, surface: int) -> bool:
        """True if a surface absorbs less than rounding at every angle, so that a detector there would stay dark."""
        bsdf, table = self.bsdfs[surface], self.tables[surface]
        if table is not None:
            shares = table.refraction if not self.stokes else table.refraction[:, :, :2].mean(axis=2, keepdims=True)
            return bool(np.all(shares[:, :2, 0].min(axis=1) + shares[:, 2, 0] > 1 - NO_LOSS))
        return not bsdf.ideal or bsdf.coating.R + bsdf.coating.T > 1 - NO_LOSS
