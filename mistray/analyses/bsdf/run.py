"""Evaluation of a scatter model at several angles of incidence, with the share that the specular beam loses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from mistray.analyses.bsdf.models import model_of
from mistray.analyses.bsdf.request import EVENTS, BsdfRequest
from mistray.errors import MistrayError
from mistray.materials import refractive_index
from mistray.physics.abg import AbgFromRms
from mistray.scatter import Placement
from mistray.scatter.chance import Chance, chance
from mistray.scatter.scan import IncidentLight, Scan, scan

DEFAULT_ROTATIONS = (0.0, 90.0)


@dataclass(frozen=True)
class BsdfResult:
    """
    Evaluated scatter model: BSDF curves, 1/sr, and scattered fractions of the incident light.

    Attributes
    ----------
    title : str
        Name of the model with the parameters that were given.
    model : Placement
        Scatter model that was evaluated.
    sheet : AbgFromRms or None
        Calculation of A, B and g from a roughness; None if no roughness was given.
    request : BsdfRequest
        Request that was evaluated.
    light : IncidentLight
        Incident light with the sample in its first orientation.
    turned : bool
        Whether the scatter depends on the azimuth of the sample.
    totals : list of dict
        A row for each event, angle of incidence and rotation, degrees. ``scattered`` is the TIS, 0 … 1, ``loss`` the
        fraction that the specular beam loses, ``peak_1_sr`` the BSDF there. They are None for transmission under total
        reflection.
    curves : list of Scan
        BSDF, 1/sr, of one event at each angle of incidence and rotation.
    unaimed : Chance or None
        Probability of hitting the detector of the request without aiming; None if it has no detector.
    """

    title: str
    model: Placement
    sheet: AbgFromRms | None
    request: BsdfRequest
    light: IncidentLight
    turned: bool
    totals: list[dict[str, Any]]
    curves: list[Scan]
    unaimed: Chance | None


def run_bsdf(name: str, parameters: Mapping[str, Any], request: BsdfRequest) -> BsdfResult:
    """
    Evaluate a scatter model for a request.

    The name and the parameters are those of `mistray.analyses.bsdf.models.model_of`.

    Raises
    ------
    MistrayError
        If the model scatters nothing from the side of the light, or rotations are given for one that does not depend on
        them. Also if the event to be drawn has no light at an angle of incidence, or `model_of` raises.
    """
    (model, title, sheet), angles = model_of(name, parameters, request), request.angles_deg
    sides = [refractive_index(material, request.wavelength_nm) for material in (request.front, request.back)]
    n_in, n_out = sides[::-1] if request.from_back else sides
    light = IncidentLight(request.wavelength_nm, n_in, n_out, not request.from_back, request.R, request.T)
    lobes = model.lobes(light.wavelength_nm, n_in, n_out, light.from_front)
    events = [event for event in EVENTS if any(lobe.event == event for lobe in lobes)]
    if not events:
        raise MistrayError(f"{name} scatters nothing from this side; raise its amount or turn --from-back")
    event = request.event or events[0]
    turned = any(lobe.anisotropic for lobe in lobes)
    if request.rotations_deg is not None and not turned:
        raise MistrayError(f"{name} scatters alike however the sample is turned; leave --rotations-deg out")
    rotations = (request.rotations_deg or DEFAULT_ROTATIONS) if turned else (0.0,)
    lights = [replace(light, rotation_deg=rotation) for rotation in rotations]
    curves = [one for lit in lights for one in scan(model, angles, event, lit)]
    totals = [_total(model, which, angle, lit, turned) for lit in lights for which in events for angle in angles]
    hit, unaimed = request.hit, None
    if hit is not None:
        about: Any = {"incidence_deg": angles[0], "event": event, "light": lights[0], "before": hit.hit_before}
        unaimed = chance(model, hit.hit_deg, hit.hit_sr, **about)
    return BsdfResult(title, model, sheet, request, lights[0], turned, totals, curves, unaimed)


def _total(model: Placement, event: str, angle: float, light: IncidentLight, turned: bool) -> dict[str, Any]:
    row = {"event": event, "incidence_deg": angle, "scattered": None, "loss": None, "peak_1_sr": None}
    row |= {"rotation_deg": light.rotation_deg} if turned else {}
    if event != "transmission" or not light.is_totally_reflected(angle):
        (one,) = scan(model, [angle], event, light)
        row |= {"scattered": one.scattered, "loss": one.loss, "peak_1_sr": one.values[one.distance.argmin()]}
    return row
