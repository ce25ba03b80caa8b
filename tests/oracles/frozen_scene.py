"""A scene as a list of numbers that can be moved, in float64, by the keys of the plugins' parameters."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from .freeform import Freeform
from .geometry import Array, Asphere, Frustum, Surface
from .glass import absorption_per_mm
from .interface import Interaction, Interface, interact
from .layers import stack_powers
from .scatter_integrals import Lobe, Profile, abg, harvey_shack, lambertian
from .scene_xml import SceneModel, _rotation, parse_scene

ORDERS = tuple(range(4, 21, 2))
POSE = ("x", "y", "z", "tilt_x", "tilt_y", "tilt_z")


@dataclass(frozen=True)
class ScatterModel:
    """A scatter model nested in an interface: key prefix of its numbers, and what makes lobes of them."""

    key: str
    names: tuple[str, ...]
    # From its numbers, the wavelength (nm), the index on the side of incidence and on the other
    lobes: Callable[[tuple[float, ...], float, float, float], tuple[Lobe, ...]]


@dataclass(frozen=True)
class Film:
    """Layers of a coating: key prefix, index of each layer (k > 0 absorbs), and on which side the first one lies."""

    key: str
    indices: tuple[complex, ...]
    first: str


@dataclass(frozen=True)
class FrozenScene:
    """The model as the file gives it, key → numbers, and by shape the keys of interface, film and scatter models."""

    model: SceneModel
    wavelength_nm: float
    numbers: dict[str, Array]
    interface_keys: dict[str, str]
    films: dict[str, Film]
    scatter: dict[str, tuple[ScatterModel, ...]]

    def moved(self, key: str, step: float, entry: int = 0) -> FrozenScene:
        if key not in self.numbers:
            raise ValueError(f"frozen scene has no number {key!r}")
        values = self.numbers[key].copy()
        values[entry] += step
        return replace(self, numbers={**self.numbers, key: values})

    def met_by(self, key: str, shape_id: str) -> bool:
        owner = key.rsplit(".", 1)[0]
        film = self.films.get(shape_id)
        owners = [shape_id, self.interface_keys[shape_id], film.key if film else None]
        return owner in [*owners, *(model.key for model in self.scatter.get(shape_id, ()))]

    def number(self, key: str) -> float:
        return float(self.numbers[key][0])

    def pose(self, shape_id: str) -> tuple[Array, Array]:
        to_world = self.model.by_id[shape_id].to_world
        x, y, z, *tilts = (self.number(f"{shape_id}.{name}") for name in POSE)
        rotation = to_world[:3, :3]
        for axis, angle in zip(np.eye(3), tilts, strict=True):
            rotation = rotation @ _rotation(axis, angle)
        return rotation, to_world[:3, 3] + to_world[:3, :3] @ np.array([x, y, z])

    def surface(self, shape_id: str) -> Surface:
        own = self.model.by_id[shape_id].surface
        if isinstance(own, Asphere):
            powers = tuple((k // 2, self.number(f"{shape_id}.a{k}")) for k in ORDERS)
            curvature, conic = self.number(f"{shape_id}.curvature"), self.number(f"{shape_id}.conic")
            return replace(own, curvature=curvature, conic=conic, coefficients=tuple(p for p in powers if p[1]))
        if isinstance(own, Frustum):
            return Frustum(*(self.number(f"{shape_id}.{name}") for name in ("r0", "z0", "r1", "z1")))
        if isinstance(own, Freeform):
            return replace(own, numbers={name: self.number(f"{shape_id}.{name}") for name in own.numbers})
        return own

    def cross(self, shape_id: str, origin: Array, direction: Array, near: Array) -> Array:
        """Path lengths (n,) to the crossings of the unbounded surface next to `near`, mm, by Newton's method."""
        surface = self.surface(shape_id)
        rotation, vertex = self.pose(shape_id)
        o, d = (origin - vertex) @ rotation, direction @ rotation
        t, tolerance = near.copy(), 1e-13 * (1 + np.abs(near) + np.linalg.norm(o, axis=1))
        for _ in range(30):
            value, gradient = surface.implicit(o + t[:, None] * d)
            step = value / np.einsum("ij,ij->i", gradient, d)
            t = t - step
            if np.all(np.abs(step) <= tolerance):
                return t
        raise ValueError(f"rays do not settle on {shape_id}: last step {np.max(np.abs(step)):.1e} mm")

    def meet(self, shape_id: str, point: Array, direction: Array) -> Interaction:
        """Both daughters of rays at points of a surface, and its R and T for unpolarised light."""
        rotation, vertex = self.pose(shape_id)
        normal = self.surface(shape_id).normal((point - vertex) @ rotation) @ rotation.T
        interface, (n_front, n_back) = self._interface(shape_id), self._indices(shape_id)
        out = interact(interface, n_front, n_back, self.wavelength_nm, direction, normal)
        film = self.films.get(shape_id)
        if film is None:
            return out
        cos_i = np.abs(np.einsum("ij,ij->i", direction, normal))
        R, T = np.zeros(len(point)), np.zeros(len(point))
        for side in (True, False):
            here = out.from_front == side
            R[here], T[here] = self._film_powers(film, n_front, n_back, side, cos_i[here])
        return replace(out, reflectance=R, transmittance=T)

    def lobes(self, shape_id: str, side: str) -> list[Lobe]:
        n_in, n_out = self._indices(shape_id)
        if side == "back":
            n_in, n_out = n_out, n_in
        found = []
        for model in self.scatter.get(shape_id, ()):
            numbers = tuple(self.number(f"{model.key}.{name}") for name in model.names)
            found += [lobe for lobe in model.lobes(numbers, self.wavelength_nm, n_in, n_out) if side in lobe.sides]
        return found

    def absorption(self, material: str) -> float:
        return absorption_per_mm(material, self.wavelength_nm)

    def _interface(self, shape_id: str) -> Interface:
        own = self.model.by_id[shape_id].interface
        if own.reflectance is None or own.table is not None:
            return own
        key = self.interface_keys[shape_id]
        return replace(own, reflectance=self.number(f"{key}.R"), transmittance=self.number(f"{key}.T"))

    def _indices(self, shape_id: str) -> tuple[float, float]:
        if self.model.by_id[shape_id].interface.opaque:
            return 1.0, 1.0
        n_front, n_back = self.model.indices(shape_id, self.wavelength_nm)
        key = self.interface_keys[shape_id]
        return n_front + self.number(f"{key}.n_front_shift"), n_back + self.number(f"{key}.n_back_shift")

    def _film_powers(
        self, film: Film, n_front: float, n_back: float, from_front: bool, cosine: Array
    ) -> tuple[Array, Array]:
        thickness, n_shift, k_shift = (self.numbers[f"{film.key}.{k}"] for k in ("thickness_nm", "n_shift", "k_shift"))
        n = np.array(film.indices) + n_shift + 1j * k_shift
        front_first = film.first == "front" or (film.first == "outside" and n_front <= n_back)
        if front_first != from_front:
            n, thickness = n[::-1], thickness[::-1]
        outer = (n_front, n_back) if from_front else (n_back, n_front)
        return stack_powers(outer[0], n, thickness, outer[1], self.wavelength_nm, cosine)


