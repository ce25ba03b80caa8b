"""Coating presets fitted to a substrate: the materials of a design, with thicknesses of least mean reflectance.

A design is made for one index. On another body its layers keep their materials and their order. Their thicknesses
minimise the mean of R over the band of the design at normal incidence. A layer that only does harm gets the thickness 0
and is left out. So a design with an outermost layer of 1.38 is never worse than that layer alone. R follows from the
recursion of Fresnel coefficients, r = (r₁ + r₂ e^{2iδ}) / (1 + r₁ r₂ e^{2iδ}) with δ = 2πNd/λ (H. A. Macleod,
*Thin-Film Optical Filters*, chapter 2). The search starts from a fixed grid, so that it always finds the same layers.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np

from mistray.coatings.presets import DEFAULT_NM, PRESETS, preset
from mistray.coatings.response import METAL_K
from mistray.coatings.stack import Layer, Stack
from mistray.errors import MistrayError
from mistray.materials import complex_index, nearest_known_nm

LIKE_THE_DESIGN = 0.02  # relative difference of the body's index below which a preset is left as designed
GRID_WAVES = (0.0, 0.125, 0.25, 0.5)
REFINED = 6  # best starts, which are refined
POINTS = 41  # wavelengths over the band
THINNEST, MOST_WAVES, STEP = 0.005, 0.75, 1e-5  # waves: least thickness kept, greatest thickness, step of differences
DIGITS = 2  # decimals of thicknesses in nm
SAME_FACTOR = 1e-6  # thicknesses in a scene are float32
MUCH, MUCH_R = 2.0, 2e-3  # factor to the R on the design's body, and R, above which a preset gets a remark
OF_USE = 0.5  # a coating that leaves more than this fraction of the bare surface's R is refused


@dataclass(frozen=True)
class FittedPreset:
    """
    Preset coating with layer thicknesses fitted to a body's index.

    Attributes
    ----------
    stack : Stack
        Stack with the fitted thicknesses; as designed if `changed` is False.
    changed : bool
        Whether the thicknesses differ from those of the design: not for a body like that of the design, for a single
        layer, or where no better thicknesses were found.
    low_nm, high_nm : float
        Limits of the band, nm.
    reached, designed, bare : float
        Mean R over the band, 0 … 1, at normal incidence: of the stack, of the preset as designed, and of the bare body.

    Examples
    --------
    >>> fitted = mistray.coatings.fitted_preset("bbar3", "N-SF11")
    >>> print(f"{fitted.low_nm:.0f} … {fitted.high_nm:.0f} nm")
    450 … 650 nm
    >>> print(f"R = {fitted.reached:.2%} instead of {fitted.designed:.2%}")
    R = 0.06% instead of 1.06%
    """

    stack: Stack
    changed: bool
    low_nm: float
    high_nm: float
    reached: float
    designed: float
    bare: float

    def __str__(self) -> str:
        """Return the mean reflectance of the fitted stack in words, with that of the design and of the bare body."""
        band = f"mean R = {100 * self.reached:.3g} % from {self.low_nm:g} to {self.high_nm:g} nm"
        return f"{band} (as designed {100 * self.designed:.3g} %, bare {100 * self.bare:.3g} %)"


def fitted_preset(name: str, body: str, design_nm: float = 550.0) -> FittedPreset:
    """
    Return a preset fitted to a body in air.

    Parameters
    ----------
    name : str
        Name of a preset that transmits.
    body : str
        Material, see `mistray.materials`. Where its index is unknown in the band, that at the nearest known wavelength
        counts.
    design_nm : float
        Wavelength of the design, nm, as for `preset`.

    Raises
    ------
    MistrayError
        If the name is unknown, the body is a metal, or the coating leaves more than half of the bare surface's
        reflectance.

    Examples
    --------
    >>> fitted = mistray.coatings.fitted_preset("bbar3", "N-SF11")
    >>> print(f"bare {fitted.bare:.2%}, as designed {fitted.designed:.2%}, fitted {fitted.reached:.2%}")
    bare 8.07%, as designed 1.06%, fitted 0.06%
    """
    stack, design = preset(name, design_nm), PRESETS[name]
    lam = np.linspace(*design.band, POINTS) * design.centre_nm(design_nm)
    # The data in a file may have changed
    return _fitted(stack, body, design_nm, tuple(_index(body, nearest_known_nm(body, nm)) for nm in lam.tolist()))


@lru_cache(maxsize=256)
def _fitted(stack: Stack, body: str, design_nm: float, indices: tuple[complex, ...]) -> FittedPreset:
    """Return the result of `fitted_preset` for a preset's `stack`; `indices` are those of the body over the band."""
    name, design = stack.name, PRESETS[stack.name]
    centre = design.centre_nm(design_nm)
    lam, substrate = np.linspace(*design.band, POINTS) * centre, np.array(indices)
    if substrate.imag.max() > METAL_K:
        band = f"light from {lam[0]:g} to {lam[-1]:g} nm"
        raise MistrayError(f"coating preset '{name}': '{body}' passes no {band}; choose a preset of another band")
    index = np.array([stack.indices(nm) for nm in lam.tolist()]).T
    designed = np.array([layer.thickness_nm for layer in stack.layers])
    bare = float(_mean_r(np.zeros((1, len(designed))), index, substrate, lam)[0])
    as_designed = float(_mean_r(designed[None], index, substrate, lam)[0])
    like = abs(float(substrate.real.mean()) - design.substrate) <= LIKE_THE_DESIGN
    changed = not like and len(designed) > 1  # a quarter wave is one on every body
    d = _best(designed, index, substrate, lam, centre) if changed else designed
    reached = float(_mean_r(d[None], index, substrate, lam)[0])
    if changed and reached >= as_designed:  # nothing better was found
        d, reached, changed = designed, as_designed, False
    found = FittedPreset(stack, changed, float(lam[0]), float(lam[-1]), reached, as_designed, bare)
    if reached > OF_USE * bare:
        raise MistrayError(f"coating preset '{name}' does not suit '{body}': {found}; choose another one, or layers")
    if not changed:
        return found
    layers = (Layer(layer.material, float(t)) for layer, t in zip(stack.layers, d, strict=True) if t)
    return FittedPreset(Stack(tuple(layers), name=name), True, found.low_nm, found.high_nm, reached, as_designed, bare)


