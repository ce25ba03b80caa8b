"""Lobes of scatter models: additive parts of a BSDF with one peak each."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, MISSING, dataclass, fields, replace
from types import MappingProxyType
from typing import Any, ClassVar, Protocol, Self

import numpy as np

from mistray.errors import MistrayError
from mistray.param import Param, params_of
from mistray.physics.diffraction import obliquity
from mistray.ranges import Words, check_fields

EVENTS = ("reflection", "transmission")
MEASURES = ("cosines", "angle")
CENTRES = ("specular", "normal", "retro")
AXES = ("radial", "angular", "cosines")
FACTORS = ("none", "ghs", "rayleigh_rice", "edge", "cosine")
EVENT = Param("string", Words(("both", *EVENTS)), "event that scatters")
SIDE = Param("string", Words(("both", "front", "back")), "side from which light is scattered")
RELATIVE_TO = Param(
    "string",
    Words(("specular", "incident")),
    "BSDF per unit of R and T (``specular``) or of incident light (``incident``), taken from the absorbed light",
)
PLACEMENT = ("event", "side", "relative_to")


@dataclass(frozen=True, eq=False)
class RatioTable:
    """
    Smooth function that multiplies a lobe's profile, for models that do not depend on |β - β0| alone.

    Attributes
    ----------
    values : (a, b, c) or (a, d, b, c) float64
        Values at uniform nodes of three variables, or of four for an anisotropic lobe; interpolation is linear. The
        first variable is the cosine of the angle between the specular direction and the normal, 0 … 1. For "angular" it
        is the angle itself, 0 … π/2.
    axes : {"radial", "angular", "cosines"}
        Choice of the last two variables. "radial" and "angular" have log r, `r_min` … 2 (the first node also holds
        below), and ψ, 0 … π. ψ is the angle of β - β_c against β0, 0 away from the normal and π towards it. "cosines"
        has the cosine of the scattered direction with the normal, 0 … 1, and its azimuth φ from the specular direction,
        0 … π. With d nodes of the rotation ψ and φ go from 0 to 2π, counterclockwise as seen from the side of
        incidence; the last node repeats the first.
    r_min : float
        Smallest r of the nodes; not used for "cosines".
    fixed : bool
        Whether no differentiable value of the model changes the table.
    first_rotation : float
        First node of the rotation ρ of an anisotropic lobe, rad; the last one is 2π more. ρ is the azimuth of the
        sample's x axis from that of the specular direction, counterclockwise as ψ and φ.
    from_x : bool
        Whether ψ and φ of an anisotropic lobe are counted from the sample's x axis. Then values interpolated between
        two nodes of ρ turn with the sample; otherwise they are fixed to the plane of incidence.

    Examples
    --------
    >>> half = mistray.scatter.RatioTable(np.full((2, 2, 2), 0.5))
    >>> half.at(np.array([1.0]), np.array([0.1]), np.array([0.0]))
    array([0.5])
    """

    values: np.ndarray
    r_min: float = 1e-3
    axes: str = "radial"
    fixed: bool = False
    first_rotation: float = 0.0
    from_x: bool = False

    def __post_init__(self) -> None:
        if self.values.ndim not in (3, 4) or min(self.values.shape) < 2 or not 0 < self.r_min < 2:
            raise MistrayError(
                f"ratio table of shape {self.values.shape}, r_min {self.r_min:g}; give ≥ 2 nodes each way"
            )
        if not np.all(np.isfinite(self.values)) or np.any(self.values < 0):
            raise MistrayError("ratio table with NaN or negative values; a BSDF is finite and not negative")
        if self.axes not in AXES:
            raise MistrayError(f"ratio table: axes is '{self.axes}'; use {' or '.join(map(repr, AXES))}")

    @property
    def anisotropic(self) -> bool:
        """True if the ratio depends on the rotation of the sample about its normal."""
        return self.values.ndim == 4

    def at(self, cos_specular: np.ndarray, second: np.ndarray, angle: np.ndarray, rotation: float = 0.0) -> np.ndarray:
        """
        Return the ratio at broadcastable arrays of its variables.

        Parameters
        ----------
        cos_specular, second, angle : float64
            Cosine of the specular direction with the normal; r or cos θs; ψ or φ from the specular direction, -π … 2π,
            rad. The sign of the angle has no effect for an isotropic lobe.
        rotation : float
            Rotation ρ of the sample, rad; used by an anisotropic lobe only.
        """
        first = np.clip(cos_specular, 0, 1)
        if self.axes == "angular":
            first = np.arccos(first) * (2 / np.pi)
        if self.axes != "cosines":
            second = np.log(np.maximum(second, self.r_min) / self.r_min) / np.log(2 / self.r_min)
        if self.anisotropic:
            angle = np.mod((angle - (rotation if self.from_x else 0.0)) / (2 * np.pi), 1)
        else:
            angle = np.clip(np.abs(angle) / np.pi, 0, 1)
        values, places = self.values, [first, np.clip(second, 0, 1), angle]
        if first.ndim == 0:  # one plane of the table holds for all
            places = places[1:]
            low, share = _cell(float(first), len(values))
            parts = [(1 - share, values[low]), (share, values[low + 1])]
        else:
            parts = [(1.0, values)]
        if self.anisotropic:
            low, share = _cell(np.mod((rotation - self.first_rotation) / (2 * np.pi), 1), values.shape[1])
            parts = [
                (weight * part_share, np.take(part, low + step, axis=part.ndim - 3))
                for weight, part in parts
                for step, part_share in ((0, 1 - share), (1, share))
            ]
        values = np.asarray(sum(weight * part for weight, part in parts))
        sizes = values.shape
        places = list(np.broadcast_arrays(*(place * (n - 1) for place, n in zip(places, sizes, strict=True))))
        lows = [np.minimum(place.astype(int), n - 2) for place, n in zip(places, sizes, strict=True)]
        total, flat = np.zeros(places[0].shape), values.ravel()
        for corner in range(2 ** len(sizes)):
            weight, index = np.ones(places[0].shape), np.zeros(places[0].shape, dtype=int)
            for axis, (place, low, n) in enumerate(zip(places, lows, sizes, strict=True)):
                step = corner >> axis & 1
                weight = weight * (place - low if step else low + 1 - place)
                index = index * n + low + step
            total += weight * flat[index]
        return total


def _cell(place: float, nodes: int) -> tuple[int, float]:
    """Return the node below a place, 0 … 1, on an axis of `nodes` even nodes, and the fraction of a step past it."""
    place = place * (nodes - 1)
    low = min(int(place), nodes - 2)
    return low, place - low


@dataclass(frozen=True, eq=False)
class Lobe:
    """
    One part of a BSDF, with one peak.

    Let X be R or T of the coating at the angle of incidence, and c = c0 + c1 X + c2 X². The distance of the scattered
    direction from the lobe's centre is r. The scattered flux per unit of incident flux is

    - in the measure "cosines": c · factor · ratio · profile(r) per projected solid angle, r = |β - β_c|; this is the
      BSDF;
    - in the measure "angle": c · oblique · factor · profile(r) per solid angle, where r = 2 sin(α/2) for the angle α
      between the scattered direction and the centre, and oblique = min(1/cos θi, `oblique_limit`); the BSDF is this
      over cos θs.

    β is the tangential part of a unit vector in its own medium.

    Attributes
    ----------
    event : {"reflection", "transmission"}
        Event in which the lobe scatters.
    profile : callable
        Function of r, (m,) in 0 … 2, that returns values ≥ 0, (m,), 1/sr.
    measure : {"cosines", "angle"}
        Measure of the distance r, see above.
    centre : {"specular", "normal", "retro"}
        Centre of the lobe: the reflected or refracted direction, the normal, or the direction back to the light.
    shares : tuple of float
        Coefficients c0, c1 and c2.
    factor : {"none", "ghs", "rayleigh_rice", "edge", "cosine"}
        Factor of the profile, in the order above: 1; ((cos θi + cos θs)/2)² of the generalised Harvey-Shack theory; cos
        θi cos θs; the `obliquity` of `mistray.physics.diffraction` about the specular direction; or cos θs. The last
        one is for the measure "angle" only, where the BSDF is then c · oblique · profile(r).
    ratio : RatioTable, optional
        Ratio that multiplies the profile; 1 by default.
    optical_depth : float, optional
        Fraction of X that the specular beam loses at normal incidence, if it is more than the lobe scatters; multiplied
        by `oblique` at other angles. None: the beam loses just the light that the lobe scatters.
    oblique_limit : float
        Upper bound of 1/cos θi, so that a beam does not lose more light than it has.

    Examples
    --------
    >>> lambertian = mistray.scatter.Lobe("reflection", lambda r: np.full(r.shape, 0.3 / np.pi), centre="normal")
    >>> lambertian.profile(np.array([0.0, 0.5])).round(3)
    array([0.095, 0.095])
    """

    event: str
    profile: Callable[[np.ndarray], np.ndarray]
    measure: str = "cosines"
    centre: str = "specular"
    shares: tuple[float, float, float] = (0.0, 1.0, 0.0)
    factor: str = "none"
    ratio: RatioTable | None = None
    optical_depth: float | None = None
    oblique_limit: float = np.inf

    def __post_init__(self) -> None:
        known = (("event", EVENTS), ("measure", MEASURES), ("centre", CENTRES), ("factor", FACTORS))
        for key, names in known:
            if getattr(self, key) not in names:
                raise MistrayError(f"lobe: {key} is '{getattr(self, key)}'; use {' or '.join(map(repr, names))}")
        by_angle = self.measure == "angle"
        if by_angle and (self.factor not in ("none", "cosine") or self.ratio is not None or self.centre == "normal"):
            raise MistrayError(
                "lobe: measure 'angle' goes with factor 'none' or 'cosine', no ratio and a specular or retro centre"
            )
        if not by_angle and self.factor == "cosine":
            raise MistrayError("lobe: factor 'cosine' goes with measure 'angle'; leave it out")

    @property
    def anisotropic(self) -> bool:
        """True if the lobe depends on the rotation of the sample about its normal."""
        return self.ratio is not None and self.ratio.anisotropic

    @property
    def fixed(self) -> bool:
        """True if no parameter of the model changes a ratio table of the lobe, or it has none."""
        return self.ratio is None or self.ratio.fixed

    @property
    def r_max(self) -> float:
        """Largest possible distance r, dimensionless, of a scattered direction from the lobe's centre."""
        return 1.0 if self.centre == "normal" else 2.0

    def oblique(self, cos_i: np.ndarray) -> np.ndarray:
        """Return 1/cos θi, limited to `oblique_limit`, for the measure "angle"; 1 for "cosines"."""
        if self.measure == "cosines":
            return np.ones_like(cos_i)
        with np.errstate(divide="ignore"):
            return np.minimum(1 / cos_i, self.oblique_limit)


