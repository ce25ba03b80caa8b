"""Plugin `interface`: the optical surface, with a material on either side and one coating."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.coatings import CoatingTable
from mistray.errors import MistrayError
from mistray.materials import refractive_index
from mistray.physics.fresnel import reflectance

STOCK_WAVELENGTH_NM = 550.0


class Interface(mi.BSDF):
    r"""
    Optical interface (:monosp:`interface`): two materials and a coating, with the energy budget R + T + A = 1.

    The materials are those at the ``front`` (where the shape's normal comes from) and at the ``back`` (where
    it points to), so that a ray needs no stack of media. The reflectance R and the transmittance T are

    - those of the bare surface (Fresnel, unpolarised, T = 1 - R) when no coating is given,
    - constant when ``R`` and ``T`` are given (an ideal coating; ``R`` alone makes the surface opaque),
    - interpolated in a CSV file when ``table`` is given.

    A = 1 - R - T is absorbed. Beyond the critical angle the transmitted part is reflected as well: R + T.

    ============== ======= ======= ======== ==============================================================
    parameter      unit    range   default  meaning
    ============== ======= ======= ======== ==============================================================
    front, back    string          air      material: ``air``, ``vacuum``, an index (``1.5168``),
                                            ``nd=1.544 Vd=56.1`` or a glass name (``N-BK7``)
    R              1       0 … 1   Fresnel  reflectance of an ideal coating (differentiable)
    T              1       0 … 1   0 if R   transmittance of an ideal coating (differentiable)
    table          file            none     CSV with the columns wavelength_nm, angle_deg, R, T and, where
                                            the coating absorbs, R_back; the angle is the one in the rarer
                                            material, for light from either side
    mirror         bool            false    the design path reflects here: such a reflection is not counted
                                            as a ghost bounce
    wavelength_nm  nm      > 0     550      wavelength for *stock* integrators only; the ray tree uses the
                                            wavelength of its source
    ============== ======= ======= ======== ==============================================================

    Source: Fresnel's equations, see `mistray.physics.fresnel`. Under a stock integrator the plugin is a
    delta BSDF (a smooth dielectric with the coating's R and T).

    .. code-block:: xml

        <bsdf type="interface">
            <string name="front" value="air"/>
            <string name="back" value="N-BK7"/>
            <float name="R" value="0.01"/>
            <float name="T" value="0.99"/>
        </bsdf>

    .. code-block:: python

        {"type": "interface", "front": "air", "back": "nd=1.544 Vd=56.1", "R": 0.02, "T": 0.98}
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.name = str(props.id())
        self.front = str(props.get("front", "air"))
        self.back = str(props.get("back", "air"))
        self.mirror = bool(props.get("mirror", False))
        self.wavelength_nm = float(props.get("wavelength_nm", STOCK_WAVELENGTH_NM))
        for spec in (self.front, self.back):
            refractive_index(spec, self.wavelength_nm)  # an unknown material is an error of the scene, now
        ideal = "R" in props or ("T" in props)
        if ideal and ("table" in props):
            raise MistrayError(f"interface '{self.name}': give R and T or table, not both")
        self.table: CoatingTable | None = None
        self.ideal = ideal
        if ideal and "R" not in props:
            raise MistrayError(f"interface '{self.name}': T is given without R; give both (A = 1 - R - T is absorbed)")
        self.R = mi.Float(float(props.get("R", 0.0)))
        self.T = mi.Float(float(props.get("T", 0.0)))
        self._check()
        self._held = (float(self.R[0]), float(self.T[0]))
        if "table" in props:
            path = str(mi.file_resolver().resolve(str(props.get("table"))))
            self.table = CoatingTable.read(path)
        side = mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide
        self.m_components = [
            mi.BSDFFlags.DeltaReflection | side,
            mi.BSDFFlags.DeltaTransmission | mi.BSDFFlags.NonSymmetric | side,
        ]
        self.m_flags = self.m_components[0] | self.m_components[1]

    def _check(self) -> None:
        if not self.ideal:
            return
        r, t = float(dr.detach(self.R)[0]), float(dr.detach(self.T)[0])
        if not (0 <= r <= 1 and 0 <= t <= 1 and r + t <= 1 + 1e-6):
            raise MistrayError(
                f"interface '{self.name}': R = {r:g} and T = {t:g}; both must lie in 0 … 1 and R + T must not exceed 1"
            )

    @property
    def opaque(self) -> bool:
        """Whether nothing is transmitted at any wavelength and angle."""
        if self.table is not None:
            return self.table.opaque
        return self.ideal and float(dr.detach(self.T)[0]) == 0.0

    def indices(self, wavelength_nm: float) -> tuple[float, float]:
        """Refractive indices of the front and the back material at a wavelength in nm."""
        return refractive_index(self.front, wavelength_nm), refractive_index(self.back, wavelength_nm)

    @property
    def coating(self):
        from mistray.coatings import Bare

        return Bare() if self.table is None else self.table

    film = None

    def complex_indices(self, wavelength_nm: float) -> tuple[complex, complex]:
        """Placeholder of worker C's method."""
        return tuple(complex(n) for n in self.indices(wavelength_nm))

    def tabulate(self, wavelength_nm: float, cos_rare: np.ndarray) -> np.ndarray | None:
        """
        Reflectance and transmittance for the ray tree, or None if bare Fresnel or an ideal coating says it all.

        Parameters
        ----------
        wavelength_nm : float
            Vacuum wavelength, nm.
        cos_rare : (n,) float
            Cosine of the angle of incidence in the rarer material.

        Returns
        -------
        (n, 3) float or None
            R for light from the front, R for light from the back, T. A subclass with a coating of its own
            overrides this.
        """
        return None if self.table is None else self.table.evaluate(wavelength_nm, cos_rare)

    def _specular(self, cos_wi: mi.Float, active: mi.Mask) -> tuple[mi.Float, mi.Float, mi.Float, mi.Float]:
        """R, T, the signed cosine of the transmitted direction and n_i/n_t, for a direction wi in the local frame."""
        n_front, n_back = self.indices(self.wavelength_nm)
        from_back = cos_wi > 0
        n_i, n_t = dr.select(from_back, n_back, n_front), dr.select(from_back, n_front, n_back)
        eta, cos_i = n_i / n_t, dr.abs(cos_wi)
        sin2_t = dr.square(eta) * dr.maximum(0, 1 - dr.square(cos_i))
        tir = sin2_t >= 1
        cos_t = dr.sqrt(dr.maximum(0, 1 - sin2_t))
        if self.table is not None:
            nodes = np.linspace(0.0, 1.0, 257)
            values = self.table.evaluate(self.wavelength_nm, nodes)
            x = dr.minimum(cos_i, cos_t) * (len(nodes) - 1)
            index = dr.minimum(mi.UInt32(x), len(nodes) - 2)
            column = [mi.Float(values[:, k]) for k in range(3)]
            r_f, r_b, t = (
                dr.lerp(dr.gather(mi.Float, c, index, active), dr.gather(mi.Float, c, index + 1, active), x - index)
                for c in column
            )
            r = dr.select(from_back, r_b, r_f)
        elif self.ideal:
            r, t = mi.Float(self.R), mi.Float(self.T)
        else:
            r = reflectance(cos_i, cos_t, n_i, n_t)
            t = 1 - r
        return dr.select(tir, r + t, r), dr.select(tir, 0, t), -dr.mulsign(cos_t, cos_wi), eta

    def sample(
        self,
        ctx: mi.BSDFContext,
        si: mi.SurfaceInteraction3f,
        sample1: mi.Float,
        sample2: mi.Point2f,
        active: mi.Mask = True,
    ) -> tuple[mi.BSDFSample3f, mi.Spectrum]:
        r, t, cos_t, eta = self._specular(si.wi.z, active)
        reflects = ctx.is_enabled(mi.BSDFFlags.DeltaReflection, 0)
        transmits = ctx.is_enabled(mi.BSDFFlags.DeltaTransmission, 1)
        r, t = (r if reflects else mi.Float(0)), (t if transmits else mi.Float(0))
        total = r + t
        active = active & (total > 0)
        probability = dr.select(total > 0, r / total, 0)
        reflected = active & (sample1 <= probability)
        bs = dr.zeros(mi.BSDFSample3f)
        bs.pdf = dr.select(active, dr.select(reflected, probability, 1 - probability), 0)
        bs.sampled_component = dr.select(reflected, mi.UInt32(0), mi.UInt32(1))
        bs.sampled_type = dr.select(
            reflected, mi.UInt32(+mi.BSDFFlags.DeltaReflection), mi.UInt32(+mi.BSDFFlags.DeltaTransmission)
        )
        bs.wo = dr.select(
            reflected, mi.Vector3f(-si.wi.x, -si.wi.y, si.wi.z), mi.Vector3f(-eta * si.wi.x, -eta * si.wi.y, cos_t)
        )
        bs.eta = dr.select(reflected, 1, 1 / eta)
        # Radiance, unlike flux, scales with the square of the index
        scale = dr.square(eta) if ctx.mode == mi.TransportMode.Radiance else mi.Float(1)
        weight = dr.select(reflected, total, total * scale)
        return bs, mi.Spectrum(weight) & active

    def eval(
        self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Mask = True
    ) -> mi.Spectrum:
        return mi.Spectrum(0)

    def pdf(
        self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Mask = True
    ) -> mi.Float:
        return mi.Float(0)

    def eval_pdf(
        self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Mask = True
    ) -> tuple[mi.Spectrum, mi.Float]:
        return mi.Spectrum(0), mi.Float(0)

    def traverse(self, callback: mi.TraversalCallback) -> None:
        if self.ideal:
            callback.put("R", self.R, mi.ParamFlags.Differentiable)
            callback.put("T", self.T, mi.ParamFlags.Differentiable)

    def parameters_changed(self, keys: list[str] = []) -> None:  # noqa: B006  (Mitsuba's own signature)
        try:
            self._check()
        except MistrayError:
            self.R[0], self.T[0] = self._held
            raise
        self._held = (float(dr.detach(self.R)[0]), float(dr.detach(self.T)[0]))

    def to_string(self) -> str:
        coating = (
            f"R = {float(self.R[0]):g}, T = {float(self.T[0]):g}"
            if self.ideal
            else "Fresnel"
            if self.table is None
            else "table"
        )
        return f"Interface[{self.front} | {self.back}, {coating}{', mirror' if self.mirror else ''}]"


mi.register_bsdf("interface", lambda props: Interface(props))
