"""A slow nonsequential tracer for surfaces that scatter: Monte Carlo in float64, never aimed.

Every hit sends on the specular rays, weakened by what they lose to scatter, and one ray for each lobe. A lobe is a
profile f(|beta - beta0|) in 1/sr about the reflected or the refracted direction; its ray is drawn from f itself over
the circle |beta - beta0| <= 1 + |beta0| and is nothing where beta is no direction. Books are kept by path and by batch
of start rays, so that every number has a standard error.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections import defaultdict
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .geometry import Array
from .interface import interact
from .nonsequential import nearest_hits
from .scatter_integrals import Profile, abg, harvey_shack, lambertian, total_scatter
from .scene_xml import SceneModel

BATCHES = 32
EVENTS = ("reflection", "transmission")
ANGLES = 257


@dataclass(frozen=True)
class Model:
    """A scatter model: one profile for the lobes in reflection and in transmission.

    ``relative_to`` is the specular beam or the incident light, ``about_normal`` puts the centre of the profile there.
    """

    profile: Profile
    events: tuple[str, ...] = EVENTS
    sides: tuple[str, ...] = ("front", "back")
    relative_to: str = "specular"
    about_normal: bool = False

    @cached_property
    def totals(self) -> tuple[Array, Array]:
        """Squares of the sine of the specular direction, and the totals of the profile there."""
        cosines = np.linspace(0.0, 1.0, ANGLES)
        return cosines, np.array([total_scatter(self.profile, float(np.sqrt(1 - c * c))) for c in cosines])

    def total(self, cosine: Array) -> Array:
        """Total integrated scatter where the specular direction has these cosines."""
        return np.interp(np.ones_like(cosine) if self.about_normal else cosine, *self.totals)

    @cached_property
    def radii(self) -> tuple[Array, Array]:
        """Radii 0 … 2 and the flux within them, on a fine grid; linear in r^2 between its nodes."""
        r = np.concatenate([[0.0], np.logspace(-9, np.log10(2.0), 20_000)])
        middle = np.sqrt(0.5 * (r[1:] ** 2 + r[:-1] ** 2))
        rings = np.pi * np.diff(r * r) * self.profile(middle)
        return r, np.concatenate([[0.0], np.cumsum(rings)])

    def sample(self, centre: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Tangential parts (n, 2) drawn about centres (n, 2), and weights (n,) with a mean equal to the total."""
        r, within = self.radii
        most = np.interp(1 + np.linalg.norm(centre, axis=1), r, within)
        u = rng.random(len(centre)) * most
        cell = np.clip(np.searchsorted(within, u, side="right") - 1, 0, len(r) - 2)
        fraction = (u - within[cell]) / (within[cell + 1] - within[cell])
        radius = np.sqrt(r[cell] ** 2 + fraction * (r[cell + 1] ** 2 - r[cell] ** 2))
        angle = rng.random(len(centre)) * 2 * np.pi
        beta = centre + radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return beta, np.where(np.sum(beta * beta, axis=1) < 1, most, 0.0)


def scatter_models(text: str) -> dict[str, tuple[Model, ...]]:
    """Shape id → models nested in its interface, from a scene's XML; knows ``abg``, ``harvey_shack``, ``paint``."""
    found = {}
    for shape in ElementTree.fromstring(text).iter("shape"):
        bsdf = shape.find("bsdf")
        if bsdf is not None:
            found[shape.attrib["id"]] = tuple(_model(node) for node in bsdf.findall("bsdf"))
    return found


def _model(node: ElementTree.Element) -> Model:
    values = {child.attrib["name"]: child.attrib["value"] for child in node}
    kind = node.attrib["type"]
    paint = kind == "paint"
    event = values.pop("event", "reflection" if paint else "both")
    side = values.pop("side", "both")
    relative_to = values.pop("relative_to", "incident" if paint else "specular")
    names = {"abg": (abg, "A", "B", "g"), "harvey_shack": (harvey_shack, "b0", "l", "s")}
    names["paint"] = (lambertian, "reflectance")
    if kind not in names or set(values) != set(names[kind][1:]):
        raise ValueError(f"oracle knows no {kind!r} with {sorted(values)}")
    make, *keys = names[kind]
    return Model(
        make(*(float(values[key]) for key in keys)),
        EVENTS if event == "both" else (event,),
        ("front", "back") if side == "both" else (side,),
        relative_to,
        about_normal=paint,
    )


@dataclass(frozen=True)
class Books:
    """What became of the launched power, by batch of start rays: every array is (BATCHES,), W.

    Paths are texts ``"plate:t detector:A"``: T R specular, I totally reflected, t r scattered, A absorbed.
    """

    launched_W: float
    paths: dict[str, Array]
    absorbed: dict[str, Array]
    escaped: Array
    cut: Array

    def power(self, path: str) -> tuple[float, float]:
        """Power of a path and its standard error, W."""
        return mean_and_se(self.paths[path])

    @property
    def detected(self) -> tuple[float, float]:
        """Power on the detector and its standard error, W."""
        return mean_and_se(np.sum(list(self.paths.values()), axis=0))


def mean_and_se(by_batch: Array) -> tuple[float, float]:
    """Sum over batches of equal size, and its standard error."""
    return float(by_batch.sum()), float(np.sqrt(len(by_batch)) * by_batch.std(ddof=1))


@dataclass
class _Rays:
    origin: Array
    direction: Array
    weight: Array
    batch: np.ndarray
    last: np.ndarray
    reflections: np.ndarray
    scatters: np.ndarray
    path: np.ndarray

    def take(self, index: np.ndarray) -> _Rays:
        return _Rays(*(getattr(self, name)[index] for name in _Rays.__dataclass_fields__))


