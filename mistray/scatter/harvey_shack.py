"""Harvey-Shack model of a polished surface, by its three parameters or by its roughness."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from mistray.errors import MistrayError
from mistray.physics import harvey_shack
from mistray.scatter.lobe import Lobe, Placement
from mistray.scatter.numbers import FALLING, KNEE, PEAK, REFERENCE, ROUGHNESS, unusual, within


def index_step(event: str, n_in: Any, n_out: Any) -> Any:
    """
    Return the optical path difference per surface height at normal incidence, Δn ≥ 0.

    Δn is 2 n_in in reflection and |n_in - n_out| in transmission; n_in is the index on the side of incidence.
    """
    return 2 * n_in if event == "reflection" else abs(n_in - n_out)


def need_smooth(title: str, event: str, rms_um: float, wavelength_um: float, step: float, remedy: str) -> None:
    """
    Check that a surface is smooth enough for first-order scatter theory, 2π Δn σ ≪ λ.

    The roughness σ and the vacuum wavelength λ are in µm; `step`, Δn, is that of `index_step`. `title` begins the
    message, and `remedy` ends it.

    Raises
    ------
    MistrayError
        If 2π Δn σ/λ is above `mistray.physics.harvey_shack.MAX_PHASE`.
    """
    phase = harvey_shack.phase_rms(rms_um, wavelength_um, step)
    if phase > harvey_shack.MAX_PHASE:
        raise MistrayError(
            f"{title}: rms roughness {rms_um * 1e3:g} nm is not smooth in {event} at {wavelength_um * 1e3:g} nm "
            f"(2π Δn σ/λ is {phase:.3g}, limit {harvey_shack.MAX_PHASE:.3g}); {remedy}"
        )


@dataclass(frozen=True)
class HarveyShack(Placement):
    """
    Harvey-Shack scatter, BSDF = b0 (1 + (|β - β0|/l)²)^(s/2).

    Give either `b0` or `rms_nm`. `b0` is the same in reflection and transmission and from both sides, as in FRED. From
    `rms_nm`, b0 follows for each event and side. Total scatter at normal incidence is then (2π Δn σ/λ)², with Δn = 2
    n_in in reflection and |n_in - n_out| in transmission. β and l are direction cosines in the medium of the scattered
    light. Equations and sources: `mistray.physics.harvey_shack`.

    Attributes
    ----------
    b0 : float, optional
        BSDF in the specular direction, 1/sr, ≥ 0.
    rms_nm : float, optional
        Rms roughness σ, nm, ≥ 0, at spatial frequencies up to 1/λ; by keyword only.
    l : float
        Direction cosine of the knee, > 0. 0.01 is common for polished plastic.
    s : float
        Slope beyond the knee, < 0. -1.5 is common for polished plastic.
    reference_nm : float, optional
        Vacuum wavelength, nm, at which b0 (or the b0 of `rms_nm`) and l hold. At another one the same smooth surface
        has b0/k⁴ and k l, with k = λ/reference_nm. Without it a given b0 is the same at all wavelengths; with `rms_nm`,
        b0 is computed at each wavelength with the same l.

    Raises
    ------
    MistrayError
        If a parameter is out of range, or not exactly one of `b0` and `rms_nm` is given. `lobes` raises it for a
        surface that is not smooth at a wavelength.
    """

    b0: float | None = PEAK.field(None)
    rms_nm: float | None = replace(ROUGHNESS, doc="rms roughness instead of b0").field(None, kw_only=True)
    l: float = KNEE.field(0.01)  # noqa: E741
    s: float = FALLING.field(-1.5)
    reference_nm: float | None = replace(
        REFERENCE,
        doc="wavelength at which b0 and l hold; at others the scatter of a smooth surface is scaled. None: l, and b0 "
        "if given, do not depend on the wavelength",
    ).field(None)

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.b0 is None) == (self.rms_nm is None):
            given = "neither" if self.b0 is None else "both"
            raise MistrayError(f"{self.title}: {given} of b0 and rms_nm given; give one of them")

    def parameters(self, wavelength_nm: float, event: str, n_in: float, n_out: float) -> tuple[float, float]:
        """
        Return b0, 1/sr, and l of one event.

        Parameters
        ----------
        wavelength_nm : float
            Vacuum wavelength, nm.
        event : {"reflection", "transmission"}
            Event to which the values apply.
        n_in, n_out : float
            Refractive indices on the side of incidence and on the other side.

        Raises
        ------
        MistrayError
            If `rms_nm` is given and the surface is not smooth at the wavelength.
        """
        reference_nm = self.reference_nm or wavelength_nm
        if self.rms_nm is None:
            b0 = float(self.b0 or 0)
        else:
            step, rms_um = index_step(event, n_in, n_out), self.rms_nm * 1e-3
            remedy = "give b0 of a measurement, or a k_correlation of theory 'ghs_full'"
            need_smooth(self.title, event, rms_um, min(wavelength_nm, reference_nm) * 1e-3, step, remedy)
            share = harvey_shack.tis_from_rms(rms_um, reference_nm * 1e-3, step)
            b0 = float(harvey_shack.b0_from_tis(share, self.l, self.s))
        return harvey_shack.at_wavelength(b0, self.l, wavelength_nm / reference_nm)

    def event_lobes(self, event: str, wavelength_nm: float, n_in: float, n_out: float) -> tuple[Lobe, ...]:
        """Return the lobe of an event, or () if b0 or the roughness is 0, see `Placement.event_lobes`."""
        b0, knee = self.parameters(wavelength_nm, event, n_in, n_out)
        if b0 == 0:
            return ()
        return (Lobe(event, lambda r: harvey_shack.bsdf(r, b0, knee, self.s), shares=self.shares),)

    def advice(self) -> str | None:
        """
        Return a line of advice if l, s or the total scatter are unusual; None otherwise.

        Usual are l in 1e-4 … 1e-2 and s in -3.5 … -0.5 (FRED). The total is judged only if `b0` is given.
        """
        usual = within(self.l, 1e-4, 1e-2) and -3.5 <= self.s <= -0.5
        text = f"l {self.l:g} and s {self.s:g} are outside what is usual: l 1e-4 … 1e-2, s -3.5 … -0.5"
        total = 0.0 if self.b0 is None else float(harvey_shack.tis(self.b0, self.l, self.s))
        return unusual(self.title, None if usual else text, total=total)
