"""The design sequences of a scene as a trace uses them, and its surfaces with the mirrors that they show."""

from __future__ import annotations

from collections.abc import Sequence

import mitsuba as mi
import numpy as np

from mistray.coatings import Bare
from mistray.recorders.design_sequences import DesignSequences, Sequences
from mistray.sampling.design.sequences import chosen_orders, combined, declared, has_optics
from mistray.sampling.design_path import design_probes
from mistray.sampling.importance_targets import signature
from mistray.surfaces.optics import DETECTOR, MIRROR
from mistray.surfaces.surfaces import SurfaceTable

MOST_KNOWN = 64  # scenes whose sequences are kept: a scene is traced at many fields
_known: dict[str, dict[int, Sequences]] = {}


def design_sequences(scene: mi.Scene, *tables: SurfaceTable, free: bool = False) -> DesignSequences:
    """
    The sequences of the design for each detector of a scene.

    A detector has those that its interface declares; else those of the first source, at the first design field, of
    which probes come to it over optics, see `mistray.sampling.design.sequences`. The field of a trace does not matter.

    Parameters
    ----------
    scene : mi.Scene
    *tables : SurfaceTable
        Its surfaces at each wavelength; a sequence of any wavelength is one of all.
    free : bool
        In a scene without lenses and mirrors, light that meets nothing forms the image, as a PST has it.

    Raises
    ------
    MistrayError
        If a declared sequence names what the scene does not have.
    """
    lists: dict[int, set[tuple[int, ...]]] = {}
    for table in tables:
        for detector, sequences in _found(scene, table).items():
            lists.setdefault(detector, set()).update(sequences)
    if free and not has_optics(tables[0]):
        lists |= {detector: {()} for detector in tables[0].detectors if detector not in lists}
    return DesignSequences({detector: tuple(sorted(found)) for detector, found in lists.items()})


def traced_table(
    scene: mi.Scene, wavelength_nm: float, detector: str | Sequence[str] | None = None, stokes: bool = False
) -> SurfaceTable:
    """
    The surfaces of a scene, with the opaque ones where a design sequence is reflected as mirrors, declared or not.

    Parameters
    ----------
    scene, wavelength_nm, detector, stokes
        See `SurfaceTable`.
    """
    table = SurfaceTable(scene, wavelength_nm, detector, stokes)
    bare = (table.optics.host_words & np.uint32(MIRROR | DETECTOR)) == 0
    undeclared = np.flatnonzero(table.optics.mostly_reflects & bare)
    if not len(undeclared):
        return table
    design = design_sequences(scene, table)
    reflectors = frozenset().union(*(design.reflectors(one) for one in table.detectors))
    return table.with_mirrors(reflectors.intersection(undeclared.tolist()))


def _found(scene: mi.Scene, table: SurfaceTable) -> dict[int, Sequences]:
    """The sequences of each detector of a table that has any."""
    coatings = [hash(one.coating) for one in table.interfaces if not isinstance(one.coating, Bare)]
    declarations = [getattr(table.interfaces[k], "design_path", "") for k in table.detectors]
    key = signature(table, scene, table.detectors) + repr((coatings, declarations))
    if key not in _known:
        while len(_known) >= MOST_KNOWN:
            _known.pop(next(iter(_known)))
        _known[key] = _search(scene, table)
    return _known[key]


def _search(scene: mi.Scene, table: SurfaceTable) -> dict[int, Sequences]:
    """What is declared, and what probes find."""
    lists = {detector: declared(table, detector) for detector in table.detectors}
    missing = [detector for detector, found in lists.items() if not found]
    for _, probes in design_probes(table, scene) if missing else ():
        for detector in missing:
            arms = chosen_orders(table, probes.orders(detector))
            lists[detector] = combined(table, arms)
        missing = [detector for detector in missing if not lists[detector]]
        if not missing:
            break
    return {detector: found for detector, found in lists.items() if found}
