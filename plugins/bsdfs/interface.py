"""Plugin `interface`: an optical surface with a material on either side and one coating."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import reduce
from operator import or_
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.coatings import Bare, CoatingModel, CoatingTable, Ideal
from mistray.coatings.simple import check_shares
from mistray.errors import MistrayError
from mistray.kernel.interaction import Interaction
from mistray.materials import complex_index, refractive_index
from mistray.param import OBJECT, Param, documented, fixed
from mistray.plugins.bsdfs.glasses import MATERIALS, Glasses
from mistray.plugins.bsdfs.rendered_surface import RenderedScattering, RenderedSurface
from mistray.plugins.bsdfs.sample_axis import SampleAxis, common_axis
from mistray.ranges import AIMED_RAYS, FLAG, SHARE, TEXT, WAVELENGTH_NM, Words
from mistray.scatter import LobeModel
from mistray.spectra.spectrum import DEFAULT_NM

# Reflected and transmitted beams, then scatter
COMPONENTS = (
    mi.BSDFFlags.DeltaReflection,
    mi.BSDFFlags.DeltaTransmission,
    mi.BSDFFlags.GlossyReflection,
    mi.BSDFFlags.GlossyTransmission,
)
UNNAMED = ("bsdf", "coating")  # names that Mitsuba makes from the key in a dict
# What an interface has beside its coating
SIDES = {
    **MATERIALS,
    "mirror": fixed(
        "bool", FLAG, "the design path reflects here: such a reflection is not counted as a ghost bounce", False
    ),
    "design_path": fixed(
        "string",
        TEXT,
        "for a detector: sequences of its direct image, if they differ from those found; ``L1:T L2:T fold:R``, "
        "alternatives of a step joined by ``|``, sequences by ``;``; see docs/design_path.md",
        "",
        otherwise="found",
    ),
    "splitting": fixed(
        "string",
        Words(("split", "one")),
        "follow all children of a ray here, or one of them at random (one in, one out; unbiased), whatever the trace "
        "does elsewhere",
        "split",
    ),
    "scatter_rays": fixed(
        "1",
        AIMED_RAYS,
        "random scattered rays at every hit of the ray tree; 0: the number in the settings of the trace",
        0,
    ),
    "wavelength_nm": fixed(
        "nm",
        WAVELENGTH_NM,
        "wavelength for Mitsuba's own integrators only; by default the first of the scene's first source",
        DEFAULT_NM,
        otherwise="source",
    ),
}
BY_ITSELF = {name: replace(param, doc="by itself only; see ``interface``") for name, param in SIDES.items()}
MODELS = (
    "models of scatter, any number: ``abg``, ``harvey_shack``, ``k_correlation``, ``psd_table``, ``gaussian_lobe``, "
    "``phong``, ``polynomial``, ``particulate``, ``paint``, ``edge_diffraction``, ``tabulated``; see docs/scatter.md"
)


@documented
class Interface(mi.BSDF):
    r"""
    Optical interface (:monosp:`interface`): two materials and a coating, with the energy budget R + T + A = 1.

    The materials are those at the ``front``, from which the shape's normal comes, and at the ``back``, to which it
    points. So a ray needs no stack of media. The reflectance R and the transmittance T are

    - those of the bare surface (Fresnel's equations) when no coating is given; a metal may lie on either side,
    - constant when ``R`` and ``T`` are given (an ideal coating; ``R`` alone makes the surface opaque),
    - interpolated in a CSV file when ``table`` is given,
    - those of the nested ``thinfilm``: layers, a preset, or again R and T or a table. Several interfaces may
      share one by ``<ref id="…"/>``; it is then one object, with one set of parameters.

    A = 1 - R - T is absorbed. Beyond the critical angle nothing is transmitted. Bare surfaces and layers then reflect
    as their equations give, ideal and tabulated coatings reflect R + T.

    .. parameters::

    Models of scatter add up. Scatter relative to R and T is taken from the specular beams, absolute scatter is taken
    from A. A surface that would send away more light than it receives is refused.

    Source: Fresnel's equations, see `mistray.physics.thinfilm`. Under Mitsuba's own integrators the plugin is a delta
    BSDF for unpolarised light, plus the lobes of its scatter. R and T of a coating then come from the table over the
    angle that the ray tree uses, at ``wavelength_nm``. By default `mistray.load` takes the first wavelength of the
    scene's first source. It is 550 nm for a scene without source, or one made by Mitsuba's own loader. If materials or
    coating are not known there, the nearest wavelength at which they are known is used. A material without k counts as
    transparent. The ray tree evaluates materials at the traced wavelengths, and they may be unknown elsewhere. The
    components are the reflected and the transmitted beam, then reflected and transmitted scatter. In the mode
    "radiance" light is scattered from wo to wi.

    .. code-block:: xml

        <bsdf type="interface">
            <string name="front" value="air"/>
            <string name="back" value="N-BK7"/>
            <float name="R" value="0.01"/>
            <float name="T" value="0.99"/>
        </bsdf>

    .. code-block:: python

        {"type": "interface", "back": "N-BK7", "coating": {"type": "thinfilm", "preset": "bbar3"}}
    """

    kind = "interface"
    properties: Mapping[str, Param] = {
        **SIDES,
        "R": Param("1", SHARE, "reflectance of an ideal coating", default=None, otherwise="Fresnel"),
        "T": Param("1", SHARE, "transmittance of an ideal coating", default=0.0, otherwise="0 if R"),
        "table": fixed(
            "file",
            TEXT,
            "CSV over wavelength and angle, see docs/coatings.md; angles are those in the rarer material, for light "
            "from either side",
            None,
        ),
        "(nested) thinfilm": fixed("bsdf", OBJECT, "the coating, instead of R, T and table", None),
        "(nested) scatter": fixed("bsdf", OBJECT, MODELS, None),
    }
    sample_axis: SampleAxis | None = None

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.name = "" if props.id() in UNNAMED else str(props.id())
        self.wavelength_nm = self._take(props, "wavelength_nm")
        self._own_wavelength = "wavelength_nm" in props
        self._glasses = Glasses(props, self.title, _resolve)
        # Shifts of the indices, materials without them, and whether the scene declares the materials
        self.shifts, self.materials = self._glasses.parameters, self._glasses.given
        self.declared = self._glasses.declared
        self.is_nested = False
        self.mirror, self.design_path = self._take(props, "mirror"), self._take(props, "design_path")
        self.one_child = self._take(props, "splitting") == "one"
        self.scatter_rays = self._take(props, "scatter_rays")
        self._take_glasses()  # an unknown material is an error of the scene, now
        self.turned: bool | None = None
        self._own_ideal = False
        self._R, self._T = mi.Float(0), mi.Float(0)
        self._own: CoatingModel = Bare()
        self._held: tuple[np.ndarray, ...] = ()
        self._rendered: tuple[CoatingModel, tuple[LobeModel, ...], RenderedSurface] | None = None
        self.scatterers: tuple[Any, ...] = ()
        # Only objects are read here: properties never read are reported as unknown
        objects = [props[key] for key in list(props.keys()) if props.type(key) == mi.Properties.Type.Object]
        nested = [item for item in objects if isinstance(item, mi.BSDF)]
        self._nested = self._nested_film(props, nested) if nested else None
        if self._nested is None:
            self._read_coating(props)
        self.sample_axis = common_axis(self.scatterers, self.title)
        side = mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide
        self.m_components = [kind | side for kind in COMPONENTS[: 4 if bool(self.scatterers) else 2]]
        self.m_components[1:] = [kind | mi.BSDFFlags.NonSymmetric for kind in self.m_components[1:]]
        self.m_flags = reduce(or_, self.m_components)

    def _take(self, props: mi.Properties, name: str) -> Any:
        """Return the value that a scene sets for a parameter, or its default, see `Param.of`."""
        return self.properties[name].of(props, name, self.title)

    # -- the coating ---------------------------------------------------------------------------------------------

    def _nested_film(self, props: mi.Properties, nested: list[Any]) -> Any:
        """
        Return the nested `thinfilm` plugin, or None without one.

        Nested scatter plugins are stored in `scatterers`. Raise `MistrayError` if nested plugins do not suit an
        interface, or the coating is also given by parameters.
        """
        self.scatterers = tuple(item for item in nested if hasattr(item, "scatterers") and item.scatterers == (item,))
        for item in self.scatterers:
            item.nest(self)
        nested = [item for item in nested if item not in self.scatterers]
        if not nested:
            return None
        film = nested[0]
        if len(nested) > 1 or getattr(film, "kind", "") != "thinfilm":
            what = f"{len(nested)} BSDFs" if len(nested) > 1 else f"{str(film).partition('[')[0]}"
            raise MistrayError(f"{self.title}: {what} nested; nest one 'thinfilm', its coating, and models of scatter")
        given = [key for key in ("R", "T", "table") if key in props]
        if given:
            raise MistrayError(f"{self.title}: give {given[0]} or a nested thinfilm, not both")
        if film.sides:
            raise MistrayError(
                f"{self.title}: its {film.title} has {film.sides[0]} as well; give {film.sides[0]} at the "
                "interface only"
            )
        film.is_nested = True
        return film

    def _read_coating(self, props: mi.Properties) -> None:
        """
        Set the coating from the scene's parameters R and T or table, if any is given.

        Raise `MistrayError` if `table` is given with R or T, T without R, or a value is not valid.
        """
        given = [key for key in ("R", "T", "table") if key in props]
        if "table" in given and len(given) > 1:
            raise MistrayError(f"{self.title}: give R and T or table, not both")
        if given == ["T"]:
            raise MistrayError(f"{self.title}: T is given without R; give both (A = 1 - R - T is absorbed)")
        if given == ["table"]:
            self._own = self._read_table(self._take(props, "table"))
        elif given:
            self._own_ideal = True
            self._R, self._T = (mi.Float(self._take(props, key)) for key in ("R", "T"))
            self._rebuild()

    def _read_table(self, spec: str) -> CoatingModel:
        if not spec.lower().endswith(".csv"):
            raise MistrayError(f"{self.title}: table '{spec}' is not a CSV file; nest a 'thinfilm' for other files")
        return CoatingTable.read(_resolve(spec))

    @property
    def title(self) -> str:
        """Kind and name of the plugin, for error messages."""
        return f"{self.kind} '{self.name}'" if self.name else self.kind

    def _parameters(self) -> dict[str, mi.Float]:
        """Return the coating's differentiable parameters that this plugin owns, by name."""
        return {"R": self._R, "T": self._T} if self._own_ideal else {}

    def _rebuild(self) -> None:
        """
        Rebuild the coating from the current parameters.

        If a parameter is not valid or has another number of entries, raise `MistrayError` and leave everything
        unchanged.
        """
        values = tuple(np.array(dr.detach(value), dtype=np.float64) for value in self._parameters().values())
        for name, value, held in zip(self._parameters(), values, self._held, strict=False):
            if len(value) != len(held):
                raise MistrayError(f"{self.title}: {name} has {len(value)} entries; it must have {len(held)} as before")
        self._own = self._build(*values)
        self._held = values

    def _build(self, *values: np.ndarray) -> CoatingModel:
        r, t = (float(value[0]) for value in values)
        check_shares(r, t, self.title)
        return Ideal(r, t, self.name)

    @property
    def _owner(self) -> Any:
        """Plugin that owns the coating: the nested `thinfilm`, or this one."""
        return self if self._nested is None else self._nested

    @property
    def coating(self) -> CoatingModel:
        """Coating with the current values of its parameters."""
        return self._owner._own

    @property
    def film(self) -> Any:
        """Plugin that owns differentiable coating parameters, this one or the nested one; None if there are none."""
        return self._owner if self._owner._parameters() else None

    @property
    def ideal(self) -> bool:
        """True if the coating has constant R and T."""
        return self._owner._own_ideal

    def _named_scatterers(self) -> dict[str, Any]:
        """Return the nested scatter plugins by their names in `mi.traverse`: "abg", "abg_2" for a second one."""
        kinds = [item.kind for item in self.scatterers]
        counts = [kinds[:k].count(kind) for k, kind in enumerate(kinds)]
        names = [f"{kind}_{count + 1}" if count else kind for kind, count in zip(kinds, counts, strict=True)]
        return dict(zip(names, self.scatterers, strict=True))

    @property
    def scatter(self) -> tuple[LobeModel, ...]:
        """Scatter models with the current values of their parameters, in the given order; () for none."""
        return tuple(item.model for item in self.scatterers)

    @property
    def R(self) -> mi.Float:
        """Reflectance of an ideal coating, 0 … 1; 0 for other coatings."""
        return self._owner._R

    @property
    def T(self) -> mi.Float:
        """Transmittance of an ideal coating, 0 … 1; 0 for other coatings."""
        return self._owner._T

    @property
    def opaque(self) -> bool:
        """True if the coating transmits nothing at any wavelength and angle."""
        return self.coating.opaque

    # -- the materials -------------------------------------------------------------------------------------------

    @property
    def front(self) -> str:
        """Material in front, with its index shift if it has one."""
        return self._glasses.front

    @property
    def back(self) -> str:
        """Material behind, with its index shift if it has one."""
        return self._glasses.back

    def _take_glasses(self) -> None:
        """
        Apply new index shifts of the materials.

        If a shift is not valid, raise `MistrayError` and leave everything unchanged.
        """
        try:
            if self._glasses.update(self.wavelength_nm):
                self._rendered = None
        except MistrayError as error:
            raise MistrayError(f"{self.title}: {error}" if self.name else str(error)) from None

    def lit_by(self, wavelength_nm: float) -> None:
        """Use the wavelength of the scene's light, nm, for Mitsuba's own integrators, unless the scene gives one."""
        if not self._own_wavelength and wavelength_nm != self.wavelength_nm:
            self.wavelength_nm, self._rendered = wavelength_nm, None

    @property
    def known_indices(self) -> tuple[float, float]:
        """Real refractive indices in front and behind, at `wavelength_nm` or the nearest known wavelength of each."""
        return self._glasses.known_indices(self.wavelength_nm)

    def indices(self, wavelength_nm: float) -> tuple[float, float]:
        """
        Return the real refractive indices of the front and the back material at a wavelength, nm.

        Raise `MistrayError` if one is not known there.
        """
        return refractive_index(self.front, wavelength_nm), refractive_index(self.back, wavelength_nm)

    def complex_indices(self, wavelength_nm: float) -> tuple[complex, complex]:
        """
        Return the indices n + ik of the front and the back material at a wavelength, nm.

        Raises
        ------
        MistrayError
            If n or k of a material is not known at the wavelength; the message names the interface.
        """
        try:
            return complex_index(self.front, wavelength_nm), complex_index(self.back, wavelength_nm)
        except MistrayError as error:
            raise MistrayError(f"{self.title}: {error}" if self.name else str(error)) from None

    # -- Mitsuba's protocol --------------------------------------------------------------------------------------

    def transparent(self, wavelength_nm: float) -> tuple[complex, complex]:
        """Return the indices of the materials for Mitsuba's own integrators, see `Glasses.transparent`."""
        return self._glasses.transparent(wavelength_nm)

    def _rendered_surface(self) -> RenderedSurface:
        """Return the surface for Mitsuba's own integrators, with the current coating and models of scatter."""
        coating, models = self.coating, self.scatter
        if self._rendered is None or self._rendered[0] is not coating or self._rendered[1] != models:
            nearest_nm = self._glasses.nearest_nm(self.wavelength_nm, coating)
            self._rendered = coating, models, RenderedSurface(self, self.name or self.kind, nearest_nm)
        return self._rendered[2]

    def _meet(
        self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, active: mi.Mask
    ) -> tuple[Interaction, RenderedScattering | None, list[mi.Float]]:
        """
        Return the interaction at a hit, its scatter, and the fraction of the incident flux in each of `COMPONENTS`.

        Without scatter the second is None, and the third has two entries. It is 0 for components that `ctx` disables.
        """
        surface, active = self._rendered_surface(), mi.Bool(active)
        it, scattering = surface.meet(-si.wi, active), None
        shares = [it.R, it.T]
        # Mitsuba's kernels also call nested plugins, which send no scattered light by themselves
        if self.scatterers and not self.is_nested:
            x_axis = None if self.sample_axis is None else self.sample_axis.local(si, bool(self.turned))
            scattering = surface.scattering(ctx.mode == mi.TransportMode.Radiance, -si.wi, it, x_axis)
        if scattering is not None:
            budget = scattering.shares(active)
            events = budget.reflection, budget.transmission
            shares = [share * event.kept for share, event in zip(shares, events, strict=True)]
            shares += [event.scattered for event in events]
        enabled = [ctx.is_enabled(kind, k) for k, kind in enumerate(COMPONENTS)]
        return it, scattering, [share if lit else mi.Float(0) for share, lit in zip(shares, enabled, strict=False)]

    def carried(self, by: Any, turned: bool) -> None:
        """
        Register a shape that has this interface, and whether its mesh normals point to the front (`turned`).

        Raise `MistrayError` if a detector shares it with other shapes and its two sides have different materials.
        """
        if self.turned not in (None, turned) and self.front != self.back:
            raise MistrayError(
                f"{self.title} has '{self.front}' and '{self.back}' on its sides and is shared by a detector "
                f"and another shape, the last '{by.name}'; give it an interface of its own. Mitsuba's loaders take "
                "equal ones for one: load with optimize=False or mistray.load"
            )
        self.turned = turned
        if self.sample_axis is not None:
            self.sample_axis.carried(by)

    def sample(
        self,
        ctx: mi.BSDFContext,
        si: mi.SurfaceInteraction3f,
        sample1: mi.Float,
        sample2: mi.Point2f,
        active: mi.Mask = True,
    ) -> tuple[mi.BSDFSample3f, mi.Spectrum]:
        it, scattering, shares = self._meet(ctx, si, active)
        chances = _chances(shares)
        # Scatter comes first; the remainder of sample1 chooses between the beams
        chosen, pdf, inner, rest = mi.UInt32(1), chances[1], mi.Float(0), mi.Float(sample1)
        undecided = mi.Bool(active)
        for k in (2, 3, 0) if scattering is not None else (0,):
            here = undecided & (rest <= chances[k]) & (chances[k] > 0)
            chosen, pdf = dr.select(here, k, chosen), dr.select(here, chances[k], pdf)
            inner = dr.select(here, rest / chances[k], inner)
            undecided, rest = undecided & ~here, dr.select(here, rest, rest - chances[k])
        # Beams: radiance, unlike flux, scales with the square of the index
        reflected = (chosen & 1) == 0
        index = dr.square(it.eta) if ctx.mode == mi.TransportMode.Radiance else 1
        weight, wo = (
            dr.select(reflected, shares[0], shares[1] * index),
            dr.select(reflected, it.reflected, it.transmitted),
        )
        if scattering is not None:
            drawn = scattering.draw(reflected, inner, sample2)
            value, density = self._scattered(ctx, si, scattering, chances, drawn, active)
            valid = (drawn.z * si.wi.z > 0) == reflected
            wo, weight = dr.select(chosen >= 2, drawn, wo), dr.select(chosen >= 2, value, weight)
            pdf = dr.select(chosen >= 2, dr.select(valid, density, 0), pdf)
        bs = dr.zeros(mi.BSDFSample3f)
        good = mi.Bool(active) & (pdf > 0)
        bs.wo, bs.pdf, bs.sampled_component = wo, dr.select(good, pdf, 0), chosen
        bs.sampled_type = mi.UInt32(0)
        for k, kind in enumerate(COMPONENTS):
            bs.sampled_type = dr.select(chosen == k, mi.UInt32(+kind), bs.sampled_type)
        bs.eta = dr.select(wo.z * si.wi.z > 0, 1, 1 / it.eta)
        return bs, mi.Spectrum(dr.select(good, weight / dr.select(good, pdf, 1), 0))

    def _scattered(
        self,
        ctx: mi.BSDFContext,
        si: mi.SurfaceInteraction3f,
        scattering: RenderedScattering,
        chances: list[mi.Float],
        wo: mi.Vector3f,
        active: mi.Mask,
    ) -> tuple[mi.Float, mi.Float]:
        """Return BSDF · cosine for the local direction wo, 1/sr, and the pdf with which `sample` draws it, 1/sr."""
        reflect = wo.z * si.wi.z > 0
        enabled = [ctx.is_enabled(COMPONENTS[k], k) for k in (2, 3)]
        lit = mi.Bool(active) & dr.select(reflect, *map(mi.Bool, enabled))
        value, density = scattering.evaluate(reflect, wo, lit)
        return value, density * dr.select(reflect, chances[2], chances[3])

    def eval(
        self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Mask = True
    ) -> mi.Spectrum:
        return self.eval_pdf(ctx, si, wo, active)[0]

    def pdf(
        self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Mask = True
    ) -> mi.Float:
        return self.eval_pdf(ctx, si, wo, active)[1]

    def eval_pdf(
        self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Mask = True
    ) -> tuple[mi.Spectrum, mi.Float]:
        _, scattering, shares = self._meet(ctx, si, active)
        if scattering is None:
            return mi.Spectrum(0), mi.Float(0)
        value, pdf = self._scattered(ctx, si, scattering, _chances(shares), wo, active)
        return mi.Spectrum(value), pdf

    def traverse(self, callback: mi.TraversalCallback) -> None:
        if self._nested is not None:
            callback.put("coating", self._nested, mi.ParamFlags.Differentiable)
        for name, item in self._named_scatterers().items():
            callback.put(name, item, mi.ParamFlags.Differentiable)
        for name, value in self._parameters().items():
            callback.put(name, value, mi.ParamFlags.Differentiable)
        if not self.is_nested:
            for name, value in self._glasses.parameters.items():
                callback.put(name, value, mi.ParamFlags.Differentiable)

    def parameters_changed(self, keys: list[str] = []) -> None:  # noqa: B006  (Mitsuba's own signature)
        before = self._valid_values()
        try:
            self._apply()
        except MistrayError:
            for value, held in before:
                mi.set_property(value, mi.Float(held))  # in place: mi.traverse has handed out this very object
            self._apply()
            raise

    def _valid_values(self) -> list[tuple[mi.Float, np.ndarray]]:
        """Return the parameters that this plugin owns, each with the last value that `_apply` has accepted."""
        own = zip(self._parameters().values(), self._held, strict=True)
        return [*zip(self._glasses.parameters.values(), self._glasses.held, strict=True), *own]

    def _apply(self) -> None:
        """Apply new values of the parameters; if one is not valid, raise `MistrayError`, perhaps after others."""
        self._take_glasses()
        if self._parameters():  # a nested coating looks after its own
            self._rebuild()

    def to_string(self) -> str:
        mirror = ", mirror" if self.mirror else ""
        scatter = "".join(f", {item}" for item in self.scatterers)
        return f"{type(self).__name__}[{self.front} | {self.back}, {self._owner._summary()}{mirror}{scatter}]"

    def _summary(self) -> str:
        """Return the string that describes the coating: its R and T, "Fresnel" or "table"."""
        if self._own_ideal:
            return f"R = {float(self._R[0]):g}, T = {float(self._T[0]):g}"
        return "Fresnel" if isinstance(self._own, Bare) else "table"


def _resolve(path: str) -> str:
    """Return the path of a file named relative to the scene file, as Mitsuba resolves it; unchanged if not found."""
    found = Path(str(mi.file_resolver().resolve(path)))
    # A folder that is left by ".." may be gone when the file is read again
    return str(found.resolve() if ".." in found.parts and found.exists() else found)


def _chances(shares: list[mi.Float]) -> list[mi.Float]:
    """Return the probability of drawing each component, in proportion to its fraction of the flux; 0 without flux."""
    total = dr.detach(sum(shares, mi.Float(0)))
    return [dr.select(total > 0, dr.detach(share) / dr.select(total > 0, total, 1), 0) for share in shares]


mi.register_bsdf("interface", lambda props: Interface(props))
