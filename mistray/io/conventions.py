"""Conversion of conventions common to lens files: surface shapes, rotations, pupils, apertures."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mistray.errors import MistrayError
from mistray.physics.geometry.pose import fixed_angles_deg
from mistray.physics.geometry.sag import trimmed
from mistray.prescription.sequential.first_order import paraxial_system
from mistray.prescription.sequential.table import Sequential


def figure(radius: float, conic: float, even_terms: Sequence[float]) -> dict[str, Any]:
    """
    Return radius, conic, coefficients and sag of a `Row` for an even polynomial that begins at r².

    A plane with an r² term becomes the paraboloid of radius 1/(2 a2). On a curved surface the term stays in the sag.

    Parameters
    ----------
    radius, conic : float
        Radius of curvature, mm (``inf`` for a plane), and conic constant.
    even_terms : sequence of float
        Coefficients of r², r⁴, …, in mm⁻¹, mm⁻³, …
    """
    first, *higher = [float(term) for term in even_terms] or [0.0]
    sag = {}
    if first and math.isfinite(radius):
        sag["a2"] = first
    elif first:
        radius, conic = 1 / (2 * first), -1.0
    return {"radius": radius, "conic": conic, "coefficients": trimmed(higher), "sag": sag}


def turns_deg(rotation: np.ndarray) -> tuple[float, float, float]:
    """Return the angles, degrees, of R = Rx Ry Rz, (3, 3): about x, the new y and the newest z; without round-off."""
    x, y, z = (0.0 - angle for angle in fixed_angles_deg(rotation.T))  # its inverse is Rz(-z) Ry(-y) Rx(-x)
    return x, y, z


def choose_position(
    given: int | str | None, saved: int, names: Mapping[int, str], count: int, what: str
) -> tuple[int, str]:
    """
    Choose one of several configurations of a lens file; return its number and a note on the others.

    Parameters
    ----------
    given : int or str, optional
        Number or name of the one to read; None: the one that the file was saved in.
    saved, count : int
        Number, from 1, of the one that the file was saved in, and how many there are.
    names : mapping of int to str
        Their names, by number.
    what : str
        Name that the program has for them, for messages.

    Returns
    -------
    number, note : int, str
        Number, and a note on those that are left out; "" if there is only one.

    Raises
    ------
    MistrayError
        If there is none of this number or name.
    """
    number = saved if given is None else given
    if isinstance(number, str):
        found = [k for k, name in names.items() if name == number]
        if not found and not number.isdecimal():
            named = ", ".join(f"'{name}'" for name in names.values() if name) or "no names"
            raise MistrayError(f"{what} '{number}' is not there; the file has {named}")
        number = found[0] if found else int(number)
    if not 1 <= number <= count:
        raise MistrayError(f"{what} {number} of {count}; give one from 1 to {count}")
    named = ", ".join(f"{k} '{name}'" for k, name in sorted(names.items()) if name)
    of = f"{count} ({named})" if named else f"{count}"
    return number, f"{what} {number} of {of}; configuration chooses another" if count > 1 else ""


def squeezed(upper_x: float, lower_x: float, upper_y: float, lower_y: float) -> tuple[float, float, float, float]:
    """
    Return shift VDX, VDY and compression VCX, VCY of the pupil from CODE V's vignetting factors VUX, VLX, VUY, VLY.

    All are fractions of the radius of the pupil; a shift is positive towards +x or +y.
    """
    return (lower_x - upper_x) / 2, (lower_y - upper_y) / 2, (lower_x + upper_x) / 2, (lower_y + upper_y) / 2


def object_na(lens: Sequential, image_na: float) -> float:
    """
    Return the numerical aperture n sin θ in object space of the paraxial cone with a given NA at the image.

    Parameters
    ----------
    lens : Sequential
        Lens whose object is at a finite distance.
    image_na : float
        Slope |dy/dz| of the marginal ray at the image, times the index there: 1/(2F), or NA.

    Raises
    ------
    MistrayError
        If the image lies at infinity.
    """
    system, _ = paraxial_system(lens)
    magnified = abs(system.trace(lens.object_distance, 1.0)[-1, 1])
    if not magnified > 0:
        raise MistrayError(f"lens '{lens.name}': an aperture at the image, which lies at infinity; give a diameter")
    return float(abs(system.index[0]) * math.sin(math.atan(image_na / abs(system.index[-1]) / magnified)))
