"""Settings of a trace and their defaults, shared by `mistray.trace`, the integrator plugin and the command line."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

from mistray.errors import MistrayError, refuse_unknown
from mistray.named_values import named_values
from mistray.ranges import (
    AIMED_RAYS,
    CONSECUTIVE,
    EVENTS,
    LIMIT,
    NOT_NEGATIVE,
    RAYS,
    RAYS_PER_HIT,
    SEED,
    SEGMENTS,
    THRESHOLD,
    Demand,
    Words,
    check_fields,
)

BATCHES = 32  # of start rays, each a sample of the whole beam, for standard errors
NO_LIMIT = int(LIMIT.high)
OPERATIONS = "TRIMtrA"  # what light may do at a surface, see `Settings.ray_control`
RAY_CONTROLS = {"allow_all": OPERATIONS, "transmit_specular": "TIMA", "reflect_specular": "RIMA", "halt_all": "A"}
BRANCHES = {
    "R": "specular_reflection",
    "T": "specular_transmission",
    "r": "scattered_reflection",
    "t": "scattered_transmission",
    "A": "absorption",
}  # letters of the branches that `cut_below` tells apart, in its order; what a medium scatters is transmitted
LARGEST = 1e30  # threshold: the kernel has float32
MAX_SEGMENTS = 1 << 19  # a second of a core, also where each segment scatters


class RayControl(Demand):
    """Condition on `Settings.ray_control`: a name of `RAY_CONTROLS`, or letters of `OPERATIONS`."""

    demand = f"must be one of {', '.join(RAY_CONTROLS)}, or letters of {', '.join(OPERATIONS)}"
    also = ({"enum": [*RAY_CONTROLS]}, {"type": "string", "pattern": f"^[ ,]*[{OPERATIONS}][{OPERATIONS} ,]*$"})

    def check(self, name: str, value: Any, owner: str = "") -> str:
        """
        Return the name of a ray control, else its letters in the order of `OPERATIONS`.

        Letters that have a name give the name. Raise `MistrayError` for anything else.
        """
        if isinstance(value, str) and value in RAY_CONTROLS:
            return str(value)
        letters = value.replace(",", "").replace(" ", "") if isinstance(value, str) else ""
        if not letters or set(letters) - set(OPERATIONS):
            names = ", ".join(map(repr, RAY_CONTROLS))
            raise MistrayError(f"{name} is {value!r}; use {names}, or letters of {', '.join(OPERATIONS)} such as 'TIA'")
        ordered = "".join(letter for letter in OPERATIONS if letter in letters)
        return next((key for key, allowed in RAY_CONTROLS.items() if allowed == ordered), ordered)


class ByBranch(Demand):
    """Condition on a set of flux thresholds, one per kind of branch, in any form that `Settings.cut_below` allows."""

    demand = f"must be numbers for {', '.join(BRANCHES)}, as in 'R=1e-6, t=1e-9'"
    metavar = "LIST"
    _number: Mapping[str, Any] = {"type": "number", "minimum": NOT_NEGATIVE.low, "maximum": NOT_NEGATIVE.high}
    also = (
        {"type": "string", "pattern": f"^([ ,]*[{''.join(BRANCHES)}]=[^ ,]+)*[ ,]*$"},
        {"type": "object", "propertyNames": {"enum": [*BRANCHES]}, "additionalProperties": _number},
        {"type": "array", "items": _number, "minItems": len(BRANCHES), "maxItems": len(BRANCHES)},
    )

    def check(self, name: str, value: Any, owner: str = "") -> tuple[float, ...]:
        """
        Return flux thresholds as a tuple in the order of `BRANCHES`, relative to a start ray or in W, as given.

        A branch that a mapping or string leaves out has 0. Raise `MistrayError` for an unknown branch, a wrong number
        of values, or one that is not a number ≥ 0.
        """
        given = value
        letters = ", ".join(BRANCHES)
        if isinstance(given, str):
            given = named_values(given.replace(",", " ").split(), name, like="R=1e-6, t=1e-9")
        if isinstance(given, Mapping):
            unknown = [str(letter) for letter in given if letter not in BRANCHES]
            if unknown:
                raise MistrayError(f"{name} has '{unknown[0]}'; its branches are {letters}, as in 'R=1e-6, t=1e-9'")
            given = [given.get(letter, 0.0) for letter in BRANCHES]
        try:
            found = tuple(float(number) for number in given)
        except (TypeError, ValueError):
            raise MistrayError(f"{name} is {given!r}; give a number for {letters}, as in 'R=1e-6, t=1e-9'") from None
        if len(found) != len(BRANCHES):
            raise MistrayError(f"{name} has {len(found)} numbers; give one for each of {letters}")
        for letter, number in zip(BRANCHES, found, strict=True):
            NOT_NEGATIVE.check(f"{name} of {letter}", number)
        return found


CONTROL, BY_BRANCH = RayControl(), ByBranch()
NOTHING_CUT = (0.0,) * len(BRANCHES)


@dataclass(frozen=True)
class Settings:
    """
    Settings of a trace: numbers of rays, limits of the ray tree, sampling and polarisation.

    Attributes
    ----------
    rays : int
        Number of start rays of all sources together.
    max_reflections : int
        Largest number of reflections along a path. Total internal reflections and reflections at surfaces declared
        ``mirror`` do not count.
    max_scatters : int
        Largest number of scatter events along a path. With 0, surfaces only reflect and refract, and scattered light is
        lost.
    max_optical_scatters : int
        Largest number of scatter events along a path that are at transmitting surfaces.
    max_random_scatters : int
        Largest number of scatter events along a path that are not aimed at a target. Beyond it, hits send only aimed
        rays, and light scattered elsewhere is lost; `Energy.cut` lists it under "max_scatters".
    max_generations : int
        Largest number of reflections and scatter events together along a path.
    max_events : int
        Largest number of surfaces met along a path, including the detector; 1 … 1000.
    max_consecutive : int
        Largest number of consecutive hits on one surface; a ray that would meet it once more ends.
    max_segments : int
        Largest number of ray segments in the tree of one start ray, 1 … 2³²-1. The rest of a larger tree is cut.
        `Energy.cut` lists it, together with the light of such a tree that `max_events` cuts.
    scatter_rays : int
        Number of rays that each hit scatters at random from the BSDF.
    aimed_rays : int
        Number of rays that each hit scatters towards the automatic targets, for reflection and transmission each.
    aim : {"auto", "targets", "none"}
        Targets of scattered rays. "auto": targets of the scene, and automatic ones for surfaces without any. "targets":
        only targets of the scene. "none": no target, also for rays of sources. The choice changes only the standard
        error.
    cut_below : tuple of five float
        Smallest flux of branches relative to the start ray: specular reflection, specular transmission, scattered
        reflection, scattered transmission, and absorption by a surface. Weaker branches are cut, before and after
        scatter, and `Energy.cut` lists them by kind. Give five numbers, a mapping from the letters R, T, r, t and A, or
        a string such as "R=1e-6, t=1e-9"; missing letters are 0, which cuts nothing. A scattered branch is one ray, and
        it is weaker the more rays are sent. So unlike `scatter_threshold` this changes the result. Absorption that is
        cut is recorded at no surface, and such a hit of the detector does not count. Absorption within a medium is
        always recorded.
    cut_below_W : tuple of five float
        Smallest flux of branches as in `cut_below`, but in W, for forward traces.
    flux_threshold : float
        Flux below which a ray ends, relative to its start ray; see `below_threshold`.
    scatter_threshold : float
        Threshold relative to the flux with which a ray started, at the source or at its last scatter event. Below it,
        hits scatter with a probability proportional to the flux, and weak branches after a scatter event are followed
        with such a probability. The remaining rays carry more flux. This changes only the standard error; 0 follows all
        rays.
    splitting : {"split", "one"}
        Whether to follow both children at an interface ("split"), or one of them at random ("one").
    below_threshold : {"cut", "roulette"}
        Treatment of a branch below `flux_threshold`: end it and record its flux ("cut"), or play Russian roulette,
        which is unbiased.
    seed : int
        Seed of the random numbers, 0 … 2³²-1.
    ray_control : str
        Allowed interactions at a surface, as letters: T (transmission), R (reflection), I (total internal reflection),
        M (reflection by a surface declared ``mirror``), t (scatter in transmission, also by a medium), r (scatter in
        reflection) and A (absorption). Light of other interactions is cut. Names stand for letters: "allow_all" for
        "TRIMtrA", "transmit_specular" for "TIMA", "reflect_specular" for "RIMA" and "halt_all" for "A". With "halt_all"
        a ray ends at the first surface.
    polarization : {"auto", "unpolarized", "stokes"}
        Treatment of polarisation. "unpolarized": R and T are averaged over both polarisations at every hit. "stokes":
        every branch carries its Stokes vector. "auto" is "stokes" if a source of the scene is polarised. It is, too, if
        a pilot trace finds that this changes a listed path or the stray light by more than 1 %, see
        `mistray.trace.host.polarization_choice`. Otherwise it is "unpolarized".

    Raises
    ------
    MistrayError
        If a value is not allowed.

    Examples
    --------
    >>> settings = mistray.trace.Settings(rays=20_000, max_reflections=1)
    >>> settings.max_events, settings.flux_threshold
    (64, 1e-08)
    """

    rays: int = RAYS.field(1_000_000, "start rays of all sources together")
    max_reflections: int = LIMIT.field(2, "reflections on one path, those of mirrors and TIR not counted")
    max_generations: int = LIMIT.field(NO_LIMIT, "reflections and scatter events together on one path")
    max_events: int = EVENTS.field(64, "surfaces met on one path")
    max_consecutive: int = CONSECUTIVE.field(NO_LIMIT, "hits of one surface in a row on one path")
    max_segments: int = SEGMENTS.field(MAX_SEGMENTS, "ray segments of the tree of one start ray")
    flux_threshold: float = THRESHOLD.field(1e-8, "flux below which a ray ends, relative to its start ray")
    cut_below: Any = BY_BRANCH.field(  # noqa: RUF009  of what cannot change
        NOTHING_CUT,
        "flux below which branches end, relative to the start ray, by kind, such as 'R=1e-6, t=1e-9': R and T "
        "specular, r and t scattered reflection and transmission, A absorption",
    )
    cut_below_W: Any = BY_BRANCH.field(NOTHING_CUT, "the same in W")  # noqa: RUF009
    splitting: str = Words(("split", "one")).field("split", "follow both rays at a surface, or one of them by chance")
    below_threshold: str = Words(("cut", "roulette")).field(
        "cut", "end a ray below the threshold, or play unbiased roulette"
    )
    seed: int = SEED.field(0, "seed of the random numbers")
    ray_control: str = CONTROL.field(
        "allow_all",
        "what light may do at surfaces: allow_all, transmit_specular, reflect_specular, halt_all, or letters of T, R, "
        "I (total reflection), M (mirrors), t and r (scatter) and A (absorption), such as TIA",
    )
    polarization: str = Words(("auto", "unpolarized", "stokes")).field(
        "auto",
        "means of s and p at every hit, or Stokes vectors along paths; auto: Stokes where it changes a listed path by "
        "more than a hundredth",
    )
    max_scatters: int = LIMIT.field(1, "scatter events on one path; 0: none")
    max_optical_scatters: int = LIMIT.field(NO_LIMIT, "those of them at surfaces that transmit")
    max_random_scatters: int = LIMIT.field(NO_LIMIT, "those of them that are not aimed at a target")
    scatter_rays: int = RAYS_PER_HIT.field(1, "rays scattered at random at every hit")
    aimed_rays: int = AIMED_RAYS.field(1, "rays aimed at the targets at every hit, to either side; 0: none")
    aim: str = Words(("auto", "targets", "none")).field(
        "auto", "aim at the detector and targets of the scene, only at these, or not"
    )
    scatter_threshold: float = THRESHOLD.field(
        0.1, "flux below which hits scatter by chance, relative to the ray's start"
    )

    def __post_init__(self) -> None:
        check_fields(self)

    @classmethod
    def of(cls, scene: Any, **given: Any) -> Settings:
        """Return the settings of `unresolved`; "auto" becomes "stokes" for polarised sources, else "unpolarized"."""
        return cls.unresolved(scene, **given).resolved(scene)

    @classmethod
    def without_sources(cls, scene: Any, purpose: str = "", **given: Any) -> Settings:
        """
        Return settings for a trace without the light of the scene's sources, for which "auto" is "unpolarized".

        Parameters
        ----------
        scene : mi.Scene
            Scene to trace.
        purpose : str
            Purpose of the trace, such as "a PST", if a reader could mistake its light for that of the sources.
        **given
            Settings that take precedence over those of the scene's integrator, as for `of`.

        Raises
        ------
        MistrayError
            If there is a purpose, a source is polarised, and `polarization` is "auto"; or as `unresolved` does.
        """
        found = cls.unresolved(scene, **given)
        if found.polarization != "auto":
            return found
        if purpose and (names := polarized_sources(scene)):
            raise MistrayError(
                f"source '{names[0]}' is polarised, and {purpose} is of unpolarised light from elsewhere; give "
                "polarization='unpolarized' to trace that"
            )
        return replace(found, polarization="unpolarized")

    @classmethod
    def unresolved(cls, scene: Any, **given: Any) -> Settings:
        """
        Return the settings of a scene's ``straylight`` integrator, or defaults, with given values unless None.

        Raise `MistrayError` for a value that is unknown or not allowed.
        """
        own = getattr(scene.integrator(), "settings", None) or cls()
        values = {f.name: getattr(own, f.name) for f in fields(cls)}
        refuse_unknown(given, values, "Settings: ")
        return cls(**(values | {key: value for key, value in given.items() if value is not None}))

    def resolved(self, scene: Any) -> Settings:
        """
        Return the settings with the `polarization` "auto" replaced; other settings are returned as they are.

        It becomes "stokes" if a source of the scene is polarised, else "unpolarized".
        """
        if self.polarization != "auto":
            return self
        return replace(self, polarization="stokes" if polarized_sources(scene) else "unpolarized")

    def with_unit(self, unit_W: float) -> Settings:
        """
        Return the settings with `cut_below_W` in units of a start ray's flux, which is `unit_W` watts on average.

        Entries are at most 1e30; of rays without flux nothing is cut. Settings without `cut_below_W` are returned
        unchanged.
        """
        if not any(self.cut_below_W):
            return self
        if not unit_W > 0:
            return replace(self, cut_below_W=NOTHING_CUT)
        return replace(self, cut_below_W=tuple(min(float(one) / float(unit_W), LARGEST) for one in self.cut_below_W))

    @property
    def scatter_limits(self) -> tuple[int, int, int]:
        """Largest numbers of scatter events along a path: in all, at random, and at transmitting surfaces."""
        return self.max_scatters, self.max_random_scatters, self.max_optical_scatters

    @property
    def allowed(self) -> str:
        """Letters of the interactions (such as reflection) that rays may undergo, see `ray_control`."""
        return RAY_CONTROLS.get(self.ray_control, self.ray_control)

    @property
    def limits_consecutive(self) -> bool:
        """True if `max_consecutive` can end a ray before `max_events` does."""
        return self.max_consecutive < self.max_events

    @property
    def tree_limits(self) -> tuple[int, int, int]:
        """Limits of a ray tree: `max_reflections`, `scatter_rays` and `max_segments`."""
        return self.max_reflections, self.scatter_rays, self.max_segments

    @property
    def stokes(self) -> bool:
        """True if rays carry Stokes vectors, that is if `polarization` is "stokes"."""
        return self.polarization == "stokes"


def polarized_sources(scene: Any) -> list[str]:
    """Return the names of the scene's sources whose light is polarised."""
    return [emitter.name for emitter in scene.emitters() if getattr(emitter, "polarized", False)]
