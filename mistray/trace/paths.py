"""The path table: one row for each way from a source to the detector."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, overload

import numpy as np

from mistray.errors import MistrayError
from mistray.trace.ledger import ABSORBED, EVENT_BITS, REFLECTED, SUMS, TOTAL, TRANSMITTED
from mistray.trace.optics import DETECTOR, MIRROR, OPAQUE, WALL

if TYPE_CHECKING:
    import pandas as pd

    from mistray.trace.ledger import DecodedPaths
    from mistray.trace.tracer import Run

INTERCEPTS = {ABSORBED: "Absorbed", TRANSMITTED: "SpecTran", REFLECTED: "SpecRefl", TOTAL: "TIR"}
LETTERS = {ABSORBED: "A", TRANSMITTED: "T", REFLECTED: "R", TOTAL: "I"}


@dataclass(frozen=True)
class PathRow:
    """
    One path from a source to the detector. Every number with ``_se`` after it is that number's standard error.

    Attributes
    ----------
    path_id : int
        Rank by power, 0 is the strongest.
    source : str
        Id of the source.
    wavelength_nm : float
    events : str
        Surfaces and what happened there, ``L1_front:T L1_rear:R … detector:A``; T transmitted, R reflected, I totally
        internally reflected, A absorbed.
    path : str
        The letters alone.
    order : int
        Ghost reflections: at refracting surfaces and at the detector; mirrors and total internal reflection apart.
    kind : str
        "direct" (no reflection but at mirrors), "straight shot" (the same, past all optics or through an edge or bevel,
        that is, a ``frustum``), "ghost", "structure" (reflections at opaque surfaces that are no mirror),
        "structure+ghost", "TIR" (total internal reflections only).
    ghost_1, ghost_2 : str
        First and second surface that reflects, mirrors and total internal reflection apart, or "-".
    scatter_1 : str
        First surface that scatters; "-", because surfaces do not scatter yet.
    structure_bounces, tir : int
        Reflections at structure, total internal reflections.
    rays : int
        Hits of the detector.
    power_W : float
        Flux that the detector absorbs.
    incident_W : float
        Flux that reaches the detector.
    percent : float
        Of the power of all paths.
    x_mm, y_mm : float
        Centroid in the detector's frame.
    rms_radius_mm : float
        RMS distance from the centroid.
    rms_irradiance_W_mm2 : float
        power / (π · rms_radius²).
    polarization : float
        Degree of polarisation of all light of the path together, 0 … 1; NaN if traced unpolarised.
    """

    path_id: int
    source: str
    wavelength_nm: float
    events: str
    path: str
    order: int
    kind: str
    ghost_1: str
    ghost_2: str
    scatter_1: str
    structure_bounces: int
    tir: int
    rays: int
    power_W: float
    power_se_W: float
    incident_W: float
    incident_se_W: float
    percent: float
    percent_se: float
    x_mm: float
    x_se_mm: float
    y_mm: float
    y_se_mm: float
    rms_radius_mm: float
    rms_radius_se_mm: float
    rms_irradiance_W_mm2: float
    rms_irradiance_se_W_mm2: float
    polarization: float
    polarization_se: float

    @property
    def event_list(self) -> list[tuple[str, str]]:
        """(shape id, intercept type) of every event; the types are SpecTran, SpecRefl, TIR and Absorbed."""
        names = {LETTERS[code]: name for code, name in INTERCEPTS.items()}
        return [(name, names[letter]) for name, letter in (event.rsplit(":", 1) for event in self.events.split())]


class PathTable(Sequence[PathRow]):
    """
    Paths to the detector, the strongest first.

    A sequence of `PathRow`; `to_pandas` and `to_csv` give the whole table.
    """

    def __init__(self, rows: Sequence[PathRow], where: Sequence[tuple[int, int, int]]) -> None:
        self._rows = list(rows)
        # run, slot in its ledger, key
        self._places = {row.path_id: place for row, place in zip(self._rows, where, strict=True)}

    @overload
    def __getitem__(self, index: int) -> PathRow: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[PathRow]: ...
    def __getitem__(self, index: int | slice) -> PathRow | Sequence[PathRow]:
        return self._rows[index]

    def __len__(self) -> int:
        return len(self._rows)

    def __iter__(self) -> Iterator[PathRow]:
        return iter(self._rows)

    def locate(self, path_id: int) -> tuple[int, int, int]:
        """Run, ledger slot and key of a path; raises `MistrayError` for an id that does not exist."""
        if path_id in self._places:
            return self._places[path_id]
        raise MistrayError(f"path_id {path_id} does not exist; this trace has the paths 0 … {len(self) - 1}")

    def find(self, *surfaces: str) -> list[PathRow]:
        """
        Paths whose events match a sequence of words.

        Parameters
        ----------
        *surfaces : str
            Shape ids, each with an optional ``:T``, ``:R``, ``:I`` or ``:A``; they must occur in this order, other
            events may lie between. ``find("detector:R", "window_rear:R")`` are the detector-window ghosts.
        """
        pattern = ".* ".join(re.escape(word) + ("(?= )" if ":" in word else ":[TRIA](?= )") for word in surfaces)
        return [row for row in self if re.search(rf"(?:^| ){pattern}", row.events + " ")]

    def to_pandas(self) -> pd.DataFrame:
        """The table as a DataFrame, one column for each attribute of `PathRow`."""
        import pandas as pd

        return pd.DataFrame([asdict(row) for row in self], columns=[f.name for f in fields(PathRow)])

    def to_csv(self, path: str | Path) -> None:
        """Write the table as CSV, numbers with nine digits."""
        self.to_pandas().to_csv(path, index=False, float_format="%.9g")

    def __str__(self) -> str:
        lines = [f"{'id':>4} {'power W':>12} {'± se':>9} {'%':>9} {'rays':>9} {'rms mm':>10} {'kind':<16} reflects at"]
        for row in self._rows[:20]:
            lines.append(
                f"{row.path_id:>4} {row.power_W:>12.5e} {row.power_se_W:>9.1e} {row.percent:>9.4g} {row.rays:>9} "
                f"{row.rms_radius_mm:>10.4g} {row.kind:<16} {row.ghost_1} {row.ghost_2}"
            )
        more = len(self) - 20
        return "\n".join(lines + ([f"… and {more} more"] if more > 0 else []))


def path_table(runs: Sequence[Run], decoded: Sequence[DecodedPaths]) -> PathTable:
    """The table of all paths of all runs; paths without a hit are left out."""
    entries = []
    for number, (run, paths) in enumerate(zip(runs, decoded, strict=True)):
        for k in range(len(paths.keys)):
            if paths.sums[k, :, 0].sum() > 0:
                entries.append((number, k, run.unit * paths.sums[k, :, 2].sum()))

    def rank(entry: tuple[int, int, float]) -> tuple:
        """By power; equal ones by source, wavelength and events, whatever the order of the shapes in the file."""
        number, k, power = entry
        codes = decoded[number].codes[k]
        return -power, number, [(runs[number].table.ids[code >> EVENT_BITS], int(code)) for code in codes]

    entries.sort(key=rank)
    total = sum(entry[2] for entry in entries)
    rows, where = [], []
    for path_id, (number, k, _) in enumerate(entries):
        run, paths = runs[number], decoded[number]
        facts = describe_events(paths.codes[k], run.table.ids, run.table.optics.host_words)
        numbers = _numbers(paths.sums[k], run.started, run.unit)
        numbers["percent"] = float(100 * numbers["power_W"] / total)
        numbers["percent_se"] = float(100 * numbers["power_se_W"] / total)
        rows.append(
            PathRow(path_id=path_id, source=run.beam.name, wavelength_nm=run.beam.wavelength_nm, **facts, **numbers)
        )
        where.append((number, int(paths.slots[k]), int(paths.keys[k])))
    return PathTable(rows, where)


def describe_events(codes: np.ndarray, ids: Sequence[str], words: np.ndarray) -> dict:
    """Text and classification of an event list, as the fields of `PathRow`."""
    surfaces, kinds = codes >> EVENT_BITS, codes & ((1 << EVENT_BITS) - 1)
    reflecting = [
        (int(s), bool(words[s] & OPAQUE) and not words[s] & DETECTOR)
        for s, kind in zip(surfaces, kinds, strict=True)
        if kind == REFLECTED and not words[s] & MIRROR
    ]
    structure = sum(is_structure for _, is_structure in reflecting)
    order, tir = len(reflecting) - structure, int(np.sum(kinds == TOTAL))
    if order and structure:
        kind = "structure+ghost"
    elif order or structure:
        kind = "ghost" if order else "structure"
    elif tir:
        kind = "TIR"
    else:
        kind = "straight shot" if len(codes) == 1 or np.any(words[surfaces[:-1]] & WALL) else "direct"
    names = [ids[s] for s, _ in reflecting] + ["-", "-"]
    return {
        "events": " ".join(f"{ids[s]}:{LETTERS[int(k)]}" for s, k in zip(surfaces, kinds, strict=True)),
        "path": "".join(LETTERS[int(k)] for k in kinds),
        "order": order,
        "kind": kind,
        "ghost_1": names[0],
        "ghost_2": names[1],
        "scatter_1": "-",
        "structure_bounces": structure,
        "tir": tir,
    }


def _numbers(sums: np.ndarray, started: np.ndarray, unit: float) -> dict:
    """
    Power, centroid and radius of a path from its sums by batch; `started` are the start rays of the batches.

    The error of the power is that of a mean over the start rays, each of which takes the path at most once:
    se² = Σa² - (Σa)²/N. Centroid and radius are ratios of sums; their errors come from leaving out one batch at a time
    (jackknife).
    """
    total, rays = sums.sum(axis=0), started.sum()
    count, incident, absorbed, squares = total[:4]
    relative = np.sqrt(max(squares - absorbed**2 / rays, 0.0)) / absorbed

    def shape(s: np.ndarray) -> np.ndarray:
        """x, y, rms radius, rms irradiance, degree of polarisation of sums (…, SUMS)."""
        a = s[..., 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            x, y = s[..., 4] / a, s[..., 5] / a
            variance = np.maximum(s[..., 6] / a - x * x - y * y, 0.0)
            stokes = np.linalg.norm(s[..., SUMS:], axis=-1) / a if s.shape[-1] > SUMS else np.full(a.shape, np.nan)
            return np.stack([x, y, np.sqrt(variance), a * unit / (np.pi * variance), stokes])

    values = shape(total)
    # Without the batch, and the flux scaled to that of all batches
    without = total - sums
    without[:, 2:] *= (rays / np.maximum(rays - started, 1))[:, None]
    left_out = shape(without)
    n = left_out.shape[1]
    se = np.full(len(values), np.inf)
    known = np.isfinite(left_out).all(axis=1)  # not where a batch holds all rays, or all but one
    with np.errstate(invalid="ignore"):
        spread = np.square(left_out - left_out.mean(axis=1, keepdims=True))
    se[known] = np.sqrt((n - 1) / n * np.sum(spread, axis=1))[known]
    numbers = {
        "rays": int(count),
        "power_W": unit * absorbed,
        "power_se_W": unit * absorbed * relative,
        "incident_W": unit * incident,
        "incident_se_W": unit * incident * relative,
        "x_mm": values[0],
        "x_se_mm": se[0],
        "y_mm": values[1],
        "y_se_mm": se[1],
        "rms_radius_mm": values[2],
        "rms_radius_se_mm": se[2],
        "rms_irradiance_W_mm2": values[3],
        "rms_irradiance_se_W_mm2": se[3],
        "polarization": values[4],
        "polarization_se": se[4] if np.isfinite(values[4]) else np.nan,
    }
    return {key: value if isinstance(value, int) else float(value) for key, value in numbers.items()}
