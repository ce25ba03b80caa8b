"""BSDF in the plane of incidence at several angles of incidence, with total scatter, for plots and tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mistray.errors import MistrayError
from mistray.scatter.evaluate import bsdf
from mistray.scatter.lobe import EVENTS, LobeModel
from mistray.scatter.measured.rotations import RotatedSamples
from mistray.scatter.measured.samples import BsdfSamples
from mistray.scatter.total import check_loss, totals

SMALLEST_R, LARGEST_ANGLE_DEG = 1e-7, 89.9
NODES_R, NODES_ANGLE = 600, 720
RADIALS, FIRST_RADIAL_DEG, AZIMUTHS = 72, 0.01, 19  # nodes of a table about the specular direction
ROTATIONS = 24  # rotations of an anisotropic sample
NORMAL_STEP_DEG, PEAK_NODES = 2.0, 16  # nodes of a table about the normal


@dataclass(frozen=True)
class IncidentLight:
    """
    Light that meets a scattering surface.

    Attributes
    ----------
    wavelength_nm : float
        Vacuum wavelength, nm.
    n_in, n_out : float
        Refractive indices on the side of incidence and on the other side.
    from_front : bool
        Whether the light comes from the front.
    R, T : float
        Fractions that the coating reflects and transmits, at all angles.
    rotation_deg : float
        Azimuth of the sample's x axis from that of the specular direction, degrees, counterclockwise as seen from the
        side of incidence; used for anisotropic scatter.
    """

    wavelength_nm: float = 550.0
    n_in: float = 1.0
    n_out: float = 1.5
    from_front: bool = True
    R: float = 1.0
    T: float = 1.0
    rotation_deg: float = 0.0

    @property
    def rotation(self) -> float:
        """Azimuth of the sample about its normal, rad; see `rotation_deg`."""
        return float(np.radians(self.rotation_deg))

    def share(self, event: str) -> float:
        """Return the coating's R for the event "reflection" or T for "transmission", 0 … 1."""
        return self.R if event == "reflection" else self.T

    def is_totally_reflected(self, angle_deg: float) -> bool:
        """True if light at this angle of incidence, degrees, is totally reflected."""
        return bool(np.sin(np.radians(angle_deg)) * self.n_in >= self.n_out)

    def sin_specular(self, event: str, angle_deg: float) -> float:
        """
        Return the sine of the angle between specular direction and normal, for an angle of incidence in degrees.

        Raises
        ------
        MistrayError
            If `event` is neither "reflection" nor "transmission", or the angle is not from 0° to below 90°. It is also
            raised if transmission is requested for totally reflected light.
        """
        if event not in EVENTS:
            raise MistrayError(f"event is '{event}'; use {' or '.join(map(repr, EVENTS))}")
        if not 0 <= angle_deg < 90:
            raise MistrayError(f"angle of incidence {angle_deg:g}°; give angles from 0 to below 90°")
        sine = np.sin(np.radians(angle_deg))
        if event == "reflection":
            return float(sine)
        if self.is_totally_reflected(angle_deg):
            raise MistrayError(
                f"angle of incidence {angle_deg:g}°: light from n = {self.n_in:.4g} to {self.n_out:.4g} is totally "
                "reflected, nothing is transmitted; give smaller angles"
            )
        return float(sine * self.n_in / self.n_out)


Light = IncidentLight  # its name before version 0.3


@dataclass(frozen=True, eq=False)
class Scan:
    """
    BSDF in the plane of incidence at one angle of incidence.

    Attributes
    ----------
    event : {"reflection", "transmission"}
        Event of the scattered light.
    incidence_deg, specular_deg : float
        Angles of the incident and the specular light with the normal, degrees, each in its own medium.
    theta_s_deg : (m,) float64
        Angles of the scattered directions with the normal, ascending, degrees; positive on the side of the specular
        direction.
    distance : (m,) float64
        Distances |β - β0| of the scattered directions.
    values : (m,) float64
        BSDF at the scattered directions, 1/sr.
    scattered : float
        Total integrated scatter over the hemisphere, as a fraction of the incident flux.
    loss : float
        Fraction of its flux that the specular beam loses.
    rotation_deg : float
        Rotation of the sample, degrees, as in `IncidentLight`.
    """

    event: str
    incidence_deg: float
    specular_deg: float
    theta_s_deg: np.ndarray
    distance: np.ndarray
    values: np.ndarray
    scattered: float
    loss: float
    rotation_deg: float = 0.0


