"""Scatter models as closed forms of unit vectors of incidence and of scatter, 1/sr in float64, without lobes."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
from oracles.geometry import Array

from mistray.physics import contamination, diffraction, rayleigh_rice
from mistray.physics import generalized_harvey_shack as ghs

SPECTRUM = Path(__file__).parent / "data" / "psd_polish.csv"
WAVELENGTH_NM = 550.0
WAVELENGTH_UM = 1e-3 * WAVELENGTH_NM
BAND_UM = 0.5

Values = Mapping[str, float]


def _dot(a: Array, b: Array) -> Array:
    return np.einsum("...i,...i->...", a, b)


@dataclass(frozen=True)
class Light:
    """Light along unit vectors d (n, 3) that a surface scatters into w (n, 3); `axis` is the normal on d's far side."""

    d: Array
    w: Array
    axis: Array
    reflect: bool
    from_front: bool
    n_in: float
    n_out: float

    n = property(lambda self: self.n_in if self.reflect else self.n_out)  # on the side of the scattered light
    # Path difference by height of the surface at normal incidence
    step = property(lambda self: 2 * self.n_in if self.reflect else abs(self.n_in - self.n_out))
    cos_i = property(lambda self: _dot(self.d, self.axis))
    cos_s = property(lambda self: np.abs(_dot(self.w, self.axis)))
    cos_0 = property(lambda self: np.abs(_dot(self.specular, self.axis)))
    r = property(lambda self: np.linalg.norm(self.tangential(self.w - self.specular), axis=1))

    @property
    def refracts(self) -> Array:
        return np.ones_like(self.cos_i, bool) if self.reflect else self.n_in**2 * (1 - self.cos_i**2) < self.n_out**2

    @property
    def specular(self) -> Array:
        if self.reflect:
            return self.d - 2 * self.cos_i[:, None] * self.axis
        tangential = self.n_in / self.n_out * (self.d - self.cos_i[:, None] * self.axis)
        return tangential + np.sqrt(np.maximum(0.0, 1 - _dot(tangential, tangential)))[:, None] * self.axis

    def tangential(self, v: Array) -> Array:
        return v - _dot(v, self.axis)[:, None] * self.axis

    @property
    def cos_phi(self) -> Array:
        """Cosine of the azimuth between specular and scattered direction."""
        a, b = self.tangential(self.w), self.tangential(self.specular)
        return _dot(a, b) / np.maximum(np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1), 1e-300)

    @property
    def path(self) -> Array:
        if self.reflect:
            return self.n_in * (self.cos_i + self.cos_s)
        return self.n_in * self.cos_i - self.n_out * self.cos_s


def abg(v: Values, light: Light, reference_nm: float = WAVELENGTH_NM) -> Array:
    """Of a smooth surface, with A and B at a wavelength."""
    k = WAVELENGTH_NM / reference_nm
    return v["A"] * k ** (v["g"] - 4) / (v["B"] * k ** v["g"] + light.r ** v["g"])


def harvey_shack(v: Values, light: Light) -> Array:
    """With b0, or with the roughness whose total scatter at normal incidence is (2π Δn σ/λ)²."""
    shape = (1 + (light.r / v["l"]) ** 2) ** (v["s"] / 2)
    if "b0" in v:
        return v["b0"] * shape
    power = 1 + v["s"] / 2
    whole = math.pi * v["l"] ** 2 * ((1 + v["l"] ** -2) ** power - 1) / power
    return (2 * math.pi * light.step * 1e-3 * v["rms_nm"] / WAVELENGTH_UM) ** 2 / whole * shape


def gaussian(v: Values, light: Light) -> Array:
    peak = v["total"] / (math.pi * v["width"] ** 2 * -math.expm1(-(v["width"] ** -2)))
    return peak * np.exp(-((light.r / v["width"]) ** 2))


def phong(v: Values, light: Light) -> Array:
    return v["b0"] * np.maximum(_dot(light.w, light.specular), 0) ** v["exponent"]


REST = {"c000": 0.6, "c010": 0.3, "c001": 0.5, "l10": -0.6, "d": 2e3}


def polynomial(rest: Values, values: Values, light: Light) -> Array:
    """With named powers of the invariants of Greynolds, written out; `rest` are coefficients that stay."""
    v = {**rest, **values}
    b, b0 = light.tangential(light.w), light.tangential(light.specular)
    u, w, t = _dot(b, b), _dot(b0, b0), _dot(b - b0, b - b0)
    diffuse = v["c000"] + v["c100"] * (u + w) + v["c010"] * u * w + v["c001"] * _dot(b, b0)
    return 10 ** (diffuse + (v["l10"] + v["l11"] * _dot(b, b0)) * np.log10(1 + v["d"] * t))


