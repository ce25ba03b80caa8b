"""Reflectance and transmittance of thin-film stacks in s or p polarisation, from mistray and from the program tmm."""

from __future__ import annotations

import math
from typing import Any

from mistray.analyses.validate.declared import DeclaredRow, ReferenceFile
from mistray.analyses.validate.pack import Finder, others
from mistray.estimate import Estimate
from mistray.physics.thinfilm import reflectance_transmittance


def _complex(value: Any) -> complex:
    return complex(*value) if isinstance(value, list) else complex(value)


def ours(file: ReferenceFile, rays: int | None, seed: int) -> Finder:
    """Return the function by which mistray computes R or T, 0 … 1, of a row's film stack; the parameters are unused."""

    def number(row: DeclaredRow) -> Estimate:
        layers = [_complex(n) for n in row.argument("n")]
        cosine = math.cos(math.radians(row.argument("angle_deg")))
        substrate = _complex(row.argument("substrate"))
        shares = reflectance_transmittance(
            1.0, layers, row.argument("thickness_nm"), substrate, row.argument("nm"), cosine
        )
        return Estimate(float(shares["RT".index(row.argument("share"))]["sp".index(row.argument("polarization"))]), 0.0)

    return number


def asked(row: DeclaredRow, _: Finder) -> Estimate:
    """Return the reflectance or transmittance, 0 … 1, of a row's film stack as the program tmm computes it."""
    indices = [1.0, *map(_complex, row.argument("n")), _complex(row.argument("substrate"))]
    thickness = [math.inf, *row.argument("thickness_nm"), math.inf]
    angle = math.radians(row.argument("angle_deg"))
    with others():
        import tmm

        found = tmm.coh_tmm(row.argument("polarization"), indices, thickness, angle, row.argument("nm"))
        return Estimate(float(found[row.argument("share")]), 0.0)
