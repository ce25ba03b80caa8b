"""The coatings of a study on the surfaces of a scene: which surfaces they are, and how their thicknesses are set."""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from mistray.coatings import METAL_K, Stack
from mistray.errors import MistrayError
from mistray.optimize.gradient import parameter_owners
from mistray.optimize.study import CoatingGroup, MetricStudy, Study
from mistray.scene import load
from mistray.scene.recoat import SharedCoating, write_recoated
from mistray.trace.sources import beams

THIN = 1.01  # index of the medium that counts as air


@dataclass(frozen=True)
class Placed:
    """
    A design and the surfaces of a scene that have it.

    Attributes
    ----------
    group : CoatingGroup
    surfaces : tuple of str
        Ids of shapes.
    glasses : tuple of (str, str)
        Materials in front and behind, each pair once.
    """

    group: CoatingGroup
    surfaces: tuple[str, ...]
    glasses: tuple[tuple[str, str], ...]

    def stack(self, thickness_nm: Sequence[float] | np.ndarray) -> Stack:
        """The design with other thicknesses, nm."""
        start = self.group.start
        layers = (
            dataclasses.replace(layer, thickness_nm=float(d))
            for layer, d in zip(start.layers, thickness_nm, strict=True)
        )
        return dataclasses.replace(start, layers=tuple(layers))

    def shared(self, thickness_nm: Sequence[float] | np.ndarray) -> SharedCoating:
        """The design with other thicknesses, as `mistray.scene.recoat` takes it."""
        return SharedCoating(self.group.name, self.stack(thickness_nm), self.surfaces, self.group.design_nm)


@dataclass(frozen=True)
class Design:
    """
    Thicknesses of all coatings of a study.

    Attributes
    ----------
    name : str
        Where it comes from.
    thickness_nm : dict
        Name of the coating → (layers,) float64, nm.
    """

    name: str
    thickness_nm: dict[str, np.ndarray]


def spectrum(scene: Any, study: MetricStudy) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Wavelengths (nm, ascending) and their shares of the flux: those of the study, or else of the scene's sources."""
    sources = beams(scene, wavelength_nm=study.wavelength_nm, weights=study.weights)
    wavelengths = np.unique([beam.wavelength_nm for beam in sources])
    powers = np.array([sum(b.power for b in sources if b.wavelength_nm == nm) for nm in wavelengths])
    return tuple(float(nm) for nm in wavelengths), tuple(float(share) for share in powers / powers.sum())


def place(scene: Any, study: Study) -> tuple[Placed, ...]:
    """
    Find the surfaces of each coating of a study.

    Raises
    ------
    MistrayError
        If a surface does not exist, is opaque or is in two groups, "all" finds none, or a material of a layer is not
        known over the band.
    """
    band = spectrum(scene, study.metric)[0]
    nm = band[0]
    shapes = {shape.id(): shape for shape in scene.shapes()}
    clear = {name: shape for name, shape in shapes.items() if _is_clear(shape.bsdf(), nm)}
    lenses = [name for name, shape in clear.items() if _meets_air(shape, nm)]
    owner: dict[str, str] = {}
    placed = []
    for group in study.coatings:
        where = f"study '{study.name}', coating '{group.name}'"
        if group.surfaces is None and not lenses:
            raise MistrayError(f'{where}: surfaces = "all" finds no transparent surface in air; name the surfaces')
        try:
            for wavelength in band:
                group.start.indices(wavelength)
        except MistrayError as error:
            raise MistrayError(f"{where}: {error}") from None
        surfaces = tuple(lenses) if group.surfaces is None else group.surfaces
        for name in surfaces:
            if name not in shapes:
                raise MistrayError(f"{where}: the scene has no surface '{name}'; choose from {', '.join(clear)}")
            if name not in clear:
                raise MistrayError(f"{where}: surface '{name}' is opaque or a mirror; choose from {', '.join(clear)}")
            if name in owner:
                raise MistrayError(
                    f"{where}: surface '{name}' has the coating '{owner[name]}' already; a surface is in one group"
                )
            owner[name] = group.name
        sides = (shapes[name].bsdf() for name in surfaces)
        placed.append(Placed(group, surfaces, tuple(dict.fromkeys((bsdf.front, bsdf.back) for bsdf in sides))))
    return tuple(placed)


def _is_clear(bsdf: Any, wavelength_nm: float) -> bool:
    """Whether light gets through an interface."""
    if not hasattr(bsdf, "coating") or bsdf.opaque or bsdf.mirror:
        return False
    return max(n.imag for n in bsdf.complex_indices(wavelength_nm)) <= METAL_K


def _meets_air(shape: Any, wavelength_nm: float) -> bool:
    """Whether this is an optical surface, no edge or bevel, with air on one side and something denser on the other."""
    low, high = sorted(shape.bsdf().indices(wavelength_nm))
    return getattr(shape, "kind", None) != "frustum" and low < THIN < high


class CoatedScene:
    """
    A scene with the coatings of a study, whose thicknesses can be changed.

    Parameters
    ----------
    source : Path
        Scene XML file.
    placed : sequence of Placed

    Attributes
    ----------
    scene : mi.Scene
    params : mi.SceneParameters
        The thicknesses alone.
    keys : dict
        Name of the coating → key of its thicknesses in `params`.
    """

    def __init__(self, source: Path, placed: Sequence[Placed]) -> None:
        self.placed = tuple(placed)
        start = [item.shared([layer.thickness_nm for layer in item.group.start.layers]) for item in placed]
        with tempfile.TemporaryDirectory() as folder:
            self.scene = load(write_recoated(source, start, Path(folder) / "scene.xml"))
        self.params = mi.traverse(self.scene)
        films = {shape.id(): shape.bsdf().film for shape in self.scene.shapes() if hasattr(shape.bsdf(), "film")}
        owners = parameter_owners(self.params)
        nodes = {owner: key for key, (owner, name) in owners.items() if name == "thickness_nm"}
        self.keys = {item.group.name: nodes[id(films[item.surfaces[0]])] for item in placed}
        self.params.keep(list(self.keys.values()))

    def apply(self, thickness_nm: dict[str, np.ndarray]) -> None:
        """Set the thicknesses, by name of the coating, nm."""
        for name, key in self.keys.items():
            self.params[key] = mi.Float(np.asarray(thickness_nm[name], dtype=np.float32))
        self.params.update()
