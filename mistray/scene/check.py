"""Checks that a parsed scene has valid names and finite numbers, and that its surfaces do not overlap."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import Any

import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.ids import check_id, hidden
from mistray.physics.geometry.crossing import SAMPLES, meeting

LAST_ROW = [0.0, 0.0, 0.0, 1.0]  # of a transform; Mitsuba takes it for this whatever it says
NAMES = ("grid", "part")  # properties that are names; Mitsuba finds its own folder by an empty one
TOLERANCE = 1e-7  # heights, relative to the radius of the surface: what is written with fewer digits than that touches


def check_values(state: Any) -> None:
    """
    Check names and numbers of a scene that Mitsuba has parsed, from a file or a dict, and not yet built.

    Parameters
    ----------
    state : mi.parser.ParserState
        Parsed scene.

    Raises
    ------
    MistrayError
        If an id, a grid or a part is not a valid name, or a string holds invisible characters. It is also raised if a
        number is NaN, a transform or a vector is not finite, or the last row of a transform is not 0 0 0 1. The message
        names the place as Mitsuba's own errors do.
    """
    for node in state.nodes:
        kind = node.type.name.lower()
        try:
            check_id(node.props.id(), "object" if kind == "unknown" else kind)
            for key in node.props.keys():  # noqa: SIM118  Properties iterate over other things
                _check_value(key, property_of(node, key), node.props.type(key).name)
        except MistrayError as error:
            raise MistrayError(f"While loading {mi.parser.file_location(state, node)}: MistrayError: {error}") from None


def property_of(node: Any, key: str) -> Any:
    """
    Return a property of a parsed scene node without marking it as read.

    Mitsuba reports properties that nobody has read as unknown; reading one here would hide that.
    """
    value = node.props[key]
    node.props.mark_queried(key, False)
    return value


def _check_value(key: str, value: Any, kind: str) -> None:
    """
    Raise `MistrayError` if a property value is invalid for every plugin, such as NaN or an empty name.

    `key` is the name of the property, and `kind` is Mitsuba's name for the type of the value.
    """
    if isinstance(value, str):
        if key in NAMES and not value.strip():
            raise MistrayError(f"{key} is {value!r}; give a name, or leave it out")
        if key == "part":
            check_id(value, key)
        if letter := hidden(value, "\t\n\r"):
            raise MistrayError(f"{key} {value!a} holds U+{ord(letter):04X}, which is not seen; take it out")
    elif isinstance(value, float):
        if np.isnan(value):
            raise MistrayError(f"{key} is nan; it must be a number")
    elif kind in ("Transform", "Any") and hasattr(value, "matrix"):
        matrix = np.array(value.matrix, dtype=np.float64)
        if not np.isfinite(matrix).all():
            raise MistrayError(f"{key} holds {_first_strange(matrix)}; its numbers must be finite")
        if matrix.shape == (4, 4) and matrix[3].tolist() != LAST_ROW:
            raise MistrayError(f"{key} has {matrix[3].tolist()} as its last row; it must be {LAST_ROW}")
    elif kind in ("Vector", "Color", "Spectrum"):
        numbers = np.array(getattr(value, "values", value), dtype=np.float64)
        if not np.isfinite(numbers).all():
            raise MistrayError(f"{key} holds {_first_strange(numbers)}; its numbers must be finite")


def _first_strange(numbers: np.ndarray) -> str:
    return f"{numbers[~np.isfinite(numbers)].flat[0]:g}"


def require_scene(scene: Any, function: str) -> None:
    """
    Raise `MistrayError` if an argument is not a loaded scene, but for example the name of one.

    `function` is the name of the function that got it, for the message.
    """
    if not isinstance(scene, mi.Scene):
        raise MistrayError(f"{function}() got {type(scene).__name__}; load the scene first: mistray.load(path)")


@dataclass(frozen=True)
class _Placed:
    """
    `asphere` on a common axis: vertex z along it, mm; sign, -1 if reversed; inner and outer radius of its aperture, mm.

    The outer radius of a rectangle is half of its shorter side.
    """

    shape: Any
    z: float
    sign: float
    inner: float
    outer: float

    def height(self, r: np.ndarray) -> np.ndarray:
        """Return the surface's position along the axis, mm, at radii r, mm."""
        return np.asarray(self.z + self.sign * self.shape.sag(r))

    def material(self, ahead: bool) -> tuple[float, str]:
        """
        Return index and name of the material on the +axis side of the surface if `ahead`, else on the other side.

        The index is that at or near the wavelength of the light.
        """
        bsdf = self.shape.bsdf()
        front, back = bsdf.known_indices
        return (back, bsdf.back) if ahead == (self.sign > 0) else (front, bsdf.front)

    def __str__(self) -> str:
        x, y, z = self.shape.matrix[:3, 3]
        place = f"z = {z:g} mm" if x == y == 0 else f"({x:g}, {y:g}, {z:g}) mm"
        return f"'{self.shape.id()}' at {place}"


@dataclass
class _Axis:
    """Common axis of aspheres in the world: a point, mm, a unit vector, and the aspheres centred on it."""

    foot: np.ndarray
    along: np.ndarray
    placed: list[_Placed]

    def sign(self, shape: Any) -> float:
        """Return 1 if a shape has this axis, -1 if it has it reversed, and 0 if it has another axis."""
        return float(_signs(self.foot[None], self.along[None], shape)[0])

    def add(self, shape: Any) -> None:
        v = shape.values
        outer = min(v["half_width"], v["half_height"]) if shape.rectangular else v["semi_diameter"]
        z = float((shape.matrix[:3, 3] - self.foot) @ self.along)
        self.placed.append(_Placed(shape, z, self.sign(shape), v.get("inner_semi_diameter", 0.0), outer))


