"""Surface transfer functions of scatter models: by Harvey's formula from a roughness spectrum, and from any BSDF."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from mistray.analyses.transfer.request import BsdfTransferRequest, SurfaceTransferRequest
from mistray.errors import MistrayError, MistrayWarning
from mistray.physics import generalized_harvey_shack as ghs
from mistray.physics import harvey_shack
from mistray.physics.imaging import surface_transfer as formulas
from mistray.ranges import NOT_NEGATIVE, POSITIVE, several, shown
from mistray.result import KeyNumber, Result
from mistray.scatter.evaluate import bsdf
from mistray.scatter.harvey_shack import index_step
from mistray.scatter.lobe import LobeModel
from mistray.scatter.radial import RadialTable, node_radii, ring_flux
from mistray.scatter.rough_surface import RoughSurface
from mistray.scatter.total import model_lobes, specular_cosine, totals
from mistray.toolkit.analysis import analysis

Array = npt.NDArray[np.float64]

AROUND = 32  # azimuths about the specular direction where the light is not the same in all
LEAST_COSINE = 0.05  # of scattered light: a BSDF that counts solid angles grows without bound towards the horizon


@dataclass(frozen=True, repr=False)
class SurfaceTransfer(Result):
    """
    Surface transfer function: the factor by which a rough surface multiplies the optical transfer function.

    Attributes
    ----------
    wavelength_um : float
        Vacuum wavelength, µm.
    plateau : float
        1 - TIS, dimensionless: value at lags beyond all correlation of the surface.
    at_lag : callable
        Function of lags on the surface, µm, (m,), that returns values, (m,), 1 at lag 0.

    Examples
    --------
    >>> from mistray.scatter.abg import ABg
    >>> found = mistray.analysis.transfer_of_bsdf(ABg(A=0.0025, B=0.001, g=1.8), 550.0)
    >>> print(f"TIS = {found.tis:.4f}, plateau = {found.plateau:.4f}")
    TIS = 0.0413, plateau = 0.9587
    >>> found.at([0.0, 20.0], f_number=8.0, footprint_mm=10.0).round(4)
    array([1.    , 0.9587])
    """

    wavelength_um: float
    plateau: float
    at_lag: Callable[[Array], Array]

    def key_numbers(self) -> dict[str, KeyNumber]:
        """Return the wavelength (µm), the plateau and the scattered fraction of the light, by label."""
        return {"wavelength [µm]": self.wavelength_um, "plateau": self.plateau, "TIS": self.tis}

    @property
    def tis(self) -> float:
        """Scattered share of the light that the surface reflects or transmits (TIS), 0 … 1."""
        return 1 - self.plateau

    def at(self, frequencies_per_mm: npt.ArrayLike, f_number: float, footprint_mm: float) -> Array:
        """
        Return the factor on the OTF at spatial frequencies of the image, (m,), dimensionless.

        Parameters
        ----------
        frequencies_per_mm : float or (m,) array_like
            Spatial frequencies, 1/mm, ≥ 0.
        f_number : float
            Working F-number at the image.
        footprint_mm : float
            Diameter of the beam of one image point on the surface, along the direction of the frequency, mm.

        Returns
        -------
        (m,) float64

        Raises
        ------
        MistrayError
            If a value is out of range.
        """
        POSITIVE.check("f_number", f_number)
        POSITIVE.check("footprint_mm", footprint_mm)
        found = np.array(NOT_NEGATIVE.check_each("frequencies_per_mm", frequencies_per_mm))
        return self.at_lag(formulas.lag_um(found, self.wavelength_um, f_number, footprint_mm))


def run_bsdf(models: LobeModel | Sequence[LobeModel], request: BsdfTransferRequest) -> SurfaceTransfer:
    """
    Return the surface transfer function from the BSDF: ``H(s) = 1 - TIS + ∫ BSDF(β) exp(2πi n (β - β0) s/λ) d²β``.

    The lag s is in µm, β and β0 are direction cosines of the light and of the specular direction, n is the index there.
    Light that the surface reflects, or transmits, counts as 1, so that TIS is the integral at s = 0. The Hankel
    transform is about the specular direction and averages over azimuths: exact at normal incidence on an isotropic
    surface.

    Parameters
    ----------
    models : LobeModel or sequence of LobeModel
        Scatter models of the surface.
    request : BsdfTransferRequest

    Raises
    ------
    MistrayError
        If the event or a value is invalid, light is totally reflected, the surface sends no light on, or a model fails
        at this event.

    Examples
    --------
    >>> from mistray.scatter.abg import ABg
    >>> found = mistray.analysis.transfer_of_bsdf(ABg(A=0.0025, B=0.001, g=1.8), 550.0)
    >>> print(f"TIS {found.tis:.4f}")
    TIS 0.0413
    """
    wavelength_um, share = request.wavelength_nm * 1e-3, request.share
    event, n_in, n_out, cos_i = request.event, request.n_in, request.n_out, request.cos_i
    chosen = several(models)
    if not all(hasattr(model, "lobes") for model in chosen):
        raise MistrayError(f"models is {shown(models)}; give one of mistray.scatter.kinds.KINDS, or several")
    lobes = model_lobes(chosen, request.wavelength_nm, n_in, n_out, request.from_front)
    cosines = np.array([cos_i])
    sums = totals(lobes, cosines, n_in, n_out)
    specular = share * (1 - float(sums.loss[event][0]))
    scattered = float(sums.scattered(event, np.array([share]))[0])
    if not specular + scattered > 0:
        raise MistrayError(f"surface transfer function: nothing goes on in {event}; give a share above 0")
    plateau = specular / (specular + scattered)
    if scattered == 0:
        return SurfaceTransfer(wavelength_um, 1.0, _AtLag())
    cos_0 = float(specular_cosine(event, cosines, n_in, n_out)[0])
    sin_0 = float(np.sqrt(1 - cos_0 * cos_0))
    symmetric = sin_0 == 0 and not any(lobe.anisotropic for lobe in lobes)
    psi = np.pi * (np.arange(AROUND) + 0.5) / AROUND * 2 if not symmetric else np.zeros(1)

    def profile(r: Array) -> Array:
        x, y = sin_0 + r[:, None] * np.cos(psi), r[:, None] * np.sin(psi)
        below = 1 - x * x - y * y
        cos_s = np.sqrt(np.maximum(below, LEAST_COSINE**2))
        found = bsdf(lobes, event, cos_i, np.stack([x, y, cos_s], axis=-1), n_in, n_out, share)
        return np.asarray(np.where(below >= 0, found, 0.0).mean(axis=1))

    rings = _Rings.of(profile, 1 + sin_0)
    n = n_in if event == "reflection" else n_out
    return SurfaceTransfer(wavelength_um, plateau, _AtLag(rings, n / wavelength_um, specular=plateau))


transfer_of_bsdf = analysis("transfer_of_bsdf", BsdfTransferRequest, run_bsdf)


def run_spectrum(model: RoughSurface, request: SurfaceTransferRequest) -> SurfaceTransfer:
    """
    Return the surface transfer function of a roughness spectrum by Harvey's formula, ``exp{-a [1 - C(s)/σ²]}``.

    s is the lag on the surface, µm, and a the variance of the phase, rad². C, µm², is the Hankel transform of the
    spectrum at the frequencies that scatter into the half space at normal incidence, 0 … n/λ. σ² is the variance of the
    heights there, n the index of the medium of the scattered light, and λ the vacuum wavelength. The formula holds for
    surfaces of any roughness whose heights are Gaussian.

    Parameters
    ----------
    model : RoughSurface
        A `KCorrelation` or a `PsdTable`.
    request : SurfaceTransferRequest

    Raises
    ------
    MistrayError
        If the event or a value is invalid, or light is totally reflected.

    Warns
    -----
    MistrayWarning
        If the surface is not smooth, 2π Δn σ/λ above `mistray.physics.harvey_shack.MAX_PHASE`: its BSDF is then not
        that of the theories for smooth surfaces. The theory "ghs_full" has no such limit.

    Examples
    --------
    >>> from mistray.scatter.k_correlation import KCorrelation
    >>> found = mistray.analysis.transfer_of_spectrum(KCorrelation(2.0, 10.0, 2.5), 550.0)
    >>> print(f"TIS {found.tis:.2e}, {(4 * np.pi * 2.0 / 550) ** 2:.2e} by the formula of Bennett and Porteus")
    TIS 1.60e-03, 2.09e-03 by the formula of Bennett and Porteus
    """
    event, n_in, n_out, cos_i = request.event, request.n_in, request.n_out, request.cos_i
    wavelength_nm, n = request.wavelength_nm, n_in if event == "reflection" else n_out
    wavelength_um = wavelength_nm * 1e-3
    rms_um = 0.0 if model.is_smooth_as_glass else model.relevant_rms_um(wavelength_nm, n)
    cos_0 = float(specular_cosine(event, np.array([cos_i]), n_in, n_out)[0])
    if event == "reflection":
        path = ghs.path_in_reflection(cos_i, cos_i, n_in)
    else:
        path = ghs.path_in_transmission(cos_i, cos_0, n_in, n_out)
    phase = float(harvey_shack.phase_rms(rms_um, wavelength_um, index_step(event, n_in, n_out)))
    if phase > harvey_shack.MAX_PHASE and model.theory != "ghs_full":
        warnings.warn(
            f"{model.title}: rms roughness {rms_um * 1e3:.3g} nm is not smooth in {event} at {wavelength_nm:g} nm "
            f"(2π Δn σ/λ is {phase:.3g}, the most is {harvey_shack.MAX_PHASE:.3g}); the transfer function holds, the "
            "BSDF does not",
            MistrayWarning,
            stacklevel=5,  # the line that calls `transfer_of_spectrum`, see `mistray.toolkit.analysis`
        )
    variance = float(ghs.phase_variance(path, rms_um, wavelength_um))
    if variance == 0:
        return SurfaceTransfer(wavelength_um, 1.0, _AtLag())
    psd, highest = model.psd(wavelength_nm), n / wavelength_um
    rings = _Rings.of(lambda r: np.asarray(psd(r * highest)), 1.0)
    return SurfaceTransfer(wavelength_um, float(np.exp(-variance)), _AtLag(rings, highest, variance=variance))


transfer_of_spectrum = analysis("transfer_of_spectrum", SurfaceTransferRequest, run_spectrum)


def product(transfers: Sequence[SurfaceTransfer], lags_um: Sequence[Array]) -> Array:
    """
    Return the surface transfer function of several independent surfaces, (m,).

    Parameters
    ----------
    transfers : sequence of SurfaceTransfer
        Transfer function of each surface.
    lags_um : sequence of (m,) float64
        Lags on each surface, µm, for the same frequencies of the image; see
        `mistray.physics.imaging.surface_transfer.lag_um`.
    """
    return np.prod([one.at_lag(lag) for one, lag in zip(transfers, lags_um, strict=True)], axis=0)


@dataclass(frozen=True, eq=False)
class _Rings:
    """
    Light scattered onto rings about the specular direction, with a total flux of 1: inner and outer radii, and flux.

    Radii are direction cosines, or for a roughness spectrum frequencies over the highest one.
    """

    inner: Array
    outer: Array
    flux: Array

    @classmethod
    def of(cls, profile: Callable[[Array], Array], r_max: float) -> _Rings:
        table, nodes = RadialTable.of(profile, r_max), node_radii()
        inside = np.pi * nodes[0] ** 2 * 2.0 ** table.log2_values[0]
        flux = np.concatenate([[inside], ring_flux(nodes[:-1], table.log2_values)])
        flux[np.concatenate([[0.0], nodes[:-1]]) >= r_max] = 0
        return cls(np.concatenate([[0.0], nodes[:-1]]), nodes, flux / flux.sum())

    def transform(self, frequency: Array) -> Array:
        """Return the Hankel sum Σ flux J0(2π r q), (m,), of the rings at q, (m,), cycles per unit of the radii."""
        flat = np.atleast_1d(frequency)
        return formulas.ring_transform(self.inner, self.outer, self.flux, flat).reshape(np.shape(frequency))


@dataclass(frozen=True, eq=False)
class _AtLag:
    """
    Surface transfer function of lags on the surface, µm.

    Attributes
    ----------
    rings : _Rings or None
        Scattered light, or the spectrum of the phase; None: nothing is scattered.
    highest : float
        Surface frequency at the radius 1 of the rings, n/λ, 1/µm.
    specular : float
        Share of the light that is not scattered; unused with a `variance`.
    variance : float, optional
        Variance of the phase whose spectrum the rings are, rad²; None if the rings are scattered light.
    """

    rings: _Rings | None = None
    highest: float = 0.0
    specular: float = 1.0
    variance: float | None = None

    def __call__(self, lag: Array) -> Array:
        """Return the values at lags, µm, of any shape; they are 1 if nothing is scattered."""
        if self.rings is None:
            return np.ones_like(lag, dtype=np.float64)
        found = self.rings.transform(self.highest * np.asarray(lag))
        if self.variance is not None:
            return formulas.surface_transfer(found, self.variance)
        return self.specular + (1 - self.specular) * found