def factor(name: str, cos_i: Any, cos_s: Any, cos_0: Any, r2: Any) -> Any:
    """
    Return the obliquity or polarisation factor that a `Lobe.factor` names, for arrays of NumPy or Dr.Jit.

    Parameters
    ----------
    name : {"none", "ghs", "rayleigh_rice", "edge", "cosine"}
        Name of the factor.
    cos_i, cos_s, cos_0 : array
        Cosines of the angles of incidence, of scatter and of the specular direction with the normal.
    r2 : array
        Squared distance r² from the centre of the lobe.
    """
    if name == "edge":
        return obliquity(cos_0, cos_s, r2)
    if name == "ghs":
        both = cos_i + cos_s
        return 0.25 * (both * both)
    if name == "cosine":
        return cos_s
    return cos_i * cos_s if name == "rayleigh_rice" else 1.0


class LobeModel(Protocol):
    """
    Interface of a scatter model for the kernel and the plugins.

    Examples
    --------
    >>> from mistray.scatter.abg import ABg
    >>> model = ABg(A=0.0025, B=0.001, g=1.8)
    >>> (lobe,) = model.event_lobes("reflection", 550.0, 1.0, 1.5)
    >>> lobe.profile(np.array([0.01, 0.1])).round(3)  # BSDF in 1/sr at |β - β0|
    array([1.998, 0.148])
    """

    @property
    def name(self) -> str:
        """Name of the scatter model for error messages."""

    def lobes(self, wavelength_nm: float, n_in: float, n_out: float, from_front: bool) -> tuple[Lobe, ...]:
        """
        Return the BSDF lobes for light from one side of the surface; () if none of it scatters.

        Parameters
        ----------
        wavelength_nm : float
            Vacuum wavelength, nm.
        n_in, n_out : float
            Real refractive indices on the side of incidence and on the other side.
        from_front : bool
            Whether the light comes from the front.
        """


