"""Reads a study from TOML; every message is one line with the file, the key and the remedy."""

from __future__ import annotations

import difflib
import math
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mistray.coatings import Stack, parse_layers, preset
from mistray.errors import MistrayError
from mistray.optimize.metrics import KINDS
from mistray.optimize.study import METRICS, CoatingGroup, MetricStudy, Optimizer, Study

ALL = "all"
COATING_KEYS = ("name", "surfaces", "layers", "preset", "design_nm", "first", "thickness_nm")


def read_study(source: str | Path | Mapping[str, Any]) -> Study:
    """
    Read a study.

    Parameters
    ----------
    source : str, Path or mapping
        A TOML file, or its content as a dictionary. See docs/optimization.md for the keys. Files of materials are
        sought relative to the TOML file.

    Raises
    ------
    MistrayError
        If the file is missing or no TOML, a key is unknown or missing, or a value is impossible; one line with the
        file, the key and the remedy.
    """
    if isinstance(source, Mapping):
        return _Reader("study", dict(source), Path()).study()
    path = Path(source)
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise MistrayError(f"study '{path}': {error.strerror}; check the path") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise MistrayError(f"study '{path}': {error}; correct the TOML") from None
    return _Reader(f"study '{path}'", content, path.parent).study()


class _Reader:
    """Reads the sections of one study; every message names the study and the key."""

    def __init__(self, title: str, content: dict[str, Any], folder: Path) -> None:
        self.title, self.content, self.folder = title, content, folder

    def fail(self, key: str, text: str) -> MistrayError:
        return MistrayError(f"{self.title}: {key} {text}")

    def study(self) -> Study:
        self.known(self.content, "", ("metric", "coating", "optimizer"))
        for key in ("metric", "optimizer"):
            if not isinstance(self.content.get(key, {}), dict):
                raise self.fail(key, f"is {self.content[key]!r}; write a section [{key}]")
        coatings = self.content.get("coating")
        if not isinstance(coatings, list) or not coatings or not all(isinstance(item, dict) for item in coatings):
            raise self.fail("coating", "is missing or no section; add at least one section [[coating]]")
        groups = tuple(self.coating(item, number) for number, item in enumerate(coatings, start=1))
        names = [group.name for group in groups]
        for name in names:
            if names.count(name) > 1:
                raise self.fail("coating.name", f"'{name}' is given twice; give every [[coating]] a name of its own")
        return Study(
            self.title.removeprefix("study ").strip("'"),
            self.metric(self.content.get("metric", {})),
            groups,
            self.optimizer(self.content.get("optimizer", {})),
        )

    def known(self, section: dict[str, Any], prefix: str, keys: tuple[str, ...]) -> None:
        for key in section:
            if key not in keys:
                close = difflib.get_close_matches(key, keys, n=1)
                hint = f"did you mean '{close[0]}'?" if close else f"choose from {', '.join(keys)}"
                raise self.fail(f"{prefix}{key}", f"is unknown; {hint}")

    def number(self, section: dict[str, Any], key: str, place: str, default: float, low: float, high: float) -> float:
        value = section.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
            raise self.fail(f"{place}{key}", f"is {value!r}; it must be a number from {low:g} to {high:g}")
        return float(value)

    def whole(self, section: dict[str, Any], key: str, place: str, default: int, low: int, high: float) -> int:
        value = self.number(section, key, place, default, low, high)
        if value != int(value):
            raise self.fail(f"{place}{key}", f"is {value!r}; it must be a whole number")
        return int(value)

    def numbers(self, value: Any, key: str) -> tuple[float, ...]:
        """A number or a list of numbers."""
        values = value if isinstance(value, list) else [value]
        if not values or any(isinstance(v, bool) or not isinstance(v, int | float) for v in values):
            raise self.fail(key, f"is {value!r}; give a number or a list of numbers")
        if not all(math.isfinite(v) for v in values):
            raise self.fail(key, f"is {value!r}; the numbers must be finite")
        return tuple(float(v) for v in values)

    def metric(self, section: dict[str, Any]) -> MetricStudy:
        keys = tuple(MetricStudy.__dataclass_fields__)
        self.known(section, "metric.", keys)
        kind = section.get("kind", MetricStudy.kind)
        if kind not in METRICS:
            raise self.fail("metric.kind", f"is {kind!r}; choose from {', '.join(METRICS)}")
        paths = section.get("paths", MetricStudy.paths)
        if not isinstance(paths, str) or (paths not in KINDS and ":" not in paths):
            raise self.fail("metric.paths", f"is {paths!r}; use one of {', '.join(KINDS)} or the events of one path")
        fields = section.get("fields_deg")
        fields = None if fields is None else self.numbers(fields, "metric.fields_deg")
        if fields is not None and not all(-90 < angle < 90 for angle in fields):
            raise self.fail("metric.fields_deg", f"is {list(fields)}; angles lie between -90 and 90 degrees")
        wavelengths, weights = self.wavelengths(section), section.get("weights")
        if weights is not None:
            weights = self.numbers(weights, "metric.weights")
            if wavelengths is None or len(weights) != len(wavelengths):
                count = 0 if wavelengths is None else len(wavelengths)
                raise self.fail(
                    "metric.weights", f"has {len(weights)} entries for {count} wavelength_nm; give one each"
                )
            if min(weights) <= 0:
                raise self.fail("metric.weights", f"is {list(weights)}; weights are greater than 0")
        return MetricStudy(
            kind,
            paths,
            fields,
            wavelengths,
            weights,
            self.whole(section, "rays", "metric.", MetricStudy.rays, 1, 2**32 - 1),
            self.whole(section, "max_reflections", "metric.", MetricStudy.max_reflections, 0, 2**15 - 1),
            self.number(section, "flux_threshold", "metric.", MetricStudy.flux_threshold, 0.0, 0.5),
            self.whole(section, "seed", "metric.", MetricStudy.seed, 0, 2**31),
        )

    def wavelengths(self, section: dict[str, Any]) -> tuple[float, ...] | None:
        value = section.get("wavelength_nm")
        if value is None:
            return None
        if isinstance(value, dict):
            self.known(value, "metric.wavelength_nm.", ("start", "stop", "step"))
            missing = [key for key in ("start", "stop", "step") if key not in value]
            if missing:
                raise self.fail(
                    "metric.wavelength_nm", f"has no {missing[0]}; write {{start = 450, stop = 650, step = 25}}"
                )
            start, stop, step = (
                self.number(value, key, "metric.wavelength_nm.", 0.0, 1e-3, 1e9) for key in ("start", "stop", "step")
            )
            if stop < start:
                raise self.fail(
                    "metric.wavelength_nm", f"goes from {start:g} to {stop:g} nm; stop must not be below start"
                )
            result = tuple(float(v) for v in start + step * np.arange(math.floor((stop - start) / step + 1e-9) + 1))
        else:
            result = self.numbers(value, "metric.wavelength_nm")
        if min(result) <= 0 or len(set(result)) < len(result):
            raise self.fail("metric.wavelength_nm", f"is {list(result)}; give positive wavelengths in nm, each once")
        return result

    def coating(self, section: dict[str, Any], number: int) -> CoatingGroup:
        place = f"coating[{number}]."
        self.known(section, place, COATING_KEYS)
        name = section.get("name", f"coating_{number}")
        if not isinstance(name, str) or not name:
            raise self.fail(f"{place}name", f"is {name!r}; it must be text")
        surfaces = section.get("surfaces")
        if surfaces != ALL and not (
            isinstance(surfaces, list) and surfaces and all(isinstance(surface, str) for surface in surfaces)
        ):
            raise self.fail(f"{place}surfaces", f'is {surfaces!r}; give a list of shape ids, or "{ALL}"')
        if surfaces != ALL and len(set(surfaces)) < len(surfaces):
            raise self.fail(f"{place}surfaces", f"is {surfaces}; name every surface once")
        design_nm = self.number(section, "design_nm", place, 550.0, 1.0, 1e9)
        start = self.start(section, place, name, design_nm)
        bounds = self.bounds(section, place, len(start.layers))
        for k, (layer, (low, high)) in enumerate(zip(start.layers, bounds, strict=True), start=1):
            if not low <= layer.thickness_nm <= high:
                raise self.fail(
                    f"{place}thickness_nm",
                    f"is {low:g} … {high:g} nm, but layer {k} ({layer.material}) starts with "
                    f"{layer.thickness_nm:g} nm; widen the bounds or change the start",
                )
        return CoatingGroup(name, None if surfaces == ALL else tuple(surfaces), start, bounds, design_nm)

    def start(self, section: dict[str, Any], place: str, name: str, design_nm: float) -> Stack:
        given = [key for key in ("layers", "preset") if key in section]
        if len(given) != 1:
            raise self.fail(place.rstrip("."), f"has {' and '.join(given) or 'no start design'}; give layers or preset")
        (key,) = given
        if not isinstance(section[key], str):
            raise self.fail(f"{place}{key}", f"is {section[key]!r}; it must be text")
        first = section.get("first", "outside")
        try:
            if key == "layers":
                return Stack(parse_layers(section[key], design_nm, name, self.resolve), str(first), name)
            stack = preset(section[key], design_nm)
        except MistrayError as error:
            raise self.fail(f"{place}{key}:", str(error)) from None
        if stack.opaque:
            raise self.fail(f"{place}preset", f"is '{section[key]}', a mirror; give a coating that transmits")
        if "first" in section:
            raise self.fail(f"{place}first", "stands beside a preset, which knows its order; remove it or write layers")
        return Stack(stack.layers, stack.first, name)

    def resolve(self, path: str) -> str:
        """Path of a file of materials that is named relative to the study."""
        return path if Path(path).is_absolute() else str((self.folder / path).resolve())

    def bounds(self, section: dict[str, Any], place: str, layers: int) -> tuple[tuple[float, float], ...]:
        value = section.get("thickness_nm")
        pairs = value if isinstance(value, list) and value and isinstance(value[0], list) else [value] * layers
        form = "give [low, high] in nm, or one such pair for each layer"
        if len(pairs) != layers:
            raise self.fail(f"{place}thickness_nm", f"has {len(pairs)} pairs for {layers} layers; {form}")
        result = []
        for pair in pairs:
            if not isinstance(pair, list) or len(pair) != 2:
                raise self.fail(f"{place}thickness_nm", f"is {value!r}; {form}")
            low, high = self.numbers(pair, f"{place}thickness_nm")
            if not 0 <= low < high:
                raise self.fail(f"{place}thickness_nm", f"is {pair}; low must be at least 0 and less than high")
            result.append((low, high))
        return tuple(result)

    def optimizer(self, section: dict[str, Any]) -> Optimizer:
        self.known(section, "optimizer.", tuple(Optimizer.__dataclass_fields__))
        return Optimizer(
            self.whole(section, "steps", "optimizer.", Optimizer.steps, 0, 10_000),
            self.number(section, "tolerance", "optimizer.", Optimizer.tolerance, 0.0, 1.0),
            self.whole(section, "starts", "optimizer.", Optimizer.starts, 1, 100),
            self.whole(section, "searches", "optimizer.", Optimizer.searches, 1, 100),
        )
