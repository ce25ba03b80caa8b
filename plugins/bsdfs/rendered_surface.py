"""Surface for Mitsuba's own integrators, computed by the kernel's functions in the local frame of a hit."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from types import SimpleNamespace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.gradients.scatter_gradient import quotient, table_slopes
from mistray.gradients.scatter_replay import RATIOS, ReplayTables
from mistray.kernel.interaction import Interaction, Place, shares_at
from mistray.kernel.lobes import multilinear
from mistray.kernel.scatter_shares import ScatterBudget
from mistray.kernel.scatter_tables import NORMAL, RATIO_HEAD, Case, ScatterTables
from mistray.kernel.scattering import Scattering
from mistray.surfaces.optics import OPAQUE, Optics
from mistray.surfaces.upload import upload

BODY_MM = 1.0  # length after which a dark medium counts as opaque: Mitsuba's integrators have no absorption on the way
STEP = 1e-3  # relative step of a parameter, for differences of tables in single precision
ONE_LESS = 1 - 2.0**-24  # the largest float32 below 1
NUMBER = 0  # number of the surface, the only one


class RenderedOptics(Optics):
    """
    Optical properties of one surface for Mitsuba's integrators, which have no absorption in media.

    Parameters
    ----------
    interface : Interface
        Plugin of the surface.
    title : str
        Name of the surface, for messages.
    wavelength_nm : float
        Wavelength at which materials and coating are known, nm.
    """

    def __init__(self, interface: Any, title: str, wavelength_nm: float) -> None:
        endless: Any = SimpleNamespace(size=BODY_MM, thickness=lambda surface: np.full(2, np.inf))
        super().__init__([title], [interface], np.zeros(1, dtype=np.uint32), endless, wavelength_nm, stokes=False)
        self.scatters = False
        self.word, self.opaque = int(self.host_words[NUMBER]), bool(self.host_words[NUMBER] & OPAQUE)
        # Nothing is refracted into an opaque material, but its lobes depend on the indices all the same
        self.refraction = self.host_indices[NUMBER, :2].tolist()
        self.host_indices[NUMBER, :2] = [n.real for n in self.complex_indices[NUMBER]]

    def _sides(self, name: str, bsdf: Any) -> tuple[complex, complex]:
        sides: tuple[complex, complex] = bsdf.transparent(self.wavelength_nm)
        return sides


class RenderedTables(ScatterTables):
    """Scatter tables of one surface for Mitsuba's integrators, where each hit has its own sample axis."""

    @staticmethod
    def _frames(table: Any, turned: Sequence[int]) -> None:
        return None


class ModelTables(ReplayTables):
    """
    Scatter tables of one surface whose entries carry derivatives with respect to the parameters of the scatter models.

    Parameters
    ----------
    tables : ScatterTables
        Tables of the surface.

    Attributes
    ----------
    moving : list of (mi.Float, dict)
        One zero for each parameter, with the derivatives of all arrays with respect to that parameter; to be set before
        tables are read.
    """

    def __init__(self, tables: ScatterTables) -> None:
        super().__init__(tables)
        self.leaves = {}  # derivatives come from `moving` alone
        self.any, self.bulk, self.all_cases, self.total_rows = True, None, tables.all_cases, tables.total_rows
        self.moving: list[tuple[mi.Float, dict[str, mi.Float]]] = []
        self._slopes: dict[tuple[int, str], dict[str, mi.Float]] = {}

    def slopes(self, table: Any, plugin: Any, name: str) -> dict[str, mi.Float]:
        """
        Return the derivatives of all entries with respect to the parameter `name` of a model.

        They are keyed by the name of the array, and per unit of the parameter.
        """
        if (id(plugin), name) not in self._slopes:
            cases = [case for case in self.all_cases if _has(case, plugin)]
            found = {array: np.zeros(size) for array, size in self.sizes.items()}
            found[RATIOS] = np.zeros(max(len(self.packed.ratios), 1))
            for array, place, slope in table_slopes(table, cases, self.packed, plugin, quotient(plugin, name, STEP)):
                found[array][place : place + slope.size] += slope.ravel()
            self._slopes[id(plugin), name] = {array: upload(mi.Float, values) for array, values in found.items()}
        return self._slopes[id(plugin), name]

    def _zero(self, name: str, index: mi.UInt32, active: mi.Bool) -> mi.Float:
        zeros = (dr.gather(mi.Float, slopes[name], index, active) * zero for zero, slopes in self.moving)
        return sum(zeros, mi.Float(0))

    def ratio(self, place: mi.UInt32, places: Any, active: mi.Bool) -> mi.Float:
        sizes, first = self._ratio_sizes(place, len(places), active), place + RATIO_HEAD
        zeros = (multilinear(slopes[RATIOS], first, sizes, places, active) * zero for zero, slopes in self.moving)
        return super().ratio(place, places, active) + sum(zeros, mi.Float(0))