def trace(
    model: SceneModel,
    models: dict[str, tuple[Model, ...]],
    origin: Array,
    direction: Array,
    power: Array,
    wavelength_nm: float,
    *,
    max_reflections: int = 2,
    max_scatters: int = 1,
    max_events: int = 32,
    flux_threshold: float = 0.0,
    seed: int = 0,
) -> Books:
    """Books of start rays (n, 3), powers (n,). The threshold is in W; ``cut`` is what the limits remove."""
    rng = np.random.default_rng(seed)
    n, ids = len(origin), [shape.shape_id for shape in model.shapes]
    zero = np.zeros(n, dtype=np.int64)
    batch = rng.permutation(n) % BATCHES
    unit = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    rays = _Rays(np.array(origin), unit, np.array(power, dtype=float), batch, zero - 1, zero, zero, zero)
    texts, numbers = [""], {"": 0}
    paths: defaultdict[int, Array] = defaultdict(lambda: np.zeros(BATCHES))
    absorbed = {name: np.zeros(BATCHES) for name in ids}
    escaped, cut = np.zeros(BATCHES), np.zeros(BATCHES)

    def step(parents: np.ndarray, event: str) -> np.ndarray:
        unique, inverse = np.unique(parents, return_inverse=True)
        children = np.empty(len(unique), dtype=np.int64)
        for i, parent in enumerate(unique):
            text = f"{texts[parent]} {event}".strip()
            if text not in numbers:
                numbers[text] = len(texts)
                texts.append(text)
            children[i] = numbers[text]
        return children[inverse]

    for generation in range(max_events):
        t, surface = nearest_hits(model, rays.origin, rays.direction, rays.last)
        np.add.at(escaped, rays.batch[surface < 0], rays.weight[surface < 0])
        children: list[_Rays] = []
        for number in np.unique(surface[surface >= 0]):
            shape, name = model.shapes[number], ids[number]
            here = np.flatnonzero(surface == number)
            arrived = rays.take(here)
            point = arrived.origin + t[here, None] * arrived.direction
            normal = shape.normal(point)
            n_front, n_back = model.indices(name, wavelength_nm)
            out = interact(shape.interface, n_front, n_back, wavelength_nm, arrived.direction, normal)
            taken = np.ones(len(here))
            for event, letter, x, heading in (
                ("transmission", "T", out.transmittance, out.transmitted),
                ("reflection", "R", out.reflectance, out.reflected),
            ):
                cosine = np.abs(np.einsum("ij,ij->i", heading, normal))
                kept = np.ones(len(here))
                for lobe in models.get(name, ()):
                    mine = np.where(out.from_front, "front" in lobe.sides, "back" in lobe.sides)
                    mine &= event in lobe.events
                    if event == "transmission":
                        mine &= ~out.tir
                    total = np.where(mine, lobe.total(cosine), 0.0)
                    specular = lobe.relative_to == "specular"
                    kept -= total if specular else 0.0
                    taken -= total * (x if specular else 1.0)
                    weight = np.where(mine, arrived.weight * (x if specular else 1.0), 0.0)
                    child = _scattered(lobe, arrived, point, heading, normal, weight, number, rng)
                    child.scatters = arrived.scatters + 1
                    child.path = step(arrived.path, f"{name}:{letter.lower()}")
                    children.append(child)
                taken -= kept * x
                counts = (event == "reflection") & ~out.tir & (not shape.interface.mirror)
                path = step(arrived.path, f"{name}:{letter}")
                if event == "reflection" and out.tir.any():
                    path = np.where(out.tir, step(arrived.path, f"{name}:I"), path)
                last = np.full(len(here), number)
                children.append(
                    _Rays(
                        point,
                        heading,
                        arrived.weight * x * kept,
                        arrived.batch,
                        last,
                        arrived.reflections + counts,
                        arrived.scatters,
                        path,
                    )
                )
            if shape.detector:
                ends = step(arrived.path, f"{name}:A")
                for path in np.unique(ends):
                    mine = ends == path
                    np.add.at(paths[path], arrived.batch[mine], (arrived.weight * taken)[mine])
            else:
                np.add.at(absorbed[name], arrived.batch, arrived.weight * taken)
        if not children:
            break
        joined = _Rays(*(np.concatenate([getattr(c, k) for c in children]) for k in _Rays.__dataclass_fields__))
        alive = (joined.weight > flux_threshold) & (joined.reflections <= max_reflections)
        alive &= (joined.scatters <= max_scatters) & (generation + 1 < max_events)
        np.add.at(cut, joined.batch[~alive], joined.weight[~alive])
        rays = joined.take(np.flatnonzero(alive))
        if not len(rays.weight):
            break
    return Books(float(np.sum(power)), {texts[k]: v for k, v in paths.items()}, absorbed, escaped, cut)


def _scattered(
    lobe: Model,
    arrived: _Rays,
    point: Array,
    heading: Array,
    normal: Array,
    weight: Array,
    number: int,
    rng: np.random.Generator,
) -> _Rays:
    """One ray of a lobe about the directions ``heading``, for the rays with a weight."""
    first = np.cross(normal, np.where(np.abs(normal[:, :1]) < 0.7, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]))
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(normal, first)
    centre = np.stack([np.einsum("ij,ij->i", heading, axis) for axis in (first, second)], axis=1)
    centre *= not lobe.about_normal
    beta, factor = lobe.sample(centre, rng)
    along = np.sqrt(np.maximum(0.0, 1 - np.sum(beta * beta, axis=1)))
    outward = np.copysign(along, np.einsum("ij,ij->i", heading, normal))
    direction = beta[:, :1] * first + beta[:, 1:] * second + outward[:, None] * normal
    last = np.full(len(weight), number)
    return _Rays(point, direction, weight * factor, arrived.batch, last, arrived.reflections, arrived.scatters, last)
