"""Refractive indices n + ik from the material strings of a scene.

A material string is one of

============================  ======================================================================== ==============
string                        n                                                                        k
============================  ======================================================================== ==============
``air``, ``vacuum``           1; glass indices are relative to air, as catalogues give them            0
``1.5168``                    constant                                                                 0
``1.5+0.01i``                 constant                                                                 constant
``nd=1.544 Vd=56.1``          two-term Cauchy through nd and Vd, see `cauchy_index`                    unknown
``n(480)=1.52 n(590)=1.51``   linear between these points, wavelengths in nm                           of ``k(480)=…``
``N-BK7``, ``schott/F2``      formula of the maker's catalogue (see `catalogue.MAKERS`)                from internal
                                                                                                       transmittances
``MgF2``, ``Al``, ``PMMA``    pinned page of refractiveindex.info (see `catalogue.PINNED`)             of the page
``main/Ag/nk/Yang``           any page of its database, by its path                                    of the page
``mitsuba/Au``                table of Mitsuba's plugin `conductor`                                    of its table
``glass.csv``                 user's table, see `user_table`                                           of the table
``makers.agf:N-BK7``          glass of a Zemax AGF file, see `agf`                                     from IT lines
``COATING.DAT:MGF2``          MATE section of a Zemax coating file, see `mate`                         of the section
============================  ======================================================================== ==============

Further words may follow, separated by spaces:

- ``k=VALUE`` sets k, whatever the data say.
- ``extrapolate`` allows wavelengths outside the data's range: formulas are evaluated there, tables keep the value of
  their nearest end.
- ``shift=VALUE`` is added to n at every wavelength.
- ``scatter=PER_MM g=G``: the material scatters light with this coefficient, 1/mm, and the phase function of Henyey and
  Greenstein of asymmetry g.

Wavelengths are in nm, in vacuum. If k is unknown, `complex_index` raises an error and never assumes 0.
docs/materials.md has the names, their pages and their sources.
"""

from mistray.materials.catalogue import names
from mistray.materials.formulas import CAUCHY_RANGE_NM, LINE_C_NM, LINE_D_NM, LINE_F_NM, cauchy_index
from mistray.materials.lookup import (
    MaterialSource,
    bulk_scatter,
    complex_index,
    nearest_known_nm,
    refractive_index,
    resolved,
    source,
    table_nodes_nm,
)
from mistray.materials.spec import BulkScatter, shifted

Source = MaterialSource  # its name before version 0.3

__all__ = [
    "CAUCHY_RANGE_NM",
    "LINE_C_NM",
    "LINE_D_NM",
    "LINE_F_NM",
    "BulkScatter",
    "MaterialSource",
    "Source",
    "bulk_scatter",
    "cauchy_index",
    "complex_index",
    "names",
    "nearest_known_nm",
    "refractive_index",
    "resolved",
    "shifted",
    "source",
    "table_nodes_nm",
]


def __dir__() -> list[str]:
    return sorted(__all__)