def measured(v: Values, light: Light) -> Array:
    """First order of the generalised Harvey-Shack theory, of a table of a spectrum."""
    f, psd = np.log(np.loadtxt(SPECTRUM, delimiter=",", skiprows=2)).T
    found = np.exp(np.interp(np.log(1e3 * light.n * light.r / WAVELENGTH_UM), f, psd))
    return 4 * math.pi**2 * light.n**2 * light.path**2 / WAVELENGTH_UM**4 * v["scale"] * found


def _psd(v: Values, light: Light, band_um: float | None = None) -> Array:
    """K-correlation spectrum, µm⁴, of a total roughness or of one up to 1/band_um."""
    rms, length, slope = 1e-3 * v["rms_nm"], v["B_um"], v["slope"]
    amplitude = rms**2 * length**2 * (slope - 2) / (2 * math.pi)
    if band_um is not None:
        amplitude /= 1 - (1 + (length / band_um) ** 2) ** (1 - slope / 2)
    return amplitude / (1 + (length * light.n * light.r / WAVELENGTH_UM) ** 2) ** (slope / 2)


def smooth(v: Values, light: Light, band_um: float | None = None) -> Array:
    return 4 * math.pi**2 * light.n**2 * light.path**2 / WAVELENGTH_UM**4 * _psd(v, light, band_um)


smooth_in_band = partial(smooth, band_um=BAND_UM)


def all_orders(v: Values, light: Light) -> Array:
    length = v["B_um"] / (2 * math.pi)
    f = light.n * light.r / WAVELENGTH_UM
    return ghs.exponential(light.path, f, 1e-3 * v["rms_nm"], length, WAVELENGTH_UM, light.n)


def scalar_rayleigh_rice(v: Values, light: Light) -> Array:
    return 16 * math.pi**2 * light.cos_i * light.cos_s * _psd(v, light) / (WAVELENGTH_UM / light.n_in) ** 4


def vector_rayleigh_rice(v: Values, light: Light) -> Array:
    """Relative to the bare surface's R or T."""
    index, one = light.n_out / light.n_in, np.ones_like(light.cos_i)
    if light.reflect:
        q = rayleigh_rice.polarization_factor(light.cos_i, light.cos_s, light.cos_phi, index)
        return (
            scalar_rayleigh_rice(v, light) * q / rayleigh_rice.polarization_factor(light.cos_i, light.cos_i, one, index)
        )
    q = rayleigh_rice.transmitted_factor(light.cos_i, light.cos_s, light.cos_phi, index)
    q = q / rayleigh_rice.transmitted_factor(light.cos_i, light.cos_0, one, index)
    path = light.n_in * light.cos_i - light.n_out * light.cos_0
    return 4 * math.pi**2 * light.n**2 * path**2 / WAVELENGTH_UM**4 * _psd(v, light) * q


def edge(v: Values, light: Light) -> Array:
    wavelength_mm = 1e-3 * WAVELENGTH_UM / light.n_out
    ring = diffraction.ring_bsdf(light.r, v["width_mm"], wavelength_mm)
    apart = light.w - light.specular
    return ring * (1 + _dot(apart, apart) / (2 * np.maximum(light.cos_0, 0.05) * np.maximum(light.cos_s, 0.05)))


def lambertian(v: Values, light: Light) -> Array:
    return np.full(len(light.w), v["reflectance"] / math.pi)


def gloss(v: Values, light: Light) -> Array:
    def fresnel(cosine: Array) -> Array:
        t = np.sqrt(1 - (1 - cosine**2) / v["n"] ** 2)
        s, p = (cosine - v["n"] * t) / (cosine + v["n"] * t), (t - v["n"] * cosine) / (t + v["n"] * cosine)
        return 0.5 * (s**2 + p**2)

    growth = np.sqrt(fresnel(light.cos_0) * fresnel(light.cos_s)) / ((v["n"] - 1) / (v["n"] + 1)) ** 2
    return v["b0"] * (1 + (light.r / v["l"]) ** 2) ** (v["s"] / 2) * growth


def particles(v: Values, light: Light, share: float) -> Array:
    """Spheres at the front, in air: F once in transmission; 2 R F forward and (1 + R²) F back in reflection."""
    cloud = contamination.cloud(WAVELENGTH_UM, contamination.dust_index(WAVELENGTH_UM), v["level"])

    def angle(centre: Array) -> Array:
        return 2 * np.arcsin(np.minimum(0.5 * np.linalg.norm(light.w - centre, axis=1), 1))

    forward = angle(light.specular)
    if light.reflect:
        back = np.pi - angle(-light.d)
        turned = np.where(back > np.radians(30), cloud.f(back), 0.0)
        found = 2 * share * cloud.f(forward) + (1 + share**2) * turned
    elif light.from_front:
        sine = light.n_out * np.sin(forward)
        before = np.arcsin(np.minimum(sine, 1))
        spread = light.n_out**2 * np.cos(forward) / np.maximum(np.cos(before), 1e-2)
        found = share * np.where((sine < 1) & (forward < np.pi / 2), spread * cloud.f(before), 0.0)
    else:
        found = share * cloud.f(forward)
    # The shares that the beam loses stay below 1/2 at grazing incidence; tests do not go there
    return found / (light.cos_i * light.cos_s)


