"""Search for a scene's design sequences, and for opaque surfaces that act as mirrors in them."""

from __future__ import annotations

from collections.abc import Sequence

import mitsuba as mi
import numpy as np

from mistray.cache.remembered import remembered
from mistray.coatings import Bare
from mistray.recorders.design_sequences import DesignSequences, Sequences
from mistray.sampling.design.kept_tables import KeptTables
from mistray.sampling.design.sequences import chosen_orders, combined, declared, has_optics
from mistray.sampling.design_path import design_probes
from mistray.sampling.importance_targets import signature
from mistray.surfaces.optics import DETECTOR, MIRROR
from mistray.surfaces.surfaces import SurfaceTable

_known: dict[str, dict[int, Sequences]] = {}


def design_sequences(scene: mi.Scene, *tables: SurfaceTable, free: bool = False) -> DesignSequences:
    """
    Return the design sequences of each detector of a scene: the event sequences that form its direct image.

    A detector has the sequences that its interface declares. Without a declaration it has those of the first source, at
    the first design field, whose probes reach it over optics; see `mistray.sampling.design.sequences`. They do not
    depend on the field of a trace.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene.
    *tables : SurfaceTable
        Surfaces of the scene at each wavelength; a sequence of any wavelength is one of all.
    free : bool
        Whether light that meets nothing forms the image in a scene without lenses and mirrors, as a PST assumes, on
        detectors that have no sequence otherwise.

    Raises
    ------
    MistrayError
        If a declared sequence is not valid, see `mistray.sampling.design.sequences.declared`.
    """
    # Union over the wavelengths, at which R and T, and with them the ways of the probes, may differ
    lists: dict[int, set[tuple[int, ...]]] = {}
    for table in tables:
        for detector, sequences in _found(scene, table).items():
            lists.setdefault(detector, set()).update(sequences)
    if free and not has_optics(tables[0]):
        lists |= {detector: {()} for detector in tables[0].detectors if detector not in lists}
    return DesignSequences({detector: tuple(sorted(found)) for detector, found in lists.items()})


def traced_tables(
    scene: mi.Scene, wavelengths_nm: Sequence[float], detector: str | Sequence[str] | None = None, stokes: bool = False
) -> list[SurfaceTable]:
    """
    Return the surface tables of a scene as it is now, one for each wavelength, which share their geometry.

    Opaque surfaces at which a design sequence of the first wavelength reflects count as mirrors, if they reflect more
    than half of the light and are no detectors.

    Parameters
    ----------
    scene, detector, stokes
        See `SurfaceTable`.
    wavelengths_nm : sequence of float
        Vacuum wavelengths, nm.
    """
    kept = KeptTables(scene)
    table, *others = (kept.table(wavelength, detector, stokes) for wavelength in wavelengths_nm)
    # The search is skipped where no surface could become a mirror by it
    bare = (table.optics.host_words & np.uint32(MIRROR | DETECTOR)) == 0
    undeclared = np.flatnonzero(table.optics.mostly_reflects & bare)
    if not len(undeclared):
        return [table, *others]
    design = design_sequences(scene, table)
    reflectors = frozenset().union(*(design.reflectors(one) for one in table.detectors))
    mirrors = reflectors.intersection(undeclared.tolist())
    return [kept.table(wavelength, detector, stokes, mirrors) for wavelength in wavelengths_nm]


def _found(scene: mi.Scene, table: SurfaceTable) -> dict[int, Sequences]:
    """
    Return the design sequences by detector, from the cache if they were found before.

    Detectors without any are left out.
    """
    # Coatings decide what beam splitters and undeclared mirrors are; the signature leaves them out
    coatings = [hash(one.coating) for one in table.interfaces if not isinstance(one.coating, Bare)]
    declarations = [getattr(table.interfaces[k], "design_path", "") for k in table.detectors]
    key = signature(table, scene, table.detectors) + repr((coatings, declarations))
    return remembered(_known, key, lambda: _search(scene, table))


def _search(scene: mi.Scene, table: SurfaceTable) -> dict[int, Sequences]:
    """
    Return the design sequences by detector: those that it declares, else those that probe rays find.

    Detectors without any are left out.
    """
    lists = {detector: declared(table, detector) for detector in table.detectors}
    # Sources and fields in their order, until every detector has some
    missing = [detector for detector, found in lists.items() if not found]
    for _, probes in design_probes(table, scene) if missing else ():
        for detector in missing:
            arms = chosen_orders(table, probes.orders(detector))
            lists[detector] = combined(table, arms)
        missing = [detector for detector in missing if not lists[detector]]
        if not missing:
            break
    return {detector: found for detector, found in lists.items() if found}
