"""Ledgers without a kernel: event lists and hits that a test writes down, in the form in which a run decodes them."""

from collections.abc import Mapping, Sequence
from types import SimpleNamespace

import numpy as np

from mistray.events import EVENT_BITS, LETTERS
from mistray.recorders.design_sequences import DesignSequences
from mistray.recorders.ledger import SUMS, DecodedPaths
from mistray.recorders.path_key import host_keys
from mistray.settings import BATCHES
from mistray.surfaces.optics import DETECTOR, DIFFRACTS, MIRROR, OPAQUE, WALL

GLASS, STRUCTURE, EDGE, RING = 0, OPAQUE, WALL, DIFFRACTS
SENSOR, REFLECTOR = OPAQUE | DETECTOR, OPAQUE | MIRROR
CODES = {letter: code for code, letter in LETTERS.items()}


def encode(lists: Sequence[str], ids: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """(p, k) uint32 events and (p,) lengths from texts such as "L1_front:T detector:A"."""
    numbers = {name: number for number, name in enumerate(ids)}
    rows = [
        [numbers[name] << EVENT_BITS | CODES[letter] for name, letter in (word.rsplit(":", 1) for word in text.split())]
        for text in lists
    ]
    lengths = np.array([len(row) for row in rows], dtype=np.int64)
    events = np.zeros((len(rows), int(lengths.max(initial=0))), dtype=np.uint32)
    for event, row in zip(events, rows, strict=True):
        event[: len(row)] = row
    return events, lengths


def design_of(surfaces: Mapping[str, int], *sequences: str) -> DesignSequences:
    events, lengths = encode(sequences, list(surfaces))
    lists: dict[int, list[tuple[int, ...]]] = {}
    for row, length in zip(events.tolist(), lengths.tolist(), strict=True):
        lists.setdefault(row[length - 1] >> EVENT_BITS, []).append(tuple(row[: length - 1]))
    return DesignSequences({detector: tuple(found) for detector, found in lists.items()})


def hit_sums(
    batch: np.ndarray, absorbed: np.ndarray, x: np.ndarray, y: np.ndarray, incident: np.ndarray | None = None
) -> np.ndarray:
    """(BATCHES, SUMS) of one path from its hits."""
    a = absorbed
    terms = [np.ones(len(a)), a if incident is None else incident, a, a * x, a * y, a * (x * x + y * y), a**2, a**4]
    sums = np.zeros((BATCHES, SUMS))
    np.add.at(sums, batch, np.transpose(terms))
    return sums


def decoded(events: np.ndarray, lengths: np.ndarray, sums: np.ndarray) -> DecodedPaths:
    return DecodedPaths(host_keys(events, lengths), np.arange(len(events)), events, lengths, sums)


def fake_run(
    surfaces: Mapping[str, int],
    paths: DecodedPaths,
    unit: float = 1.0,
    rays: int = 32_000,
    wavelength_nm: float = 550.0,
    design: Sequence[str] = (),
) -> SimpleNamespace:
    """What the path table reads of a run; `surfaces` are bits by names, `design` the sequences of the direct image."""
    return SimpleNamespace(
        source=SimpleNamespace(name="source", wavelength_nm=wavelength_nm),
        table=SimpleNamespace(
            event_ids=list(surfaces),
            event_parts=[name.split("_")[0].strip("()") for name in surfaces],
            event_words=np.array(list(surfaces.values()), dtype=np.uint32),
            count=sum(not name.startswith("(") for name in surfaces),
        ),
        started=np.full(BATCHES, rays / BATCHES),
        unit=unit,
        paths=paths,
        design=design_of(surfaces, *design),
    )
