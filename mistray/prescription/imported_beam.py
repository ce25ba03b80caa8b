"""How wide the beam of an imported lens is.

A beam that ends exactly where the stop does has no derivative by what moves the two, see
`mistray.gradients.full.full_rims`, and shows nothing of a stop that opens. So it is wider than that, at the same
irradiance, and its source says which part of the cross-section the stop of the file takes.
"""

from __future__ import annotations

import math
from typing import Any, Literal

from mistray.errors import MistrayError

Beam = Literal["pupil", "front", "exact"]
"""The entrance pupil or the first surface overfilled, or the entrance pupil just filled."""
Fill = Literal["pupil", "exact"]
OVERFILL = 0.05
_DIGITS = 9  # of radii and areas in mm and mm²


def check_beam(beam: str, known: tuple[str, ...] = ("pupil", "exact")) -> None:
    """Raise if a beam is none of those known."""
    if beam not in known:
        raise MistrayError(f"beam = '{beam}'; it is {', '.join(map(repr, known[:-1]))} or '{known[-1]}'")


def beam_size(
    beam: str, radius: float, reach: float = 0.0, *, inner: float = 0.0, of: str = "the pupil"
) -> tuple[dict[str, Any], list[str]]:
    """
    Size of the beam of an imported lens: the only place that decides it.

    Parameters
    ----------
    beam : str
        A `Beam`.
    radius : float
        Of what the file says that the light fills on the axis, mm.
    reach : float
        Farthest that the light of any field reaches from the middle of the beam in the same plane, mm.
    inner : float
        Radius of the unlit centre, mm.
    of : str
        What is filled, in words.

    Returns
    -------
    size : dict
        Arguments of `Source`.
    notes : list of str
    """
    hole = {"inner_radius": inner} if inner else {}
    if beam == "exact":
        return {"radius": radius, **hole}, []
    outer = round((1 + OVERFILL) * max(radius, reach), _DIGITS)
    hole = {"inner_radius": round((1 - OVERFILL) * inner, _DIGITS)} if inner else {}
    area = round(math.pi * (radius**2 - inner**2), _DIGITS)
    wider = "" if outer <= (1 + 2 * OVERFILL) * radius else ", for the pupils of all fields"
    note = (
        f"the source is wider than {of}: {outer:.6g} mm instead of {radius:.6g} mm{wider}, so that the stop has "
        "derivatives; transmissions count what the pupil takes (beam 'exact' fills it)"
    )
    return {"radius": outer, **hole, "pupil_area": area}, [note]
