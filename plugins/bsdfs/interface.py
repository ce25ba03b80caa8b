"""Plugin `interface`: the optical surface, with a material on either side and one coating."""

from __future__ import annotations

from functools import reduce
from operator import or_
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.coatings import Bare, CoatingModel, CoatingTable, Ideal
from mistray.coatings.simple import check_shares
from mistray.errors import MistrayError
from mistray.materials import complex_index, refractive_index
from mistray.physics.fresnel import reflectance
from mistray.plugins.bsdfs.glasses import SHIFTS, Glasses
from mistray.plugins.bsdfs.lobe_sum import LobeSum
from mistray.plugins.bsdfs.sample_axis import SampleAxis, SampleFrame, common_axis
from mistray.ranges import AIMED_RAYS, SHARE, WAVELENGTH_NM
from mistray.scatter import Scatter
from mistray.spectra.spectrum import DEFAULT_NM
from mistray.surfaces.optics import (
    REFLECTION_BACK,
    REFLECTION_FRONT,
    TRANSMISSION,
    angle_table,
    is_dark,
    total_variable,
    unpolarized_shares,
)

STOCK_BODY_MM = 1.0  # stock integrators know no absorption on the way: what is dark after this length is opaque
UNNAMED = ("bsdf", "coating")  # names that come from the place in a dict
SIDES = (
    "front",
    "back",
    "mirror",
    "design_path",
    "splitting",
    "scatter_rays",
    "wavelength_nm",
    *SHIFTS,
)  # what an interface has beside its coating


