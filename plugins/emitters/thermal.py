"""Plugin `thermal`: thermal emission of the scene's own warm surfaces."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import mitsuba as mi
import numpy as np

from mistray.coatings import METAL_K
from mistray.errors import MistrayWarning
from mistray.ids import fits
from mistray.materials import complex_index
from mistray.named_values import as_number, named_values
from mistray.param import documented, fixed, take
from mistray.physics.planck import band_radiance
from mistray.plugins.emitters.light_source import BAND, LIGHT, LightSource
from mistray.ranges import TEMPERATURE_K, TEXT, ByName
from mistray.sampling.emission_laws import IntensityTable
from mistray.sampling.source import SceneSource, SourceRequest
from mistray.sampling.warm.emissivity import BACK, FRONT, emissivities, material_of, medium_of
from mistray.sampling.warm.surface_rays import WarmRays
from mistray.spectra.spectrum import DEFAULT_BANDS, SpectrumSamples, spectrum
from mistray.surfaces.host_points import area
from mistray.surfaces.surfaces import SurfaceTable

BAND_NM = (8000.0, 12000.0)
ANGLES = 721  # angles from the normal to the surface


@documented
class Thermal(LightSource):
    r"""
    Thermal emission of the scene (:monosp:`thermal`): every surface at its temperature is a source of a forward trace.

    By Kirchhoff's law a surface emits, at each angle, that fraction of a blackbody's radiance that it absorbs there.
    That is the light that its coating neither reflects nor transmits and its scatter does not send on. Each surface is
    a separate source in the path table, ``id:surface``. So the table shows by which paths each surface lights each
    detector.

    .. parameters::

    Both sides of a surface emit, with n² of the material there. Nothing is emitted into a metal. An opaque surface
    without a material emits as in air. The light is unpolarised. Media that absorb also emit; that is not traced, and a
    warning names them. `mistray.thermal` computes the irradiance of the detector faster, by rays from the detector.
    This source shows where the emission of each surface goes, on any surface, probe or detector.

    With ``wavelength_nm`` in a call the optics are traced at these wavelengths, and the power is that of the whole
    band. Temperatures have no derivatives.

    .. code-block:: xml

        <emitter type="thermal" id="warm">
            <float name="temperature_K" value="293"/>
            <string name="parts" value="detector=77"/>
        </emitter>

    .. code-block:: python

        {"type": "thermal", "temperature_K": 293.0, "band_nm": "3000, 5000", "parts": "detector=77; shield_*=80"}
    """

    numbers = {"temperature_K": fixed("K", TEMPERATURE_K, "temperature of all that ``parts`` does not name", 293.0)}
    properties = {
        **numbers,
        "parts": fixed(
            "string",
            TEXT,
            'temperatures of surfaces and parts by their names, with * and ?: "detector=77; shield_*=80"; the last '
            "match counts",
            "",
            within="name=T; …",
        ),
        **BAND,
        "band_nm": replace(
            BAND["band_nm"],
            doc="band of the detector: its two ends",
            otherwise="{:g}, {:g}".format(*BAND_NM),
        ),
    }

    def _rules(self, text: str) -> dict[str, float]:
        """
        Return the temperatures, K, in the string ``parts``, by pattern of surface or part names.

        Raise `MistrayError` if the string is not valid.
        """
        owner = f"{self.owner}: parts"
        named = named_values(filter(str.strip, text.split(";")), owner, like="detector=77; shield_*=80")
        kelvins = {name: as_number(kelvin, f"temperature of '{name}'", owner) for name, kelvin in named.items()}
        return ByName(TEMPERATURE_K, "detector=77").check("temperature", kelvins, self.owner)

    def _light(self, props: mi.Properties) -> SpectrumSamples:
        """
        Return the wavelengths of the band's parts, nm, with weights.

        Weights follow from the blackbody spectrum of the warmest given temperature. Raise `MistrayError` if a property
        is not valid.
        """
        if given := [key for key in ("power", *LIGHT) if key in props and key not in BAND]:
            self._fail(
                f"{given[0]} is given; the scene's own emission takes temperature_K, parts, band_nm and bands alone"
            )
        band, bands = self._band(props)
        self.rules = self._rules(take(self, props, "parts"))
        warmest = max([self.values["temperature_K"], *self.rules.values()])
        if band is not None and len(band) != 2:
            self._fail(f"band_nm has {len(band)} values; give its two ends in nm")
        low, high = band or BAND_NM
        self.edges_nm = np.linspace(low, high, (bands or DEFAULT_BANDS) + 1)
        if not warmest > 0:
            self._fail("everything is at 0 K and emits nothing; give temperature_K or parts")
        light = spectrum(f"blackbody:{warmest!r}")
        # As in the light, without parts that are dark
        self.parts_nm = [part for part in pairwise(self.edges_nm.tolist()) if light.energy(*part) > 0]
        return light.light((low, high), bands or DEFAULT_BANDS)

    def kelvin(self, *names: str) -> float:
        """
        Return the temperature, K, of a surface or part with the given names.

        It is that of the last rule that fits one of the names, or ``temperature_K`` if no rule fits.
        """
        found = self.values["temperature_K"]
        for pattern, value in self.rules.items():
            if any(fits(name, pattern) for name in names):
                found = value
        return found

    def sources(self, request: SourceRequest) -> Sequence[SceneSource]:
        """
        Return the start ray sources of a trace: each side of each surface at each wavelength at which it emits.

        Raise `MistrayError` if ``parts`` names no surface or part of the scene.
        """
        first = SurfaceTable(request.system, float(request.wavelengths_nm[0]))
        for pattern in self.rules:
            if not any(fits(name, pattern) for name in (*first.ids, *first.parts)):
                self._fail(f"parts names '{pattern}', and no surface or part is called so; parts are "
                           + ", ".join(sorted(set(first.parts))))  # fmt: skip
        self._tell_of_bulk(first, float(request.wavelengths_nm[0]))
        kelvins = [self.kelvin(*names) for names in zip(first.ids, first.parts, strict=True)]
        areas = [area(first, k) for k in range(first.count)]
        own = np.array_equal(request.wavelengths_nm, self.wavelengths_nm)
        theta = np.linspace(0, 90, ANGLES)
        cosines = np.maximum(np.cos(np.radians(theta)), 1e-6)
        laws: dict[bytes, IntensityTable] = {}
        found: list[SceneSource] = []
        for line, (wavelength, weight) in enumerate(zip(request.wavelengths_nm, request.weights, strict=True)):
            table = first if line == 0 else first.at(float(wavelength))
            shares = emissivities(table, cosines)
            for k in range(table.count):
                radiance = self._radiance(kelvins[k], line if own else None) * (1.0 if own else float(weight))
                for side in (FRONT, BACK):
                    emitted = shares[k, side] * cosines
                    emitted[-1] = 0.0
                    index = self._index(table, k, side, float(wavelength))
                    if not emitted.any() or not radiance > 0 or not index:
                        continue
                    law = laws.setdefault(emitted.tobytes(), _law(theta, emitted))
                    found.append(self._rays(request, table, k, side, law, areas[k] * radiance * index**2 * law.flux))
        return found

    def _tell_of_bulk(self, table: SurfaceTable, wavelength_nm: float) -> None:
        """Warn of absorbing media other than metals, whose own thermal emission is not traced."""
        for material in table.optics.media[1:]:
            if 0 < complex_index(material, wavelength_nm).imag <= METAL_K:
                warnings.warn(
                    f"{self.owner}: '{material}' absorbs, and what it emits is not traced, only what surfaces emit; "
                    "mistray.thermal has both", MistrayWarning, stacklevel=2,
                )  # fmt: skip

    def _radiance(self, kelvin: float, part: int | None) -> float:
        """Return the radiance of a blackbody, W/mm²/sr, in a part of the light, by index, or in all of it for None."""
        low, high = self.edges_nm[[0, -1]] if part is None else self.parts_nm[part]
        return float(band_radiance(kelvin, 1e-3 * low, 1e-3 * high))

    @staticmethod
    def _index(table: SurfaceTable, surface: int, side: int, wavelength_nm: float) -> float:
        """Return the real refractive index of the medium on one side of a surface; 0 for a metal."""
        index = complex_index(material_of(table, surface, side), wavelength_nm)
        return 0.0 if index.imag > METAL_K else float(index.real)

    def _rays(
        self, request: SourceRequest, table: SurfaceTable, surface: int, side: int, law: IntensityTable, power: float
    ) -> WarmRays:
        """
        Return the thermal rays of one side of a surface as a source of the flux `power`, W.

        `side` is `FRONT` or `BACK`, and `law` the intensity by the angle from the normal on that side.
        """
        axes = np.eye(3)
        return WarmRays(
            emitter=self,
            name=f"{request.name}:{table.ids[surface]}",
            wavelength_nm=table.wavelength_nm,
            power=power,
            pivot=np.zeros(3),
            direction=axes[2],
            u=axes[0],
            v=axes[1],
            shape=table.ids[surface],
            medium=medium_of(table, surface, side),
            table=table,
            surface=surface,
            to_back=side == BACK,
            law=law,
        )

    def to_string(self) -> str:
        """
        Return a string for Mitsuba with temperatures, K, and the band, nm.

        It is without the power, which depends on the scene.
        """
        low, high = self.edges_nm[[0, -1]]
        return f"Thermal[{self.values['temperature_K']:g} K, {self.rules}, {low:g} to {high:g} nm]"

    def power(self, field_deg: float | None = None) -> float:
        """Return 0 W to Mitsuba's own integrators, as the emitted flux depends on the scene."""
        return 0.0


def _law(theta_deg: np.ndarray, emitted: np.ndarray) -> IntensityTable:
    """Return the table of a rotationally symmetric intensity, `emitted`, (n,), at angles from the normal, degrees."""
    return IntensityTable(theta_deg, np.array([0.0, 360.0]), np.repeat(emitted[:, None], 2, axis=1))


mi.register_emitter("thermal", lambda props: Thermal(props))
