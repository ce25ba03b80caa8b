"""State of polarisation of light, as a source declares it: Stokes parameters, a Jones vector or an angle.

Looking into the light, with x to the right and y up, (s1, s2, s3) = (S1, S2, S3)/S0 are

    s1: +1 along x, -1 along y;   s2: +1 along the bisector of x and y, -1 along that of x and -y;
    s3: +1 circular, clockwise: right-handed in optics;   -1 counter-clockwise

and with fields that go as exp(-iωt) a Jones vector (ex, ey) has s1 = |ex|² - |ey|², s2 + i s3 = 2 ex ey*, over |ex|² +
|ey|². Source: M. Born and E. Wolf, *Principles of Optics*, 7th ed., section 1.4.2, whose sense of rotation is the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mistray.errors import MistrayError
from mistray.ranges import AZIMUTH_DEG, shown

State = tuple[float, float, float]
WAYS = ("stokes", "jones", "polarization_deg")
ROUNDING = 1e-4  # excess of the degree of polarisation over 1 that counts as rounding of decimals


def polarization_state(owner: str, stokes: Any = None, jones: Any = None, polarization_deg: Any = None) -> State | None:
    """
    Return the Stokes parameters of a source.

    They are S1, S2 and S3 over S0, for an observer who looks into the light with x to the right and y up. Of these s1
    is positive along x, s2 along the bisector of x and y, and s3 for clockwise (right-handed) rotation.

    Parameters
    ----------
    owner : str
        Name of the source for messages, such as "source 'laser'".
    stokes : str or sequence of three numbers, optional
        Stokes parameters s1, s2, s3, with a degree of polarisation √(s1² + s2² + s3²) of at most 1.
    jones : str or sequence of two complex numbers, optional
        Jones vector ex, ey, of any size, for fields that go as exp(-iωt). In strings the imaginary unit is i or j, as
        in "1, -1i".
    polarization_deg : float, optional
        Angle of linear polarisation from x towards y, degrees.

    Returns
    -------
    tuple of three float or None
        Stokes parameters s1, s2, s3; None if no form is given, or s1, s2, s3 are all 0: unpolarised light.

    Raises
    ------
    MistrayError
        If two forms are given, a value is missing, not a number or not finite, or no light can have this state.
    """
    given = [way for way, value in zip(WAYS, (stokes, jones, polarization_deg), strict=True) if value is not None]
    if len(given) > 1:
        raise MistrayError(f"{owner}: {' and '.join(given)} are given; give one of them")
    if stokes is not None:
        return _from_stokes(owner, stokes)
    if jones is not None:
        return _from_jones(owner, jones)
    if polarization_deg is None:
        return None
    angle = 2 * np.radians(float(AZIMUTH_DEG.check("polarization_deg", polarization_deg, owner)))
    return float(np.cos(angle)), float(np.sin(angle)), 0.0


def _from_stokes(owner: str, stokes: Any) -> State | None:
    s = np.array(_numbers(owner, "stokes", stokes, float, ("s1", "s2", "s3")))
    degree = float(np.linalg.norm(s))
    if degree > 1 + ROUNDING:
        raise MistrayError(
            f"{owner}: stokes is {_shown(s)}, a degree of polarisation of {degree:.6g}; "
            "give s1, s2, s3 divided by S0, at most 1"
        )
    if degree == 0:
        return None
    s1, s2, s3 = (s / max(degree, 1.0)).tolist()
    return s1, s2, s3


def jones_numbers(owner: str, jones: Any) -> tuple[complex, complex]:
    """
    Return the components ex, ey of a Jones vector, which may be a string, see `polarization_state`.

    Raise `MistrayError` if they are not two finite numbers.
    """
    ex, ey = _numbers(owner, "jones", jones, complex, ("ex", "ey"))
    return ex, ey


def _from_jones(owner: str, jones: Any) -> State:
    e = np.array(jones_numbers(owner, jones))
    largest = float(np.max(np.abs(e)))
    if largest == 0:
        raise MistrayError(f"{owner}: jones is 0, 0, which is not light; give a field, as in '1, -1i'")
    x, y = (e / largest).tolist()
    intensity, product = abs(x) ** 2 + abs(y) ** 2, 2 * x * y.conjugate()
    return (abs(x) ** 2 - abs(y) ** 2) / intensity, product.real / intensity, product.imag / intensity


def _numbers(owner: str, key: str, value: Any, kind: type[float] | type[complex], names: Sequence[str]) -> list[Any]:
    words: Sequence[Any]
    if isinstance(value, str):
        words = value.replace(",", " ").split()
        if kind is complex:
            words = [word.replace("i", "j") if "inf" not in word else word for word in words]
    else:
        words = np.ravel(np.asarray(value, dtype=object)).tolist()
    try:
        found = [kind(word) for word in words]
    except (TypeError, ValueError):
        found = []
    if len(found) != len(names) or not np.all(np.isfinite(found)) or np.any(np.abs(found) > 1e30):
        raise MistrayError(f"{owner}: {key} is {shown(value)}; give {len(names)} numbers, {', '.join(names)}")
    return found


def _shown(values: np.ndarray) -> str:
    return ", ".join(f"{value:g}" for value in values)
