"""Ranges of numbers, stated once for constructors, files, the command line and plugins of scenes.

A dataclass has them as metadata of its fields, see `Demand.field`, and its constructor calls `check_fields`. An
argument of the command line has a range as its type, and its help states the range. Plugins call `Range.check`.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import math
import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from numbers import Number
from typing import Any, ClassVar

from mistray.errors import MistrayError, nearest

_KEY, _DOC = "range", "doc"
LONGEST_VALUE = 300  # letters in a message


def several(given: Any) -> list[Any]:
    """Return an argument as a list: the items of a sequence, or the single value (text included) alone."""
    return [_of_python(given)] if _single(given) else list(given)


def _single(given: Any) -> bool:
    """True for an argument that is one value, such as a number or a text, and no sequence of values."""
    return isinstance(given, str | bytes) or not isinstance(given, Iterable) or getattr(given, "ndim", 1) == 0


def shown(value: Any) -> str:
    """Return a value as text in one line for a message; a text beyond `LONGEST_VALUE` characters is cut."""
    text = f"{value:g}" if isinstance(value, float) else " ".join(repr(value).split())
    return text if len(text) <= LONGEST_VALUE else f"{text[: LONGEST_VALUE - 1]}…"


class Demand:
    """
    Condition on a value: a range of numbers, a choice of words, or a type.

    Attributes
    ----------
    demand : str
        Condition in words, for messages.
    also : tuple of mapping
        JSON schemas of further allowed values, which the range, the words or the type do not cover.
    """

    demand: str
    also: ClassVar[tuple[Mapping[str, Any], ...]] = ()

    def check(self, name: str, value: Any, owner: str = "") -> Any:
        """Return the value if it is allowed; otherwise raise `MistrayError`, see `Range.check`."""
        raise NotImplementedError

    def check_all(self, owner: str, /, **values: Any) -> None:
        """Raise `MistrayError` if a keyword value is not allowed, see `Range.check`; None is always allowed."""
        for name, value in values.items():
            if value is not None:
                self.check(name, value, owner)

    def field(self, default: Any = dataclasses.MISSING, doc: str = "", kw_only: Any = dataclasses.MISSING) -> Any:
        """
        Return a dataclass field with this condition and the help text `doc`.

        `default` and `kw_only` are those of `dataclasses.field`. `check_fields` says where None is allowed.
        """
        return dataclasses.field(default=default, kw_only=kw_only, metadata={_KEY: self, _DOC: doc})


@dataclass(frozen=True)
class Range(Demand):
    """
    A range of numbers; it also serves as the type of a command-line argument.

    Attributes
    ----------
    low, high : float
        Ends of the range, in the unit of the number.
    above, below : bool
        Whether `low` or `high` itself is excluded from the range.
    unit : str
        Unit of the number, for messages.
    whole : bool
        Whether only whole numbers are allowed; the command line accepts "1e6" as one.
    remedy : str
        Advice for a number outside, if the range does not say enough.
    """

    low: float = -1e30
    high: float = 1e30
    above: bool = False
    below: bool = False
    unit: str = ""
    whole: bool = False
    remedy: str = ""

    def __contains__(self, value: float) -> bool:
        # NaN is in no range
        return (self.low < value if self.above else self.low <= value) and (
            value < self.high if self.below else value <= self.high
        )

    def __str__(self) -> str:
        low, high = number_text(self.low), number_text(self.high)
        return f"{'> ' if self.above else ''}{low} … {'< ' if self.below else ''}{high}"

    @property
    def demand(self) -> str:  # type: ignore[override]  # read-only
        """Condition that a number must meet, in words, such as "must lie between 0 and 90 degrees", and any remedy."""
        ends = {(True, True): ", both excluded", (True, False): f", {number_text(self.low)} excluded",
                (False, True): f", {number_text(self.high)} excluded"}.get((self.above, self.below), "")  # fmt: skip
        unit = f" {self.unit}" if self.unit else ""
        remedy = f"; {self.remedy}" if self.remedy else ""
        kind = "be a whole number" if self.whole else "lie"
        return f"must {kind} between {number_text(self.low)} and {number_text(self.high)}{unit}{ends}{remedy}"

    def check(self, name: str, value: Any, owner: str = "") -> Any:
        """
        Return the number, converted to int if it must be whole, and from NumPy to Python.

        Parameters
        ----------
        name : str
            Name of the number, for the message.
        value : float
            Number to check.
        owner : str
            Owner of the number, such as "shape 'L1'".

        Raises
        ------
        MistrayError
            If the value is not a number, is not whole where it must be, or lies outside the range.
        """
        number, value = math.nan, _of_python(value)
        if not isinstance(value, bool | str | bytes):
            with contextlib.suppress(TypeError, ValueError, OverflowError):
                number = float(value)
        if number not in self or (self.whole and number != math.floor(number)):
            remedy = "" if _single(value) else "; give a single number"
            raise MistrayError(f"{_titled(name, owner)} is {shown(value)}; it {self.demand}{remedy}")
        if self.whole:
            return int(value)
        return number if isinstance(value, Number) and not isinstance(value, int | float) else value

    def check_each(self, name: str, values: Any, owner: str = "") -> list[float]:
        """
        Return a list of floats, or of ints if they must be whole, from a single number or a sequence.

        Parameters
        ----------
        name, owner
            Name and owner of the numbers, as for `check`.
        values : float or sequence of float
            Numbers to check.

        Raises
        ------
        MistrayError
            If the list is empty, or an entry is not allowed, see `check`.
        """
        numbers = [values] if isinstance(values, Mapping) else several(values)
        if not numbers:
            unit = f" in {self.unit}" if self.unit else ""
            raise MistrayError(f"{_titled(name, owner)} is empty; give at least one number{unit}")
        found = [self.check(name, number, owner) for number in numbers]
        return found if self.whole else [float(number) for number in found]

    def __call__(self, text: str) -> Any:
        """Return a word of the command line as a number in the range; raise an `argparse` error if it is not one."""
        number = math.nan
        with contextlib.suppress(ValueError):
            number = float(text)
        if math.isnan(number):
            raise argparse.ArgumentTypeError(f"'{text}' is not a number")
        try:
            return self.check("", number)
        except MistrayError:
            raise argparse.ArgumentTypeError(f"{text} {self.demand}") from None


@dataclass(frozen=True)
class Words(Demand):
    """
    Condition that a string is one of some choices.

    Attributes
    ----------
    choices : tuple of str
        Allowed strings.
    """

    choices: tuple[str, ...]

    @property
    def demand(self) -> str:  # type: ignore[override]  # read-only
        """Condition that a string must meet, in words, such as "must be one of a, b"."""
        return f"must be one of {', '.join(self.choices)}"

    def check(self, name: str, value: Any, owner: str = "") -> Any:
        """Return the string if it is one of the choices; otherwise raise `MistrayError`, see `Range.check`."""
        if not isinstance(value, str) or value not in self.choices:
            raise MistrayError(f"{_titled(name, owner)} is {shown(value)}; {nearest(str(value), self.choices)}")
        return value


@dataclass(frozen=True)
class OfType(Demand):
    """
    Condition that a value has a given type.

    Attributes
    ----------
    kind : type
        Type of allowed values, or a union of types.
    demand : str
        Condition in words, for messages.
    """

    kind: Any
    demand: str

    def check(self, name: str, value: Any, owner: str = "") -> Any:
        """Return the value; raise `MistrayError` if it is of another type or an empty string, see `Range.check`."""
        value = _of_python(value) if self.kind is bool else value
        if not isinstance(value, self.kind) or (isinstance(value, str) and not value):
            raise MistrayError(f"{_titled(name, owner)} is {shown(value)}; it {self.demand}")
        return value


class Anything(Demand):
    """Condition that every value meets, for what is checked where it is used."""

    demand = "may be anything"

    def check(self, name: str, value: Any, owner: str = "") -> Any:
        """Return the value."""
        return value


@dataclass(frozen=True)
class OfRange(Demand):
    """
    Base of conditions on several numbers in one range.

    Attributes
    ----------
    of : Range
        Range of each number.
    """

    of: Range

    @property
    def demand(self) -> str:  # type: ignore[override]  # read-only
        """Condition that each number must meet, in words for messages."""
        return self.of.demand


@dataclass(frozen=True)
class Each(OfRange):
    """
    Condition that a value is one number or several, each within the range.

    Attributes
    ----------
    count : int
        Required number of values; 0 allows any number.
    least : int
        Smallest number of values, 1 or 0.
    """

    count: int = 0
    least: int = 1

    def check(self, name: str, value: Any, owner: str = "") -> tuple[float, ...]:
        """Return the values as a tuple; raise `MistrayError` if there are too few or many, or one is out of range."""
        numbers = [value] if _single(value) or isinstance(value, Mapping) else several(value)
        if self.count and len(numbers) != self.count:
            has = f"is {shown(value)}" if _single(value) else f"has {len(numbers)} numbers"
            raise MistrayError(f"{_titled(name, owner)} {has}; give {self.count} numbers")
        return tuple(self.of.check_each(name, numbers, owner)) if numbers or self.least else ()


@dataclass(frozen=True)
class Ascending(Each):
    """
    Condition on numbers, which are sorted and freed of duplicates.

    The command line also takes ranges first:last:step.
    """

    def check(self, name: str, value: Any, owner: str = "") -> tuple[float, ...]:
        """Return the numbers in ascending order without duplicates; raise `MistrayError` as `Each.check` does."""
        return tuple(sorted(set(super().check(name, value, owner))))


@dataclass(frozen=True)
class Interval(OfRange):
    """Condition that a value is an interval: two ends within the range, the lower one first."""

    def check(self, name: str, value: Any, owner: str = "") -> tuple[float, float]:
        """Return the two ends; raise `MistrayError` unless there are two, both in range, the first below the second."""
        ends = self.of.check_each(name, value, owner)
        before = _titled(name, owner)
        if len(ends) != 2:
            raise MistrayError(f"{before} has {len(ends)} numbers; give two, the lower one first")
        if ends[0] >= ends[1]:
            raise MistrayError(f"{before} is {ends[0]:g} to {ends[1]:g}; give the lower one first")
        return ends[0], ends[1]


@dataclass(frozen=True)
class Several(Demand):
    """
    Condition on one or several values that are not numbers; `Each` is for numbers.

    Attributes
    ----------
    of : Demand
        Condition on each value; if it is callable, it converts a text of the command line to a value.
    least : int
        Smallest number of values.
    """

    of: Demand
    least: int = 1

    @property
    def demand(self) -> str:  # type: ignore[override]  # read-only
        """Condition that each value must meet, as words for messages."""
        return self.of.demand

    def check(self, name: str, value: Any, owner: str = "") -> tuple[Any, ...]:
        """Return the values as a tuple; raise `MistrayError` if there are too few, or one fails its condition."""
        values = [value] if isinstance(value, Mapping) else several(value)
        if len(values) < self.least:
            raise MistrayError(f"{_titled(name, owner)} is empty; give at least one")
        return tuple(self.of.check(name, one, owner) for one in values)


@dataclass(frozen=True)
class ByName(Demand):
    """
    Condition on a mapping from names, or patterns of names, to numbers or strings.

    Attributes
    ----------
    of : Demand
        Condition on each value.
    example : str
        Example of a pair such as "detector=77", for the command line.
    """

    of: Demand
    example: str

    @property
    def demand(self) -> str:  # type: ignore[override]  # read-only
        """Condition that each value of the mapping must meet, in words for messages."""
        return self.of.demand

    def check(self, name: str, value: Any, owner: str = "") -> dict[str, Any]:
        """Return a dict; raise `MistrayError` unless it is a mapping of strings, not blank, to allowed values."""
        before = _titled(name, owner)
        if not isinstance(value, Mapping) or not all(isinstance(key, str) and key.strip() for key in value):
            raise MistrayError(f"{before} is {shown(value)}; give a mapping from names to values, as of {self.example}")
        return {key: self.of.check(f"{name} of '{key}'", number, owner) for key, number in value.items()}


def _of_python(value: Any) -> Any:
    """Return a NumPy scalar, or array of no dimensions, as a Python object; any other value unchanged."""
    return value.item() if type(value).__module__ == "numpy" and not getattr(value, "ndim", 1) else value


def _titled(name: str, owner: str) -> str:
    """Return the start of an error message: ``owner: name``, or the name alone."""
    return f"{owner}: {name}" if owner else name


def demand_of(field: dataclasses.Field[Any]) -> Demand | None:
    """Return the condition declared for a dataclass field; None if there is none."""
    return field.metadata.get(_KEY)


def type_of(declared: Any) -> str:
    """Return the name of a type annotation, given as a string or as a type."""
    return declared if isinstance(declared, str) else getattr(declared, "__name__", str(declared))


def doc_of(field: dataclasses.Field[Any]) -> str:
    """Return the help text of a field of a dataclass for the command line; "" if it has none."""
    return str(field.metadata.get(_DOC, ""))


def check_fields(settings: Any, owner: str = "") -> None:
    """
    Check the values of a dataclass by the conditions on its fields.

    None is allowed where the type or the default says so, and "" where it is the default.
    Numbers that must be whole become int, and a single value becomes a tuple where a field has several.

    Parameters
    ----------
    settings : dataclass
        Object whose fields are checked.
    owner : str
        Owner of the values, for the message, see `Range.check`.

    Raises
    ------
    MistrayError
        If a value does not meet its condition.
    """
    for field in dataclasses.fields(settings):
        value = getattr(settings, field.name)
        if (
            _KEY in field.metadata
            and not (value is None and _optional(field))
            and not (field.default == "" and isinstance(value, str) and not value)
        ):
            object.__setattr__(settings, field.name, field.metadata[_KEY].check(field.name, value, owner))


def _optional(field: dataclasses.Field[Any]) -> bool:
    """True if a field of a dataclass may be None, by its default or its type."""
    return field.default is None or not {"None", "Any"}.isdisjoint(re.findall(r"\w+", type_of(field.type)))


def number_text(value: float) -> str:
    """Return a number as text of at most ten digits, without padding of the exponent, such as 4294967295 or 1e-6."""
    short = f"{value:g}"
    return re.sub(r"e\+?(-?)0*", r"e\1", short if float(short) == value else f"{value:.10g}")


TEXT = OfType(str, "must be text")
FLAG = OfType(bool, "must be true or false")
ANYTHING = Anything()

# Numbers of which nothing more is known: the kernel has float32, whose products need room
FINITE = Range()
NOT_NEGATIVE = Range(0.0)
POSITIVE = Range(1e-30)
SHARE = Range(0.0, 1.0)

# Of a trace
RAYS = Range(1, 2**32 - 1, whole=True, remedy="use several seeds for more")
CONTESTED_RAYS = Range(0, RAYS.high, whole=True, remedy=RAYS.remedy)
LIVE_RAYS = Range(1, 10**7, whole=True, remedy="a trace must end while somebody looks; mistray ghosts takes more")
SEED = Range(0, 2**32 - 1, whole=True)
LIMIT = Range(0, 2**15 - 1, whole=True)  # of reflections or scatters: the most is more than a path can have
SEGMENTS = Range(1, 2**32 - 1, whole=True)
EVENTS = Range(1, 1000, whole=True)  # scatter events of a path are counted with ten bits
CONSECUTIVE = Range(1, LIMIT.high, whole=True)
RAYS_PER_HIT = Range(1, 255, whole=True)
AIMED_RAYS = Range(0, 255, whole=True)
THRESHOLD = Range(0.0, 1.0, below=True, remedy="it is relative to a start ray")
RELATIVE_ERROR = Range(1e-5, 1.0, below=True, remedy="0.02 is 2 %")
THREADS = Range(1, os.cpu_count() or 1, whole=True, remedy="that is what this machine has")

# Of light
WAVELENGTH_NM = Range(10.0, 1e7, unit="nm", remedy="0.55 µm are 550 nm")
WAVELENGTH_UM = Range(0.01, 1e4, unit="µm")
WEIGHT = NOT_NEGATIVE
WAVELENGTHS_NM, WEIGHTS = Each(WAVELENGTH_NM), Each(WEIGHT)
TEMPERATURE_K = Range(0.0, 1e6, unit="K")
BANDWIDTH_HZ = Range(1e-9, 1e15, unit="Hz")
DETECTIVITY = Range(1.0, 1e30, unit="cm √Hz/W", remedy="1e11 is usual at 10 µm")
QUANTUM_EFFICIENCY = Range(0.0, 1.0, above=True)

# Of directions, degrees
FIELD_DEG = Range(-90.0, 90.0, above=True, below=True, unit="degrees")
HALF_FIELD_DEG = Range(0.0, 90.0, below=True, unit="degrees")
PST_FIELD_DEG = Range(-90.0, 90.0, unit="degrees")
POLAR_DEG = Range(0.0, 90.0, unit="degrees")
AZIMUTH_DEG = Range(-360.0, 360.0, unit="degrees")
TILT_DEG = Each(FINITE, 3)  # about x, y and z
CONE_DEG = Range(1e-6, 90.0, unit="degrees")  # half angle
CELL_WIDTH_DEG = Range(1e-6, 90.0, unit="degrees")
AZIMUTH_WIDTH_DEG = Range(1e-6, 360.0, unit="degrees")
SOLID_ANGLE_SR = Range(1e-30, 2 * math.pi, unit="sr")

# Of places and sizes
PLACE_MM = Range(-1e12, 1e12, unit="mm")
POINT_MM = Each(PLACE_MM, 3)
SIZE_MM = Range(1e-15, 1e12, unit="mm")
RADIUS_MM = Range(0.0, 1e12, unit="mm")  # or another length that may be 0
TOLERANCE_MM = Range(1e-6, 1e3, unit="mm")  # of facets
MARGIN = Range(0.0, 10.0)  # of clear radii
COEFFICIENT = Range(-1e300, 1e300)  # of aspheres, mm to the power of 1 less its order
COEFFICIENTS = Each(COEFFICIENT, least=0)

SPACE = Range(-1, 10**6, whole=True)  # optical space; -1: of none
TARGET_SCALE = Range(1e-6, 1e6)

# Of what is drawn and listed
ROWS = Range(0, 10**6, whole=True)
PIXELS = Range(1, 4096, whole=True)  # along a side
PIXELS_OR_NONE = Range(0, 4096, whole=True)
BLOCK = Range(0, 4096, whole=True)  # of pixels that are averaged
STOPS = Range(-200.0, 200.0)
FREQUENCY_PER_MM = Range(0.0, 1e9, unit="1/mm")
PUPIL_CELLS = Range(16, 1024, whole=True)
RAYS_DRAWN = Range(1, 10**5, whole=True)
RAYS_LISTED = Range(1, RAYS.high, whole=True)
RAYS_OR_ALL = Range(1, RAYS.high, whole=True, remedy="None stands for all")

FILM_SIDE = Range(1, 2**16, whole=True)
FILM_PIXELS = Range(1, 2**26, whole=True)  # 0.5 GB an image
FILM_SIDES = Each(FILM_SIDE, 2)  # columns and rows

# Of searches and comparisons
CHANCE = Range(1e-30, 1.0)
NORM = Range(1.0, 1e6, remedy="a smooth maximum takes 16, say")
PART = Range(0.0, 1.0, below=True)
FACTOR = Range(1.0, 1e6, above=True, remedy="it says how much smaller the metric shall become")
EDGE_WIDTH = Range(1e-6, 0.5, remedy="it is relative to the radius of a rim")
SEEDS = Range(2, 1000, whole=True)
SECONDS = Range(1e-3, 1e9, unit="s")
PORT = Range(1, 65535, whole=True)

# Of materials and coatings
INDEX = Range(1e-3, 1e5)  # n; of metals in the far infrared some thousands
EXTINCTION = Range(0.0, 1e5)  # k
ABBE_NUMBER = Range(1.0, 1e6)
INDEX_SHIFT = Range(-1e3, 1e3)
INDEX_STEP = Range(1e-6, 1e3)  # of a rough surface
LAYER_NM = Range(0.0, 1e9, unit="nm")
SCATTER_PER_MM = Range(0.0, 1e9, unit="per mm")

# Of scatter
SLOPE = Range(0.0, 100.0)  # g of an ABg
FALL = Range(-100.0, 0.0, below=True, remedy="a BSDF falls with the angle")  # s of Harvey and Shack
SPECTRUM_SLOPE = Range(0.0, 100.0, above=True)
EXPONENT = Range(1.0, 1e9)
LOBE_WIDTH = Range(1e-6, 1e6)
ROUGHNESS_NM = Range(0.0, 1e6, unit="nm")
LENGTH_UM = Range(1e-6, 1e9, unit="µm")
LEVEL = Range(1.0, 1e4, remedy="100 … 1000 is usual")  # of cleanliness
COVERAGE_PERCENT = Range(0.0, 100.0, above=True, unit="%")
BINDER_INDEX = Range(1.0, 100.0, above=True)
