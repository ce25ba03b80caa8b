"""CIE 1931 2° observer (CIE 15:2018, table 1) and sRGB from its own definition (IEC 61966-2-1)."""

import numpy as np

from .geometry import Array
from .layers import stack_powers

# nm: x̄, ȳ, z̄
OBSERVER = {
    400.0: (0.01431, 0.000396, 0.06785),
    450.0: (0.3362, 0.038, 1.77211),
    500.0: (0.0049, 0.323, 0.272),
    555.0: (0.51205, 1.0, 0.00575),
    600.0: (1.0622, 0.631, 0.0008),
    650.0: (0.2835, 0.107, 0.0),
    700.0: (0.011359, 0.004102, 0.0),
}
# nm: x, y of monochromatic light
SPECTRUM_LOCUS = {
    450.0: (0.15664, 0.01770),
    480.0: (0.09129, 0.13270),
    520.0: (0.07430, 0.83380),
    560.0: (0.37310, 0.62445),
    600.0: (0.62704, 0.37249),
    650.0: (0.72599, 0.27401),
    700.0: (0.73469, 0.26531),
}
RED, GREEN, BLUE, D65 = (0.64, 0.33), (0.30, 0.60), (0.15, 0.06), (0.3127, 0.3290)


def chromaticity(xyz: Array) -> Array:
    return xyz[..., :2] / xyz.sum(axis=-1, keepdims=True)


def from_xy(xy: tuple[float, float]) -> Array:
    return np.array([xy[0] / xy[1], 1.0, (1 - xy[0] - xy[1]) / xy[1]])


def rgb_to_xyz() -> Array:
    """Matrix from linear sRGB: the primaries, scaled so that (1, 1, 1) is D65."""
    primaries = np.column_stack([from_xy(xy) for xy in (RED, GREEN, BLUE)])
    return primaries * np.linalg.solve(primaries, from_xy(D65))


def decode(rgb: Array) -> Array:
    return np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)


def encode(linear: Array) -> Array:
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def bare(index: float) -> float:
    return ((index - 1) / (index + 1)) ** 2


def stack_in_air(layers: list[tuple[float, float]], substrate: float, wavelength_nm: Array) -> Array:
    """Reflectance at normal incidence; ``layers``: index and thickness in nm, the outermost first, no absorption."""
    n, d = np.array(layers, dtype=float).reshape(-1, 2).T
    return np.array([stack_powers(1.0, n, d, substrate, nm, np.ones(1))[0][0] for nm in wavelength_nm])
