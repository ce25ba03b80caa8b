"""Rules that assign coatings, paint and scatter models to surfaces of a system by patterns of names."""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

from mistray.coatings import fitted_preset, layer_text
from mistray.errors import MistrayError, errors_of
from mistray.ids import fits, plain_name
from mistray.materials import resolved
from mistray.mechanics.finish import Finish, finish, known_finishes
from mistray.prescription.by_text import CLEAN, coating_of, scatter_of
from mistray.prescription.closing.names import renamed_in
from mistray.prescription.coating import BLACK, Coating
from mistray.prescription.geometry import is_gas
from mistray.prescription.scatter import Scatter
from mistray.ranges import ANYTHING, ByName
from mistray.scatter.kinds import KINDS

OFFERED = 5  # names in a message about a pattern that fits none
VISIBLE_NM = (380.0, 780.0)
OPAQUE, CEMENTED = "is opaque", "lies in cement"

CoatingRules = Mapping[str, str | Coating | None]
PaintRules = Mapping[str, str | float | Finish]
ScatterRules = Mapping[str, str | Scatter | Sequence[str | Scatter]]
EXAMPLES = {
    "coatings": "{'L1': 'bbar3'}",
    "paint": "{'barrel': 'flat_black'}",
    "scatter": "{'L1': 'harvey_shack rms_nm=4'}",
}
_NONE: Mapping[str, Any] = MappingProxyType({})


@dataclass(frozen=True)
class Rules:
    """
    Coatings, paint and scatter models, keyed by patterns of names of surfaces or parts; see `mistray.scene.coat`.

    Attributes
    ----------
    coatings, paint, scatter : mapping
        Pattern → coating, paint or scatter models.

    Examples
    --------
    >>> rules = mistray.scene.Rules(coatings={"L1": "bbar3"}, paint={"barrel": 0.03})
    >>> coated = mistray.scene.write_coated("cooke_triplet", "coated.xml", rules)
    >>> sorted(coated.changes)[:3]
    ['L1_front', 'L1_rear', 'barrel_1_wall']
    """

    coatings: CoatingRules = field(default_factory=dict)
    paint: PaintRules = field(default_factory=dict)
    scatter: ScatterRules = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, example in EXAMPLES.items():
            ByName(ANYTHING, example).check(name, getattr(self, name))

    def __bool__(self) -> bool:
        return bool(self.coatings or self.paint or self.scatter)


@dataclass(frozen=True)
class Face:
    """
    Properties of a surface that the rules depend on.

    Attributes
    ----------
    name : str
        Name of the surface.
    part : str or None
        Part that the surface belongs to.
    opaque : bool
        Whether its coating transmits no light.
    mirror : bool
        Whether the surface is a declared mirror of the design path.
    cemented : bool
        Whether there is a gas on neither side.
    fault : str
        Reason why nothing can be put on it; empty if there is none.
    front, back : str
        Materials on its sides.
    """

    name: str
    part: str | None = None
    opaque: bool = False
    mirror: bool = False
    cemented: bool = False
    fault: str = ""
    front: str = "air"
    back: str = "air"

    def fits(self, pattern: str) -> bool:
        """True if a pattern matches the name of the surface or of its part."""
        return fits(self.name, pattern) or (self.part is not None and fits(self.part, pattern))


@dataclass(frozen=True)
class Change:
    """
    Change of the coating and the scatter models of a surface.

    Attributes
    ----------
    recoated : bool
        Whether its coating is replaced by `coating`.
    coating : Coating or None
        New coating, if `recoated`; None means bare.
    scatter : tuple of Scatter
        Scatter models that are added.
    drops : frozenset of str
        Kinds of its scatter models that are removed.
    """

    recoated: bool = False
    coating: Coating | None = None
    scatter: tuple[Scatter, ...] = ()
    drops: frozenset[str] = frozenset()


@dataclass(frozen=True)
class Left:
    """Surface that a rule leaves as it is although it matches the pattern; `why` is the reason, as "is opaque"."""

    surface: str
    pattern: str
    why: str