@dataclass(frozen=True)
class Placement:
    """
    Options common to all scatter models: event, side of incidence and reference of the total.

    Attributes
    ----------
    event : {"both", "reflection", "transmission"}
        Whether reflected light, transmitted light or both scatter.
    side : {"both", "front", "back"}
        Side from which light must come to scatter.
    relative_to : {"specular", "incident"}
        Reference of the BSDF. A BSDF relative to the specular beam is multiplied by R or T of the coating, and its
        light is taken from that beam. A BSDF relative to the incident light is absolute, and its light is taken from
        the absorbed light.
    name : str
        Name of the model for error messages.

    Examples
    --------
    >>> from mistray.scatter.abg import ABg
    >>> polish = ABg(A=0.0025, B=0.001, g=1.8, event="reflection")
    >>> polish.events(from_front=True)
    ('reflection',)
    >>> polish.changed(A=0.005).values
    {'A': 0.005, 'B': 0.001, 'g': 1.8}
    """

    _: KW_ONLY
    event: str = EVENT.field("both")
    side: str = SIDE.field("both")
    relative_to: str = RELATIVE_TO.field("specular")
    name: str = ""

    also: ClassVar[Mapping[str, Param]] = MappingProxyType({})
    """Properties of the plugin that are not fields, see `of`."""

    def __post_init__(self) -> None:
        check_fields(self, self.title)

    @classmethod
    def params(cls) -> dict[str, Param]:
        """Return the parameters of the model's plugin, by name."""
        return params_of(cls)

    @classmethod
    def param(cls, name: str) -> Param | None:
        """Return the parameter with a given name; None if there is none."""
        return cls.params().get(name)

    @classmethod
    def of(cls, resolve: Callable[[str], str] = str, **properties: Any) -> Self:
        """
        Create the model from the properties of its plugin.

        Parameters
        ----------
        resolve : callable
            Function that makes a path relative to the scene absolute.
        **properties
            Values of `params` by name, and `name`.

        Raises
        ------
        MistrayError
            If a property is missing, unsuitable or out of range.
        """
        needed = [field.name for field in fields(cls) if field.init and field.default is MISSING]
        missing = [name for name in needed if name not in properties]
        if missing:
            raise MistrayError(f"{cls.__name__}: {missing[0]} is missing; give {', '.join(needed)}")
        return cls(**properties)

    @property
    def values(self) -> dict[str, float]:
        """Values of the differentiable parameters of the model, by name, without those that are None."""
        numbers = {name: getattr(self, name) for name, param in self.params().items() if param.moves}
        return {name: number for name, number in numbers.items() if number is not None}

    def lobes(self, wavelength_nm: float, n_in: float, n_out: float, from_front: bool) -> tuple[Lobe, ...]:
        """Return the lobes for light from one side, see `LobeModel.lobes`; () if `side` is the other side."""
        events = self.events(from_front)
        return tuple(lobe for event in events for lobe in self.event_lobes(event, wavelength_nm, n_in, n_out))

    def event_lobes(self, event: str, wavelength_nm: float, n_in: float, n_out: float) -> tuple[Lobe, ...]:
        """Return the lobes of one event, "reflection" or "transmission"; parameters as in `LobeModel.lobes`."""
        raise NotImplementedError

    def changed(self, **values: float) -> Self:
        """Return a copy of the scatter model with other values of its parameters, given by their names."""
        return replace(self, **values)  # type: ignore[arg-type]  # all of its fields are parameters

    @property
    def title(self) -> str:
        """Kind and name of the model, for error messages."""
        kind = type(self).__name__
        return f"{kind} '{self.name}'" if self.name else kind

    @property
    def shares(self) -> tuple[float, float, float]:
        """
        Coefficients c0, c1 and c2 of R or T in the flux of the lobes, see `Lobe`.

        They are 0, 1, 0 for a BSDF relative to the specular beam, and 1, 0, 0 for an absolute one.
        """
        return (0.0, 1.0, 0.0) if self.relative_to == "specular" else (1.0, 0.0, 0.0)

    def events(self, from_front: bool) -> tuple[str, ...]:
        """Return the events in which light from one side scatters: "reflection", "transmission", both, or none."""
        if self.side not in ("both", "front" if from_front else "back"):
            return ()
        return EVENTS if self.event == "both" else (self.event,)
