"""Surfaces that scatter, one for each model, as the tests of the scatter plugins use them."""

from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.scatter.harvey_shack import HarveyShack
from mistray.scatter.measured.bsdf_csv import write_bsdf_csv
from mistray.scatter.scan import table

R, T = 0.2, 0.4
FRONT, BACK = 1.0, 1.5
EVENTS = ("reflection", "transmission")
RADIANCE, IMPORTANCE = mi.TransportMode.Radiance, mi.TransportMode.Importance
SPECTRUM = Path(__file__).parent / "data" / "psd_polish.csv"
MODELS: dict[str, dict[str, Any]] = {
    "abg": {"type": "abg", "A": 0.0025, "B": 0.001, "g": 1.8},
    "abg_narrow": {"type": "abg", "A": 2e-3, "B": 1e-9, "g": 2.0},
    "abg_lambertian": {"type": "abg", "A": 0.1, "B": 0.0, "g": 0.0},
    "edge_diffraction": {"type": "edge_diffraction", "width_mm": 0.05, "event": "transmission"},
    "harvey_shack": {"type": "harvey_shack", "rms_nm": 4.0, "l": 0.01, "s": -1.5},
    "k_correlation": {"type": "k_correlation", "rms_nm": 4.0, "B_um": 20.0, "slope": 2.5},
    "rayleigh_rice": {
        "type": "k_correlation", "rms_nm": 4.0, "B_um": 20.0, "slope": 2.5, "event": "reflection",
        "theory": "rayleigh_rice",
    },
    "gaussian_lobe": {"type": "gaussian_lobe", "total": 0.3, "width": 0.05},
    "phong": {"type": "phong", "b0": 2.0, "exponent": 40.0},
    "polynomial": {
        "type": "polynomial", "c000": 0.6, "c100": -0.8, "c010": 0.3, "c001": 0.5, "l10": -0.6, "l11": 0.1, "d": 2e3,
    },
    "psd_table": {"type": "psd_table", "file": str(SPECTRUM), "scale": 1.2},
    "particulate": {"type": "particulate", "level": 400.0},
    "paint": {"type": "paint", "reflectance": 0.03, "b0": 0.1, "l": 0.2, "s": -3.0, "n": 1.5, "event": "both"},
}  # fmt: skip


def surface(model: dict[str, Any], **more: Any) -> Any:
    """An interface with an ideal coating between 1.0 and 1.5 that a model scatters."""
    return mi.load_dict(
        {"type": "interface", "front": str(FRONT), "back": str(BACK), "R": R, "T": T, "model": model, **more}
    )


def context(mode: Any, event: str | None = None) -> mi.BSDFContext:
    made = mi.BSDFContext(mode)
    if event is not None:
        made.component = 2 + EVENTS.index(event)
    return made


def direction(angle_deg: float, front: bool, azimuth: float = 0.7) -> np.ndarray:
    """The direction towards the light, local frame, rounded to float32: the front is at z < 0."""
    t = np.radians(angle_deg)
    z = -np.cos(t) if front else np.cos(t)
    return np.array([np.sin(t) * np.cos(azimuth), np.sin(t) * np.sin(azimuth), z]).astype(np.float32).astype(float)


def interaction(wi: np.ndarray, count: int) -> mi.SurfaceInteraction3f:
    si = dr.zeros(mi.SurfaceInteraction3f, count)
    si.wi = mi.Vector3f(*map(float, wi))
    return si


def vectors(directions: np.ndarray) -> mi.Vector3f:
    return mi.Vector3f(np.ascontiguousarray(directions.T.astype(np.float32)))


def write_table(folder: Path) -> dict[str, Any]:
    """A `tabulated` model: a broad peak about the specular direction, in a CSV file."""
    file = folder / "measured.csv"
    write_bsdf_csv(table(HarveyShack(0.2, 0.2, -2.0), [0, 20, 40, 60, 75, 85], "normal"), file)
    return {"type": "tabulated", "file": str(file)}
