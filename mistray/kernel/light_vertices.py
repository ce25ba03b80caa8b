"""
Light vertex cache: points where light of distant sources is first scattered, to which backward rays are connected.

Forward rays from all cells of directions follow specular paths through mirrors and lenses. Each hit of a surface that
scatters is a light vertex. A backward ray that is sent there, and from there back along the incident light, finds paths
that neither direction finds by itself. On these paths light is scattered twice, and passes a gap between both events
(E. Veach, Robust Monte Carlo methods for light transport simulation, 1997, chapter 10; T. Davidovič et al., Progressive
light transport simulation on the GPU, ACM Trans. Graph. 33, 29 (2014)).
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.events import RANDOM_TRANSMITTED, kind_of
from mistray.recorders.path_key import FIRST_KEY, extend_key
from mistray.recorders.recorder import Departure, Memory, Recorder, Visit
from mistray.settings import BATCHES
from mistray.surfaces.upload import upload

ROUNDING = 2e-5  # of the scene's extent: largest distance of a light vertex from the hit of its connection


class LightVertexRecorder(Recorder):
    """
    Recorder of light vertices: hits of surfaces that scatter, in a forward trace of specular paths.

    Parameters
    ----------
    room : int
        Largest number of light vertices that are kept; those beyond it are only counted.
    """

    def __init__(self, room: int) -> None:
        self.room, self._most = room, dr.opaque(mi.UInt32, room)  # opaque, so that it makes no new kernel
        self._count = dr.zeros(mi.UInt32, 1)
        self._words = [dr.zeros(mi.UInt32, room) for _ in range(4)]
        self._floats = [dr.zeros(mi.Float, room) for _ in range(6)]
        self._keys = dr.zeros(mi.UInt64, room)
        dr.make_opaque(self._count, self._words, self._floats, self._keys)

    @property
    def count(self) -> int:
        """Number of light vertices found so far, including those beyond `room`, which are not stored."""
        return int(self._count[0])

    def visit(self, visit: Visit, memory: Memory) -> None:
        """
        Record a light vertex for each active ray with flux that meets a scattering surface.

        Beyond `room` it is only counted. Without any scattering surface nothing is recorded.
        """
        if visit.shares is None:
            return
        start = visit.start
        assert start.cell is not None
        active = visit.active & (visit.shares.scattered > 0) & (visit.weight > 0)
        # Append; what finds no room is counted only
        place = dr.scatter_inc(self._count, mi.UInt32(0), active)
        active &= place < self._most
        words = (start.batch, start.lane, start.cell, visit.surface)
        floats = (*visit.interaction.p, *visit.state["d"])
        dr.scatter(self._keys, visit.state["key"], place, active)
        for array, value in zip((*self._words, *self._floats), (*words, *floats), strict=True):
            dr.scatter(array, value, place, active)

    def read(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """
        Return the light vertices on the host, in a reproducible order.

        Returns
        -------
        words : (4, n) int64
            Indices of the batch, the start ray, the cell of directions and the surface of each vertex.
        numbers : (6, n) float32
            Position (mm, in the device's frame) and unit direction of the light that arrives.
        keys : (n,) uint64
            Keys of the paths from the starts to the light vertices, see `mistray.recorders.path_key.extend_key`.
        """
        count = self.count
        assert count <= self.room
        words = np.array([np.array(array)[:count] for array in self._words]).astype(np.int64)
        numbers = np.array([np.array(array)[:count] for array in self._floats])
        keys = np.array(self._keys)[:count]
        # Lanes append in any order: sort by batch, start ray, cell, surface and position
        order = np.lexsort((*numbers, *words[:0:-1], words[0]))
        return words[:, order], numbers[:, order], keys[order]


class LightVertices:
    """
    Light vertices on the device, sorted by batch, to which backward rays are connected.

    Parameters
    ----------
    words, numbers, keys : np.ndarray
        See `LightVertexRecorder.read`.
    starts_per_connection : (c,) float64
        Number of start rays of each cell per connection, see `mistray.sampling.sharing.mis_weights.Sharing`.
    lanes : (c,) int
        Number of forward start rays of each cell.
    extent : float
        Extent of the scene, mm.
    """

    def __init__(
        self,
        words: np.ndarray,
        numbers: np.ndarray,
        keys: np.ndarray,
        starts_per_connection: np.ndarray,
        lanes: np.ndarray,
        extent: float,
    ) -> None:
        # Range of the light vertices of each batch
        batch, _, cell, surface = words
        of_batch = np.bincount(batch, minlength=BATCHES)
        self._first = upload(mi.UInt32, np.cumsum(of_batch) - of_batch)
        self._of_batch = upload(mi.UInt32, of_batch)
        # Each of the m light vertices of a batch is picked with the probability 1/m. MIS weights assume the density of
        # `starts_per_connection` start rays for each connection, and the cell has lanes/BATCHES start rays in the batch
        factor = starts_per_connection[cell] * of_batch[batch] / np.maximum(lanes[cell] / BATCHES, 1)

        def rows(*columns: np.ndarray) -> mi.Float:
            table = np.zeros((len(batch) + 1, 4))  # never empty
            for k, column in enumerate(columns):
                table[:-1, k] = column
            return upload(mi.Float, table.ravel())

        self._points, self._headings = rows(*numbers[:3], factor), rows(*numbers[3:6], surface)
        self._cell = upload(mi.UInt32, np.append(cell, 0))
        self._keys = upload(mi.UInt64, np.append(keys, np.uint64(0)))
        self._slack = dr.opaque(mi.Float, ROUNDING * extent)

    def pick(self, batch: mi.UInt32, u: mi.Float) -> tuple[mi.UInt32, mi.Float]:
        """
        Return the index of a random light vertex of each batch, and the throughput factor of the choice.

        `u` is a random number, uniform in 0 … 1. Index and factor are 0 for a batch without light vertices.
        """
        # Uniform among the light vertices of the batch
        first, count = (dr.gather(mi.UInt32, array, batch) for array in (self._first, self._of_batch))
        there = count > 0
        number = first + dr.minimum(mi.UInt32(u * mi.Float(count)), dr.maximum(count, 1) - 1)
        number = dr.select(there, number, 0)
        return number, dr.select(there, dr.gather(mi.Float, self._points, 4 * number + 3, there), 0)

    def point(self, number: mi.UInt32, active: mi.Bool) -> mi.Vector3f:
        """Return the positions of light vertices, given their indices, in the device's frame, mm."""
        return dr.gather(mi.Vector4f, self._points, number, active).xyz

    def heading(self, number: mi.UInt32, active: mi.Bool) -> mi.Vector3f:
        """Return the unit directions along which light arrives at light vertices, given their indices."""
        return dr.gather(mi.Vector4f, self._headings, number, active).xyz

    def meets(self, number: mi.UInt32, s: mi.UInt32, p: mi.Vector3f, active: mi.Bool) -> mi.Bool:
        """
        Return a mask of rays that reach the light vertex they were sent to: they hit its surface, s, close to it.

        `p` is the point of the hit, mm. Its distance from the vertex must be within rounding.
        """
        row = dr.gather(mi.Vector4f, self._headings, number, active)
        apart = dr.norm(p - self.point(number, active))
        return active & (mi.UInt32(row.w) == s) & (apart < self._slack)

    def comes_from(self, number: mi.UInt32, departure: Departure, cell: mi.UInt32, active: mi.Bool) -> mi.Bool:
        """
        Return a mask of connected rays that leave within the vertex's own cell, by the path on which light came to it.

        `number` is the index of each ray's vertex, and `cell` the cell of directions in which the ray leaves the scene.
        """

        # The key of the path from the start to the light vertex: from the last event back to the first scatter event
        def back(k: mi.UInt32, key: mi.UInt64, going: mi.Bool) -> tuple[mi.UInt32, mi.UInt64, mi.Bool]:
            code = departure.event(k - 1, going)
            going = going & (kind_of(code) < RANDOM_TRANSMITTED)
            return k - 1, dr.select(going, extend_key(key, code), key), going & (k > 1)

        width = dr.width(number)
        going = active & (departure.length > 0)
        _, key, _ = dr.while_loop(
            (mi.UInt32(departure.length), dr.full(mi.UInt64, FIRST_KEY, width), going),
            lambda k, key, going: going,
            back,
            mode="symbolic",
            label="way of the light",
        )
        # Light of one cell may reach a surface by several paths, and by the same path from several cells
        same = dr.gather(mi.UInt32, self._cell, number, active) == cell
        return active & same & (dr.gather(mi.UInt64, self._keys, number, active) == key)