def read_frozen(source: str | Path) -> FrozenScene:
    path = source if isinstance(source, Path) else None
    text = path.read_text(encoding="utf-8") if path else str(source)
    model, root = parse_scene(text, path), ElementTree.fromstring(text)
    wavelength_nm = float(model.emitters[0].values.get("wavelength_nm", 550.0))
    named = {node.attrib["id"]: node for node in root.iter("bsdf") if "id" in node.attrib}
    numbers: dict[str, Array] = {}
    interface_keys: dict[str, str] = {}
    films: dict[str, Film] = {}
    scatter: dict[str, tuple[ScatterModel, ...]] = {}
    nodes = {node.attrib.get("id", f"shape_{k}"): node for k, node in enumerate(root.findall("shape"))}
    for shape in model.shapes:
        name = shape.shape_id
        numbers |= {f"{name}.{part}": np.zeros(1) for part in POSE}
        if isinstance(shape.surface, Asphere):
            own = {f"a{order}": 0.0 for order in ORDERS} | {f"a{2 * i}": a for i, a in shape.surface.coefficients}
            own |= {"curvature": shape.surface.curvature, "conic": shape.surface.conic}
            numbers |= {f"{name}.{part}": np.array([float(value)]) for part, value in own.items()}
        if isinstance(shape.surface, Frustum):
            for part in ("r0", "z0", "r1", "z1"):
                numbers[f"{name}.{part}"] = np.array([float(getattr(shape.surface, part))])
        if isinstance(shape.surface, Freeform):
            numbers |= {f"{name}.{part}": np.array([value]) for part, value in shape.surface.numbers.items()}
        found = _nested(nodes[name], named, name)
        key, node = found[0] if found else (f"{name}.bsdf", None)
        interface_keys[name] = key
        numbers |= {f"{key}.{part}": np.zeros(1) for part in ("n_front_shift", "n_back_shift")}
        if shape.interface.reflectance is not None:
            numbers[f"{key}.R"] = np.array([float(shape.interface.reflectance)])
            numbers[f"{key}.T"] = np.array([float(shape.interface.transmittance or 0.0)])
        models = []
        for nested_key, nested in _nested(node, named, key) if node is not None else []:
            if nested.attrib["type"] == "thinfilm":
                films[name] = _film(nested_key, nested, numbers)
            else:
                models.append(_scatter_model(nested_key, nested, numbers))
        scatter[name] = tuple(models)
    return FrozenScene(model, wavelength_nm, numbers, interface_keys, films, scatter)