class Painter:
    """
    Application of rules for coatings, paint and scatter to the surfaces of a system.

    Parameters
    ----------
    where : str
        Name of the system, for messages.
    faces : sequence of Face
        Surfaces of the system.
    shared : mapping of str to Coating or Scatter
        Named coatings and scatter models of the system.
    taken : collection of str
        Names that new coatings and models must not have.
    beside : callable
        Function from the name of a file in the system to its path from the current folder.
    light_nm : sequence of float
        Wavelengths of the system's light, nm. If none is visible, layer thicknesses in waves refer by default to the
        middle of their range.
    provenance : str
        Provenance of the lens file that the system comes from. It says which names of that file were changed on import.

    Attributes
    ----------
    changes : dict of str to Change
        Changes, keyed by the name of the surface.
    left : list of Left
        Surfaces that a rule leaves as they are although they match its pattern.
    notes : list of str
        Notes on the reflectance of presets on the substrates that they are put on.
    """

    def __init__(
        self,
        where: str,
        faces: Sequence[Face],
        shared: Mapping[str, Coating | Scatter],
        taken: Collection[str],
        beside: Callable[[str], str] = str,
        light_nm: Sequence[float] = (),
        provenance: str = "",
    ) -> None:
        self.changes: dict[str, Change] = {}
        self.left: list[Left] = []
        self.notes: list[str] = []
        self._design_nm = _design_nm(light_nm)
        self._where, self._faces, self._beside, self._provenance = where, faces, beside, provenance
        self._coatings = {name: item for name, item in shared.items() if isinstance(item, Coating)}
        self._scatter = {name: item for name, item in shared.items() if isinstance(item, Scatter)}
        self._shared: dict[str, Coating | Scatter] = dict(shared)
        self._taken = {*taken, *shared}

    def apply(self, rules: Rules) -> None:
        """
        Determine the changes to all surfaces: later patterns override earlier ones, and paint overrides coatings.

        Scatter models come last.

        Raises
        ------
        MistrayError
            If a pattern matches no surface, or none that can take the coating or model, or a coating, paint or model
            is unknown or not valid.
        """
        for pattern, given in rules.coatings.items():
            wanted = coating_of(given, self._coatings, self._design_nm) if isinstance(given, str) else given
            rule = f"coating '{pattern}={_shown(given)}'"
            named = not isinstance(given, str) or given in self._coatings
            by_body = not named and wanted is not None and wanted.preset is not None
            coating = None if by_body else self._named(wanted)
            for face in self._able(pattern, rule, not self._closed(wanted), True):
                change = self.changes.get(face.name, Change())
                on = self._named(self._on_body(wanted, face, rule)) if by_body else coating
                self.changes[face.name] = replace(change, recoated=True, coating=on)
        for pattern, paint in rules.paint.items():
            look = self._finish(paint)
            coating = self._named(look.coating)
            models = tuple(self._named(model) for model in look.scatter)
            for face in self._able(pattern, f"paint '{pattern}={_shown(paint)}'"):
                self.changes[face.name] = Change(True, coating, models, frozenset(KINDS))
        for pattern, models_given in rules.scatter.items():
            found = [self._model(item) for item in _listed(models_given)]
            clean, more = None in found, [self._named(model) for model in found if model is not None]
            kinds = frozenset(KINDS) if clean else frozenset(model.kind for model in more)
            for face in self._able(pattern, f"scatter '{pattern}={_shown(models_given)}'"):
                change = self.changes.get(face.name, Change())
                kept = tuple(model for model in change.scatter if model.kind not in kinds)
                self.changes[face.name] = replace(change, scatter=(*kept, *more), drops=change.drops | kinds)

    def _able(self, pattern: str, rule: str, transmits: bool = False, coats: bool = False) -> list[Face]:
        """
        Return the surfaces that a pattern matches and that can take the coating, paint or scatter model of a rule.

        Raise `MistrayError` if nothing matches, if the only match or a surface given by its exact name cannot take it,
        or if no match can. Other surfaces that cannot take it are added to `left`. With `coats` the rule is a coating,
        and with `transmits` one that transmits light, see `_refusal`. `rule` is for messages.
        """
        fitting = [face for face in self._faces if face.fits(pattern)]
        if not fitting:
            meant = renamed_in(self._provenance).get(pattern)
            if meant is not None:
                raise MistrayError(
                    f"{self._where}: {rule} fits no surface and no part; did you mean '{meant}'? '{pattern}' is a name "
                    "of the lens file"
                )
            names = dict.fromkeys(name for face in self._faces for name in (face.name, face.part) if name)
            near = difflib.get_close_matches(re.sub(r"[*?]+$", "", pattern), names, n=OFFERED, cutoff=0.3)
            hint = ", ".join(near or list(names)[:OFFERED])
            raise MistrayError(f"{self._where}: {rule} fits no surface and no part; the nearest names are {hint}")
        able: list[Face] = []
        for face in fitting:
            named = face.name == pattern
            why = face.fault or (_refusal(face, named, transmits) if coats else "")
            if not why:
                able.append(face)
            elif named or len(fitting) == 1:
                raise MistrayError(f"{self._where}: {rule}: '{face.name}' {why}{_remedy(why)}")
            else:
                self.left.append(Left(face.name, pattern, why))
        if not able:
            reasons = sorted({item.why for item in self.left if item.pattern == pattern})
            raise MistrayError(
                f"{self._where}: {rule}: each of its {len(fitting)} surfaces {' or '.join(reasons)}"
                f"{_remedy(reasons[0])}"
            )
        return able

    def _on_body(self, coating: Coating | None, face: Face, rule: str) -> Coating | None:
        """
        Return a coating preset as layers fitted to the substrate of a surface in air.

        Any other coating, None included, is returned as it is, and so is a preset that needs no change. A preset that
        cannot be fitted raises `MistrayError`.
        """
        body = face.back if is_gas(face.front) else face.front
        if coating is None or coating.preset is None or coating.opaque or face.cemented or is_gas(body):
            return coating
        body = resolved(body, self._beside)
        with errors_of(f"{self._where}: {rule}: '{face.name}'"):
            fitted = fitted_preset(coating.preset, body, coating.design_nm)
        note = f"{coating.preset} on {body}: {fitted}"
        if note not in self.notes:
            self.notes.append(note)
        if not fitted.changed:
            return coating
        name = plain_name(f"{coating.name}_{body}")
        return Coating(layers=layer_text(fitted.stack.layers), first=coating.first, name=name)

    def _closed(self, coating: Coating | None) -> bool:
        """True if a coating is known to transmit no light."""
        own = coating is not None and self._coatings.get(coating.name or "") == coating
        return coating is not None and coating.blocks(self._beside if own else str)

    def _finish(self, paint: str | float | Finish) -> Finish:
        if isinstance(paint, Finish):
            return paint
        if isinstance(paint, str):
            return finish(paint, known_finishes(self._shared.values()))
        if paint == 0:
            return Finish(BLACK)
        return Finish(BLACK, (Scatter("paint", {"reflectance": float(paint)}),))

    def _model(self, given: str | Scatter) -> Scatter | None:
        if isinstance(given, Scatter):
            return given
        found = scatter_of(given, self._scatter)
        if found is None and given != CLEAN:
            near = difflib.get_close_matches(" ".join(given.split()[:1]), [*self._scatter, *KINDS], n=1)
            hint = f"did you mean '{near[0]}'? " if near else ""
            raise MistrayError(
                f"scatter '{given}': there is none of this name; {hint}give a plugin with its properties, such as "
                f"'harvey_shack rms_nm=4', '{CLEAN}'"
                + (f", or one of the scene: {', '.join(self._scatter)}" if self._scatter else "")
            )
        return found

    def _named(self, item: Any) -> Any:
        """
        Return a coating or scatter model under a name that no different one of the system uses.

        One without a name is not shared and stays as it is.
        """
        if item is None or item.name is None:
            return item
        name, number = item.name, 2
        while name in self._taken and self._shared.get(name) != replace(item, name=name):
            name, number = f"{item.name}_{number}", number + 1
        self._taken.add(name)
        self._shared[name] = found = replace(item, name=name)
        return found


