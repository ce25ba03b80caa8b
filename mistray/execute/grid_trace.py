"""Base classes of traces over a grid of directions, by forward rays or by backward rays from the detector."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.execute.scene_task import fingerprint, kernel_arrays
from mistray.kernel.kernel_scene import KernelScene
from mistray.kernel.scattering import Scattering
from mistray.light import AS_THE_SCENE, Light
from mistray.notes import Note
from mistray.recorders.design_sequences import DesignKeys
from mistray.recorders.directions import DirectionGrid
from mistray.recorders.path_sums import PathSums
from mistray.sampling.design.search import design_sequences, traced_tables
from mistray.sampling.importance_targets import importance_targets
from mistray.sampling.outer_medium import closed_media, outer_medium
from mistray.sampling.outlines import detector_area
from mistray.sampling.plane_wave import Entrance, hull_points
from mistray.sampling.sharing.cell_waves import CellWaves
from mistray.sampling.sources import spectrum_of
from mistray.settings import Settings
from mistray.surfaces.intersect import Intersector
from mistray.surfaces.surfaces import SurfaceTable
from mistray.surfaces.thin_gaps import thin_gaps

PATH_SLOTS, ENTRY_SLOTS = 1 << 17, 1 << 20  # largest sizes of the tables of paths, and of their sums by cell
# Slots for sums: per slot of a path (scenes of 4 to 21 cells had 1 to 3 sums of a path), and in each cell at least
SUMS_OF_PATH, SUMS_OF_CELL = 4, 256
# Slots per start ray, and the fewest: 1e4 rays have found up to 2400 paths; setting a table of all to zero takes 0.13 s
SLOTS_OF_RAY, FEWEST_SLOTS = 2, 1 << 14


@dataclass(frozen=True)
class Band:
    """
    One wavelength of a trace.

    Attributes
    ----------
    table, scattering : SurfaceTable, Scattering
        Surfaces and their scatter.
    share : float
        Fraction of the light and of the rays.
    closed : mi.Bool or None
        Mask of the media in which no ray can leave the scene, see `mistray.sampling.outer_medium`; None: there are
        none.
    outside : int
        Position of the medium that surrounds the scene in `Optics.media`; 0 if it is unknown or there are no others.
    """

    table: SurfaceTable
    scattering: Scattering
    share: float
    closed: mi.Bool | None
    outside: int


class GridTrace:
    """
    Base class of traces of light from a grid of directions to a detector, by forward or backward rays.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene.
    grid : DirectionGrid
        Cells of directions.
    settings : Settings
        Settings of the trace.
    light : Light
        Wavelengths, by default those of the first source, else 550 nm; their weights, and the detector. Wavelengths of
        weight 0 are not traced.
    map_pixels : int
        Longer side of the maps of the detector; 0: none.
    paths : bool
        Whether a table of the paths is kept.

    Raises
    ------
    MistrayError
        If `cut_below_W` is set, since start rays have no watts of a source.

    Attributes
    ----------
    bands : list of Band
        Wavelengths with the scatter of the rays; set by the subclass, see `with_aims`.
    waves : CellWaves
        Plane waves from which forward rays start; set by a subclass that has some.
    table : SurfaceTable
        Surfaces at the first wavelength.
    area : float
        Area of the detector, mm².
    extent : tuple of float
        Bounds x0, x1, y0, y1 of the detector, in its own frame, mm.
    map_size : tuple of int
        Columns and rows of the maps; 0 without maps.
    design : DesignSequences
        Sequences of the direct image; in a scene without optics, light that meets nothing forms it.
    """

    bands: list[Band]
    waves: CellWaves

    def __init__(
        self,
        scene: mi.Scene,
        grid: DirectionGrid,
        settings: Settings,
        light: Light = AS_THE_SCENE,
        map_pixels: int = 0,
        paths: bool = False,
    ) -> None:
        if any(settings.cut_below_W):
            raise MistrayError("cut_below_W is in watts of a source, and this trace starts from none; use cut_below")
        self.grid, self.settings, self.lists_paths = grid, settings, paths
        self._scene = scene
        # Surfaces at each wavelength, and the paths of the direct image
        wavelengths, shares = spectrum_of(scene, light.wavelength_nm, light.weights)
        self.wavelength_nm, self.weights = tuple(map(float, wavelengths)), tuple(map(float, shares))
        self._tables = traced_tables(scene, self.wavelength_nm, light.detector, settings.stokes)
        self.table = self._tables[0]
        self.intersector = Intersector.of(self.table)
        self.design = design_sequences(scene, *self._tables, free=True)
        self.design_keys = DesignKeys(self.design, self.table.detector)
        self._outside = outer_medium(self.table, scene)
        # Maps with the aspect ratio of the film
        self.area = detector_area(self.table)
        width, height, self.extent = self.table.film()
        columns, rows = (round(map_pixels * side / max(width, height)) for side in (width, height))
        self.map_size = (max(1, columns), max(1, rows)) if map_pixels else (0, 0)

    def with_aims(self, aims: Mapping[Any, Any], backward: bool = False) -> list[Band]:
        """
        Return one `Band` per wavelength, with scattered rays aimed at the given importance targets.

        With `backward` they have the scatter of backward rays, else that of forward ones.
        """
        bands = []
        for table, share in zip(self._tables, self.weights, strict=True):
            scattering = Scattering.of(table, aims, backward)
            closed = closed_media(table, self._outside)
            outside = 0 if closed is None else table.optics.media.index(self._outside)
            bands.append(Band(table, scattering, share, closed, outside))
        return bands

    @property
    def notes(self) -> list[Note]:
        """Notes on gaps too thin for float32 and on assumed media, see `Optics.notes`."""
        return [*thin_gaps(self.table), *dict.fromkeys(text for one in self._tables for text in one.optics.notes)]

    @property
    def facts(self) -> dict[str, Any]:
        """Detector, its area in mm², wavelengths in nm and their weights, as entries for the facts of a result."""
        return {
            "detector": self.table.ids[self.table.detector],
            "detector_area_mm2": self.area,
            "wavelength_nm": list(self.wavelength_nm),
            "weights": list(self.weights),
        }

    def new_paths(self) -> PathSums:
        """Return an empty table of paths and their sums by cell, in device memory."""
        slots = max(FEWEST_SLOTS, 1 << int(SLOTS_OF_RAY * self.settings.rays - 1).bit_length())
        paths, cells = min(slots, PATH_SLOTS), int(np.prod(self.grid.shape))
        # An entry takes 264 bytes
        entries = max(SUMS_OF_PATH * paths, 1 << int(SUMS_OF_CELL * cells - 1).bit_length())
        return PathSums(paths, min(entries, ENTRY_SLOTS), self.settings.max_events, cells)

    def maps(self, found: np.ndarray) -> np.ndarray:
        """Return maps of PST_normal and its standard error, (2, n, m, rows, columns), from `CellSums.by_pixel`."""
        # The map is a rectangle; a round detector does not fill it
        columns, rows = self.map_size
        x0, x1, y0, y1 = self.extent
        value, variance = found.reshape(2, *self.grid.shape, rows, columns)
        return np.asarray(rows * columns * self.area / ((x1 - x0) * (y1 - y0)) * np.stack([value, np.sqrt(variance)]))

    @property
    def fingerprint(self) -> str:
        """Hexadecimal hash of all that the kernel reads: geometry, coatings, media and scatter at every wavelength."""
        return fingerprint((one.table, one.scattering) for one in self.bands)

    def kernel_arrays(self) -> list[list[np.ndarray]]:
        """Return the arrays of geometry, coatings, media and scatter that the kernel reads, for each wavelength."""
        return [kernel_arrays(one.table, one.scattering) for one in self.bands]


class WaveTrace(GridTrace):
    """
    Trace of forward rays alone, from all cells of a grid: all branches are followed, all MIS weights are 1.

    Parameters
    ----------
    scene, grid, settings, light, map_pixels, paths
        See `GridTrace`.
    entrance : Entrance, optional
        Disc to which the start rays are limited; None: they fill the hull.
    points : (p, 3) float64, optional
        Hull of the illuminated volume, from `hull_points`; by default that of the scene.
    """

    def __init__(self, *arguments: Any, entrance: Entrance | None = None, points: np.ndarray | None = None) -> None:
        super().__init__(*arguments)
        points = hull_points(self.table) if points is None else points
        self.waves = CellWaves(points, self.grid, self.table.centre, entrance)
        self.bands = self.with_aims(importance_targets(self.table, self._scene, self.settings))

    def balance(self, number: int) -> None:
        """Return None: without backward rays there are no MIS weights."""

    def forward_scene(self, number: int) -> KernelScene:
        """Return the kernel's scene for forward rays at the wavelength of index `number`, without competing trace."""
        band = self.bands[number]
        return KernelScene(band.table, band.scattering, self.intersector)
