"""Model of a study: terms with their goals, variables with their bounds, coatings and the settings of the optimizer."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from mistray.analyses.design.request import STEPS
from mistray.analyses.design.search.nlopt import ALGORITHMS
from mistray.coatings import Stack
from mistray.errors import MistrayError
from mistray.ranges import EDGE_WIDTH, FINITE, FLAG, POSITIVE, TEXT, Range, Words, check_fields

LIMITED = ("at_least", "at_most")  # goals
DESIGN_NM = Range(1.0, 1e9, unit="nm")
COUNT = Range(1, 100, whole=True)
PATIENCE = {"sqp": 3, "lbfgsb": 2, "adam": 10, "nlopt": 10}  # steps, by method
STARTS = 4  # with coatings


@dataclass(frozen=True)
class Term:
    """
    Section ``[[term]]``: a metric and the goal for its value.

    Attributes
    ----------
    name : str
    kind : str or callable
        A key of `mistray.analyses.design.study.terms.KINDS`; or, from Python, a function that takes a scene and the
        settings of `traced` with a `seed`, and returns a `Metric`.
    goal : {"minimise", "at_least", "at_most", "keep"}
    weight : float
        Weight of the term in the merit, greater than 0.
    limit, limit_of_start : float or None
        For "at_least" and "at_most" one of the two: the least or greatest value in the unit of the term, or as a
        multiple of the value at the start.
    tolerance : float
        Width of the zone inside the limit in which the penalty grows from 0 to `weight`, relative to the limit; for
        "keep" the relative change at which it is `weight`. Greater than 0.
    floor_of_start : float
        For "minimise": share of the value at the start below which further reduction hardly counts, so that 0 has a
        finite merit. Greater than 0.
    worst : {"none", "field", "wavelength", "both"}
        Whether the term is the value at the worst of its fields, wavelengths or pairs of both, instead of that of all
        together. It is a smooth maximum, for "at_least" a smooth minimum, see `smooth_maximum`. Weights are ignored.
    own : mapping
        Arguments of the kind, such as `paths` or `coatings`.
    traced : mapping
        `field_deg`, `wavelength_nm`, `weights` and arguments of `mistray.trace` except `seed`.
    """

    name: str
    kind: Any
    goal: str = Words(("minimise", *LIMITED, "keep")).field("minimise")
    weight: float = POSITIVE.field(1.0)
    limit: float | None = FINITE.field(None)
    limit_of_start: float | None = FINITE.field(None)
    tolerance: float = POSITIVE.field(0.01)
    floor_of_start: float = POSITIVE.field(1e-15)
    worst: str = Words(("none", "field", "wavelength", "both")).field("none")
    own: Mapping[str, Any] = field(default_factory=dict)
    traced: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_fields(self)
        given = [key for key in ("limit", "limit_of_start") if getattr(self, key) is not None]
        if self.goal in LIMITED and len(given) != 1:
            what = f"{given[1]} is one limit too many" if given else "limit is missing"
            raise MistrayError(f'{what}; with goal = "{self.goal}" give limit or limit_of_start')
        if self.goal not in LIMITED and given:
            raise MistrayError(f'{given[0]} has no meaning with goal = "{self.goal}"; remove it')
        if self.goal == "keep" and self.worst != "none":
            raise MistrayError(f'worst = "{self.worst}" has no meaning with goal = "keep"; give a limit')


@dataclass(frozen=True)
class Moved:
    """
    Parameters of a scene that a variable moves.

    Attributes
    ----------
    key : str
        A key of ``mi.traverse(scene)``, a pattern as of `fnmatch`, a name of `mistray.optimize.groups`, or the
        displacement or tilt of one of `mistray.metrics.bodies`, such as "L6.tilt_x".
    entry : int or None
        Index of an entry of a parameter that is a list; 0 is the first. None: all entries.
    factor : float
        Change of the parameters per change of the variable; not 0.
    pivot : (3,) float, optional
        Point in world coordinates about which a body is tilted, mm, see `mistray.metrics.bodies`.
    """

    key: str = TEXT.field()
    entry: int | None = None
    factor: float = FINITE.field(1.0)
    pivot: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        if self.factor == 0:
            raise MistrayError("factor is 0; the parameter would not move, leave it out")


@dataclass(frozen=True)
class VariableGroup:
    """
    Section ``[[variable]]``: parameters that move together, with their bounds.

    Attributes
    ----------
    name : str or None
        Name of the variable; None: the first parameter's key.
    parameters : tuple of Moved
    low, high : float
        Least and greatest value of every parameter over its factor, in the parameter's unit.
    scale : {"linear", "log"}
        Whether parameters move together by differences or by ratios.
    each : bool
        Every parameter is a variable of its own.
    """

    name: str | None
    parameters: tuple[Moved, ...]
    low: float = FINITE.field()
    high: float = FINITE.field()
    scale: str = Words(("linear", "log")).field("linear")
    each: bool = FLAG.field(False)

    def __post_init__(self) -> None:
        check_fields(self)
        if not self.low < self.high:
            raise MistrayError(f"low is {self.low:g} and high is {self.high:g}; low must be less than high")
        if self.scale == "log" and self.low <= 0:
            raise MistrayError(f'low is {self.low:g}; with scale = "log" it must be greater than 0')
        if self.scale == "log" and any(moved.factor != 1 for moved in self.parameters):
            raise MistrayError('parameters has a factor; with scale = "log" parameters move by ratios, without factors')


@dataclass(frozen=True)
class CoatingGroup:
    """
    Section ``[[coating]]``: a design shared by some surfaces; its layer thicknesses are variables.

    Attributes
    ----------
    name : str
        Id of the coating in the scene.
    surfaces : tuple of str or None
        Ids of shapes; None: every transparent optical surface in air.
    start : Stack
        Design to start from.
    bounds_nm : tuple of (float, float)
        Smallest and largest thickness of each layer, nm.
    design_nm : float
        Wavelength at which the start design was made, nm.
    """

    name: str
    surfaces: tuple[str, ...] | None
    start: Stack
    bounds_nm: tuple[tuple[float, float], ...]
    design_nm: float = DESIGN_NM.field(550.0)


@dataclass(frozen=True)
class Optimizer:
    """
    Section ``[optimizer]``: method of the search and its settings.

    Attributes
    ----------
    method : {"sqp", "lbfgsb", "adam", "nlopt"}
    algorithm : str
        Algorithm of NLopt.
    steps : int
        Largest number of steps of the search from each start.
    step_size : float
        Step as a share of the way from bound to bound. It is the largest move in the first trial of "sqp" and "lbfgsb",
        the length of the steps of "adam", and the initial step of "nlopt". 0 … 1.
    decay : float
        Ratio of the length of a step of "adam" to that of the step before, 0.1 … 1.
    tolerance : float
        A search ends when `patience` steps have lowered the merit by less than this; 0: when the steps are used up.
    patience : int
        Number of steps that `tolerance` refers to, at least 1.
    seeds : {"fixed", "fresh"}
        Whether all evaluations trace the same rays or each traces others ("adam" only).
    seed : int
        Seed of the rays; the verification takes the seeds that follow.
    starts : int
        Number of starts that are evaluated, the given one included; 1 … 100.
    searches : int
        Number of starts, the best ones, from which a search begins; 1 … 100.
    edge_width : float or None
        Width of the smoothing zones at rims, over the radii of the rims, as for `mistray.gradient`. None: the first
        evaluation that meets rims takes the one with the least error, and the searches keep it.
    """

    method: str = Words(tuple(PATIENCE)).field("lbfgsb")
    algorithm: str = Words(ALGORITHMS).field("LD_MMA")
    steps: int = STEPS.field(40)
    step_size: float = Range(1e-6, 1.0).field(0.02)
    decay: float = Range(0.1, 1.0).field(1.0)
    tolerance: float = Range(0.0, 1.0).field(1e-3)
    patience: int = Range(1, 1000, whole=True).field(PATIENCE["lbfgsb"])
    seeds: str = Words(("fixed", "fresh")).field("fixed")
    seed: int = Range(0, 2**31, whole=True).field(0)
    starts: int = COUNT.field(1)
    searches: int = COUNT.field(1)
    edge_width: float | None = EDGE_WIDTH.field(None)

    def __post_init__(self) -> None:
        check_fields(self)
        if self.seeds == "fresh" and self.method != "adam":
            raise MistrayError(
                f'seeds is \'fresh\', which method = "{self.method}" cannot work with; take "fixed", or method = "adam"'
            )


@dataclass(frozen=True)
class DesignStudy:
    """
    Design study: terms of the merit, variables with their bounds, coatings and optimizer.

    Attributes
    ----------
    name : str
        File or other name, for messages.
    terms : tuple of Term
    variables : tuple of VariableGroup
    coatings : tuple of CoatingGroup
    optimizer : Optimizer
    """

    name: str
    terms: tuple[Term, ...]
    variables: tuple[VariableGroup, ...] = ()
    coatings: tuple[CoatingGroup, ...] = ()
    optimizer: Optimizer = Optimizer()

    @property
    def fingerprint(self) -> str:
        """Return a hash of all that must agree to resume a search; name and settings of its length may differ."""
        optimizer = replace(self.optimizer, steps=0, searches=1, tolerance=0.0, patience=1)
        content = asdict(replace(self, name="", optimizer=optimizer))
        return hashlib.sha256(json.dumps(content, sort_keys=True, default=_named).encode()).hexdigest()


Study = DesignStudy  # its name before version 0.3


def _named(kind: Any) -> str:
    """Return the qualified name of a function, by which a fingerprint contains it."""
    return f"{getattr(kind, '__module__', '')}.{getattr(kind, '__qualname__', kind)}"
