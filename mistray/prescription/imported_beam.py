"""Width of the source's beam for an imported lens.

A beam that ends exactly at the rim of the stop has no derivative with respect to parameters that move either, see
`mistray.gradients.full.full_rims`, and does not show that a stop opens. So the beam is made wider at the same
irradiance. Its source states which area of the cross-section the stop of the file accepts.
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
    """Raise `MistrayError` if `beam` is not one of the known kinds of beam."""
    if beam not in known:
        raise MistrayError(f"beam = '{beam}'; it is {', '.join(map(repr, known[:-1]))} or '{known[-1]}'")


def beam_size(
    beam: str, radius: float, reach: float = 0.0, *, inner: float = 0.0, of: str = "the pupil"
) -> tuple[dict[str, Any], list[str]]:
    """
    Return the size of the source's beam for an imported lens, and notes on it; all importers use it.

    Parameters
    ----------
    beam : str
        Kind of beam, one of `Beam`.
    radius : float
        Radius that the light fills on the axis according to the file, mm.
    reach : float
        Largest distance of the light of any field from the centre of the beam in the same plane, mm.
    inner : float
        Radius of the unlit centre, mm; 0: there is none.
    of : str
        Description of the filled aperture, for notes.

    Returns
    -------
    size : dict
        Arguments of `Source`: radii (mm) and, for a wider beam, the ``pupil_area`` that the stop accepts (mm²).
    notes : list of str
        Note on a wider beam; empty if it is exact.
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