@dataclass(frozen=True)
class Form:
    """A plugin with its values, and what it scatters: `parts` per unit of R or T, or of the light where `absolute`.

    Those `about_normal` need no specular direction; with `own_share` R or T is the third argument of the only part.
    """

    kind: str
    values: dict[str, float]
    parts: tuple[Callable[..., Array], ...]
    options: dict[str, str | bool | float] = field(default_factory=dict)
    reflects_at_back: bool = True
    absolute: bool = False
    about_normal: tuple[Callable[..., Array], ...] = ()
    own_share: bool = False

    @property
    def events(self) -> tuple[str, ...]:
        event = str(self.options.get("event", "transmission" if self.kind == "edge_diffraction" else "both"))
        return ("reflection", "transmission") if event == "both" else (event,)

    def scatters(self, reflect: bool, from_front: bool) -> bool:
        """Whether light of this side is scattered in this event."""
        back = self.options.get("side", "both") == "both" and (self.reflects_at_back or not reflect)
        return (from_front or back) and ("reflection" if reflect else "transmission") in self.events

    def bsdf(self, values: Values, light: Light, share: float | Array) -> Array:
        """1/sr; `share` is R or T."""
        if self.own_share:
            return self.parts[0](values, light, share)
        found = sum((part(values, light) for part in self.parts), np.zeros(len(light.w)))
        found = np.where(light.refracts, found, 0.0)
        found = found + sum((part(values, light) for part in self.about_normal), np.zeros(len(light.w)))
        return found if self.absolute else found * share


AT_633 = partial(abg, reference_nm=633.0)
K, ROUGH = {"rms_nm": 4.0, "B_um": 20.0, "slope": 2.5}, {"rms_nm": 20.0, "B_um": 20.0, "slope": 3.0}
PAINT, REFLECTED = {"reflectance": 0.03, "b0": 0.1, "l": 0.2, "s": -3.0, "n": 1.5}, {"event": "reflection"}
FORMS: dict[str, Form] = {
    "abg": Form("abg", {"A": 2.5e-3, "B": 1e-3, "g": 1.8}, (abg,)),
    "abg absolute": Form("abg", {"A": 2.5e-3, "B": 1e-3, "g": 1.8}, (abg,), {"relative_to": "incident"}, absolute=True),
    "abg narrow": Form("abg", {"A": 2e-3, "B": 1e-9, "g": 2.0}, (abg,)),
    "abg of 633 nm": Form("abg", {"A": 2.5e-3, "B": 1e-3, "g": 1.8}, (AT_633,), {"reference_nm": 633.0}),
    "harvey_shack": Form("harvey_shack", {"b0": 0.5, "l": 0.01, "s": -1.5}, (harvey_shack,)),
    "harvey_shack of a roughness": Form("harvey_shack", {"rms_nm": 4.0, "l": 0.01, "s": -1.5}, (harvey_shack,)),
    "gaussian_lobe": Form("gaussian_lobe", {"total": 0.3, "width": 0.15}, (gaussian,)),
    "phong": Form("phong", {"b0": 0.4, "exponent": 16.0}, (phong,)),
    "polynomial": Form("polynomial", {"c100": -0.8, "l11": 0.1}, (partial(polynomial, REST),), REST),
    "psd_table": Form("psd_table", {"scale": 1.2}, (measured,), {"file": str(SPECTRUM)}),
    "ghs": Form("k_correlation", K, (smooth,)),
    "ghs in a band": Form("k_correlation", K, (smooth_in_band,), {"band_limited": True, "reference_nm": 1e3 * BAND_UM}),
    "ghs_full": Form("k_correlation", ROUGH, (all_orders,), {"theory": "ghs_full", "side": "front"}),
    "rayleigh_rice": Form("k_correlation", K, (scalar_rayleigh_rice,), {"theory": "rayleigh_rice", **REFLECTED}),
    "rayleigh_rice_vector": Form("k_correlation", K, (vector_rayleigh_rice,), {"theory": "rayleigh_rice_vector"}),
    "edge_diffraction": Form("edge_diffraction", {"width_mm": 0.05}, (edge,)),
    "paint": Form("paint", PAINT, (gloss,), {"event": "both", "side": "front"}, True, True, (lambertian,)),
    "particulate": Form("particulate", {"level": 100.0}, (particles,), own_share=True, reflects_at_back=False),
}