def scan(
    model: LobeModel, angles_deg: Sequence[float], event: str = "reflection", light: IncidentLight | None = None
) -> list[Scan]:
    """
    Return the BSDF of a model in the plane of incidence, at each angle of incidence.

    Parameters
    ----------
    model : LobeModel
        Scatter of the surface.
    angles_deg : sequence of float
        Angles of incidence, degrees, in the medium that the light comes from.
    event : {"reflection", "transmission"}
        Event of the scattered light.
    light : IncidentLight, optional
        Incident light; by default that of `IncidentLight()`.

    Raises
    ------
    MistrayError
        If the model does not scatter in `event`, or for the reasons of `IncidentLight.sin_specular`, or if the specular
        beam would lose more light than it has.
    """
    light = light or IncidentLight()
    lobes = model.lobes(light.wavelength_nm, light.n_in, light.n_out, light.from_front)
    if not any(lobe.event == event for lobe in lobes):
        raise MistrayError(f"the model scatters nothing in {event}; choose the other event")
    sines = [light.sin_specular(event, angle) for angle in angles_deg]
    cosines = np.cos(np.radians(np.asarray(angles_deg, dtype=np.float64)))
    sums = totals(lobes, cosines, light.n_in, light.n_out, rotation=light.rotation)
    check_loss("scatter", event, sums, cosines)
    scattered = sums.scattered(event, np.full(len(cosines), light.share(event)))
    found = []
    for k, (angle, sine) in enumerate(zip(angles_deg, sines, strict=True)):
        beta = _in_plane(sine)
        directions = np.stack([beta, np.zeros_like(beta), np.sqrt(1 - beta**2)], axis=-1)
        share = light.share(event)
        values = bsdf(lobes, event, float(cosines[k]), directions, light.n_in, light.n_out, share, light.rotation)
        found.append(
            Scan(
                event,
                float(angle),
                float(np.degrees(np.arcsin(sine))),
                np.degrees(np.arcsin(beta)),
                np.abs(beta - sine),
                values,
                float(scattered[k]),
                float(sums.loss[event][k]),
                light.rotation_deg,
            )
        )
    return found


def table(
    model: LobeModel,
    angles_deg: Sequence[float],
    frame: str,
    event: str = "reflection",
    light: IncidentLight | None = None,
) -> BsdfSamples | RotatedSamples:
    """
    Return a table of a model's BSDF over the hemisphere, 1/sr; an anisotropic one at rotations over a full turn.

    Parameters
    ----------
    model, angles_deg, event, light
        Parameters of `scan`, but the rotation in `light` is not used, and the table has each angle once, ascending. It
        is 0 if the model does not scatter in `event`.
    frame : {"specular", "normal"}
        Direction from which the table's polar angles are counted, see `BsdfSamples`.

    Raises
    ------
    MistrayError
        If an angle is out of range, or transmission is requested for totally reflected light.
    """
    light = light or IncidentLight()
    lobes = model.lobes(light.wavelength_nm, light.n_in, light.n_out, light.from_front)
    angles = np.unique(np.asarray(angles_deg, dtype=np.float64))
    specular = np.degrees(np.arcsin([light.sin_specular(event, angle) for angle in angles]))
    turned = any(lobe.anisotropic for lobe in lobes)
    azimuth = np.linspace(0, 360, 2 * AZIMUTHS - 1) if turned else np.linspace(0, 180, AZIMUTHS)
    if frame == "specular":
        polar = np.concatenate([[0.0], np.geomspace(FIRST_RADIAL_DEG, 90 + specular[-1], RADIALS)])
    else:
        steps = np.geomspace(FIRST_RADIAL_DEG, NORMAL_STEP_DEG, PEAK_NODES)
        near = (specular[:, None] + np.concatenate([-steps, [0.0], steps])).ravel()
        polar = np.concatenate([np.arange(0, 90 + NORMAL_STEP_DEG / 2, NORMAL_STEP_DEG), near])
        polar = np.unique(polar[(polar >= 0) & (polar <= 90)].round(9))
    empty = BsdfSamples(
        "model", frame, specular, azimuth, polar, np.zeros((len(angles), len(azimuth), len(polar))), event
    )
    directions = empty.directions()

    def at(rotation: float) -> BsdfSamples:
        values = np.zeros(empty.values.shape)
        for k, cosine in enumerate(np.cos(np.radians(angles))):
            over = np.maximum(directions[k], 0.0) * np.array([0.0, 0.0, 1.0])
            above = directions[k] * np.array([1.0, 1.0, 0.0]) + over
            found = bsdf(lobes, event, float(cosine), above, light.n_in, light.n_out, light.share(event), rotation)
            values[k] = np.where(directions[k][..., 2] >= -1e-12, found, 0.0)
        return replace(empty, values=values)

    if not turned:
        return at(0.0)
    rotations = np.arange(ROTATIONS) * (360 / ROTATIONS)
    return RotatedSamples(rotations, tuple(at(rotation) for rotation in np.radians(rotations)))


def _in_plane(sine: float) -> np.ndarray:
    """
    Return ascending sines of scattering angles, (k,), for a scan in the plane of incidence.

    They are densest about the specular direction, whose sine is given.
    """
    r = np.geomspace(SMALLEST_R, 2, NODES_R)
    even = np.sin(np.radians(np.linspace(-LARGEST_ANGLE_DEG, LARGEST_ANGLE_DEG, NODES_ANGLE)))
    beta = np.unique(np.concatenate([sine - r, [sine], sine + r, even]))
    limit = np.sin(np.radians(LARGEST_ANGLE_DEG))
    return beta[(beta >= -limit) & (beta <= limit)]
