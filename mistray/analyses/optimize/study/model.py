"""Model of a study: terms with their goals, variables with their bounds, coatings and the settings of the optimizer."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, MISSING, asdict, dataclass, replace
from pathlib import Path
from typing import Any

from mistray.analyses.optimize.request import STEPS
from mistray.analyses.optimize.search.nlopt import ALGORITHMS
from mistray.cache import file_fingerprint
from mistray.coatings import Stack
from mistray.errors import MistrayError
from mistray.ranges import (
    ANYTHING,
    EDGE_WIDTH,
    FIELD_DEG,
    FINITE,
    FLAG,
    LAYER_NM,
    POINT_MM,
    POSITIVE,
    TEXT,
    WAVELENGTH_NM,
    WEIGHT,
    ByName,
    Interval,
    OfType,
    Range,
    Several,
    Words,
    check_fields,
)
from mistray.scene.xml_file import possible_names
from mistray.toolkit.fields import Request, field, field_of

LIMITED = ("at_least", "at_most")  # goals
OF_LIGHT = {"field_deg": FIELD_DEG, "wavelength_nm": WAVELENGTH_NM, "weights": WEIGHT}
DESIGN_NM = Range(1.0, 1e9, unit="nm")
COUNT = Range(1, 100, whole=True)
PATIENCE = {"sqp": 3, "lbfgsb": 2, "adam": 10, "nlopt": 10}  # steps, by method
STARTS = 4  # with coatings


@dataclass(frozen=True)
class Term(Request):
    """
    Section ``[[term]]`` of a study: a metric and the goal for its value.

    Examples
    --------
    >>> ghosts = {"kind": "path_power", "selection": "ghost", "goal": "minimise"}
    >>> image = {"kind": "transmission", "goal": "at_least", "limit_of_start": 0.99}
    >>> shift = {"parameters": ["window_front.y"], "low": -0.1, "high": 0.1}
    >>> study = mistray.optimize.read_study({"term": [ghosts, image], "variable": [shift]})
    >>> [(term.name, term.goal) for term in study.terms]
    [('path_power', 'minimise'), ('transmission', 'at_least')]
    """

    name: str = field(TEXT, MISSING, "name for tables and messages; without it the kind")
    kind: Any = field(
        OfType(object, "must be a kind of term"),
        MISSING,
        "see below; from Python also a function that takes a scene and the settings of its traces",
    )
    goal: str = field(
        Words(("minimise", *LIMITED, "keep")),
        "minimise",
        'goal for the value: `"minimise"`, `"at_least"` or `"at_most"` a limit, `"keep"` as it is at the start',
    )
    weight: float = field(POSITIVE, 1.0, "weight of the term in the merit")
    limit: float | None = field(FINITE, None, 'for `"at_least"` and `"at_most"`: the limit, in the unit of the term')
    limit_of_start: float | None = field(FINITE, None, "instead of `limit`: times the value at the start")
    tolerance: float = field(
        POSITIVE,
        0.01,
        "width of the zone inside the limit in which the penalty grows from 0 to `weight`, relative to the limit; for "
        '`"keep"` the relative change at which it is `weight`',
    )
    floor_of_start: float = field(
        POSITIVE,
        1e-15,
        'for `"minimise"`: what lies so far below the start is dark enough; 0 is fine, as with a baffle that leaves no '
        "ray",
    )
    worst: str = field(
        Words(("none", "field", "wavelength", "both")),
        "none",
        '`"field"`, `"wavelength"` or `"both"`: the number at the worst of its fields, of its wavelengths or of all '
        "pairs, and not that of all together",
    )
    own: Mapping[str, Any] = dataclasses.field(default_factory=dict)  # arguments of the kind, such as `coatings`
    traced: Mapping[str, Any] = dataclasses.field(default_factory=dict)  # light, and arguments of `mistray.trace`

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, example in (("own", "{'selection': 'ghost'}"), ("traced", "{'rays': 10_000}")):
            ByName(ANYTHING, example).check(name, getattr(self, name))
        light = {key: self.traced[key] for key in OF_LIGHT if self.traced.get(key) is not None}  # one or several
        several = {key: tuple(OF_LIGHT[key].check_each(key, value)) for key, value in light.items()}
        object.__setattr__(self, "traced", {**self.traced, **several})
        given = [key for key in ("limit", "limit_of_start") if getattr(self, key) is not None]
        if self.goal in LIMITED and len(given) != 1:
            what = f"{given[1]} is one limit too many" if given else "limit is missing"
            raise MistrayError(f'{what}; with goal = "{self.goal}" give limit or limit_of_start')
        if self.goal not in LIMITED and given:
            raise MistrayError(f'{given[0]} has no meaning with goal = "{self.goal}"; remove it')
        if self.goal == "keep" and self.worst != "none":
            raise MistrayError(f'worst = "{self.worst}" has no meaning with goal = "keep"; give a limit')


@dataclass(frozen=True)
class Moved(Request):
    """
    Scene parameter that a variable of a study moves, with the factor from variable to parameter, and a pivot, mm.

    Examples
    --------
    >>> rear = mistray.optimize.Moved("L2_rear.curvature", factor=-1.0)  # it bends the other way
    >>> rear.factor, rear.entry
    (-1.0, None)
    """

    key: str = field(
        TEXT,
        MISSING,
        "a key of `mi.traverse(scene)`, a pattern, a name of `mistray.optimize.groups`, or the displacement or tilt of "
        'a part, such as `"L6.tilt_x"`. An entry of a list is `"AR.thickness_nm[2]"`, the first is 0',
    )
    entry: int | None = None  # of a parameter that is a list, the first is 0; None: all entries
    factor: float = field(FINITE, 1.0, "how far it moves with the variable, not 0")
    pivot: tuple[float, ...] | None = field(
        POINT_MM, None, "point of the world about which a part is tilted, mm; without it the middle of its box"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.factor == 0:
            raise MistrayError("factor is 0; the parameter would not move, leave it out")


@dataclass(frozen=True)
class VariableGroup(Request):
    """
    Section ``[[variable]]`` of a study: parameters that move together, and the bounds of their value.

    Examples
    --------
    >>> moved = mistray.optimize.Moved("L2_front.curvature"), mistray.optimize.Moved("L2_rear.curvature", factor=-1.0)
    >>> bending = mistray.optimize.VariableGroup("bending", moved, low=-0.05, high=-0.03)
    >>> len(bending.parameters), bending.each
    (2, False)
    """

    name: str | None = field(TEXT, MISSING, "name for tables and messages; without it the first key")
    parameters: tuple[Moved, ...] = field(
        Several(OfType(Moved, 'must be keys or patterns, ["vane_*.r0"] say')),
        MISSING,
        "what it moves: texts, or tables with the keys of `parameters` below",
    )
    low: float = field(FINITE, MISSING, "least value of every parameter over its factor, in the parameter's unit")
    high: float = field(FINITE, MISSING, "greatest value")
    scale: str = field(
        Words(("linear", "log")),
        "linear",
        'parameters move together by differences, or with `"log"` by ratios, for what is known by its order of '
        "magnitude",
    )
    each: bool = field(FLAG, False, "every parameter is a variable of its own")

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.low < self.high:
            raise MistrayError(f"low is {self.low:g} and high is {self.high:g}; low must be less than high")
        if self.scale == "log" and self.low <= 0:
            raise MistrayError(f'low is {self.low:g}; with scale = "log" it must be greater than 0')
        if self.scale == "log" and any(moved.factor != 1 for moved in self.parameters):
            raise MistrayError('parameters has a factor; with scale = "log" parameters move by ratios, without factors')


@dataclass(frozen=True)
class CoatingKeys(Request):
    """Section ``[[coating]]`` of a study as written: surfaces, start design and bounds of its thicknesses, nm."""

    _: KW_ONLY
    name: str = field(TEXT, MISSING, "id of the coating in the scene; without it `coating_1`, …")
    surfaces: tuple[str, ...] | None = field(
        Several(TEXT),
        MISSING,
        'shape ids, or `"all"`: every transparent surface between air and something denser; cemented surfaces, edges '
        "and bevels (`frustum`) are not among them",
    )
    layers: str | None = field(
        TEXT,
        None,
        "design to start from, as in a `thinfilm` (docs/coatings.md); files of materials are sought beside the study",
    )
    preset: str | None = field(TEXT, None, "instead of `layers`: a design by name")
    design_nm: float = field(DESIGN_NM, 550.0, "wavelength of thicknesses in waves and of presets, nm")
    first: str | None = field(TEXT, None, 'where the first of `layers` lies; without it `"outside"`')
    thickness_nm: Any = field(
        OfType(object, "must be a range"),
        MISSING,
        "least and greatest thickness of every layer, or one such pair for each, nm; the start must lie within",
    )


STACK = OfType(Stack, "must be a mistray.coatings.Stack")


@dataclass(frozen=True)
class CoatingGroup:
    """
    Coating of a study: a design that some surfaces share; its thicknesses are variables.

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

    Raises
    ------
    MistrayError
        If a value is impossible, `bounds_nm` has another number of pairs than the start has layers, or a layer starts
        outside its bounds.

    Examples
    --------
    >>> start = mistray.coatings.preset("mgf2_quarter_wave")
    >>> coating = mistray.optimize.CoatingGroup("ar", ("L1_front", "L1_rear"), start, ((60.0, 150.0),))
    >>> [layer.material for layer in coating.start.layers]
    ['1.38']
    """

    name: str
    surfaces: tuple[str, ...] | None = Several(TEXT).field()
    start: Stack = STACK.field()  # noqa: RUF009  of what cannot change
    bounds_nm: tuple[tuple[float, float], ...] = Several(Interval(LAYER_NM)).field()
    design_nm: float = field_of(CoatingKeys, "design_nm", CoatingKeys.design_nm)

    def __post_init__(self) -> None:
        owner = f"coating '{self.name}'"
        check_fields(self, owner)
        if len(self.bounds_nm) != len(self.start.layers):
            raise MistrayError(
                f"{owner}: bounds_nm has {len(self.bounds_nm)} pairs for {len(self.start.layers)} layers; give one for "
                "each layer"
            )
        for k, (layer, (low, high)) in enumerate(zip(self.start.layers, self.bounds_nm, strict=True), start=1):
            if not low <= layer.thickness_nm <= high:
                raise MistrayError(
                    f"{owner}: its bounds are {low:g} … {high:g} nm, but layer {k} ({layer.material}) starts with "
                    f"{layer.thickness_nm:g} nm; widen the bounds or change the start"
                )


@dataclass(frozen=True)
class Optimizer(Request):
    """
    Section ``[optimizer]`` of a study: search method, numbers of steps and starts, and criteria for the end.

    Examples
    --------
    >>> optimizer = mistray.optimize.Optimizer(steps=10, starts=4)
    >>> optimizer.method, optimizer.seeds
    ('lbfgsb', 'fixed')
    """

    method: str = field(
        Words(tuple(PATIENCE)),
        "lbfgsb",
        'the default is `"sqp"` if a term has a limit or is kept; also `"adam"`, and `"nlopt"` '
        "(`pip install 'mistray[nlopt]'`)",
    )
    algorithm: str = field(
        Words(ALGORITHMS), "LD_MMA", f"method of NLopt: {', '.join(f'`{one}`' for one in ALGORITHMS)}"
    )
    steps: int = field(STEPS, 40, "most steps of the search from each start; with NLopt every evaluation is one")
    step_size: float = field(
        Range(1e-6, 1.0),
        0.02,
        "share of the way from bound to bound: largest move in the first trial of SQP and L-BFGS-B, length of Adam's "
        "steps, initial step of NLopt",
    )
    decay: float = field(Range(0.1, 1.0), 1.0, "each step of Adam is so many times as long as the one before")
    tolerance: float = field(
        Range(0.0, 1.0), 1e-3, "a search ends when `patience` steps have lowered the merit by less than this; 0: never"
    )
    patience: int = field(
        Range(1, 1000, whole=True),
        PATIENCE["lbfgsb"],
        f"number of these steps; the default is {PATIENCE['sqp']} with SQP, {PATIENCE['adam']} with Adam and NLopt",
    )
    seeds: str = field(
        Words(("fixed", "fresh")), "fixed", 'the same rays at every evaluation, or `"fresh"` ones (Adam only)'
    )
    seed: int = field(Range(0, 2**31, whole=True), 0, "seed of the rays; the verification takes the seeds that follow")
    starts: int = field(
        COUNT, 1, f"starts that are evaluated, the given one among them; with `[[coating]]` the default is {STARTS}"
    )
    searches: int = field(COUNT, 1, "number of starts, the best ones, from which a search begins")
    edge_width: float | None = field(
        EDGE_WIDTH,
        None,
        "width of the zones at rims (docs/gradients.md), over their radii; without it the first gradient takes that of "
        "the least error, and all searches keep it",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
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
        Metrics with their goals.
    variables : tuple of VariableGroup
        Parameters that are varied, with their bounds.
    coatings : tuple of CoatingGroup
        Coatings that are varied.
    optimizer : Optimizer
        Settings of the search.

    Raises
    ------
    MistrayError
        If a value is of another type, or two terms or two coatings have one name.

    Examples
    --------
    >>> term = {"kind": "path_power", "selection": "ghost", "goal": "minimise"}
    >>> shift = {"parameters": ["window_front.y"], "low": -0.1, "high": 0.1}
    >>> study = mistray.optimize.read_study({"term": [term], "variable": [shift]})
    >>> study.variables[0].high, study.optimizer.method
    (0.1, 'lbfgsb')
    """

    name: str
    terms: tuple[Term, ...] = Several(OfType(Term, "must be a Term, or several")).field()
    variables: tuple[VariableGroup, ...] = Several(
        OfType(VariableGroup, "must be a VariableGroup, or several"), least=0
    ).field(())
    coatings: tuple[CoatingGroup, ...] = Several(
        OfType(CoatingGroup, "must be a CoatingGroup, or several"), least=0
    ).field(())
    optimizer: Optimizer = Optimizer()

    def __post_init__(self) -> None:
        owner = f"study '{self.name}'"
        check_fields(self, owner)
        check_names(self.terms, self.coatings, owner)

    @property
    def fingerprint(self) -> str:
        """
        Hash (SHA-256, hexadecimal) of all settings that must agree to resume a search.

        The name of the study, and steps, searches, tolerance and patience of the optimizer may differ. Files of the
        materials of layers must have the same content.
        """
        optimizer = replace(self.optimizer, steps=0, searches=1, tolerance=0.0, patience=1)
        content = asdict(replace(self, name="", optimizer=optimizer))
        materials = {layer.material for group in self.coatings for layer in group.start.layers}
        files = {Path(name) for material in materials for name in possible_names(material) if os.path.isfile(name)}
        content["files"] = [file_fingerprint(path) for path in sorted(files)]
        return hashlib.sha256(json.dumps(content, sort_keys=True, default=_named).encode()).hexdigest()


def check_names(terms: Sequence[Term], coatings: Sequence[CoatingGroup], owner: str) -> None:
    """Raise `MistrayError` if two terms or two coatings have one name."""
    for what, names in (("term", [term.name for term in terms]), ("coating", [one.name for one in coatings])):
        for one in names:
            if names.count(one) > 1:
                raise MistrayError(f"{owner}: {what}.name '{one}' is given twice; give every {what} a name of its own")


Study = DesignStudy  # its name before version 0.3


def _named(kind: Any) -> str:
    """Return the module and name of a function, by which a study's fingerprint identifies it."""
    return f"{getattr(kind, '__module__', '')}.{getattr(kind, '__qualname__', kind)}"
