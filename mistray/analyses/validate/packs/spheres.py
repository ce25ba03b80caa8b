"""Scattering efficiencies of spheres from Mie's theory, from mistray and from the program miepython."""

from __future__ import annotations

from mistray.analyses.validate.declared import DeclaredRow, ReferenceFile
from mistray.analyses.validate.pack import Finder, others
from mistray.estimate import Estimate
from mistray.physics.mie import spheres


def ours(file: ReferenceFile, rays: int | None, seed: int) -> Finder:
    """Return the function by which mistray computes a Mie efficiency of a row's sphere; the parameters are unused."""

    def number(row: DeclaredRow) -> Estimate:
        found = spheres([row.argument("x")], complex(row.argument("n"), row.argument("k")))
        return Estimate(float(getattr(found, row.argument("efficiency"))[0]), 0.0)

    return number


def asked(row: DeclaredRow, _: Finder) -> Estimate:
    """Return the Mie efficiency of a row's sphere as miepython computes it, with its convention n - ik of the index."""
    index = complex(row.argument("n"), -row.argument("k"))
    with others():
        import miepython

        extinction, scattering, *_rest = miepython.efficiencies_mx(index, row.argument("x"))
        return Estimate(float({"extinction": extinction, "scattering": scattering}[row.argument("efficiency")]), 0.0)
