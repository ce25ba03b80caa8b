"""Phone camera: window, five plastic aspheres, IR filter, detector, barrel."""

from __future__ import annotations

from pathlib import Path

from mistray.prescription import Prescription, from_json


def build() -> Prescription:
    """The lens of ``prescription.json`` with its barrel; its ``variants`` are reached through `from_json`."""
    return from_json(Path(__file__).with_suffix(".json"), beam="exact")