class RenderedScattering(Scattering):
    """
    Scatter of one surface into directions that one of Mitsuba's integrators draws or requests.

    Parameters
    ----------
    tables : ScatterTables
        Scatter tables of the surface.
    surface : RenderedSurface
        Surface that is hit.
    d : mi.Vector3f
        Unit direction in which the ray travels, in the local frame of the hit.
    it : Interaction
        Interaction of the ray with the surface.
    x_axis : mi.Vector3f or None
        Unit vector along the sample's x axis, in the local frame; None if no model depends on it.
    """

    def __init__(
        self,
        tables: ScatterTables,
        surface: RenderedSurface,
        d: mi.Vector3f,
        it: Interaction,
        x_axis: mi.Vector3f | None,
    ) -> None:
        super().__init__(tables)
        self._surface, self._d, self._it, self._sample_x = surface, d, it, x_axis

    def _x_axis(self, s: mi.UInt32, it: Interaction, active: mi.Bool) -> mi.Vector3f | None:
        return self._sample_x

    def shares(self, active: mi.Bool) -> ScatterBudget:
        """Return the fractions of the incident flux that the surface scatters and absorbs at each hit."""
        return self.budget(mi.UInt32(NUMBER), self._it, active)

    def _lobes(self, reflect: mi.Bool) -> tuple[Any, list[dict[str, Any]], mi.Float, Any]:
        """Return the table row of the scatter case, its lobes, their total flux fraction, and their frame."""
        it = self._it
        case = dr.select(it.from_front, mi.UInt32(0), 2) + dr.select(reflect, mi.UInt32(1), 0)
        plan, lobes, frame = self._case(case, mi.UInt32(NUMBER), it, self._d, reflect)
        if not self.tables.backward:
            # In total reflection nothing is refracted into a specular direction
            for lobe in lobes:
                lobe["here"] = lobe["here"] & (reflect | (it.cos_t > 0) | ((lobe["words"].x & NORMAL) != 0))
                lobe["flux"] = dr.select(lobe["here"], lobe["flux"], 0)
        return plan, lobes, sum((lobe["flux"] for lobe in lobes), mi.Float(0)), frame

    def draw(self, reflect: mi.Bool, u: mi.Float, v: mi.Point2f) -> mi.Vector3f:
        """
        Return a unit direction of scatter in the local frame, drawn with random numbers u and v in 0 … 1.

        Light is scattered in reflection where `reflect` is True, else in transmission. A direction on the other side of
        the surface carries no light.
        """
        _, lobes, total, frame = self._lobes(reflect)
        # The remainder of the first number after the choice of the lobe places the direction within a table cell
        rest, left = u * total, u
        for lobe in lobes:
            here = (rest >= 0) & (rest < lobe["flux"])
            left = dr.select(here, rest / lobe["flux"], left)
            rest = rest - lobe["flux"]
        return self._random(lobes, total, (u, v.x, v.y, dr.minimum(left, ONE_LESS)), frame)

    def evaluate(self, reflect: mi.Bool, direction: mi.Vector3f, active: mi.Bool) -> tuple[mi.Float, mi.Float]:
        """
        Return BSDF · cosine for a local unit direction, 1/sr, and the pdf with which `draw` draws it, 1/sr.

        Both are 0 for directions on the other side, see `draw` for `reflect`.
        """
        _, lobes, total, frame = self._lobes(reflect)
        cos_s = dr.dot(direction, frame.outward)
        value, _, pdf = self._evaluate(lobes, total, direction, cos_s, frame)
        if self.tables.backward:
            # An eye sees the light that comes from there: models need not be reciprocal
            it = self._surface.meet(-direction, active)
            light = self._surface.scattering(False, -direction, it, self._sample_x)
            assert light is not None
            value = light.evaluate(reflect, -self._d, active)[0] * cos_s / self._it.cos_i
        good = active & (cos_s > 0) & dr.isfinite(value)
        return dr.select(good, value, 0), dr.detach(dr.select(good, pdf, 0))


