"""
The view of a detector: shares of surfaces, media and the sky in a backward trace from it.

By Kirchhoff's law the absorptance of a surface for backward rays is its emissivity for light to the detector. A surface
of blackbody radiance L, W/mm²/sr, irradiates the detector with π L · emission, W/mm². Here emission is the mean of
weight times absorptance over Lambertian rays.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mitsuba as mi
import numpy as np

from mistray.execute.backward import PASS_LANES, BackwardTrace
from mistray.light import Light
from mistray.messages import Message
from mistray.notes import Note
from mistray.recorders.direction_recorder import DIRECT
from mistray.recorders.directions import DirectionGrid
from mistray.recorders.sampled import batch_error
from mistray.recorders.tallies import ABSORBED_HERE, ESCAPED, HITS, INCIDENT
from mistray.sampling.design.sequences import has_optics
from mistray.sampling.sources import field_axes, spectrum_of
from mistray.settings import Settings
from mistray.time_budget import is_limited, time_is_up


@dataclass(frozen=True, kw_only=True)
class SeenSurface:
    """
    Surface in the detector's view: mean weight of Lambertian backward rays that meet it, and of those it absorbs.

    Attributes
    ----------
    id, part : str
        Id of the surface, and name of the part that it belongs to.
    space : int
        Index of the optical space; -1: not declared.
    hits : int
        Number of hits.
    share, share_se : float
        Mean weight that meets the surface, of Lambertian rays from the detector, and its standard error. If the surface
        alone had the radiance L, towards all sides, the irradiance on the detector would be π L · share. Light that is
        scattered at the surface itself is not in it.
    emission, emission_se : float
        Mean weight times the absorptance at each angle, 1 - R - T - scatter, and its standard error. By Kirchhoff's
        law, the absorptance is the emissivity: a surface with the blackbody radiance L gives the irradiance
        π L · emission.
    emission_by_batch : (BATCHES,) float64
        Estimates of `emission` from single batches of rays.
    """

    id: str
    part: str
    space: int
    hits: int
    share: float
    share_se: float
    emission: float
    emission_se: float
    emission_by_batch: np.ndarray


@dataclass(frozen=True, kw_only=True)
class Seen:
    """
    View of a detector: shares of its Lambertian backward rays that surfaces and media absorb, and that leave.

    All shares are of Lambertian rays from the side of the detector that the light of the design comes to, times n² of
    the medium there. Emission of surfaces and media, escaped and lost add up to n².

    Attributes
    ----------
    rows : list of SeenSurface
        All surfaces, in the order of the scene, the detector and those without hits included.
    media : dict
        Material → (emission, standard error, by batch) of absorbing media.
    named : dict
        Material of each medium → all names that surfaces give it: materials of equal index and scatter are one medium.
    escaped : tuple
        Share of the rays that leave the scene, standard error, by batch.
    image : tuple or None
        Share of the rays that leave by a design sequence, which is where the light of the image comes from; standard
        error, by batch. None in a scene without lenses and mirrors, and where no sequence leads to the detector.
    lost : tuple
        Share that limits and thresholds cut, with the net loss by roulette and scatter sampling, of either sign;
        standard error, by batch.
    detector : str
        Id of the detector.
    detector_area_mm2 : float
        Area of the detector, mm².
    wavelength_nm : float
        Wavelength, nm.
    rays : int
        Number of start rays that were traced.
    seconds : float
        Time that the trace took, s.
    notes : list of Note
        Assumptions about the media, see `BackwardTrace.notes`, and about the image.
    """

    rows: list[SeenSurface]
    media: dict[str, tuple[float, float, np.ndarray]]
    named: dict[str, set[str]]
    escaped: tuple[float, float, np.ndarray]
    image: tuple[float, float, np.ndarray] | None
    lost: tuple[float, float, np.ndarray]
    detector: str
    detector_area_mm2: float
    wavelength_nm: float
    rays: int
    seconds: float
    notes: list[Note]

    @property
    def whole(self) -> float:
        """Sum of all shares, n² of the medium at the detector."""
        absorbed = [row.emission for row in self.rows] + [emission for emission, *_ in self.media.values()]
        return sum(absorbed, self.escaped[0] + self.lost[0])


def see(
    scene: mi.Scene,
    rays: int = 200_000,
    wavelength_nm: float | None = None,
    detector: str | None = None,
    **settings: Any,
) -> Seen:
    """
    Trace Lambertian rays backward from a detector, and return their shares on surfaces, in media and to the sky.

    A time budget (`mistray.time_budget`) around the call ends it early, but not before the first pass is complete.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene.
    rays : int
        Number of start rays.
    wavelength_nm : float, optional
        Wavelength, nm; by default the first one of the scene's source.
    detector : str, optional
        Id of the detector; by default the only one of the scene.
    **settings
        Fields of `mistray.trace.Settings`. ``max_reflections=0, max_scatters=0`` or ``ray_control="transmit_specular"``
        leave what is seen directly.

    Raises
    ------
    MistrayError
        For bad settings, or a detector that cannot be found.
    """
    # One cell of directions for the whole half space
    chosen = Settings.without_sources(scene, rays=rays, **settings)
    wavelength = float(spectrum_of(scene, wavelength_nm, None)[0][0])
    whole = DirectionGrid.of([45.0], cell_deg=90.0, rotation=field_axes(scene))
    trace = BackwardTrace(scene, whole, chosen, Light(wavelength_nm=wavelength, detector=detector), both_sides=False)
    # Trace; with a time budget in small passes at first
    done = 0
    while done < chosen.rays and not (done and time_is_up()):
        here = min(trace.pass_size(trace.sums.passes) if is_limited() else PASS_LANES, chosen.rays - done)
        trace.advance(here)
        done += here
    started = trace.rays

    def estimate(by_batch: np.ndarray) -> tuple[float, float, np.ndarray]:
        return (
            float(by_batch.sum() / started.sum()),
            float(batch_error(by_batch, started) / started.sum()),
            by_batch / started,
        )

    # Surfaces: the weight that meets them, and the weight that they absorb
    rows = []
    for i in trace.table.listed:
        sums = trace.sums.surfaces[i]
        share, share_se, _ = estimate(sums[INCIDENT])
        emission, emission_se, emission_by_batch = estimate(sums[ABSORBED_HERE])
        table = trace.table
        rows.append(
            SeenSurface(
                id=table.ids[i],
                part=table.parts[i],
                space=table.spaces[i],
                hits=round(float(sums[HITS].sum())),
                share=share,
                share_se=share_se,
                emission=emission,
                emission_se=emission_se,
                emission_by_batch=emission_by_batch,
            )
        )
    # Absorbing media; the first entry is the unknown one
    optics = trace.table.optics
    media = {name: estimate(row) for name, row in zip(optics.media[1:], trace.sums.media[1:], strict=True) if row.any()}
    named: dict[str, set[str]] = {name: {name} for name in optics.media}
    for bsdf, numbers in zip(optics.bsdfs, optics.declared.tolist(), strict=True):
        for number, spec in zip(numbers, (bsdf.front, bsdf.back), strict=True):
            named[optics.media[number]] |= {spec.strip()} if number else set()
    # The image, if there are design sequences to this detector
    detector_id = trace.table.ids[trace.table.detector]
    imaging, designed = has_optics(trace.table), bool(trace.design.lists.get(trace.table.detector))
    # Without any, all light that is neither scattered nor a ghost counts as the image, which a note says
    missing = [Message.NO_DESIGN.note(detector=detector_id)] if imaging and not designed else []
    return Seen(
        rows=rows,
        media=media,
        named=named,
        escaped=estimate(trace.sums.channels[ESCAPED]),
        image=estimate(trace.sums.cells[DIRECT, 0, 0]) if designed and imaging else None,
        lost=estimate(trace.sums.lost),
        detector=detector_id,
        detector_area_mm2=trace.area,
        wavelength_nm=wavelength,
        rays=round(float(started.sum())),
        seconds=trace.sums.seconds,
        notes=[*trace.notes, *missing],
    )