def _design_nm(light_nm: Sequence[float]) -> float:
    """
    Return the default reference wavelength, nm, of layers given in waves, for the source wavelengths, nm.

    It is the default of a coating or, if all wavelengths are invisible, the middle of their range.
    """
    if not light_nm or any(VISIBLE_NM[0] <= nm <= VISIBLE_NM[1] for nm in light_nm):
        return Coating.design_nm
    return (min(light_nm) + max(light_nm)) / 2


def _refusal(face: Face, named: bool, transmits: bool) -> str:
    """
    Return the reason why a surface takes no coating; "" if it takes one.

    `named` says that its exact name was given, `transmits` that the coating transmits light.
    """
    if face.opaque and (transmits or not (named or face.mirror)):
        return OPAQUE
    return CEMENTED if face.cemented and not named else ""


def _remedy(why: str) -> str:
    return {
        OPAQUE: "; give an opaque coating, such as protected_al or R=0.9, or a paint",
        CEMENTED: "; to coat a surface between two solids, give its own name",
    }.get(why, "")


def _listed(given: str | Scatter | Sequence[str | Scatter]) -> Iterable[str | Scatter]:
    return (given,) if isinstance(given, str | Scatter) else given


def _shown(given: Any) -> str:
    """Return the coating, paint or models of a rule in words, for messages."""
    if isinstance(given, str | float | int) or given is None:
        return str(given)
    if isinstance(given, Coating | Scatter | Finish):
        return str(getattr(given, "name", None) or type(given).__name__)
    return ", ".join(map(_shown, given))
