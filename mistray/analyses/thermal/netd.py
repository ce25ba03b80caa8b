"""Budget of the noise-equivalent temperature difference (NETD): contribution of each light to the noise."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from mistray.analyses.thermal.request import DetectorNoise
from mistray.analyses.thermal.spectrum import TracedBand, band_weights
from mistray.analyses.thermal.sums import Key, emission, imaged_share, per_kelvin, total, with_band_error
from mistray.estimate import UNKNOWN, Estimate
from mistray.execute.seen import Seen
from mistray.physics.netd import netd_by_detectivity, netd_by_photons
from mistray.toolkit.rows import column

IMAGE, OTHER = "scene, image", "scene, ghosts and scatter"


@dataclass(frozen=True)
class NoiseSource:
    """
    One source of light on the detector: photon irradiance, 1/(s mm²), share of the variance of the noise, and NETD, K.

    The variance is that of the photon noise. The NETD is that of a detector with the noise of this light only.
    """

    name: str = column(
        "A part, a medium in brackets, or the scene: its image, and what comes by ghosts and scatter", head="photons of"
    )
    photons_mm2_s: Estimate = column("Irradiance, photons/(s mm²)", head="irradiance [1/(s mm²)]")
    percent: float = column(
        "Share of the variance of the noise of all photons, %", head="of the variance [%]", digits=".3g"
    )
    netd_K: Estimate = column("NETD if this noise were all, K; the squares add up", head="NETD by it alone [K]")


@dataclass(frozen=True)
class Netd:
    """
    Noise-equivalent temperature difference of the average pixel, see `mistray.physics.netd`.

    Attributes
    ----------
    noise : DetectorNoise
        Pixel and its noise.
    per_kelvin_W_mm2 : Estimate
        Derivative of the irradiance of the imaged scene with respect to its temperature, W/(mm² K).
    by_detectivity_K : Estimate
        NETD by the detectivity, K; NaN without a detectivity, or if no scene is seen.
    by_photons_K : Estimate
        NETD by the noise of all photons, K; NaN without a quantum efficiency, or if no scene is seen.
    sources : list of NoiseSource
        Contributions to the photon noise, the brightest first; empty if `by_photons_K` is NaN.
    """

    noise: DetectorNoise
    per_kelvin_W_mm2: Estimate
    by_detectivity_K: Estimate = UNKNOWN
    by_photons_K: Estimate = UNKNOWN
    sources: list[NoiseSource] = field(default_factory=list)


def netd_budget(
    noise: DetectorNoise,
    runs: tuple[Sequence[Seen], Sequence[Seen]],
    kelvin: Mapping[Key, float],
    scene_K: float,
    traced: TracedBand,
    band: tuple[float, float],
) -> Netd:
    """
    Return the noise-equivalent temperature difference (NETD) of a detector, from traces of its view.

    Parameters
    ----------
    noise : DetectorNoise
        Pixel and its noise.
    runs : two sequences of Seen
        Views of everything, and of the image alone; one for each wavelength of `traced`.
    kelvin : mapping of (str, str) to float
        Kind and name of each emitter → its temperature, K.
    scene_K : float
        Temperature of the scene, K.
    traced : TracedBand
        Wavelengths at which the optics were traced, with the error of band integrals.
    band : (float, float)
        Band of the detector, µm.
    """
    (seen, image), waves = runs, traced.wavelengths_um
    known = partial(with_band_error, bound=traced.error)
    slope = known(total(per_kelvin(image, scene_K, band, waves)))
    if slope.value <= 0:
        return Netd(noise, slope)
    by_detectivity = UNKNOWN
    if noise.detectivity is not None:
        value = float(netd_by_detectivity(slope.value, noise.detectivity, noise.pixel_mm2, noise.bandwidth_hz))
        by_detectivity = Estimate(value, value * slope.se / slope.value)
    if noise.quantum_efficiency is None:
        return Netd(noise, slope, by_detectivity)
    pixel = (noise.quantum_efficiency, noise.pixel_mm2, noise.bandwidth_hz)
    light = _photons(seen, image, kelvin, scene_K, band, waves)
    signal = per_kelvin(image, scene_K, band, waves, photons=True)
    every = [np.sum(parts, axis=0) for parts in zip(*light.values(), strict=True)]
    whole, rise = total(every), total(signal)

    def netd(by_wave: Sequence[np.ndarray]) -> Estimate:
        """
        Return the NETD, K, caused by the photon noise of light, 0 without light.

        `by_wave` is its irradiance, photons/(s mm²), by wavelength and batch of rays. The batches have the same rays as
        those of the signal, and the error allows for that.
        """
        flux = total(by_wave).value
        if flux <= 0:
            return Estimate(0.0, 0.0)
        value = float(netd_by_photons(flux, rise.value, *pixel))
        relative = total([a / (2 * flux) - b / rise.value for a, b in zip(by_wave, signal, strict=True)])
        return known(Estimate(value, value * relative.se))

    sums = {name: total(one) for name, one in light.items()}
    sources = [
        NoiseSource(name, known(own), 100 * own.value / whole.value, netd(light[name])) for name, own in sums.items()
    ]
    brightest = sorted(sources, key=lambda source: -source.photons_mm2_s.value)
    return Netd(noise, slope, by_detectivity, netd(every), brightest)


def _photons(
    seen: Sequence[Seen],
    image: Sequence[Seen],
    kelvin: Mapping[Key, float],
    scene_K: float,
    band: tuple[float, float],
    waves: tuple[float, ...],
) -> dict[str, list[np.ndarray]]:
    """
    Return photon irradiance, photons/(s mm²), by emitter's name: an array over batches for each wavelength.

    `seen` and `image` are the `runs` of `netd_budget`, `waves` the traced wavelengths, µm, the others its parameters.
    """
    weights = {k: math.pi * band_weights(k, band, waves, photons=True) for k in {*kelvin.values(), scene_K}}
    direct = [weight * imaged_share(one) for weight, one in zip(weights[scene_K], image, strict=True)]
    every = [weight * one.escaped[2] for weight, one in zip(weights[scene_K], seen, strict=True)]
    light = {IMAGE: direct, OTHER: [a - b for a, b in zip(every, direct, strict=True)]}
    parts = {("surface", row.id): row.part for row in seen[0].rows}
    for key, k in kelvin.items():
        name = parts.get(key, f"({key[1]})" if key[0] == "medium" else key[1])
        own = [weight * emission(one, key) for weight, one in zip(weights[k], seen, strict=True)]
        light[name] = [a + b for a, b in zip(light[name], own, strict=True)] if name in light else own
    return light
