"""Coatings made of homogeneous layers, and their form as text."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from mistray.coatings.response import METAL_K, Response, layered_response
from mistray.errors import MistrayError, errors_of
from mistray.materials import complex_index, nearest_known_nm, resolved
from mistray.named_values import finite_of
from mistray.ranges import INDEX_SHIFT, LAYER_NM, OfType, Several, check_fields, several

SIDES = ("outside", "front", "back")
# Differentiable parameters of a layer, named as in `thinfilm`; n_shift and k_shift are `Layer` attributes as well
LAYER_PARAMETERS = ("thickness_nm", "n_shift", "k_shift")
LAYER_FORM = "write 'material thickness' with the thickness in nm (99.64) or in waves (0.25w)"


@dataclass(frozen=True)
class Layer:
    """
    Homogeneous layer of a coating: material and thickness.

    Attributes
    ----------
    material : str
        Name of the material, see `mistray.materials`; its k must be known.
    thickness_nm : float
        Geometrical thickness, nm, ≥ 0.
    n_shift, k_shift : float
        Shifts added to n and k of the material at every wavelength: N = n + n_shift + i (k + k_shift).

    Examples
    --------
    >>> layer = mistray.coatings.Layer("MgF2", 99.4)
    >>> n = layer.index(550.0).real
    >>> print(f"{n:.3f}, {n * layer.thickness_nm / 550:.3f} waves")
    1.384, 0.250 waves
    """

    material: str
    thickness_nm: float = LAYER_NM.field()
    n_shift: float = INDEX_SHIFT.field(0.0)
    k_shift: float = INDEX_SHIFT.field(0.0)

    def index(self, wavelength_nm: float) -> complex:
        """Return the index N = n + ik of the layer at a vacuum wavelength, nm, with its shifts added."""
        return complex_index(self.material, wavelength_nm) + complex(self.n_shift, self.k_shift)


@dataclass(frozen=True)
class Stack:
    """
    Coating made of homogeneous layers.

    Attributes
    ----------
    layers : tuple of Layer
        Layers in the coating's own order, which `first` relates to the surface; may be empty.
    first : {"outside", "front", "back"}
        Position of the first layer. "outside", the convention of coating houses, is the side of the medium of lower
        index. A metal counts as the substrate. With equal indices the front is outside, but for light from the back the
        back if the coating is `opaque`: a mirror turns its layers to the light. "front" and "back" are those of the
        surface.
    name : str
        Name for messages and titles.
    opaque : bool
        Whether T = 0 for all media, as for mirror coatings with a thick layer of metal.

    Raises
    ------
    MistrayError
        If `first` is unknown, a thickness is negative, or a value of a layer is not finite.

    Examples
    --------
    >>> quarter_wave = mistray.coatings.Stack((mistray.coatings.Layer("MgF2", 99.4),))
    >>> found = mistray.coatings.spectrum(quarter_wave, [550], [0], back="N-BK7")
    >>> print(f"R = {found.R.mean():.2%}")
    R = 1.33%
    """

    layers: tuple[Layer, ...] = Several(OfType(Layer, "must be a mistray.coatings.Layer, or several"), least=0).field()
    first: str = "outside"
    name: str = ""
    opaque: bool = False

    def __post_init__(self) -> None:
        check_fields(self, str(self))
        if self.first not in SIDES:
            raise MistrayError(f"{self}: first = '{self.first}'; it is {', '.join(SIDES[:-1])} or {SIDES[-1]}")
        for number, layer in enumerate(self.layers, start=1):
            check_fields(layer, f"{self}, layer {number} ({layer.material})")

    def __str__(self) -> str:
        return f"coating '{self.name}'" if self.name else "coating"

    def indices(self, wavelength_nm: float, nearest: bool = False) -> tuple[complex, ...]:
        """
        Return the indices N = n + ik of the layers in the coating's own order.

        Parameters
        ----------
        wavelength_nm : float
            Vacuum wavelength, nm.
        nearest : bool
            Whether each layer is evaluated at the nearest wavelength at which its material is known.

        Raises
        ------
        MistrayError
            If a material is unknown at the wavelength, or a shift leads to n ≤ 0 or k < 0.
        """
        result = []
        for number, layer in enumerate(self.layers, start=1):
            with errors_of(f"{self}, layer {number}"):
                at = nearest_known_nm(layer.material, wavelength_nm, with_k=True) if nearest else wavelength_nm
                index = layer.index(at)
            if not (index.real > 0 and index.imag >= 0):
                raise MistrayError(
                    f"{self}, layer {number} ({layer.material}): n = {index.real:g}, k = {index.imag:g} at "
                    f"{at:g} nm; n must be greater than 0 and k 0 or greater, change n_shift or k_shift"
                )
            result.append(index)
        return tuple(result)

    def side_of_first(self, n_front: complex, n_back: complex, from_front: bool) -> str:
        """Return the side of the first layer, "front" or "back", for light from one side; see `first`."""
        if self.first != "outside":
            return self.first
        if self.opaque and not from_front and outside_first(n_back, n_front):
            return "back"
        return "front" if outside_first(n_front, n_back) else "back"

    def front_to_back(
        self, wavelength_nm: float, n_front: complex, n_back: complex, from_front: bool = True
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """
        Return indices and thicknesses of the layers in the order from the front to the back.

        Parameters
        ----------
        wavelength_nm : float
            Vacuum wavelength, nm.
        n_front, n_back : complex
            Complex indices n + ik of the media, which determine the side that is "outside".
        from_front : bool
            Whether the light comes from the front, which counts for an opaque coating between equal indices.

        Returns
        -------
        N : (L,) complex128
            Indices n + ik of the layers.
        d_nm : (L,) float64
            Thicknesses of the layers, nm.
        order : (L,) int
            Index of each layer in the coating's own order, from 0.
        """
        order = np.arange(len(self.layers))
        if self.side_of_first(n_front, n_back, from_front) == "back":
            order = order[::-1]
        indices = np.array(self.indices(wavelength_nm), dtype=np.complex128)
        thickness = np.array([layer.thickness_nm for layer in self.layers], dtype=np.float64)
        return indices[order], thickness[order], order

    def response(
        self, wavelength_nm: float, n_front: complex, n_back: complex, cos_incident: npt.ArrayLike, from_front: bool
    ) -> Response:
        """Return R, T and phases for light from one side, see `CoatingModel.response`; T = 0 if `opaque`."""
        indices, thickness, _ = self.front_to_back(wavelength_nm, n_front, n_back, from_front)
        full = layered_response(indices, thickness, wavelength_nm, n_front, n_back, cos_incident, from_front)
        return Response(full.R, 0 * full.T, full.phase_r, full.phase_t) if self.opaque else full


def outside_first(n_front: complex, n_back: complex) -> bool:
    """True if the front is outside, as the only side that is no metal, or else of lower index; also for equal sides."""
    return (n_front.imag > METAL_K, n_front.real) <= (n_back.imag > METAL_K, n_back.real)


def parse_layers(
    text: str, design_nm: float = 550.0, name: str = "", resolve: Callable[[str], str] = str
) -> tuple[Layer, ...]:
    """
    Return the layers that a string describes, such as ``MgF2 99.64, 2.1 0.5w, 1.63+0.001i 84.4``.

    Parameters
    ----------
    text : str
        Layers separated by commas or line ends. Each is a material and, as last word, its thickness in nm; with a ``w``
        its optical thickness n d in waves at `design_nm`.
    design_nm : float
        Wavelength of the optical thicknesses, nm.
    name : str
        Name of the coating, for messages.
    resolve : callable
        Function that returns the path to open for the path of a material file in the text.

    Raises
    ------
    MistrayError
        If `design_nm` is not greater than 0, a layer has no thickness, a material string is not valid, or the material
        of an optical thickness is unknown at `design_nm`.

    Examples
    --------
    >>> for layer in mistray.coatings.parse_layers("MgF2 0.25w, 2.1 0.5w", design_nm=550):
    ...     print(f"{layer.material}: {layer.thickness_nm:.1f} nm")
    ...
    MgF2: 99.4 nm
    2.1: 131.0 nm
    """
    if not design_nm > 0:
        raise MistrayError(f"{Stack((), name=name)}: design_nm = {design_nm:g}; it must be greater than 0")
    parts = [part.strip() for part in re.split(r"[,\n]", text)]
    layers = []
    for number, part in enumerate(parts, start=1):
        where = f"{Stack((), name=name)}, layer {number}"
        material, _, size = part.rpartition(" ")
        value = finite_of(size.removesuffix("w"))
        if not material or value is None:
            raise MistrayError(f"{where}: '{part}' has no material and thickness; {LAYER_FORM}")
        with errors_of(where):
            material = resolved(material.strip(), resolve)
        layers.append(waves(material, value, design_nm, where) if size.endswith("w") else Layer(material, value))
    return tuple(layers)


def moved_layers(text: str, seen: Callable[[str], str]) -> str:
    """Return the string of layers with each path of a material file replaced by the result of `seen` for it."""
    parts = [part.strip().rpartition(" ") for part in re.split(r"[,\n]", text)]
    return ", ".join(f"{resolved(material.strip(), seen)} {size}" for material, _, size in parts)


def waves(material: str, optical_thickness: float, design_nm: float, where: str = "layer") -> Layer:
    """
    Return a layer of a given optical thickness: d = w λ/n with the real part n at the design wavelength.

    Parameters
    ----------
    material : str
        Name of the material, see `mistray.materials`.
    optical_thickness : float
        Optical thickness w, waves.
    design_nm : float
        Design wavelength λ, nm.
    where : str
        Start of an error message.

    Raises
    ------
    MistrayError
        If the material, or its k, is unknown at the design wavelength.
    """
    with errors_of(where):
        n = complex_index(material, design_nm).real
    return Layer(material, optical_thickness * design_nm / n)


def layer_text(layers: Layer | Sequence[Layer]) -> str:
    """
    Return the string of layers, from which `parse_layers` reads the same thicknesses back.

    Raises
    ------
    MistrayError
        If a layer has a shift, or a material with a comma in its name (a file), which the string cannot hold.

    Examples
    --------
    >>> layers = mistray.coatings.Layer("MgF2", 99.4), mistray.coatings.Layer("2.1", 131.0)
    >>> mistray.coatings.layer_text(layers)
    'MgF2 99.4, 2.1 131'
    """
    layers = several(layers)
    for number, layer in enumerate(layers, start=1):
        OfType(Layer, "must be a mistray.coatings.Layer").check(f"layer {number}", layer)
        if "," in layer.material:
            raise MistrayError(f"layer {number} ({layer.material}): the material has a comma; rename its file")
        if layer.n_shift or layer.k_shift:
            raise MistrayError(
                f"layer {number} ({layer.material}): n_shift = {layer.n_shift:g}, k_shift = {layer.k_shift:g} have no "
                "place in the text of the layers; give them beside it"
            )
    return ", ".join(f"{layer.material} {float(layer.thickness_nm)!r}".removesuffix(".0") for layer in layers)
