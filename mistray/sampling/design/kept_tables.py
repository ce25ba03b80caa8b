"""
Surface tables that are kept with their scene, so that a trace of a scene that has not changed makes none anew.

A plugin replaces its values, coating, models of scatter and names of materials when a parameter changes. A table is
used again while all of them are the same, and the materials, whose files may change, have the same indices.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from operator import is_
from typing import Any

import mitsuba as mi

from mistray.cache.remembered import remembered
from mistray.coatings import Stack
from mistray.errors import MistrayError
from mistray.materials import complex_index
from mistray.ranges import several
from mistray.scatter.particulate import DUST, Particulate
from mistray.surfaces.surfaces import SurfaceTable, interface_of, is_analytic, named_shapes

ATTRIBUTE = "kept_tables"  # of the first shape of a scene, with which the tables go; the scene itself takes none


class KeptTables:
    """
    Surface tables of a scene as it is now, which share their geometry.

    Those of a scene with Mitsuba's own shapes are kept in this object alone: a change of a mesh would be missed.

    Parameters
    ----------
    scene : mi.Scene
        See `SurfaceTable`.

    Raises
    ------
    MistrayError
        For a shape without interface, or two of the same id.
    """

    def __init__(self, scene: mi.Scene) -> None:
        self._scene = scene
        named = named_shapes(scene)
        shapes, interfaces = list(named.values()), [interface_of(shape) for shape in named.values()]
        coatings, models = [one.coating for one in interfaces], [model for one in interfaces for model in one.scatter]
        # Materials that may be files: their indices are part of the key
        self._materials = dict.fromkeys(name for one in interfaces for name in (one.front, one.back))
        stacks = {id(one): one for one in coatings if isinstance(one, Stack)}
        self._materials |= dict.fromkeys(layer.material for stack in stacks.values() for layer in stack.layers)
        self._materials |= dict.fromkeys(one.particle for one in models if isinstance(one, Particulate))
        self._tables: dict[Any, SurfaceTable] = {}
        if not all(map(is_analytic, shapes)):
            return
        numbers = [*named, *((*shape.values.values(),) for shape in shapes)]
        numbers += [(one.front, one.back) for one in interfaces]
        objects = [*shapes, *interfaces, *coatings, *models]
        nothing: tuple[list[Any], list[Any], dict[Any, SurfaceTable]] = [], [], {}
        known = getattr(shapes[0], ATTRIBUTE, nothing) if shapes else nothing
        if numbers != known[0] or len(objects) != len(known[1]) or not all(map(is_, objects, known[1])):
            known = numbers, objects, self._tables
            setattr(shapes[0], ATTRIBUTE, known)
        self._tables = known[2]

    def table(
        self,
        wavelength_nm: float,
        detector: str | Sequence[str] | None = None,
        stokes: bool = False,
        mirrors: frozenset[int] = frozenset(),
    ) -> SurfaceTable:
        """
        Return the table of the surfaces, see `SurfaceTable`, with opaque `mirrors` of the design.

        Parameters
        ----------
        wavelength_nm, detector, stokes
            See `SurfaceTable`.
        mirrors : frozenset of int
            See `SurfaceTable.with_mirrors`.
        """

        def make() -> SurfaceTable:
            known = next(iter(self._tables.values()), None)
            if known is not None:
                return known.varied(wavelength_nm, detector, stokes, mirrors)
            first = SurfaceTable(self._scene, wavelength_nm, detector, stokes)
            first.scene = None  # nor must what is made of it: the tables go with the shapes of the scene
            return first.with_mirrors(mirrors)

        indices = [_index(name, wavelength_nm) for name in self._materials]
        names = None if detector is None else repr(several(detector))
        found = copy(remembered(self._tables, (wavelength_nm, names, stokes, mirrors, *indices), make))
        found.scene = self._scene
        return found


def _index(material: str, wavelength_nm: float) -> complex | None:
    """Return the index n + ik of a material at a wavelength, nm; None: it is not known there."""
    try:
        return complex_index(material, wavelength_nm) if material != DUST else None
    except MistrayError:
        return None