class Interface(mi.BSDF):
    r"""
    Optical interface (:monosp:`interface`): two materials and a coating, with the energy budget R + T + A = 1.

    The materials are those at the ``front`` (where the shape's normal comes from) and at the ``back`` (where
    it points to), so that a ray needs no stack of media. The reflectance R and the transmittance T are

    - those of the bare surface (Fresnel's equations) when no coating is given; a metal may lie on either side,
    - constant when ``R`` and ``T`` are given (an ideal coating; ``R`` alone makes the surface opaque),
    - interpolated in a CSV file when ``table`` is given,
    - those of the nested ``thinfilm``: layers, a preset, or again R and T or a table. Several interfaces may
      share one by ``<ref id="…"/>``; it is then one object, with one set of parameters.

    A = 1 - R - T is absorbed. Beyond the critical angle nothing is transmitted: bare surfaces and layers
    reflect what their equations give, ideal and tabled coatings R + T.

    ================= ======= ======= ======== ===========================================================
    parameter         unit    range   default  meaning
    ================= ======= ======= ======== ===========================================================
    front, back       string          air      material: ``air``, an index (``1.5168``, ``1.5+0.01i``),
                                               ``nd=1.544 Vd=56.1``, a name (``N-BK7``, ``Al``) or a file;
                                               see docs/materials.md
    n_front_shift     1       ±       0        added to the real index of ``front`` at every wavelength
                                               (differentiable)
    n_back_shift      1       ±       0        the same for ``back`` (differentiable)
    R                 1       0 … 1   Fresnel  reflectance of an ideal coating (differentiable)
    T                 1       0 … 1   0 if R   transmittance of an ideal coating (differentiable)
    table             file            none     CSV over wavelength and angle, see docs/coatings.md; the angle
                                               is the one in the rarer material, for light from either side
    (nested) thinfilm bsdf            none     the coating, instead of R, T and table
    (nested) scatter  bsdf            none     models of scatter, any number: ``abg``, ``harvey_shack``,
                                               ``k_correlation``, ``psd_table``, ``gaussian_lobe``, ``phong``,
                                               ``polynomial``, ``particulate``, ``paint``,
                                               ``edge_diffraction``, ``tabulated``; see docs/scatter.md
    mirror            bool            false    the design path reflects here: such a reflection is not counted
                                               as a ghost bounce
    design_path       string          found    of a detector: the sequences of its direct image, where they are not
                                               those that are found; ``L1:T L2:T fold:R``, alternatives of a step
                                               joined by ``|``, sequences by ``;``; see docs/design_path.md
    splitting         string  split,  split    follow all children of a ray here, or one of them at random
                              one              (one in, one out; unbiased), whatever the trace does elsewhere
    scatter_rays      1       0 … 255 0        random scattered rays at every hit of the ray tree; 0: the setting of
                                               the trace
    wavelength_nm     nm      > 0     source   wavelength for *stock* integrators only; by default the first one of
                                               the scene's first source
    ================= ======= ======= ======== ===========================================================

    Models of scatter add up. What they scatter relative to R and T is taken from the specular beams, what is absolute
    from A. A surface that would give away more light than it gets is refused.

    Source: Fresnel's equations, see `mistray.physics.thinfilm`. Under a stock integrator the plugin is a delta BSDF
    for unpolarised light, plus the lobes of its scatter. R and T of a coating then come from the same table over the
    angle that the ray tree uses, at ``wavelength_nm``. Without it `mistray.load` takes the first wavelength of the
    scene's first source; it is 550 nm where there is none, or where Mitsuba's own loader made the scene. If materials
    or coating are not known there, it is the nearest wavelength at which they are. A material without k is taken for
    transparent. The ray tree evaluates materials at the wavelengths that are traced, and
    they need not be known anywhere else. The components are the reflected and the transmitted beam, then reflected and
    transmitted scatter. In the mode "radiance" light is scattered from wo to wi.

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
    sample_axis: SampleAxis | None = None

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.name = "" if props.id() in UNNAMED else str(props.id())
        self.wavelength_nm = WAVELENGTH_NM.check("wavelength_nm", props.get("wavelength_nm", DEFAULT_NM), self.title)
        self._own_wavelength = "wavelength_nm" in props
        self._glasses = Glasses(props, _resolve)
        self.is_nested = False
        self.mirror = bool(props.get("mirror", False))
        self.design_path = str(props.get("design_path", ""))
        splitting = str(props.get("splitting", "split"))
        if splitting not in ("split", "one"):
            raise MistrayError(f"{self.title}: splitting is '{splitting}'; use 'split' or 'one'")
        self.one_child = splitting == "one"
        self.scatter_rays = AIMED_RAYS.check("scatter_rays", props.get("scatter_rays", 0), self.title)
        self._take_glasses()  # an unknown material is an error of the scene, now
        self._turned: bool | None = None
        self._own_ideal = False
        self._R, self._T = mi.Float(0), mi.Float(0)
        self._own: CoatingModel = Bare()
        self._held: tuple[np.ndarray, ...] = ()
        self._stock: tuple[CoatingModel, dict[str, Any]] | None = None
        self._lobes: tuple[dict[str, Any], LobeSum] | None = None
        self.scatterers: tuple[Any, ...] = ()
        # Only objects are looked at: what is never requested is reported as unknown
        objects = [props[key] for key in list(props.keys()) if props.type(key) == mi.Properties.Type.Object]
        nested = [item for item in objects if isinstance(item, mi.BSDF)]
        self._nested = self._nested_film(props, nested) if nested else None
        if self._nested is None:
            self._read_coating(props)
        self.sample_axis = common_axis(self.scatterers, self.title)
        side = mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide
        self.m_components = [
            mi.BSDFFlags.DeltaReflection | side,
            mi.BSDFFlags.DeltaTransmission | mi.BSDFFlags.NonSymmetric | side,
        ]
        if self.scatterers:
            self.m_components += [
                mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.NonSymmetric | side,
                mi.BSDFFlags.GlossyTransmission | mi.BSDFFlags.NonSymmetric | side,
            ]
        self.m_flags = reduce(or_, self.m_components)

    # -- the coating ---------------------------------------------------------------------------------------------

    def _nested_film(self, props: mi.Properties, nested: list[Any]) -> Any:
        """The nested thinfilm, None if there is none; scatter plugins go to `scatterers`."""
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
        """Coating from the parameters R and T or table."""
        given = [key for key in ("R", "T", "table") if key in props]
        if "table" in given and len(given) > 1:
            raise MistrayError(f"{self.title}: give R and T or table, not both")
        if given == ["T"]:
            raise MistrayError(f"{self.title}: T is given without R; give both (A = 1 - R - T is absorbed)")
        if given == ["table"]:
            self._own = self._read_table(str(props.get("table")))
        elif given:
            self._own_ideal = True
            self._R, self._T = (mi.Float(SHARE.check(key, props.get(key, 0.0), self.title)) for key in ("R", "T"))
            self._rebuild()

    def _read_table(self, spec: str) -> CoatingModel:
        if not spec.lower().endswith(".csv"):
            raise MistrayError(f"{self.title}: table '{spec}' is no CSV file; nest a 'thinfilm' for other files")
        return CoatingTable.read(_resolve(spec))

    @property
    def title(self) -> str:
        """For messages."""
        return f"{self.kind} '{self.name}'" if self.name else self.kind

    def _parameters(self) -> dict[str, mi.Float]:
        """The differentiable parameters of the coating that this plugin owns, by name."""
        return {"R": self._R, "T": self._T} if self._own_ideal else {}

    def _rebuild(self) -> None:
        """Make the coating from the parameters; raises if they are impossible, and then nothing has changed."""
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
        """The plugin that has the coating: the nested one, or this one."""
        return self if self._nested is None else self._nested

    @property
    def coating(self) -> CoatingModel:
        """The coating with the current values of its parameters."""
        return self._owner._own

    @property
    def film(self) -> Any:
        """The plugin that owns the coating's differentiable parameters, this one or the nested one; None if none."""
        return self._owner if self._owner._parameters() else None

    @property
    def ideal(self) -> bool:
        """Whether R and T are constants."""
        return self._owner._own_ideal

    @property
    def _scatters(self) -> bool:
        """Whether it sends scattered light by itself; Mitsuba's kernels call plugins that are nested, too."""
        return bool(self.scatterers) and not self.is_nested

    def _named_scatterers(self) -> dict[str, Any]:
        """The nested scatter plugins by the names that `mi.traverse` gives them: "abg", a second one "abg_2"."""
        kinds = [item.kind for item in self.scatterers]
        counts = [kinds[:k].count(kind) for k, kind in enumerate(kinds)]
        names = [f"{kind}_{count + 1}" if count else kind for kind, count in zip(kinds, counts, strict=True)]
        return dict(zip(names, self.scatterers, strict=True))

    @property
    def scatter(self) -> tuple[Scatter, ...]:
        """The models of scatter with the current values of their parameters, in the order given; () if none."""
        return tuple(item.model for item in self.scatterers)

    @property
    def R(self) -> mi.Float:
        """Reflectance of an ideal coating."""
        return self._owner._R

    @property
    def T(self) -> mi.Float:
        """Transmittance of an ideal coating."""
        return self._owner._T

    @property
    def opaque(self) -> bool:
        """Whether the coating transmits nothing at any wavelength and angle."""
        return self.coating.opaque

    # -- the materials -------------------------------------------------------------------------------------------

    @property
    def front(self) -> str:
        """Material in front, with its shift of the index if it has one."""
        return self._glasses.front

    @property
    def back(self) -> str:
        """Material behind, with its shift of the index if it has one."""
        return self._glasses.back

    @property
    def shifts(self) -> dict[str, mi.Float]:
        """``n_front_shift`` and ``n_back_shift``."""
        return self._glasses.parameters

    @property
    def materials(self) -> tuple[str, str]:
        """Materials in front and behind, without shifts of the index."""
        return self._glasses.given

    @property
    def declared(self) -> tuple[bool, bool]:
        """Whether the scene says what lies in front, and what behind."""
        return self._glasses.declared

    def _take_glasses(self) -> None:
        """Take new shifts of the indices; raises if they are impossible, and then nothing has changed."""
        try:
            if self._glasses.update(self.wavelength_nm):
                self._stock = None
        except MistrayError as error:
            raise MistrayError(f"{self.title}: {error}" if self.name else str(error)) from None

    def lit_by(self, wavelength_nm: float) -> None:
        """Take the wavelength of the scene's light, nm, for stock integrators, unless the scene gives another one."""
        if not self._own_wavelength and wavelength_nm != self.wavelength_nm:
            self.wavelength_nm, self._stock = wavelength_nm, None

    @property
    def known_indices(self) -> tuple[float, float]:
        """Real indices in front and behind, each at `wavelength_nm` or the nearest one at which it is known."""
        return self._glasses.known_indices(self.wavelength_nm)

    def indices(self, wavelength_nm: float) -> tuple[float, float]:
        """Real refractive indices of the front and the back material at a wavelength in nm."""
        return refractive_index(self.front, wavelength_nm), refractive_index(self.back, wavelength_nm)

    def complex_indices(self, wavelength_nm: float) -> tuple[complex, complex]:
        """
        Indices n + ik of the front and the back material.

        Raises
        ------
        MistrayError
            If a k is not known; the message names the interface.
        """
        try:
            return complex_index(self.front, wavelength_nm), complex_index(self.back, wavelength_nm)
        except MistrayError as error:
            raise MistrayError(f"{self.title}: {error}" if self.name else str(error)) from None

    # -- Mitsuba's protocol --------------------------------------------------------------------------------------

    def _stock_table(self) -> dict[str, Any]:
        """The coating at one wavelength for stock integrators: tables, and whether nothing is transmitted."""
        coating = self.coating
        if self._stock is None or self._stock[0] is not coating:
            wavelength_nm = self._glasses.nearest_nm(self.wavelength_nm, coating)
            sides = self._glasses.transparent(wavelength_nm)
            opaque = coating.opaque or bool(np.any(is_dark(sides, wavelength_nm, STOCK_BODY_MM)))
            tables = {}
            if not self.ideal and (opaque or not isinstance(coating, Bare)):
                table = angle_table(coating, wavelength_nm, *sides, opaque, False)
                for name, part in (("refraction", table.refraction), ("total", table.total)):
                    tables[name] = mi.Float(np.ascontiguousarray(part[:, :, 0]).ravel()), len(part) - 1
            self._stock = coating, {"nm": wavelength_nm, "n": sides, "opaque": opaque, "tables": tables}
        return self._stock[1]

    def _specular(self, cos_wi: mi.Float, active: mi.Mask) -> tuple[mi.Float, mi.Float, mi.Float, mi.Float]:
        """R, T, the signed cosine of the transmitted direction and n_i/n_t, for a direction wi in the local frame."""
        stock = self._stock_table()
        n_front, n_back = (n.real for n in stock["n"])
        from_back = cos_wi > 0
        n_i, n_t = dr.select(from_back, n_back, n_front), dr.select(from_back, n_front, n_back)
        eta, cos_i = n_i / n_t, dr.abs(cos_wi)
        sin2_t = dr.square(eta) * dr.maximum(0, 1 - dr.square(cos_i))
        tir = (sin2_t >= 1) & (not stock["opaque"])
        cos_t = dr.sqrt(dr.maximum(0, 1 - sin2_t))
        if self.ideal:
            # Copies, since Dr.Jit may widen a literal in place where a mask is one as well
            R, T = mi.Float(self.R), mi.Float(self.T)
            r, t = dr.select(tir, R + T, R), dr.select(tir, 0, T)
        elif stock["tables"]:
            rarer = cos_i if stock["opaque"] else dr.minimum(cos_i, cos_t)
            r, t = _interpolate(*stock["tables"]["refraction"], rarer, from_back, active)
            beyond, _ = _interpolate(*stock["tables"]["total"], total_variable(sin2_t, eta, cos_i), from_back, active)
            r, t = dr.select(tir, beyond, r), dr.select(tir, 0, t)
        else:
            r = dr.select(tir, 1, reflectance(cos_i, cos_t, n_i, n_t))
            t = 1 - r
        return r, t, -dr.mulsign(cos_t, cos_wi), eta

    def _lobe_sum(self) -> LobeSum:
        """What scatters, for stock integrators."""
        models, stock = self.scatter, self._stock_table()
        if self._lobes is None or self._lobes[0] is not stock or self._lobes[1].models != list(models):
            n = tuple(n.real for n in stock["n"])
            lobes = LobeSum(self.scatterers, stock["nm"], n, stock["opaque"], self._stock_shares, self.title)
            self._lobes = stock, lobes
        return self._lobes[1]

    def _stock_shares(self, from_front: bool, cosines: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """R and T for stock integrators at cosines of incidence, (m,) each."""
        stock = self._stock_table()
        return unpolarized_shares(self.coating, stock["nm"], stock["n"], stock["opaque"], from_front, cosines)

    def _sample(self, si: mi.SurfaceInteraction3f) -> SampleFrame | None:
        """How the sample lies at a hit, if a model of scatter depends on it."""
        return None if self.sample_axis is None else self.sample_axis.local(si, bool(self._turned))

    def _beams(
        self,
        ctx: mi.BSDFContext,
        wi: mi.Vector3f,
        shares: tuple[mi.Float, mi.Float],
        cos_t: mi.Float,
        sample: SampleFrame | None,
        active: mi.Mask,
    ) -> tuple[mi.Float, mi.Float]:
        """What scatter leaves of the reflected and the transmitted beam, where a context asks for them."""
        reflects = ctx.is_enabled(mi.BSDFFlags.DeltaReflection, 0)
        transmits = ctx.is_enabled(mi.BSDFFlags.DeltaTransmission, 1)
        r, t = (shares[0] if reflects else mi.Float(0)), (shares[1] if transmits else mi.Float(0))
        if self._scatters and (reflects or transmits):
            lobes, from_back = self._lobe_sum(), wi.z > 0
            cos_i = dr.abs(wi.z)
            # In the mode "radiance" light goes to wi, and what is transmitted comes from the other side
            radiance = ctx.mode == mi.TransportMode.Radiance
            side, tangent, lit = (~from_back, wi.xy, -wi.z) if radiance else (from_back, -wi.xy, wi.z)
            turns = [None, None] if sample is None else [sample.plane(tangent, z)[2] for z in (wi.z, lit)]
            r = r * (1 - lobes.loss("reflection", cos_i, from_back, active, turns[0]))
            t = t * (1 - lobes.loss("transmission", dr.minimum(cos_i, dr.abs(cos_t)), side, active, turns[1]))
        return r, t

    def _choices(
        self, ctx: mi.BSDFContext, wi: mi.Vector3f, shares: tuple[mi.Float, mi.Float], beams: tuple[mi.Float, mi.Float]
    ) -> tuple[list[tuple[Any, mi.Float]], mi.Float]:
        """Probabilities of the lobes, and by what the shares of the specular beams are multiplied to be theirs."""
        lobes = self._lobe_sum().weights(ctx, wi, shares) if self._scatters else []
        total = dr.detach(beams[0] + beams[1])
        for _, weight in lobes:
            total += weight
        scale = dr.select(total > 0, dr.rcp(dr.select(total > 0, total, 1)), 0)
        return [(slot, weight * scale) for slot, weight in lobes], scale

    def carried(self, by: Any, turned: bool) -> None:
        """Called by a shape that carries this interface: whether the normals of its mesh look to the front."""
        if self._turned not in (None, turned) and self.front != self.back:
            raise MistrayError(
                f"{self.title} has '{self.front}' and '{self.back}' on its sides and is shared by a detector "
                f"and another shape, the last '{by.name}'; give it an interface of its own. Mitsuba's loaders take "
                "equal ones for one: load with optimize=False or mistray.load"
            )
        self._turned = turned
        if self.sample_axis is not None:
            self.sample_axis.carried(by)

    def _turn(self, v: mi.Vector3f) -> mi.Vector3f:
        """From the local frame of a hit to the one whose z axis points to the back, or the other way round."""
        return mi.Vector3f(v.x, v.y, -v.z) if self._turned else v

    def sample(
        self,
        ctx: mi.BSDFContext,
        si: mi.SurfaceInteraction3f,
        sample1: mi.Float,
        sample2: mi.Point2f,
        active: mi.Mask = True,
    ) -> tuple[mi.BSDFSample3f, mi.Spectrum]:
        wi = self._turn(si.wi)
        r, t, cos_t, eta = self._specular(wi.z, active)
        sample = self._sample(si)
        beams = self._beams(ctx, wi, (r, t), cos_t, sample, active)
        lobes, scale = self._choices(ctx, wi, (r, t), beams)
        active = active & (scale > 0)
        # The lobes come first; what they leave of sample1 chooses between the beams
        choice, rest = None, sample1
        if lobes:
            choice, rest = self._lobe_sum().choose(ctx, wi, lobes, sample1, sample2, active)
        probability = dr.detach(beams[0]) * scale
        reflected = active & (rest <= probability) & (probability > 0)
        bs = dr.zeros(mi.BSDFSample3f)
        bs.pdf = dr.select(active, dr.select(reflected, probability, dr.detach(beams[1]) * scale), 0)
        bs.sampled_component = dr.select(reflected, mi.UInt32(0), mi.UInt32(1))
        bs.sampled_type = dr.select(
            reflected, mi.UInt32(+mi.BSDFFlags.DeltaReflection), mi.UInt32(+mi.BSDFFlags.DeltaTransmission)
        )
        bs.wo = dr.select(reflected, mi.Vector3f(-wi.x, -wi.y, wi.z), mi.Vector3f(-eta * wi.x, -eta * wi.y, cos_t))
        # Radiance, unlike flux, scales with the square of the index
        index = dr.square(eta) if ctx.mode == mi.TransportMode.Radiance else mi.Float(1)
        weight = dr.select(reflected, beams[0], beams[1] * index) / dr.select(bs.pdf > 0, bs.pdf, 1)
        weight = dr.select(active & (bs.pdf > 0), weight, 0)
        if choice is not None:
            value, pdf = self._scattered(ctx, wi, choice.wo, lobes, sample, choice.valid)
            use = choice.valid & (pdf > 0)
            bs.wo = dr.select(choice.chosen, choice.wo, bs.wo)
            bs.pdf = dr.select(choice.chosen, dr.select(use, pdf, 0), bs.pdf)
            bs.sampled_component = dr.select(choice.chosen, choice.component, bs.sampled_component)
            glossy = dr.select(
                choice.component == 2, +mi.BSDFFlags.GlossyReflection, mi.UInt32(+mi.BSDFFlags.GlossyTransmission)
            )
            bs.sampled_type = dr.select(choice.chosen, glossy, bs.sampled_type)
            weight = dr.select(choice.chosen, dr.select(use, value / dr.select(use, pdf, 1), 0), weight)
        bs.eta = dr.select(bs.wo.z * wi.z > 0, 1, 1 / eta)
        bs.wo = self._turn(bs.wo)
        return bs, mi.Spectrum(weight) & active

    def _scattered(
        self,
        ctx: mi.BSDFContext,
        wi: mi.Vector3f,
        wo: mi.Vector3f,
        lobes: list[tuple[Any, mi.Float]],
        sample: SampleFrame | None,
        active: mi.Mask,
    ) -> tuple[mi.Float, mi.Float]:
        """BSDF times cosine of wo, and the density of wo, by the probabilities of the lobes."""
        light = wo if ctx.mode == mi.TransportMode.Radiance else wi
        shares = self._specular(light.z, active)[:2]
        lobe_sum = self._lobe_sum()
        value = lobe_sum.value(ctx, wi, wo, shares, active, sample)
        return value, lobe_sum.density(ctx, wi, wo, lobes, active)

    def eval(
        self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Mask = True
    ) -> mi.Spectrum:
        if not self._scatters:
            return mi.Spectrum(0)
        wi, wo = self._turn(si.wi), self._turn(wo)
        light = wo if ctx.mode == mi.TransportMode.Radiance else wi
        shares = self._specular(light.z, active)[:2]
        return mi.Spectrum(self._lobe_sum().value(ctx, wi, wo, shares, mi.Mask(active), self._sample(si)))

    def pdf(
        self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Mask = True
    ) -> mi.Float:
        if not self._scatters:
            return mi.Float(0)
        wi, wo = self._turn(si.wi), self._turn(wo)
        r, t, cos_t, _ = self._specular(wi.z, active)
        beams = self._beams(ctx, wi, (r, t), cos_t, self._sample(si), active)
        lobes, _ = self._choices(ctx, wi, (r, t), beams)
        return self._lobe_sum().density(ctx, wi, wo, lobes, mi.Mask(active))

    def eval_pdf(
        self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Mask = True
    ) -> tuple[mi.Spectrum, mi.Float]:
        return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

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
        try:
            self._take_glasses()
            if self._parameters():  # a nested coating looks after its own
                self._rebuild()
        except MistrayError:
            self._glasses.restore()
            for value, held in zip(self._parameters().values(), self._held, strict=True):
                mi.set_property(value, mi.Float(held))  # in place: mi.traverse has handed out this very object
            raise

    def to_string(self) -> str:
        mirror = ", mirror" if self.mirror else ""
        scatter = "".join(f", {item}" for item in self.scatterers)
        return f"{type(self).__name__}[{self.front} | {self.back}, {self._owner._summary()}{mirror}{scatter}]"

    def _summary(self) -> str:
        """The coating in a few words."""
        if self._own_ideal:
            return f"R = {float(self._R[0]):g}, T = {float(self._T[0]):g}"
        return "Fresnel" if isinstance(self._own, Bare) else "table"


def _resolve(path: str) -> str:
    """A path that is relative to the scene file, made absolute where the file is found."""
    return str(mi.file_resolver().resolve(path))


def _interpolate(
    values: mi.Float, intervals: int, x: mi.Float, from_back: mi.Mask, active: mi.Mask
) -> tuple[mi.Float, mi.Float]:
    """R and T at x in 0 … 1 of a table with rows of R from the front, R from the back and T at uniform nodes."""
    place = x * intervals
    index = dr.minimum(mi.UInt32(place), intervals - 1)
    reflection = dr.select(from_back, mi.UInt32(REFLECTION_BACK), mi.UInt32(REFLECTION_FRONT))

    def column(channel: Any) -> mi.Float:
        low, high = (dr.gather(mi.Float, values, 3 * (index + step) + channel, active) for step in range(2))
        return dr.lerp(low, high, place - index)

    return column(reflection), column(TRANSMISSION)


mi.register_bsdf("interface", lambda props: Interface(props))
