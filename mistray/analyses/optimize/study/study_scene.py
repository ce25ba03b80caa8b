"""Scene of a study: which surfaces get its coatings, and the parameters of the coated scene."""

from __future__ import annotations

import contextlib
import dataclasses
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from mistray.analyses.optimize.study.model import CoatingGroup, DesignStudy
from mistray.analyses.optimize.study.terms import of_layers
from mistray.coatings import METAL_K, Stack
from mistray.errors import MistrayError, errors_of
from mistray.metrics.parameters import Parameter, parameters
from mistray.sampling.sources import scene_sources
from mistray.scene import load
from mistray.scene.recoat import SharedCoating, write_recoated

THIN = 1.01  # index of the medium that counts as air


@dataclass(frozen=True)
class PlacedDesign:
    """
    Coating design of a study and the surfaces of a scene that have it.

    Attributes
    ----------
    group : CoatingGroup
        Coating in the study.
    surfaces : tuple of str
        Ids of shapes.
    glasses : tuple of (str, str)
        Materials in front of and behind these surfaces, each pair once.
    """

    group: CoatingGroup
    surfaces: tuple[str, ...]
    glasses: tuple[tuple[str, str], ...]

    def stack(self, thickness_nm: Sequence[float] | np.ndarray) -> Stack:
        """Return the design with other layer thicknesses, nm, (layers,)."""
        start = self.group.start
        layers = (
            dataclasses.replace(layer, thickness_nm=float(d))
            for layer, d in zip(start.layers, thickness_nm, strict=True)
        )
        return dataclasses.replace(start, layers=tuple(layers))

    def shared(self, thickness_nm: Sequence[float] | np.ndarray) -> SharedCoating:
        """Return the design with other layer thicknesses, nm, (layers,), in the form for `mistray.scene.recoat`."""
        return SharedCoating(self.group.name, self.stack(thickness_nm), self.surfaces, self.group.design_nm)


def band(scene: Any, study: DesignStudy) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """
    Return the wavelengths for which coatings are made, nm, ascending, and their fractions of the flux.

    They are the wavelengths of the first traced term that is to be minimised, or else of the first traced term. If it
    names none, they are those of the scene's sources.
    """
    terms = [term for term in study.terms if not of_layers(term)]
    traced = next((term for term in terms if term.goal == "minimise"), terms[0]).traced
    sources = scene_sources(scene, wavelength_nm=traced.get("wavelength_nm"), weights=traced.get("weights"))
    wavelengths = np.unique([source.wavelength_nm for source in sources])
    powers = np.array([sum(b.power for b in sources if b.wavelength_nm == nm) for nm in wavelengths])
    return tuple(float(nm) for nm in wavelengths), tuple(float(share) for share in powers / powers.sum())


def place(scene: Any, study: DesignStudy) -> tuple[PlacedDesign, ...]:
    """
    Return each coating of a study with the surfaces of the scene that it covers.

    Raises
    ------
    MistrayError
        If a surface does not exist, is opaque, a mirror or a metal, or is in two groups, if "all" finds none, or if a
        material of a layer is not known at all wavelengths.
    """
    if not study.coatings:
        return ()
    wavelengths = {nm for term in study.terms for nm in term.traced.get("wavelength_nm") or ()}
    wavelengths |= set(band(scene, study)[0])
    nm = min(wavelengths)
    shapes = {shape.id(): shape for shape in scene.shapes()}
    clear = {name: shape for name, shape in shapes.items() if _is_clear(shape.bsdf(), nm)}
    lenses = [name for name, shape in clear.items() if _meets_air(shape, nm)]
    owner: dict[str, str] = {}
    placed = []
    for group in study.coatings:
        where = f"study '{study.name}', coating '{group.name}'"
        if group.surfaces is None and not lenses:
            raise MistrayError(f'{where}: surfaces = "all" finds no transparent surface in air; name the surfaces')
        with errors_of(where):
            for wavelength in sorted(wavelengths):
                group.start.indices(wavelength)
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
        placed.append(PlacedDesign(group, surfaces, tuple(dict.fromkeys((bsdf.front, bsdf.back) for bsdf in sides))))
    return tuple(placed)


def _is_clear(bsdf: Any, wavelength_nm: float) -> bool:
    """True if an interface transmits light at a wavelength, nm: it is not opaque, not a mirror and not a metal."""
    if not hasattr(bsdf, "coating") or bsdf.opaque or bsdf.mirror:
        return False
    return max(n.imag for n in bsdf.complex_indices(wavelength_nm)) <= METAL_K


def _meets_air(shape: Any, wavelength_nm: float) -> bool:
    """True if a shape lies between air and a denser medium at a wavelength, nm, and is not an edge or a bevel."""
    low, high = sorted(shape.bsdf().indices(wavelength_nm))
    return not getattr(shape, "mechanics", False) and low < THIN < high


@dataclass(frozen=True)
class StudyScene:
    """
    Scene with the start designs of a study's coatings on it.

    Attributes
    ----------
    scene : mi.Scene
        Loaded scene.
    params : mi.SceneParameters
        Parameters of the scene, ``mi.traverse(scene)``.
    known : dict of str to Parameter
        Parameters that can be differentiated, by key.
    thickness_keys : dict of str to str
        Name of a coating → key of its thicknesses.
    """

    scene: Any
    params: Any
    known: dict[str, Parameter]
    thickness_keys: dict[str, str]


@contextlib.contextmanager
def open_scene(source: Path, placed: Sequence[PlacedDesign]) -> Iterator[StudyScene]:
    """
    Yield the scene of a file with the start designs of coatings on it.

    It can be used only within the block: with coatings it comes from a file in a temporary folder, and it may load the
    files of its materials later.
    """
    with tempfile.TemporaryDirectory() as folder:
        if placed:
            start = [item.shared([layer.thickness_nm for layer in item.group.start.layers]) for item in placed]
            source = write_recoated(source, start, Path(folder) / "scene.xml")
        scene = load(source)
        params = mi.traverse(scene)
        known = parameters(scene, params)
        films = {shape.id(): shape.bsdf().film for shape in scene.shapes() if hasattr(shape.bsdf(), "film")}
        nodes = {id(p.owner): key for key, p in known.items() if p.name == "thickness_nm"}
        keys = {item.group.name: nodes[id(films[item.surfaces[0]])] for item in placed}
        yield StudyScene(scene, params, known, keys)