def check_overlaps(scene: mi.Scene) -> None:
    """
    Raise `MistrayError` if surfaces overlap: if two cross or coincide, or lie in the wrong order.

    The check compares `asphere` shapes with a common axis, within the aperture that they share. Surfaces may touch, at
    the vertex or at the rim. Structure made of `frustum` shapes is not checked, because walls are often drawn into one
    another. If nothing else on the axis refracts, the materials must also fit together along it. This finds two
    surfaces that have changed places. Materials are not checked if any shape has a BSDF of Mitsuba's own.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene.

    Raises
    ------
    MistrayError
        If two surfaces overlap or lie in the wrong order; the message names both.
    """
    shapes = [shape for shape in scene.shapes() if not getattr(shape.bsdf(), "is_target", False)]
    axes: list[_Axis] = []
    feet, directions = np.zeros((2, len(shapes), 3))
    for shape in shapes:
        if hasattr(shape, "sag"):
            known = np.flatnonzero(_signs(feet[: len(axes)], directions[: len(axes)], shape))
            if not len(known):
                feet[len(axes)], directions[len(axes)] = foot, along = shape.matrix[:3, 3], shape.matrix[:3, 2]
                axes.append(_Axis(foot, along, []))
            axes[known[0] if len(known) else -1].add(shape)
    for axis in axes:
        axis.placed.sort(key=lambda item: item.z)
        _check_crossings(axis)
    if not all(hasattr(shape.bsdf(), "known_indices") for shape in shapes):
        return
    detectors = [shape.bsdf() for shape in shapes if shape.is_sensor()]
    around = {bsdf.known_indices[0]: bsdf.front for bsdf in detectors}
    for axis in axes:
        if sum(not item.shape.bsdf().opaque for item in axis.placed) < 2:
            continue
        if not any(_crosses(shape, axis) for shape in shapes):
            _check_materials(axis)
            _check_ends(axis, around)


def _signs(feet: np.ndarray, along: np.ndarray, shape: Any) -> np.ndarray:
    """Return `_Axis.sign` of a shape for several axes, from their points (mm) and unit vectors, (n, 3) each."""
    matrix = shape.matrix
    direction, offset = matrix[:3, 2], matrix[:3, 3] - feet
    signs = np.sign(along @ direction)
    aside = offset - np.einsum("ij,ij->i", offset, along)[:, None] * along
    parallel = np.isclose(along, signs[:, None] * direction, atol=TOLERANCE).all(axis=1)
    return np.where(parallel & (np.linalg.norm(aside, axis=1) <= TOLERANCE * shape.outer_radius), signs, 0.0)


def _check_crossings(axis: _Axis) -> None:
    """Raise `MistrayError` if two surfaces of an axis cross, coincide or lie in the wrong order."""
    heights = [item.height(np.linspace(item.inner, item.outer, SAMPLES)) for item in axis.placed]
    low, high = [height.min() for height in heights], [height.max() for height in heights]
    for i, j in combinations(range(len(heights)), 2):
        a, b = axis.placed[i], axis.placed[j]
        tolerance = TOLERANCE * max(a.outer, b.outer)
        if low[j] > high[i] + tolerance or low[i] > high[j] + tolerance:
            continue
        met = meeting(a.height, b.height, max(a.inner, b.inner), min(a.outer, b.outer), tolerance)
        if met is not None:
            raise MistrayError(met.between(a.shape.id(), b.shape.id()))


def _crosses(shape: Any, axis: _Axis) -> bool:
    """True if light along an axis may change material at a shape; rings and tubes around the axis do not count."""
    if shape.bsdf().opaque or any(item.shape.id() == shape.id() for item in axis.placed):
        return False
    around = hasattr(shape, "profile") and shape.profile()[:, 0].min() > 0
    return not (getattr(shape, "mechanics", False) and axis.sign(shape) and around)


def _check_materials(axis: _Axis) -> None:
    """
    Raise `MistrayError` if the material behind a surface differs from that in front of the next one on the axis.

    Surfaces that touch, or of which one is opaque, are not compared.
    """
    for a, b in pairwise(item for item in axis.placed if item.inner == 0):
        touching = b.z - a.z <= TOLERANCE * max(a.outer, b.outer)
        if touching or a.shape.bsdf().opaque or b.shape.bsdf().opaque:
            continue
        (leaving, material_a), (entering, material_b) = a.material(ahead=True), b.material(ahead=False)
        if leaving != entering:
            raise MistrayError(
                f"surfaces {a} and {b}: the material between them is '{material_a}' for one and '{material_b}' for the "
                "other; move them, or correct their front and back"
            )


def _check_ends(axis: _Axis, around: Mapping[float, str]) -> None:
    """
    Raise `MistrayError` if light along the axis would start and end in glass, as in a lens with swapped faces.

    That is so if the material ahead of the first refracting surface is also that behind the last one, no detector
    stands in it, and one stands in the material between. `around` maps the refractive index to the name of the material
    in front of each detector; if it is empty, nothing is checked.
    """
    passed = [item for item in axis.placed if item.inner == 0 and not item.shape.bsdf().opaque]
    if len(passed) < 2 or not around:
        return
    first, last = passed[0], passed[-1]
    (starts, material), (ends, _) = first.material(ahead=False), last.material(ahead=True)
    gap, _ = first.material(ahead=True)
    if starts == ends and starts not in around and gap in around:
        raise MistrayError(
            f"surfaces {first} and {last}: light starts in '{material}' ahead of the one and ends in it behind the "
            f"other, and the detector stands in '{next(iter(around.values()))}'; exchange them, or correct its front"
        )