@lru_cache(maxsize=256)
def unfitted(stack: Stack, body: str) -> str:
    """
    Return a remark if a preset as designed leaves much more reflectance on `body` than on the body of its design.

    The result is "" if it does not, or the layers of `stack` are not those of a preset.

    Layers are those of a preset if their materials agree, and their thicknesses agree up to a common factor.
    """
    for name, design in PRESETS.items():
        own = preset(name)
        if design.metal is not None or len(own.layers) < 2 or len(own.layers) != len(stack.layers):
            continue
        factors = [a.thickness_nm / b.thickness_nm for a, b in zip(stack.layers, own.layers, strict=True)]
        same = all(a.material == b.material for a, b in zip(stack.layers, own.layers, strict=True))
        if not same or max(factors) - min(factors) > SAME_FACTOR * max(factors):
            continue
        centre = factors[0] * design.centre_nm(DEFAULT_NM)
        lam = np.linspace(*design.band, POINTS) * centre
        index = np.array([stack.indices(nm) for nm in lam.tolist()]).T
        d = np.array([[layer.thickness_nm for layer in stack.layers]])
        substrate = np.array([_index(body, nearest_known_nm(body, nm)) for nm in lam.tolist()])
        here, there = (float(_mean_r(d, index, n, lam)[0]) for n in (substrate, np.full(POINTS, design.substrate + 0j)))
        if here > max(MUCH * there, there + MUCH_R):
            return (
                f"{name} as designed, for n = {design.substrate:.4g}, leaves a mean R of {100 * here:.2g} % on {body} "
                f"from {lam[0]:g} to {lam[-1]:g} nm, and {100 * there:.2g} % on its own; 'mistray coat' fits it"
            )
    return ""


def _index(body: str, wavelength_nm: float) -> complex:
    """Return the index n + ik of a body at a wavelength in nm, with k = 0 if its k is unknown."""
    try:
        return complex_index(body, wavelength_nm)
    except MistrayError:
        return complex_index(f"{body} k=0", wavelength_nm)


def _best(designed: np.ndarray, index: np.ndarray, substrate: np.ndarray, lam: np.ndarray, centre: float) -> np.ndarray:
    """
    Return rounded layer thicknesses, (L,), nm, of the least mean R; 0 for a layer that is left out.

    The search begins at the best of a grid and of the thicknesses `designed`, nm. `centre` is the design wavelength,
    nm; the other parameters are those of `_mean_r`.
    """
    from scipy.optimize import minimize

    quarter = centre / index.real.mean(axis=1)
    grid = np.array(list(product(GRID_WAVES, repeat=len(designed)))) * quarter
    starts = np.concatenate([designed[None], grid])
    order = np.argsort(_mean_r(starts, index, substrate, lam), kind="stable")[:REFINED]
    steps = STEP * np.concatenate([np.zeros((1, len(designed))), np.eye(len(designed)), -np.eye(len(designed))])

    def value(waves: np.ndarray) -> tuple[float, np.ndarray]:
        """Return the mean R in per mille, and its derivatives with respect to optical layer thicknesses in waves."""
        r = 1e3 * _mean_r((waves + steps) * quarter, index, substrate, lam)
        ahead, back = np.split(r[1:], 2)
        return float(r[0]), (ahead - back) / (2 * STEP)

    best, least = designed, np.inf
    for waves in starts[order] / quarter:
        found = minimize(value, waves, jac=True, method="L-BFGS-B", bounds=[(0.0, MOST_WAVES)] * len(designed))
        d = np.where(found.x < THINNEST, 0.0, np.round(found.x * quarter, DIGITS))
        r = float(_mean_r(d[None], index, substrate, lam)[0])
        if r < least:
            best, least = d, r
    return best


def _mean_r(d_nm: np.ndarray, index: np.ndarray, substrate: np.ndarray, lam: np.ndarray) -> np.ndarray:
    """
    Return the mean R in air over wavelengths at normal incidence, (s,), for sets of thicknesses (s, L), nm.

    Parameters
    ----------
    d_nm : (s, L) float64
        Thicknesses of the layers, nm, the outermost first.
    index : (L, w) complex128
        Indices n + ik of the layers.
    substrate, lam : (w,)
        Index n + ik of the body, and the wavelengths, nm.
    """
    below = substrate
    r = np.zeros((len(d_nm), len(lam)), dtype=np.complex128)
    media = [np.ones_like(substrate), *index]
    for place in range(len(index), -1, -1):
        here = media[place]
        step = (here - below) / (here + below)
        if place == len(index):
            r = np.broadcast_to(step, r.shape)
        else:
            turn = np.exp(4j * np.pi * index[place] * d_nm[:, place, None] / lam)
            r = (step + r * turn) / (1 + step * r * turn)
        below = here
    return np.asarray((np.abs(r) ** 2).mean(axis=1))
