"""Parameters that several scatter models share, and usual ranges of their values."""

from __future__ import annotations

from mistray.param import Param
from mistray.ranges import FALL, NOT_NEGATIVE, POSITIVE, ROUGHNESS_NM, WAVELENGTH_NM

SINGLE = 1e-6  # relative rounding error of a number of a scene, which may be a float32
MOST_TOTAL = 0.9  # total scatter above which little is left of a specular beam
# Parameters that several models have
PEAK = Param("1/sr", NOT_NEGATIVE, "BSDF in the specular direction, r = 0")
KNEE = Param("1", POSITIVE, "r of the knee, a direction cosine")
FALLING = Param("1", FALL, "slope beyond the knee, negative", tolerance=0.05)
ROUGHNESS = Param("nm", ROUGHNESS_NM, "roughness", power=2.0)
REFERENCE = Param(
    "nm",
    WAVELENGTH_NM,
    "wavelength at which the numbers hold; at others the scatter of a smooth surface is scaled. None: no dependence on "
    "the wavelength",
    differentiable=False,
)


def within(value: float, low: float, high: float) -> bool:
    """True if a value lies between two positive bounds, within the rounding of a scene's float32 numbers."""
    return low * (1 - SINGLE) <= value <= high * (1 + SINGLE)


def unusual(title: str, *texts: str | None, total: float = 0.0) -> str | None:
    """
    Return a model's advice in one line: on unusual values, and on scatter that leaves little of the beam.

    Parameters
    ----------
    title : str
        Name of the model.
    *texts : str or None
        Remarks on unusual values; None for no remark.
    total : float
        Fraction that is scattered at normal incidence, of the light that the model's `relative_to` names.

    Returns
    -------
    str or None
        Advice; None if nothing is unusual.
    """
    found = [text for text in texts if text is not None]
    if total > MOST_TOTAL:
        found.append(
            f"TIS is {total:.3g} at normal incidence; usual is less than {MOST_TOTAL:g}, more than 1 is refused"
        )
    return f"{title}: {'; '.join(found)}" if found else None