class RenderedSurface:
    """
    Surface of one interface, in place of a `mistray.surfaces.surfaces.SurfaceTable` of a whole scene.

    Parameters
    ----------
    interface : Interface
        Plugin of the surface.
    title : str
        Name of the surface, for messages.
    wavelength_nm : float
        Wavelength at which materials and coating are known, nm.
    """

    def __init__(self, interface: Any, title: str, wavelength_nm: float) -> None:
        self._interface, self.ids, self.centre = interface, [title], np.zeros(3)
        self.wavelength_nm = wavelength_nm
        self.optics = RenderedOptics(interface, title, wavelength_nm)
        self._moving: dict[bool, ModelTables] = {}

    def coating(self, from_front: mi.Bool, cos_i: mi.Float, active: mi.Bool) -> tuple[mi.Float, mi.Float, mi.Float]:
        """
        Return R, T and cos θt at hits with cosines of the angle of incidence `cos_i`, from the front or the back.

        cos θt is 0 in total reflection. Derivatives are carried with respect to R and T of an ideal coating.
        """
        table: Any = self
        # Copies, since Dr.Jit may widen a literal in place where a mask is one as well
        ideal = mi.Float(self._interface.R), mi.Float(self._interface.T)
        word, row = mi.UInt32(self.optics.word), mi.Vector4f(*self.optics.refraction, *ideal)
        return shares_at(table, mi.UInt32(NUMBER), word, from_front, cos_i, active, row)

    def meet(self, d: mi.Vector3f, active: mi.Bool) -> Interaction:
        """Return the interaction of the surface with a ray along the unit vector d, in the local frame of the hit."""
        # A detector's mesh has its normals towards the front
        to_back = -1 if self._interface.turned else 1
        from_front, cos_i = d.z * to_back > 0, dr.minimum(dr.abs(d.z), 1)
        R, T, cos_t = self.coating(from_front, cos_i, active)
        n_front, n_back = self.optics.refraction
        eta = dr.select(from_front, mi.Float(n_front / n_back), mi.Float(n_back / n_front))
        axis, tir = mi.Vector3f(0, 0, dr.mulsign(mi.Float(1), d.z)), (cos_t <= 0) & (not self.optics.opaque)
        # Exact along the axes of the frame: a narrow lobe magnifies the rounding of its centre
        reflected = mi.Vector3f(d.x, d.y, -d.z)
        transmitted = mi.Vector3f(eta * d.x, eta * d.y, dr.mulsign(cos_t, d.z))
        p, none = mi.Vector3f(0), mi.UInt32(0)
        place = Place(none, mi.Float(0))
        return Interaction(
            p, reflected, transmitted, R, T, tir, axis, cos_i, cos_t, eta, none, none, none, p, from_front, place, None
        )

    @cached_property
    def _tables(self) -> tuple[ScatterTables, ScatterTables]:
        """Scatter tables of the surface: for forward light, then for backward rays."""
        table: Any = self
        return RenderedTables(table, {}, False), RenderedTables(table, {}, True)

    def scattering(
        self, radiance: bool, d: mi.Vector3f, it: Interaction, x_axis: mi.Vector3f | None
    ) -> RenderedScattering | None:
        """
        Return the scatter at a hit, with derivatives; None without scatter.

        It is that of rays traced backward from the sensor if `radiance`, else of forward light. For other parameters
        see `RenderedScattering`. Raise `MistrayError` if a parameter with a derivative belongs to a model that scatters
        nothing here.
        """
        tables = self._tables[radiance]
        moving = [
            (plugin, name, parameter)
            for plugin in self._interface.scatterers
            for name, parameter in plugin.values.items()
            if dr.grad_enabled(parameter)
        ]
        for plugin, _, _ in moving:
            if not any(_has(case, plugin) for case in tables.all_cases):
                raise MistrayError(f"{plugin.title}: it scatters nothing here, so it has no derivative; start above 0")
        if moving:
            if radiance not in self._moving:
                self._moving[radiance] = ModelTables(tables)
            tables = self._moving[radiance]
            tables.moving = [
                (parameter - dr.detach(parameter), tables.slopes(self, plugin, name))
                for plugin, name, parameter in moving
            ]
        return RenderedScattering(tables, self, d, it, x_axis) if tables.any else None


def _has(case: Case, plugin: Any) -> bool:
    """True if a scatter plugin has a lobe in a case (side of incidence and event)."""
    return any(member.plugin is plugin for member in case.members)
