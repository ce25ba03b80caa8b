"""Lens files as optiland and ray-optics read them; as a script it writes the two tables of tests/data about them.

All lengths are in mm. Rays start 10 mm in front of the first vertex, in the frame of the first surface before its
decentre, and end in the frame of the image surface.
"""

import contextlib
import csv
import logging
import math
import re
import shutil
import tempfile
import warnings
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import peers

from mistray.errors import MistrayError
from mistray.materials.agf import decode
from mistray.prescription import Sequential, read_codev, read_zemax
from mistray.prescription.sequential.edge_rays import launch
from mistray.prescription.sequential.first_order import first_order

DATA = Path(__file__).parent / "data"
FIRST_ORDER, RAYS, OWN = DATA / "lens_files.csv", DATA / "lens_file_rays.csv", DATA / "lenses"
PEERS = ("optiland", "rayoptics")
NUMBERS = ("wavelength_nm", "efl", "bfl")
START = 10.0
PUPIL = ((0.0, 0.0), (0.0, 0.7), (0.5, -0.4))  # points of the rays of a field, in radii of the entrance pupil


@dataclass
class Lens(ABC):
    """A lens as another program has read it, in mm; first-order data at its reference wavelength."""

    model: Any
    unit: float
    wavelength_nm: float
    efl: float
    bfl: float

    @abstractmethod
    def trace(self, position: np.ndarray, direction: np.ndarray, wavelength_nm: float) -> np.ndarray:
        """(x, y, z, L, M, N) in the frame of the image, of a ray given in that of the first surface."""


def files() -> dict[str, Path]:
    """Lens files of the packages that are installed and of the tests, by package and path; nothing is imported."""
    specs = {package: find_spec(package) for package in PEERS}
    roots = [(name, root) for name, spec in specs.items() if spec for root in spec.submodule_search_locations or []]
    found: dict[str, Path] = {}
    for name, root in (*roots, ("tests", OWN)):
        for file in sorted(Path(root).rglob("*")):
            if file.suffix.lower() in (".zmx", ".seq"):
                found[f"{name}/{file.relative_to(root).as_posix()}"] = file
    return found


def read(path: Path) -> Sequential:
    return read_codev(path) if path.suffix.lower() == ".seq" else read_zemax(path)


def unit_mm(path: Path) -> float:
    """The unit of length of a file, by its DIM or UNIT line."""
    found = re.search(r"^\s*(?:DIM|UNIT)\s+(\w)", decode(path.read_bytes()), re.MULTILINE | re.IGNORECASE)
    return {"M": 1.0, "C": 10.0, "I": 25.4}[found[1].upper()] if found else 1.0


class ByRayOptics(Lens):
    def trace(self, position: np.ndarray, direction: np.ndarray, wavelength_nm: float) -> np.ndarray:
        raytrace = peers.rayoptics("raytr.raytrace")
        sequence = self.model["seq_model"]
        sequence.gaps[0].thi = START
        sequence.lcl_tfrms = sequence.compute_local_transforms()
        start = position / self.unit + np.array([0.0, 0.0, START])
        same = min(sequence.wvlns, key=lambda value: abs(value - wavelength_nm))  # it looks its wavelengths up
        if abs(same - wavelength_nm) > 1e-6:
            return np.full(6, np.nan)
        point, heading, *_ = raytrace.trace(sequence, start, direction, same)[0][-1]
        return np.concatenate([np.asarray(point, dtype=float) * self.unit, np.asarray(heading, dtype=float)])


class ByOptiland(Lens):
    def trace(self, position: np.ndarray, direction: np.ndarray, wavelength_nm: float) -> np.ndarray:
        surfaces = list(self.model.surfaces)
        first = float(np.ravel(surfaces[1].geometry.cs.z)[0])
        x, y, z = position / self.unit
        rays = peers.optiland("rays").RealRays(x, y, z + first, *direction, 1.0, wavelength_nm / 1e3)
        self.model.surfaces.trace(rays)
        shift, turn = surfaces[-1].geometry.cs.get_effective_transform()
        end = np.array([float(np.ravel(getattr(rays, key))[0]) for key in "xyzLMN"])
        turn, shift = np.asarray(turn, dtype=float).reshape(3, 3), np.ravel(np.asarray(shift, dtype=float))
        return np.concatenate([(end[:3] - shift) @ turn * self.unit, end[3:] @ turn])


def by_rayoptics(path: Path) -> ByRayOptics:
    """A lens file by ray-optics; whatever it raises."""
    with _quietly(), _copy(path) as copy:
        cmdproc, zmxread = peers.rayoptics("codev.cmdproc"), peers.rayoptics("zemax.zmxread")
        for module in (cmdproc, zmxread):
            logger = logging.getLogger(module.__name__)
            logger.handlers.clear()  # they write files
            logger.setLevel(logging.ERROR)
        model, _ = cmdproc.read_lens(copy) if path.suffix.lower() == ".seq" else zmxread.read_lens_file(copy)
    unit, sequence, specs = unit_mm(path), model["seq_model"], model["optical_spec"]
    data = model["analysis_results"]["parax_data"].fod
    ahead = sequence.z_dir[-1]  # it counts along z: behind an odd number of mirrors light goes the other way
    efl, bfl = (math.inf if abs(data.power) < 1e-12 else float(ahead * f) * unit for f in (data.efl, data.bfl))
    sequence.gaps[-1].thi += specs["focus"].focus_shift  # the defocus of CODE V, which it keeps apart
    wavelength = float(specs["wvls"].wavelengths[specs["wvls"].reference_wvl])
    return ByRayOptics(model, unit, wavelength, efl, bfl)


