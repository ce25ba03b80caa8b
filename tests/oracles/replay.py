"""Sequential replay: rays through a prescribed list of events, in float64."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .geometry import Array, Mask
from .glass import absorption_per_mm, refractive_index
from .interface import interact
from .scene_xml import SceneModel

Event = tuple[str, str]
SPECULAR = {"SpecTran": "T", "SpecRefl": "R", "TIR": "I", "Absorbed": "A"}
KINDS = {**SPECULAR, "T": "T", "R": "R", "A": "A"}
LETTERS = {**SPECULAR, "RandTran": "t", "RandRefl": "r", "ImpTran": "i", "ImpRefl": "j"}
OUTCOMES = ("reached the end", "missed the surface", "blocked by another", "total internal reflection", "no TIR here")


@dataclass(frozen=True)
class Replay:
    """Points (k + 1, n, 3), directions (k, n, 3), flux, optical path, and which event failed why; NaN from there on."""

    points: Array
    directions: Array
    flux: Array
    opl_mm: Array
    valid: Mask
    outcome: np.ndarray
    failed_at: np.ndarray

    end = property(lambda self: self.points[-1])

    def summary(self) -> str:
        return ", ".join(
            f"{np.sum(self.outcome == i)} {name}" for i, name in enumerate(OUTCOMES) if np.any(self.outcome == i)
        )


def path_text(events: Sequence[Event]) -> str:
    """Events as a row of a path table has them, random and aimed scatter in letters of their own."""
    return " ".join(f"{shape_id}:{LETTERS[name]}" for shape_id, name in events)


def replay(
    model: SceneModel,
    origin: Array,
    direction: Array,
    events: Sequence[Event],
    wavelength_nm: float,
    *,
    first_hit: bool = True,
    start_material: str = "air",
    tolerance_mm: float = 1e-9,
) -> Replay:
    """Rays through events [(shape id, "SpecTran" | "SpecRefl" | "TIR" | "Absorbed"), …]; with ``first_hit`` none is
    valid that another surface stops. "SpecRefl" accepts total reflection, "TIR" demands it."""
    position = np.array(origin, dtype=np.float64)
    heading = np.array(direction, dtype=np.float64)
    heading /= np.linalg.norm(heading, axis=1, keepdims=True)
    n = len(position)
    flux, opl = np.ones(n), np.zeros(n)
    outcome, failed_at = np.zeros(n, dtype=int), np.full(n, -1)
    points, directions = [position.copy()], []
    medium = np.full(n, refractive_index(start_material, wavelength_nm))
    absorption = np.full(n, absorption_per_mm(start_material, wavelength_nm))
    last: str | None = None

    def fail(mask: Mask, code: int, step: int) -> None:
        new = mask & (outcome == 0)
        outcome[new], failed_at[new] = code, step

    for step, (shape_id, name) in enumerate(events):
        shape, kind = model.by_id[shape_id], KINDS[name]
        alive = np.flatnonzero(outcome == 0)
        o, d = position[alive], heading[alive]
        t = shape.first_hit(o, d, np.full(len(alive), last == shape_id))
        missed = np.zeros(n, dtype=bool)
        missed[alive] = ~np.isfinite(t)
        fail(missed, 1, step)
        if first_hit:
            blocked = np.zeros(n, dtype=bool)
            for other in model.shapes:
                if other.shape_id != shape_id:
                    other_t = other.first_hit(o, d, np.full(len(alive), last == other.shape_id))
                    blocked[alive] |= other_t < np.where(np.isfinite(t), t, np.inf) - tolerance_mm
            fail(blocked, 2, step)
        directions.append(np.where((outcome == 0)[:, None], heading, np.nan))
        length = np.zeros(n)
        length[alive] = np.where(np.isfinite(t), t, 0.0)
        opl += medium * length
        flux *= np.exp(-absorption * length)
        position = position + length[:, None] * heading
        good = np.flatnonzero(outcome == 0)
        n_front, n_back = model.indices(shape_id, wavelength_nm)
        hit = interact(shape.interface, n_front, n_back, wavelength_nm, heading[good], shape.normal(position[good]))
        tir = np.zeros(n, dtype=bool)
        tir[good] = hit.tir
        if kind == "T":
            fail(tir, 3, step)
            flux[good] *= hit.transmittance
            heading[good] = hit.transmitted
            if not shape.interface.opaque:
                medium[good] = np.where(hit.from_front, n_back, n_front)
                media = shape.interface.front, shape.interface.back
                front, back = (absorption_per_mm(m, wavelength_nm) for m in media)
                absorption[good] = np.where(hit.from_front, back, front)
        elif kind == "A":
            flux[good] *= 1 - hit.reflectance - hit.transmittance
        else:
            if kind == "I":
                fail(~tir & (outcome == 0), 4, step)
            flux[good] *= hit.reflectance
            heading[good] = hit.reflected
        points.append(np.where((outcome == 0)[:, None], position, np.nan))
        last = shape_id
    valid = outcome == 0
    flux, opl = np.where(valid, flux, 0.0), np.where(valid, opl, np.nan)
    return Replay(np.array(points), np.array(directions), flux, opl, valid, outcome, failed_at)
