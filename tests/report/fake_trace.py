"""A small stand-in for `mistray.trace.Trace`: rays drawn from known discs, so that every number is known."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pandas as pd

PARTS = {
    "window_front": "window",
    "window_rear": "window",
    "L1_front": "L1",
    "L1_rear": "L1",
    "stop_wall": "stop",
    "detector": "detector",
}
LENS = ["window_front:T", "window_rear:T", "L1_front:T", "L1_rear:T"]
INTERCEPTS = {"T": "SpecTran", "R": "SpecRefl", "A": "Absorbed"}


@dataclass
class FakePath:
    """One path: a uniform disc of `radius` about (x, y) that holds `power` over `rays` rays."""

    events: list[str]
    kind: str
    power: float
    rays: int
    x: float = 0.0
    y: float = 0.0
    radius: float = 0.1
    ghost_1: str = "-"
    ghost_2: str = "-"
    order: int = 0
    structure_bounces: int = 0
    path_id: int = -1
    points: np.ndarray = field(default_factory=lambda: np.empty((0, 2)))

    @property
    def event_list(self) -> list[tuple[str, str]]:
        return [(name, INTERCEPTS[code]) for name, code in (event.split(":") for event in self.events)]

    def row(self, total: float) -> dict[str, object]:
        rms = float(np.sqrt(np.mean(np.sum((self.points - self.points.mean(0)) ** 2, axis=1))))
        with np.errstate(divide="ignore", invalid="ignore"):
            irradiance = float(np.float64(self.power) / (np.pi * rms**2))
        relative = 1 / np.sqrt(self.rays)
        return {
            "path_id": self.path_id,
            "wavelength_nm": 550.0,
            "events": " ".join(self.events),
            "path": "".join(event.split(":")[1] for event in self.events),
            "order": self.order,
            "kind": self.kind,
            "ghost_1": self.ghost_1,
            "ghost_2": self.ghost_2,
            "scatter_1": "-",
            "structure_bounces": self.structure_bounces,
            "tir": 0,
            "rays": self.rays,
            "power_W": self.power,
            "power_se_W": self.power * relative,
            "incident_W": self.power / 0.8,
            "percent": 100 * self.power / total,
            "x_mm": self.points[:, 0].mean(),
            "y_mm": self.points[:, 1].mean(),
            "rms_radius_mm": rms,
            "rms_irradiance_W_mm2": irradiance,
            "x_se_mm": rms * relative,
            "y_se_mm": rms * relative,
            "rms_radius_se_mm": rms * relative / 2,
            "rms_irradiance_se_W_mm2": irradiance * 2 * relative,
        }


class FakePaths(list):
    def to_pandas(self) -> pd.DataFrame:
        total = sum(path.power for path in self)
        return pd.DataFrame([path.row(total) for path in self])


class FakeTable:
    def __init__(self, frame: pd.DataFrame) -> None:
        self.frame = frame

    def to_pandas(self) -> pd.DataFrame:
        return self.frame


class FakeTrace:
    """The attributes of `mistray.trace.Trace` that reports read."""

    def __init__(self, paths: list[FakePath], field_deg: float = 0.0, launched: float = 5.0, cut_events: float = 0.0):
        rng = np.random.default_rng(1)
        self.paths = FakePaths(sorted(paths, key=lambda path: -path.power))
        self.extent = (-2.0, 2.0, -1.5, 1.5)
        self.shape = (60, 80)
        for number, path in enumerate(self.paths):
            path.path_id = number
            r = path.radius * np.sqrt(rng.random(path.rays))
            phi = 2 * np.pi * rng.random(path.rays)
            path.points = np.column_stack([path.x + r * np.cos(phi), path.y + r * np.sin(phi)])
        self.settings = {
            "scene": "fake",
            "rays": 1000,
            "field_deg": field_deg,
            "azimuth_deg": 0.0,
            "wavelength_nm": [550.0],
            "max_reflections": 2,
            "max_events": 32,
            "flux_threshold": 1e-8,
            "splitting": "split",
            "below_threshold": "cut",
            "seed": 0,
            "variant": "llvm_ad_rgb",
            "versions": {"mistray": "0.1.0", "mitsuba": "3.9.1"},
        }
        self.irradiance, self.irradiance_se = self.irradiance_of([path.path_id for path in self.paths])
        detected = sum(path.power for path in self.paths)
        escaped = 0.25 * launched
        absorbed = launched - detected - escaped - cut_events - 1e-6
        self.energy = SimpleNamespace(
            launched_W=launched,
            detected_W=detected,
            detected_se_W=0.001 * detected,
            absorbed={"stop_wall": (0.9 * absorbed, 1e-3), "L1_rear": (0.1 * absorbed, 1e-4)},
            escaped_W=escaped,
            cut={"flux_threshold": 1e-6, "max_events": cut_events, "max_reflections": 0.0, "medium": 0.0},
            closure=2e-7,
        )
        self.surfaces = FakeTable(
            pd.DataFrame(
                {
                    "id": list(PARTS),
                    "part": list(PARTS.values()),
                    "space": range(len(PARTS)),
                    "hits": 1000,
                    "incident_W": np.linspace(5, 1, len(PARTS)),
                    "incident_se_W": 0.01,
                    "absorbed_W": 0.1,
                    "absorbed_se_W": 0.001,
                }
            )
        )
        self.segments = 12345
        self.seconds = 0.25

    def irradiance_of(self, path_ids: list[int]) -> tuple[np.ndarray, np.ndarray]:
        x0, x1, y0, y1 = self.extent
        height, width = self.shape
        pixel = (x1 - x0) / width * (y1 - y0) / height
        total = np.zeros(self.shape)
        variance = np.zeros(self.shape)
        for number in path_ids:
            path = self.paths[number]
            counts, _, _ = np.histogram2d(
                path.points[:, 1], path.points[:, 0], bins=self.shape, range=[(y0, y1), (x0, x1)]
            )
            weight = path.power / path.rays / pixel
            total += counts * weight
            variance += counts * weight**2
        return total, np.sqrt(variance)

    def history(self, path_id: int, n: int = 8) -> SimpleNamespace:
        path = self.paths[path_id]
        rays = []
        for start in np.linspace(-0.8, 0.8, n):
            knots = [[0.0, start, -2.0], [0.0, start, 0.0], [0.0, start * 0.9, 1.0]]
            if path.order:
                knots += [[0.0, start * 0.5, 4.0], [0.0, start * 0.4, 1.0]]
            rays.append(np.array([*knots, [path.x, path.y, 5.0]]))
        return SimpleNamespace(rays=rays)


def trace_at(field_deg: float, cut_events: float = 0.0) -> FakeTrace:
    """A field with a direct image (below 18 degrees), two ghosts, a structure path and one of very few rays."""
    y = 0.1 * field_deg
    paths = [
        FakePath(
            [*LENS, "window_rear:R", "L1_front:R", "detector:A"],
            "ghost",
            2e-4,
            400,
            0,
            -y,
            0.5,
            "detector",
            "window_rear",
            2,
        ),
        FakePath(
            [*LENS, "detector:R", "L1_rear:R", "detector:A"], "ghost", 1e-4, 400, 0, y, 0.05, "detector", "L1_rear", 2
        ),
        FakePath(["stop_wall:R", *LENS, "detector:A"], "structure", 3e-6, 100, 0.5, y, 0.3, "stop_wall", "-", 0, 1),
        FakePath([*LENS, "stop_wall:R", "detector:A"], "structure", 1e-9, 3, -1.0, 1.0, 1e-5, "stop_wall", "-", 0, 1),
    ]
    if abs(field_deg) < 18:
        paths.append(FakePath([*LENS, "detector:A"], "direct", 3.0, 1000, 0, y, 0.02))
    return FakeTrace(paths, field_deg, cut_events=cut_events)