def _nested(
    node: ElementTree.Element, named: dict[str, ElementTree.Element], owner: str
) -> list[tuple[str, ElementTree.Element]]:
    """Nested bsdfs and the prefixes of their keys: the id where there is one, else by what it is to its owner."""
    found: list[tuple[str, ElementTree.Element]] = []
    for child in node:
        if child.tag == "ref" and child.attrib["id"] in named:
            found.append((child.attrib["id"], named[child.attrib["id"]]))
        elif child.tag == "bsdf":
            kind = child.attrib["type"]
            key = {"interface": "bsdf", "thinfilm": "coating"}.get(kind, kind)
            found.append((child.attrib.get("id", f"{owner}.{key}"), child))
    if len({key for key, _ in found}) < len(found):
        raise ValueError(f"{owner} has two bsdfs of one kind without ids")
    return found


def _film(key: str, node: ElementTree.Element, numbers: dict[str, Array]) -> Film:
    values = {child.attrib["name"]: child.attrib["value"] for child in node}
    if set(values) - {"layers", "first"}:
        raise ValueError(f"oracle knows no thinfilm with {sorted(values)}")
    layers = [item.split() for item in values["layers"].split(",")]
    numbers[f"{key}.thickness_nm"] = np.array([float(thickness) for _, thickness in layers])
    for part in ("n_shift", "k_shift"):
        numbers[f"{key}.{part}"] = np.zeros(len(layers))
    return Film(key, tuple(complex(n.replace("i", "j")) for n, _ in layers), values.get("first", "outside"))


def _scatter_model(key: str, node: ElementTree.Element, numbers: dict[str, Array]) -> ScatterModel:
    """``abg``, ``harvey_shack`` by b0 or by rms_nm, ``paint`` without an index."""
    kind = node.attrib["type"]
    values = {child.attrib["name"]: child.attrib["value"] for child in node}
    event = values.pop("event", "reflection" if kind == "paint" else "both")
    relative_to = values.pop("relative_to", "incident" if kind == "paint" else "specular")
    side = values.pop("side", "both")
    known: dict[str, tuple[set[str], dict[str, float], Callable[..., list[tuple[Profile, bool]]]]] = {
        "abg": ({"A", "B", "g"}, {}, lambda v, *_: [(abg(v["A"], v["B"], v["g"]), False)]),
        "harvey_shack": ({"b0", "rms_nm"}, {"l": 0.01, "s": -1.5}, _harvey_shack),
        "paint": ({"reflectance"}, {"b0": 0.0, "l": 0.1, "s": -2.0}, _paint),
    }
    names, defaults, make = known.get(kind, (set(), {}, _paint))
    if set(values) - names - set(defaults) or kind not in known:
        raise ValueError(f"oracle knows no {kind!r} with {sorted(values)}")
    own = {**defaults, **{name: float(value) for name, value in values.items()}}
    for name, value in own.items():
        numbers[f"{key}.{name}"] = np.array([value])
    events = ("transmission", "reflection") if event == "both" else (event,)
    sides = ("front", "back") if side == "both" else (side,)

    @lru_cache(maxsize=64)  # a lobe's totals are dear
    def lobes(numbers: tuple[float, ...], wavelength_nm: float, n_in: float, n_out: float) -> tuple[Lobe, ...]:
        named = dict(zip(own, numbers, strict=True))
        return tuple(
            Lobe(event, profile, relative_to == "incident", sides, about_normal)
            for event in events
            for profile, about_normal in make(named, event, wavelength_nm, n_in, n_out)
        )

    return ScatterModel(key, tuple(own), lobes)


def _harvey_shack(
    v: dict[str, float], event: str, wavelength_nm: float, n_in: float, n_out: float
) -> list[tuple[Profile, bool]]:
    """b0 is given, or follows from the smooth-surface limit of the total scatter, (2π Δn σ/λ)²."""
    knee, slope = v["l"], v["s"]
    if "rms_nm" in v:
        step = 2 * n_in if event == "reflection" else abs(n_in - n_out)
        total = (2 * np.pi * step * v["rms_nm"] / wavelength_nm) ** 2
        power = 0.5 * slope + 1
        unit = np.log1p(knee**-2) if power == 0 else ((1 + knee**-2) ** power - 1) / power
        b0 = total / (np.pi * knee**2 * unit)
    else:
        b0 = v["b0"]
    return [(harvey_shack(b0, knee, slope), False)]


def _paint(v: dict[str, float], *_: float | str) -> list[tuple[Profile, bool]]:
    lobes = [(lambertian(v["reflectance"]), True)]
    return lobes + ([(harvey_shack(v["b0"], v["l"], v["s"]), False)] if v["b0"] else [])