def by_optiland(path: Path) -> ByOptiland:
    """A lens file by optiland; whatever it raises."""
    with _quietly(), _copy(path) as copy:
        fileio = peers.optiland("fileio")
        load = fileio.load_codev_file if path.suffix.lower() == ".seq" else fileio.load_zemax_file
        optic = load(str(copy))
    unit = unit_mm(path)
    surfaces = list(optic.surfaces)
    z = float(np.ravel(surfaces[1].geometry.cs.z)[0])
    wavelength = 1e3 * float(np.ravel(optic.primary_wavelength)[0])
    try:
        with _quietly():
            y, u = map(np.ravel, optic.paraxial.trace_generic(1.0, 0.0, z - 1.0, optic.primary_wavelength))
    except ValueError:  # folded lenses are outside of its first order; rays are not
        return ByOptiland(optic, unit, wavelength, math.nan, math.nan)
    if abs(u[-1]) < 1e-12:
        return ByOptiland(optic, unit, wavelength, math.inf, math.inf)
    # Slopes are dy/dz there: behind an odd number of mirrors light goes the other way
    ahead = (-1) ** sum(bool(surface.interaction_model.is_reflective) for surface in surfaces[1:-1])
    return ByOptiland(optic, unit, wavelength, float(-ahead / u[-1]) * unit, float(-ahead * y[-2] / u[-1]) * unit)


def peer(program: str, path: Path) -> tuple[Lens | None, str]:
    """A lens file by another program, and the kind of its failure instead."""
    try:
        return {"optiland": by_optiland, "rayoptics": by_rayoptics}[program](path), ""
    except Exception as error:  # whatever they raise is a refusal
        return None, type(error).__name__


def end_of_ray(lens: Lens, position: np.ndarray, direction: np.ndarray, wavelength_nm: float) -> np.ndarray:
    """(6,) end of a ray; NaN where the program fails."""
    try:
        with _quietly():
            return lens.trace(position, direction, wavelength_nm)
    except Exception:  # whatever they raise means that there is no such ray
        return np.full(6, np.nan)


def starts(lens: Sequential) -> tuple[np.ndarray, np.ndarray]:
    """Positions, mm, and directions, each (n_fields, 3, 3), in the world of `mistray.prescription.sequential.rays`."""
    data = first_order(lens)
    positions, directions = (
        np.array(rays) for rays in zip(*(launch(lens, data, f, PUPIL) for f in lens.fields), strict=True)
    )
    directions *= np.copysign(1.0, directions[..., 2:])
    return positions + (-START - positions[..., 2:]) / directions[..., 2:] * directions, directions


@contextlib.contextmanager
def _quietly() -> Iterator[None]:
    with warnings.catch_warnings(), contextlib.redirect_stdout(None):
        warnings.simplefilter("ignore")
        yield


@contextlib.contextmanager
def _copy(path: Path) -> Iterator[Path]:
    """A copy in a folder of its own, which is also the current one: ray-optics writes beside the files it reads."""
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        yield Path(shutil.copy(path, folder))


def main() -> None:
    summary, rays = [], []
    for name, path in files().items():
        lenses = {program: peer(program, path) for program in PEERS}
        row: dict[str, Any] = {"file": name}
        try:
            ours: Sequential | None = read(path)
        except MistrayError as error:
            ours = None
            row["mistray"] = "refused"
            print(f"{name}: {error}")
        else:
            row["mistray"] = "read"
        for program, (lens, failure) in lenses.items():
            row |= {f"{program}_failure": failure}
            row |= {f"{program}_{key}": "" if lens is None else repr(getattr(lens, key)) for key in NUMBERS}
        summary.append(row)
        if ours is None:
            continue
        wavelength = ours.wavelength_nm
        for field, (positions, directions) in enumerate(zip(*starts(ours), strict=True)):
            for number, (position, direction) in enumerate(zip(positions, directions, strict=True)):
                line: dict[str, Any] = {"file": name, "field": field, "ray": number, "wavelength_nm": wavelength}
                line |= dict(zip(("x", "y", "z", "L", "M", "N"), (*position, *direction), strict=True))
                for program, (lens, _) in lenses.items():
                    end = np.full(6, np.nan) if lens is None else end_of_ray(lens, position, direction, wavelength)
                    line |= {f"{program}_{key}": float(value) for key, value in zip("xyzLMN", end, strict=True)}
                rays.append(line)
    for table, lines in ((FIRST_ORDER, summary), (RAYS, rays)):
        with table.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, list(lines[0]), lineterminator="\n")
            writer.writeheader()
            writer.writerows(lines)


if __name__ == "__main__":
    main()
